//! Sizes of errors.

use super::observations::Observations;
use crate::student;

/// Errors over the channels that count in the error, condition by condition: sum of squares [unit of the channels, squared]
/// and number of values.
#[derive(Clone, Debug)]
pub struct SquaredErrors(pub Vec<[f64; 2]>);

impl SquaredErrors {
    /// Root mean square over all conditions.
    pub fn rmse(&self) -> f64 {
        let [square, count] = [0, 1].map(|k| self.0.iter().map(|own| own[k]).sum::<f64>());
        (square / count.max(1.0)).sqrt()
    }

    /// Errors of a prediction on the conditions `held`, over the channels that count. `prediction` gives each number of the stack.
    pub fn of(o: &Observations, prediction: impl Fn(usize) -> f64, held: &[usize]) -> Self {
        let of = |&condition: &usize| {
            let units = o.units.iter().filter(|u| u.condition == condition);
            let add =
                |[square, count]: [f64; 2], k: usize| [square + (o.values[k] - prediction(k)).powi(2), count + 1.0];
            o.counted(units).fold([0.0; 2], add)
        };
        Self(held.iter().map(of).collect())
    }
}

/// Mean of some values and half of its 95 % interval by Student's t; infinite for a single value. None without values.
pub fn mean_and_interval(values: &[f64]) -> Option<(f64, f64)> {
    let n = values.len() as f64;
    if values.is_empty() {
        return None;
    }
    let mean = values.iter().sum::<f64>() / n;
    let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0);
    let half = student::two_sided_95((n - 1.0).max(1.0)) * (variance / n).sqrt();
    Some((mean, if half.is_finite() { half } else { f64::INFINITY }))
}
