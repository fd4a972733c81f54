//! The division of the data in which the plain model's error differs most.

use super::errors;
use super::forward::{Division, ForwardModel};
use super::observations::Observations;
use super::words::{after, digits};
use serde::Serialize;
use std::collections::BTreeSet;

/// One part of the data.
#[derive(Clone, Debug, Serialize, PartialEq)]
pub struct SplitPart {
    pub name: String,
    /// Measured less predicted, along the prediction, as a share of the prediction.
    pub error: f64,
    /// Root mean square error [unit of the error].
    pub rmse: f64,
    pub unit: String,
}

/// A division of the data, with the plain model's error in both parts.
#[derive(Clone, Debug, Serialize, PartialEq)]
pub struct Split {
    /// `direction`, `side`, `shape`, `pass`, `order`, or a feature of the data.
    pub by: String,
    pub parts: [SplitPart; 2],
}

impl Split {
    /// Both errors in words, such as `+0 % going in, +40 % coming out`.
    pub fn said(&self) -> String {
        self.parts.each_ref().map(|part| format!("{} {}", percent(part.error), part.name)).join(", ")
    }
}

/// A share in percent with its sign.
pub fn percent(share: f64) -> String {
    format!("{:+.0} %", 100.0 * share).replace('-', "−")
}

/// Least share of the predicted squares that a part must have: our choice; the error of a smaller part says little.
const LEAST: f64 = 0.05;

/// The division for which the parts' errors differ most: it explains the greatest share of the squared error. None if nothing is predicted.
pub fn split(o: &Observations, model: &dyn ForwardModel, prediction: &[f64]) -> Option<Split> {
    let scored = divisions(o, model).into_iter().filter_map(|division| score(o, prediction, &division));
    scored.max_by(|a, b| a.0.total_cmp(&b.0)).map(|best| best.1)
}

fn score(o: &Observations, prediction: &[f64], division: &Division) -> Option<(f64, Split)> {
    // Products of error and prediction, squares of the prediction, squares of the error, and their number.
    let mut sums = [[0.0; 4]; 2];
    for (u, unit) in o.units.iter().enumerate() {
        for (c, _) in o.channels.iter().enumerate().filter(|c| c.1.in_rmse) {
            for (i, k) in unit.block(c).enumerate() {
                let Some(part) = division.parts[u][i] else { continue };
                let (error, m) = (o.values[k] - prediction[k], prediction[k]);
                let own = &mut sums[usize::from(part)];
                *own = [own[0] + error * m, own[1] + m * m, own[2] + error * error, own[3] + 1.0];
            }
        }
    }
    let all = sums[0][1] + sums[1][1];
    let share = sums.map(|own| own[1] / all);
    if !(all > 0.0 && share.iter().all(|s| *s > LEAST)) {
        return None;
    }
    let part = |k: usize| SplitPart {
        name: division.names[k].clone(),
        error: sums[k][0] / sums[k][1],
        rmse: (sums[k][2] / sums[k][3]).sqrt(),
        unit: o.error_unit().into(),
    };
    let parts = [part(0), part(1)];
    let score = share[0] * share[1] * (parts[0].error - parts[1].error).powi(2);
    Some((score, Split { by: division.by.into(), parts }))
}

/// All divisions: those of the motion, each feature at its median, each shape against the others, and the order of the trials.
pub fn divisions(o: &Observations, model: &dyn ForwardModel) -> Vec<Division> {
    let mut all = model.divisions();
    for feature in model.features() {
        let mut sorted: Vec<f64> = feature.values.iter().flatten().copied().collect();
        sorted.sort_by(f64::total_cmp);
        let Some(&most) = sorted.last() else { continue };
        // The middle value; if it is the greatest one, the next smaller one.
        let middle = sorted[(sorted.len() - 1) / 2];
        let Some(&edge) = (if middle < most { Some(&middle) } else { sorted.iter().rev().find(|v| **v < most) }) else {
            continue;
        };
        let [name, unit] = [feature.name.trim_end_matches("_deg").replace('_', " "), after(feature.unit)];
        let names = ["at up to", "at more than"].map(|side| format!("{side} {} {name}", digits(edge) + &unit));
        let parts = feature.values.iter().map(|own| own.iter().map(|v| Some(*v > edge)).collect()).collect();
        all.push(Division { by: feature.name, names, parts });
    }
    let of_unit = |f: &dyn Fn(usize) -> bool| -> Vec<Vec<Option<bool>>> {
        o.units.iter().enumerate().map(|(u, unit)| vec![Some(f(u)); unit.samples]).collect()
    };
    let shapes: BTreeSet<&str> = (0..o.units.len()).map(|u| model.group(u)).collect();
    for shape in shapes.iter().filter(|_| shapes.len() > 1) {
        let names = ["with the other shapes".to_string(), format!("with {shape}")];
        all.push(Division { by: "shape", names, parts: of_unit(&|u| model.group(u) == *shape) });
    }
    let half = o.units.len() / 2;
    let names = ["in the first half of the trials", "in the second half"].map(String::from);
    all.push(Division { by: "order", names, parts: of_unit(&|u| u >= half) });
    all
}

/// The ratio of measured to predicted values, for data that do not suffice for a fit ([`super::strength`]): the geometric mean over
/// conditions with its 95 % interval, in which errors of measuring are not counted. None if no condition has a ratio.
pub fn factor(o: &Observations, prediction: &[f64]) -> Option<(f64, [f64; 2])> {
    let ratio = |units: &Vec<usize>| {
        let places = o.counted(units.iter().map(|&u| &o.units[u]));
        let [product, square] =
            places.fold([0.0; 2], |[p, s], k| [p + o.values[k] * prediction[k], s + prediction[k].powi(2)]);
        Some((product / square).ln()).filter(|log| log.is_finite())
    };
    let logs: Vec<f64> = o.repetitions().iter().filter(|g| !g.is_empty()).filter_map(ratio).collect();
    // A single condition has no scatter; its trials do.
    let logs = if logs.len() > 1 { logs } else { (0..o.units.len()).filter_map(|u| ratio(&vec![u])).collect() };
    errors::mean_and_interval(&logs).map(|(mean, half)| (mean.exp(), [(mean - half).exp(), (mean + half).exp()]))
}
