//! Where the plain model errs, and what the error goes along with.

use super::forward::{Feature, ForwardModel};
use super::observations::{Channel, Observations};
use super::report::digits;
use serde::Serialize;

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
    /// Mean of (measured − predicted) along the predicted direction, and root mean square [unit of the channel].
    pub mean: f64,
    pub rms: f64,
    /// Mean error over mean predicted size: how wrong in proportion; none where next to nothing is predicted.
    pub relative: Option<f64>,
    pub samples: usize,
}

/// A proportion is stated where the predicted size is at least this share of the error's: our choice.
const PREDICTED: f64 = 0.2;

/// Ranges a feature is cut into, each with the same number of samples.
const RANGES: usize = 5;

/// Error of `prediction` by every feature and shape.
pub fn misfit(observations: &Observations, model: &dyn ForwardModel, prediction: &[f64]) -> Vec<Misfit> {
    let mut table = Vec::new();
    for feature in model.features() {
        for range in ranges(&feature) {
            let inside = |u: usize, i: usize| (range[0]..=range[1]).contains(&feature.values[u][i]);
            add(&mut table, observations, prediction, inside, &feature, Some(range), None);
        }
    }
    let mut groups: Vec<&str> = (0..observations.units.len()).map(|u| model.group(u)).collect();
    groups.sort_unstable();
    groups.dedup();
    let shape = Feature { name: "shape", unit: "", values: Vec::new() };
    for group in groups {
        add(&mut table, observations, prediction, |u, _| model.group(u) == group, &shape, None, Some(group));
    }
    table
}

/// Quantile ranges of a feature; its few values themselves where it takes few.
fn ranges(feature: &Feature) -> Vec<[f64; 2]> {
    let mut all: Vec<f64> = feature.values.iter().flatten().copied().collect();
    all.sort_by(f64::total_cmp);
    let mut distinct = all.clone();
    distinct.dedup_by(|a, b| (*a - *b).abs() <= 1e-9 * b.abs().max(1e-9));
    if distinct.len() <= RANGES {
        return distinct.iter().map(|v| [v - 1e-9 * v.abs().max(1e-9), v + 1e-9 * v.abs().max(1e-9)]).collect();
    }
    let edge = |k: usize| all[(k * (all.len() - 1)) / RANGES];
    (0..RANGES).map(|k| [edge(k), edge(k + 1)]).filter(|r| r[1] > r[0]).collect()
}

fn add(
    table: &mut Vec<Misfit>,
    observations: &Observations,
    prediction: &[f64],
    inside: impl Fn(usize, usize) -> bool,
    feature: &Feature,
    range: Option<[f64; 2]>,
    group: Option<&str>,
) {
    for (c, channel) in observations.channels.iter().enumerate() {
        let (mut sum, mut sum_of_errors, mut square, mut size, mut count) = (0.0, 0.0, 0.0, 0.0, 0usize);
        for (u, unit) in observations.units.iter().enumerate() {
            for (_, k) in unit.block(c).enumerate().filter(|(i, _)| inside(u, *i)) {
                let error = observations.values[k] - prediction[k];
                sum += error * prediction[k].signum();
                sum_of_errors += error.abs();
                square += error * error;
                size += prediction[k].abs();
                count += 1;
            }
        }
        if count > 0 {
            let n = count as f64;
            table.push(Misfit {
                by: feature.name.into(),
                unit: feature.unit.into(),
                range,
                group: group.map(Into::into),
                channel: channel.name.into(),
                mean: sum / n,
                rms: (square / n).sqrt(),
                relative: (size > PREDICTED * sum_of_errors).then(|| sum / size),
                samples: count,
            });
        }
    }
}

/// In one sentence: the two features over which the mean error of a counting channel changes most, and how.
pub fn worst(table: &[Misfit], channels: &[Channel]) -> Option<String> {
    let mut found: Vec<(f64, String)> = Vec::new();
    let mut features: Vec<&str> = table.iter().map(|m| m.by.as_str()).collect();
    features.dedup(); // the table stands feature by feature
    for by in features {
        let changes = channels.iter().filter(|c| c.in_rmse).filter_map(|channel| {
            let rows = || table.iter().filter(|m| m.by == by && m.channel == channel.name);
            let low = rows().min_by(|a, b| a.mean.total_cmp(&b.mean))?;
            let high = rows().max_by(|a, b| a.mean.total_cmp(&b.mean))?;
            let text = format!(
                "{} with {by}: {} to {}",
                channel.name,
                low.in_words(channel.unit),
                high.in_words(channel.unit)
            );
            Some((high.mean - low.mean, text))
        });
        found.extend(changes.max_by(|a, b| a.0.total_cmp(&b.0)));
    }
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    let said: Vec<String> = found.into_iter().filter(|f| f.0 > 0.0).take(2).map(|f| f.1).collect();
    (!said.is_empty()).then(|| format!("its error changes most in {}", said.join(" and in ")))
}

impl Misfit {
    fn in_words(&self, unit: &str) -> String {
        let place = match (&self.group, self.range) {
            (Some(group), _) => group.clone(),
            (None, Some(r)) if r[1] - r[0] < 1e-6 * r[1].abs() => format!("{} {}", digits(r[1]), self.unit),
            (None, Some(r)) => format!("{}–{} {}", digits(r[0]), digits(r[1]), self.unit),
            (None, None) => String::new(),
        };
        let share = self.relative.map_or(String::new(), |r| format!(" ({:+.0} %)", 100.0 * r));
        let sign = if self.mean > 0.0 { "+" } else { "" };
        format!("{sign}{} {unit}{share} at {place}", digits(self.mean))
    }
}

/// A feature that a whitened residual goes along with; never a cause.
#[derive(Clone, Debug, Serialize, PartialEq)]
pub struct Correlate {
    pub feature: String,
    pub channel: String,
    /// Change of the force per its own predicted size, when the feature goes from its least to its greatest value.
    pub strength: f64,
    pub delta_chi2: f64,
}

/// Terms of the sparse regression: our choice, more would not be read.
const TERMS: usize = 4;

/// Greedy sparse regression of the whitened residual on prediction × feature and on |prediction| × feature, features scaled
/// to −1…1 with their squares and products; terms enter while each lowers χ² by more than `gate`.
pub fn correlates(
    observations: &Observations,
    model: &dyn ForwardModel,
    prediction: &[f64],
    white: &[f64],
    whiten: impl Fn(&[f64]) -> Vec<f64>,
    gate: f64,
) -> Vec<Correlate> {
    let terms = dictionary(&model.features());
    let mut columns = Vec::new();
    for (name, values) in &terms {
        for (c, channel) in observations.channels.iter().enumerate() {
            let mut column = vec![0.0; prediction.len()];
            for (u, unit) in observations.units.iter().enumerate() {
                for (i, k) in unit.block(c).enumerate() {
                    column[k] = prediction[k] * values[u][i];
                }
            }
            columns.push((name.clone(), channel.name, whiten(&column)));
        }
    }
    let mut left = white.to_vec();
    let mut found: Vec<Correlate> = Vec::new();
    for _ in 0..TERMS {
        let gain = |column: &[f64]| {
            let (square, along) = (super::fit::dot(column, column), super::fit::dot(column, &left));
            if square > 1e-9 { (along * along / square, along / square) } else { (0.0, 0.0) }
        };
        let best = columns.iter().map(|c| (gain(&c.2), c)).max_by(|a, b| a.0.0.total_cmp(&b.0.0));
        let Some(((delta, strength), (name, channel, column))) = best else {
            break;
        };
        if delta <= gate {
            break;
        }
        left.iter_mut().zip(column).for_each(|(l, c)| *l -= strength * c);
        found.push(Correlate { feature: name.clone(), channel: (*channel).into(), strength, delta_chi2: delta });
    }
    found
}

/// Scaled features, their squares and products of two.
fn dictionary(features: &[Feature]) -> Vec<(String, Vec<Vec<f64>>)> {
    let scaled: Vec<(String, Vec<Vec<f64>>)> = features
        .iter()
        .filter_map(|f| {
            let low = f.values.iter().flatten().copied().fold(f64::MAX, f64::min);
            let high = f.values.iter().flatten().copied().fold(f64::MIN, f64::max);
            let scale = |v: &f64| (2.0 * v - low - high) / (high - low);
            (high - low > 1e-12)
                .then(|| (f.name.to_string(), f.values.iter().map(|u| u.iter().map(scale).collect()).collect()))
        })
        .collect();
    let mut all = scaled.clone();
    for (i, (a, left)) in scaled.iter().enumerate() {
        for (b, right) in &scaled[..=i] {
            let name = if a == b { format!("{a}²") } else { format!("{a} × {b}") };
            let values = left.iter().zip(right).map(|(l, r)| l.iter().zip(r).map(|(l, r)| l * r).collect()).collect();
            all.push((name, values));
        }
    }
    all
}
