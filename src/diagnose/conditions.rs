//! Describes conditions in words: by the intruder's shape or leg, and by the features that differ between conditions.

use super::forward::{Feature, ForwardModel};
use super::observations::Observations;
use super::series::ends;
use super::words::{after, digits};

/// A feature counts as constant within a trial if it varies by at most this share of its largest size in the trial: our choice,
/// because measured speeds vary by some percent.
const STEADY: f64 = 0.1;

/// A text for each condition, such as `L, speed 0.76 m/s, pass 2`. Features that are the same in all conditions, or that vary
/// within a trial, are left out. If several conditions have the same text, the name that each has in the data is added to its
/// text.
pub fn described(observations: &Observations, model: &dyn ForwardModel) -> Vec<String> {
    let firsts: Vec<usize> = observations.repetitions().iter().filter_map(|units| units.first().copied()).collect();
    let features = model.features();
    let telling: Vec<(&Feature, Vec<Option<f64>>)> = features
        .iter()
        .map(|feature| (feature, firsts.iter().map(|&u| steady(&feature.values[u])).collect::<Vec<_>>()))
        .filter(|(_, values)| values.iter().any(|v| *v != values[0]) && values.iter().all(Option::is_some))
        .collect();
    let text = |(k, &unit): (usize, &usize)| {
        let said = telling.iter().filter_map(|(feature, values)| Some(said(feature, values[k]?)));
        std::iter::once(model.group(unit).to_string()).chain(said).collect::<Vec<_>>().join(", ")
    };
    let texts: Vec<String> = firsts.iter().enumerate().map(text).collect();
    let full = |(k, text): (usize, &String)| match texts.iter().filter(|other| *other == text).count() {
        1 => text.clone(),
        _ => format!("{text} ({})", observations.conditions[k]),
    };
    texts.iter().enumerate().map(full).collect()
}

fn said(feature: &Feature, value: f64) -> String {
    let name = feature.name.trim_end_matches("_deg").replace('_', " ");
    // A value within the log's rounding is written as 0, and 2.00 as 2.
    let number = if value.abs() < 1e-9 { "0".into() } else { digits(value) };
    let number = if number.contains('.') { number.trim_end_matches('0').trim_end_matches('.') } else { &number };
    format!("{name} {}{}", number.replace('-', "−"), after(feature.unit).replace(" °", "°"))
}

/// The mean of values that hardly vary, rounded to three digits.
fn steady(values: &[f64]) -> Option<f64> {
    let [low, high] = ends(values.iter().copied());
    let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
    (high - low <= STEADY * low.abs().max(high.abs())).then(|| digits(mean).parse().ok())?
}
