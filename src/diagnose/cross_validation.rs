//! Leave-condition-out cross-validation and the gain it measures.
//!
//! Whole conditions are held out, with all their repetitions. Leaving a condition out changes the fitted values
//! little, so each fold is one Gauss-Newton step from the full fit, which is exact for a linear model.

use super::errors::Errors;
use super::fit::{COEFFICIENTS, Fit};
use super::study::Study;
use crate::number::dot;
use nalgebra::{DMatrix, DVector};

/// Held-out errors of one model.
#[derive(Clone, Debug)]
pub struct HeldOut {
    pub errors: Errors,
    /// |W (y − m)|² of all held-out data.
    pub deviance: f64,
}

impl HeldOut {
    /// Root mean square of the held-out error [N].
    pub fn rmse(&self) -> f64 {
        self.errors.rmse()
    }

    /// 95 % interval of the fraction by which `extended` reduces the error of `self`.
    pub fn reduction_interval(&self, extended: &HeldOut) -> [f64; 2] {
        self.errors.reduction_interval(&extended.errors)
    }
}

/// Errors of a model without fitted values: these do not depend on the data.
pub fn unfitted(study: &Study, fit: &Fit) -> HeldOut {
    errors(study, fit, |_| vec![0.0; fit.slopes.len()])
}

/// Held-out errors of a fitted model.
pub fn leave_condition_out(study: &Study, fit: &Fit) -> HeldOut {
    let steps = left_out(study, fit);
    errors(study, fit, |condition| steps[condition].clone())
}

/// Changes of a fit's parameters if one condition is left out, condition by condition.
pub fn left_out(study: &Study, fit: &Fit) -> Vec<Vec<f64>> {
    let (information, score) = fit.normal_equations();
    let n = fit.white_slopes.len();
    let values = n - fit.deviations.len();
    let without = |group: &Vec<usize>| {
        let (mut a, mut b) = (information.clone(), score.clone());
        for &u in group {
            let span = study.observations.span(&study.observations.units[u]);
            let own: Vec<_> = fit.white_slopes.iter().map(|s| &s[span.clone()]).collect();
            a -= DMatrix::from_fn(n, n, |i, j| dot(own[i], own[j]));
            b -= DVector::from_fn(n, |i, _| dot(own[i], &fit.white[span.clone()]));
        }
        // If only this condition depends on a value, it keeps the value of the full fit.
        for k in (0..values).filter(|&k| a[(k, k)] <= 1e-6 * information[(k, k)]).collect::<Vec<_>>() {
            a.row_mut(k).fill(0.0);
            a.column_mut(k).fill(0.0);
            a[(k, k)] = 1.0;
            b[k] = 0.0;
        }
        a.cholesky().map_or_else(|| vec![0.0; n], |c| c.solve(&b).iter().copied().collect())
    };
    study.observations.repetitions().iter().map(without).collect()
}

/// Errors if the parameters change by `step(condition)` before a condition is predicted.
fn errors(study: &Study, fit: &Fit, step: impl Fn(usize) -> Vec<f64>) -> HeldOut {
    let observations = study.observations;
    // The prediction of the sand does not include nuisances.
    let sand = fit.slopes.len().saturating_sub(fit.deviations.len() - COEFFICIENTS);
    let (mut square, mut count, mut deviance) = (Vec::new(), Vec::new(), 0.0);
    for (condition, group) in observations.repetitions().iter().enumerate() {
        let step = step(condition);
        let (mut sum, mut samples) = (0.0, 0.0);
        for &u in group {
            let unit = &observations.units[u];
            for k in observations.span(unit) {
                let moved: f64 = fit.white_slopes.iter().zip(&step).map(|(s, d)| s[k] * d).sum();
                deviance += (fit.white[k] - moved).powi(2);
            }
            for (c, _) in observations.channels.iter().enumerate().filter(|c| c.1.in_rmse) {
                for k in unit.block(c) {
                    let moved: f64 = fit.slopes.iter().zip(&step[..step.len().min(sand)]).map(|(s, d)| s[k] * d).sum();
                    sum += (observations.values[k] - fit.prediction[k] - moved).powi(2);
                    samples += 1.0;
                }
            }
        }
        square.push(sum);
        count.push(samples);
    }
    HeldOut { errors: Errors { square, count }, deviance }
}
