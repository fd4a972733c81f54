//! The normal equations of a fit, and what follows from them: covariances, and the gain, the size and the upper limit of further
//! causes.

use super::fit::{Fit, Stack, slope};
use super::screen::USUAL;
use super::shared::gram;
use super::study::FitInputs;
use crate::number::dot;
use crate::parallel;
use crate::sand::mechanism::CATALOG;
use crate::student;
use nalgebra::{DMatrix, DVector};
use std::collections::HashSet;
use std::sync::Arc;

/// Information matrix and score of a fit's (values, deviations), and its whitened slopes.
pub struct NormalEquations {
    white: Vec<Stack>,
    pub information: DMatrix<f64>,
    pub score: DVector<f64>,
}

impl NormalEquations {
    /// Score and information of a further whitened column beside the fit with this whitened `residual`,
    /// with the fit's parameters free. None if the normal equations have no solution.
    pub fn beside(&self, column: &[f64], residual: &[f64]) -> Option<[f64; 2]> {
        let cross = DVector::from_iterator(self.white.len(), self.white.iter().map(|own| dot(own, column)));
        let solved = self.information.clone().cholesky()?.solve(&cross);
        Some([dot(column, residual) - solved.dot(&self.score), dot(column, column) - cross.dot(&solved)])
    }

    /// Share of a further whitened column that the first `count` parameters explain, beyond what the other parameters explain.
    pub fn explained(&self, column: &[f64], count: usize) -> Option<f64> {
        let free = |from: usize| {
            let n = self.white.len() - from;
            let cross = DVector::from_iterator(n, self.white[from..].iter().map(|own| dot(own, column)));
            let part = self.information.view((from, from), (n, n)).into_owned();
            Some(dot(column, column) - cross.dot(&part.cholesky()?.solve(&cross)))
        };
        Some(1.0 - free(0)? / free(count)?.max(1e-300))
    }
}

/// A further cause in addition to a fitted model, from a linear estimate.
#[derive(Clone, Debug)]
pub struct Further {
    /// Whitened effect of one unit of its coordinate.
    pub white: Vec<f64>,
    /// Catalogue index.
    pub id: usize,
    /// Value from which a fit begins.
    pub start: f64,
    pub gain: f64,
    /// Estimate and its standard deviation, in the mechanism's coordinate; the estimate may have the wrong sign.
    pub estimate: f64,
    pub sd: f64,
}

impl FitInputs<'_> {
    /// A slope, whitened. Slopes that fits share are stored whitened. Other slopes are whitened when they are needed, because
    /// all of them together would take as much memory as everything else.
    pub fn whitened(&self, slope: &Stack) -> Stack {
        let known = self.marginal_slopes[0].iter().position(|own| Arc::ptr_eq(own, slope));
        let known = known.and_then(|k| self.marginal_slopes[1].get(k));
        known.map_or_else(|| Arc::new(self.whitener.apply(slope)), Stack::clone)
    }

    /// The normal equations at a fit, the prior of the deviations included.
    pub fn normal_equations(&self, fit: &Fit) -> NormalEquations {
        let white: Vec<Stack> = fit.slopes.iter().map(|s| self.whitened(s)).collect();
        let (mut information, count) = (gram(&white), fit.ids.len());
        let mut score = DVector::from_fn(white.len(), |i, _| dot(&white[i], &fit.white));
        for (k, deviation) in fit.deviations.iter().enumerate() {
            information[(count + k, count + k)] += 1.0;
            score[count + k] -= deviation;
        }
        NormalEquations { white, information, score }
    }

    /// Covariance of the parameters under the noise; infinite if the normal equations have no solution.
    pub fn covariance(&self, fit: &Fit) -> DMatrix<f64> {
        let count = fit.ids.len() + fit.deviations.len();
        let inverse = self.normal_equations(fit).information.try_inverse();
        inverse.unwrap_or_else(|| DMatrix::from_element(count, count, f64::INFINITY))
    }

    /// The same covariance for errors that are correlated within a condition in an unknown way, such as the errors of a law that
    /// is not quite right: the scatter of fits that leave out one condition each (the jackknife over clusters, CV3 of MacKinnon,
    /// Nielsen & Webb, Journal of Applied Econometrics 38:671, 2023), with the stated uncertainty of coefficients and nuisances
    /// added. One Gauss-Newton step leaves out a condition. If only this condition contains information on a value, the value
    /// returns to its prior.
    fn jackknife(&self, fit: &Fit) -> Option<DMatrix<f64>> {
        let normal = self.normal_equations(fit);
        let (mut information, mut pull) = (normal.information.clone(), DVector::zeros(normal.score.len()));
        for (k, (&id, at)) in fit.ids.iter().zip(fit.coordinates()).enumerate() {
            let [precision, score] = value_prior(id, at);
            information[(k, k)] += precision;
            pull[k] = score;
        }
        let all = information.clone().cholesky()?.solve(&pull);
        let groups = self.observations.repetitions();
        let step = |units: &Vec<usize>| {
            let (own, score) = self.products(&normal.white, fit, units);
            Some((&information - own).cholesky()?.solve(&(&pull - score)) - &all)
        };
        let steps: Vec<DVector<f64>> = groups.iter().filter(|units| !units.is_empty()).filter_map(step).collect();
        let size = normal.white.len();
        let count = steps.len() as f64;
        let scatter = steps.iter().fold(DMatrix::zeros(size, size), |sum, step| sum + step * step.transpose());
        let stated = DMatrix::from_fn(size, size, |i, j| if i == j && i >= fit.ids.len() { 1.0 } else { 0.0 });
        let inverse = normal.information.try_inverse()?;
        Some(scatter * ((count - 1.0) / count) + &inverse * stated * &inverse)
    }

    /// Half the 95 % interval of each parameter: values in their coordinates, deviations in prior standard deviations. It is the
    /// greater of two (Angrist & Pischke, Mostly Harmless Econometrics, 2009, 8.1): the one under the noise, which has `degrees`
    /// degrees of freedom, is too small if the law is not quite right, and the one from the scatter between conditions is too
    /// small if few conditions matter. Both are widened by Student's t, because the noise is only estimated and conditions are
    /// few. Infinite if the normal equations have no solution.
    pub fn reach(&self, fit: &Fit, degrees: f64) -> Vec<f64> {
        let (noise, scatter) = (self.covariance(fit), self.jackknife(fit));
        let others = (self.observations.conditions.len() as f64 - 1.0).max(2.0);
        let reach = |variance: f64, degrees: f64| (student::square_at_95(degrees) * variance.max(0.0)).sqrt();
        let of = |k: usize| {
            let scatter = scatter.as_ref().map_or(f64::INFINITY, |covariance| covariance[(k, k)]);
            reach(noise[(k, k)], degrees.max(2.0)).max(reach(scatter, others))
        };
        (0..noise.nrows()).map(of).collect()
    }

    /// Further causes in addition to a fitted model, in order of their gain [χ²], largest first.
    pub fn further(&self, first: &Fit, candidates: &[(usize, f64)]) -> Vec<Further> {
        let normal = self.normal_equations(first);
        let others: Vec<_> = candidates.iter().filter(|c| !first.ids.contains(&c.0)).copied().collect();
        let coefficients = self.coefficients(&first.deviations);
        let states: Vec<_> = others.iter().map(|&(id, v)| (first.mechanisms.with(id, v), coefficients)).collect();
        let moved: Vec<_> = others.into_iter().zip(self.model.predict_many(&states)).collect();
        let mut found: Vec<_> = parallel::map(&moved, |&((id, value), ref moved)| {
            let white = self.whitener.apply(&slope(moved, &first.prediction, value));
            let [score, left] = normal.beside(&white, &first.white).unwrap_or_default();
            let estimate = if left > 1e-12 { score / left } else { 0.0 };
            let entry = &CATALOG[id];
            let held =
                estimate.clamp(entry.bounds[0], entry.bounds[1]).clamp(-USUAL * entry.typical, USUAL * entry.typical);
            let held = if entry.ceiling { value } else { held };
            Further {
                id,
                start: if held == 0.0 { 0.05 * value } else { held },
                gain: if held * estimate > 0.0 { score * estimate } else { 0.0 },
                estimate,
                sd: left.max(1e-300).sqrt().recip(),
                white,
            }
        });
        found.sort_by(|a, b| b.gain.total_cmp(&a.gain));
        let mut seen = HashSet::new();
        found.retain(|f| seen.insert(f.id));
        found
    }

    /// Information and score of some units alone, from whitened slopes.
    fn products(&self, white: &[Stack], fit: &Fit, units: &[usize]) -> (DMatrix<f64>, DVector<f64>) {
        let n = white.len();
        let (mut information, mut score) = (DMatrix::zeros(n, n), DVector::zeros(n));
        for span in units.iter().map(|&u| self.observations.span(&self.observations.units[u])) {
            for i in 0..n {
                for j in 0..=i {
                    information[(i, j)] += dot(&white[i][span.clone()], &white[j][span.clone()]);
                }
                score[i] += dot(&white[i][span.clone()], &fit.white[span.clone()]);
            }
        }
        information.fill_upper_triangle_with_lower_triangle();
        (information, score)
    }
}

/// Precision and score of a value's prior at coordinate `at`. The prior is normal about 0, with a standard deviation of [`USUAL`] typical strengths.
pub fn value_prior(id: usize, at: f64) -> [f64; 2] {
    let precision = (USUAL * CATALOG[id].coordinate_typical()).powi(-2);
    [precision, -precision * at]
}

#[cfg(test)]
mod tests {
    use super::super::laws::tests::with_cohesion;

    /// The jackknife is the scatter of fits that are made anew without one condition each, with the stated uncertainty of
    /// coefficients and nuisances added.
    #[test]
    fn the_jackknife_is_that_of_fits_without_one_condition() {
        with_cohesion(|study, fit| {
            let fit = study.fit_from(&[fit]).swap_remove(0);
            let conditions = study.observations.conditions.len();
            let scatter = (0..conditions).map(|c| {
                let weights = study.observations.units.iter().map(|u| if u.condition == c { 0.0 } else { 1.0 });
                let whitener = study.whitener.weighted(weights);
                let without = study.under(&whitener, study.nuisances.clone()).fit_from(&[&fit]).swap_remove(0);
                (without.coordinates()[0] - fit.coordinates()[0]).powi(2)
            });
            let scatter = scatter.sum::<f64>() * (conditions as f64 - 1.0) / conditions as f64;
            let inverse = study.normal_equations(&fit).information.try_inverse().unwrap();
            let stated: f64 = (1..inverse.nrows()).map(|k| inverse[(0, k)].powi(2)).sum();
            let found = study.jackknife(&fit).unwrap()[(0, 0)];
            assert!((found / (scatter + stated) - 1.0).abs() < 0.02, "{found} and not {scatter} + {stated}");
        });
    }
}
