//! The plain model's error over the ranges of the data's features.

use super::forward::{Feature, ForwardModel};
use super::observations::Observations;
use super::words::{after, digits, span};
use serde::Serialize;
use std::collections::BTreeSet;

/// Error of the plain model in one range of one feature.
#[derive(Clone, Debug, Serialize, PartialEq)]
pub struct Misfit {
    /// `speed`, `depth`, `angle`, `pass`, `place` or `shape`.
    pub by: String,
    pub unit: String,
    /// Range of the feature, or the shape's name.
    pub range: Option<[f64; 2]>,
    pub group: Option<String>,
    pub channel: String,
    /// Mean of measured − predicted, positive in the direction of the prediction [unit of the channel]; the next field is the root mean square.
    pub mean: f64,
    pub rms: f64,
    /// Mean error divided by the mean size of the prediction; None if this size is negligible.
    pub relative: Option<f64>,
    pub samples: usize,
}

/// A relative error is stated if the predicted size is at least this share of the error's size: our choice, because an error
/// relative to a negligible force has no meaning.
const PREDICTED: f64 = 0.2;

/// Number of ranges of a feature, each with the same number of samples: our choice, enough to show a trend.
const RANGES: usize = 5;

/// Errors of `prediction` in the ranges of every feature, and for every shape, over the units that count.
pub fn misfit(
    observations: &Observations,
    model: &dyn ForwardModel,
    prediction: &[f64],
    counts: impl Fn(usize) -> bool,
) -> Vec<Misfit> {
    let mut table = Vec::new();
    let mut add =
        |by: &str, unit: &str, range: Option<[f64; 2]>, group: Option<&str>, inside: &dyn Fn(usize, usize) -> bool| {
            for (c, channel) in observations.channels.iter().enumerate() {
                let (mut sum, mut sum_of_errors, mut square, mut size, mut count) = (0.0, 0.0, 0.0, 0.0, 0usize);
                for (u, unit) in observations.units.iter().enumerate().filter(|(u, _)| counts(*u)) {
                    for (_, k) in unit.block(c).enumerate().filter(|(i, _)| inside(u, *i)) {
                        let error = observations.values[k] - prediction[k];
                        sum += error * prediction[k].signum();
                        sum_of_errors += error.abs();
                        square += error * error;
                        size += prediction[k].abs();
                        count += 1;
                    }
                }
                let n = count as f64;
                table.extend((count > 0).then(|| Misfit {
                    by: by.into(),
                    unit: unit.into(),
                    range,
                    group: group.map(Into::into),
                    channel: channel.name.to_string(),
                    mean: sum / n,
                    rms: (square / n).sqrt(),
                    relative: (size > PREDICTED * sum_of_errors).then(|| sum / size),
                    samples: count,
                }));
            }
        };
    for Feature { name, unit, values } in &model.features() {
        for range in ranges(values) {
            add(name, unit, Some(range), None, &|u, i| (range[0]..=range[1]).contains(&values[u][i]));
        }
    }
    for group in (0..observations.units.len()).map(|u| model.group(u)).collect::<BTreeSet<_>>() {
        add("shape", "", None, Some(group), &|u, _| model.group(u) == group);
    }
    table
}

/// Ranges of a feature with equal numbers of samples; if the feature has only few different values, these values.
pub fn ranges(values: &[Vec<f64>]) -> Vec<[f64; 2]> {
    let mut all: Vec<f64> = values.iter().flatten().copied().collect();
    all.sort_by(f64::total_cmp);
    let mut distinct = all.clone();
    distinct.dedup_by(|a, b| (*a - *b).abs() <= 1e-9 * b.abs().max(1e-9));
    if distinct.len() <= RANGES {
        return distinct.iter().map(|v| [v - 1e-9 * v.abs().max(1e-9), v + 1e-9 * v.abs().max(1e-9)]).collect();
    }
    let edge = |k: usize| all[(k * (all.len() - 1)) / RANGES];
    (0..RANGES).map(|k| [edge(k), edge(k + 1)]).filter(|r| r[1] > r[0]).collect()
}

/// The report names a range if its error is this many times the smallest error of the same table: our choice, because
/// smaller differences may be noise.
const UNEVEN: f64 = 1.25;
/// An error counts as increasing or decreasing along a feature even if it reverses by up to this share of its greatest
/// size, which may be noise: our choice.
const DIP: f64 = 0.1;

/// Clauses that name the shape with the largest error of `prediction`, and the ranges of the features where the error is
/// large; `error` is the name of the error. None if the error is similar everywhere.
pub fn whereabouts(
    observations: &Observations,
    model: &dyn ForwardModel,
    prediction: &[f64],
    error: &str,
) -> Vec<String> {
    let everything = misfit(observations, model, prediction, |_| true);
    let shapes = sizes(&everything, "shape", observations);
    let least = shapes.iter().map(|s| s.1).fold(f64::MAX, f64::min);
    let worst = shapes.iter().max_by(|a, b| a.1.total_cmp(&b.1)).filter(|w| w.1 > UNEVEN * least);
    let worst = worst.and_then(|(row, _)| row.group.as_deref());
    let own = worst.map(|shape| misfit(observations, model, prediction, |u| model.group(u) == shape));
    let own = own.as_ref().unwrap_or(&everything);
    let unit = after(observations.error_unit());
    let mut said: Vec<(f64, String)> = Vec::new();
    for feature in model.features() {
        said.extend(course(&sizes(own, feature.name, observations), &unit));
    }
    said.sort_by(|a, b| b.0.total_cmp(&a.0));
    let places: Vec<String> = said.into_iter().take(3).map(|s| s.1).collect();
    let shape = worst.map(|name| {
        let sizes: Vec<String> =
            shapes.iter().map(|(row, size)| format!("{} {}", row.place(), digits(*size))).collect();
        format!("is largest for {name} (rms {}{unit})", sizes.join(", "))
    });
    let places = (!places.is_empty()).then(|| places.join(", "));
    let clauses = shape.into_iter().chain(places).zip([error, "there it"]);
    clauses.map(|(text, subject)| format!("{subject} {text}")).collect()
}

/// Root mean square error over all values of the channels that count, row by row of the feature `by`.
fn sizes<'a>(table: &'a [Misfit], by: &str, observations: &Observations) -> Vec<(&'a Misfit, f64)> {
    let counts = |m: &&Misfit| observations.channels.iter().any(|c| c.in_rmse && c.name == m.channel);
    let mut rows: Vec<(&Misfit, f64, f64)> = Vec::new();
    for row in table.iter().filter(|m| m.by == by).filter(counts) {
        let count = row.samples as f64;
        match rows.last_mut().filter(|last| (&last.0.range, &last.0.group) == (&row.range, &row.group)) {
            Some((_, square, all)) => (*square, *all) = (*square + count * row.rms * row.rms, *all + count),
            None => rows.push((row, count * row.rms * row.rms, count)),
        }
    }
    rows.into_iter().map(|(row, square, count)| (row, (square / count).sqrt())).collect()
}

/// The trend of an error along one feature, and the ratio of its greatest to its least size; None if the error is similar everywhere.
fn course(rows: &[(&Misfit, f64)], unit: &str) -> Option<(f64, String)> {
    let low = rows.iter().min_by(|a, b| a.1.total_cmp(&b.1))?;
    let high = rows.iter().max_by(|a, b| a.1.total_cmp(&b.1))?;
    let (first, last) = (rows.first()?, rows.last()?);
    let (ratio, by, slack) = (high.1 / low.1, &low.0.by, DIP * high.1);
    let said = |row: &(&Misfit, f64)| format!("{}{unit} at {}", digits(row.1), row.0.place());
    let text = if rows.is_sorted_by(|a, b| a.1 <= b.1 + slack) {
        format!("grows with {by} from {} to {}", said(first), said(last))
    } else if rows.is_sorted_by(|a, b| a.1 + slack >= b.1) {
        format!("falls with {by} from {} to {}", said(first), said(last))
    } else {
        format!("depends on {by}: it is largest with {} and least with {}", said(high), said(low))
    };
    (ratio > UNEVEN).then_some((ratio, text))
}

impl Misfit {
    /// The range of the feature, or the shape's name, as text.
    pub fn place(&self) -> String {
        match (&self.group, self.range) {
            (Some(group), _) => group.clone(),
            (None, Some(range)) => span(range, &self.unit),
            (None, None) => String::new(),
        }
    }
}
