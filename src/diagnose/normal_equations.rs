//! The normal equations of a fit, and what follows from them: covariances, and the gain, the size and the upper limit of further
//! causes.

use super::fit::{Fit, Stack, slope};
use super::gram::{crosses, gram};
use super::screen::USUAL;
use super::study::{FitInputs, SlopeProducts};
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

    /// Share of a further whitened column that the first `count` parameters alone explain.
    pub fn alike(&self, column: &[f64], count: usize) -> Option<f64> {
        let own = &self.white[..count];
        let cross = DVector::from_iterator(count, own.iter().map(|own| dot(own, column)));
        Some(cross.dot(&gram(own).cholesky()?.solve(&cross)) / dot(column, column).max(1e-300))
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
    /// A slope, whitened.
    pub fn whitened(&self, slope: &Stack) -> Stack {
        let known = self.known(slope).and_then(|k| self.marginal_slopes[1].get(k));
        known.map_or_else(|| Arc::new(self.whitener.apply(slope)), Stack::clone)
    }

    /// The place of a slope among those that fits share.
    fn known(&self, slope: &Stack) -> Option<usize> {
        self.marginal_slopes[0].iter().position(|own| Arc::ptr_eq(own, slope))
    }

    /// Slopes, whitened, and their products with each other. Those of slopes that fits share are stored. Other slopes are whitened when
    /// they are needed, because all of them together would take as much memory as everything else.
    pub fn products_of(&self, slopes: &[Stack]) -> SlopeProducts {
        let known: Vec<Option<usize>> = slopes.iter().map(|slope| self.known(slope)).collect();
        let new: Vec<usize> = (0..slopes.len()).filter(|&k| known[k].is_none()).collect();
        let made = self.whitener.apply_all(&new.iter().map(|&k| slopes[k].clone()).collect::<Vec<_>>());
        let made: Vec<Stack> = made.into_iter().map(Arc::new).collect();
        let mut others = made.iter();
        let stored = |k: usize| self.marginal_slopes[1][k].clone();
        let white: Vec<Stack> = known.iter().filter_map(|k| k.map(stored).or_else(|| others.next().cloned())).collect();
        let own = crosses(&made, &white);
        let mut products = DMatrix::from_fn(slopes.len(), slopes.len(), |i, j| match (known[i], known[j]) {
            (Some(i), Some(j)) => self.marginal_products[(i, j)],
            _ => 0.0,
        });
        for (row, &i) in new.iter().enumerate() {
            for j in 0..slopes.len() {
                (products[(i, j)], products[(j, i)]) = (own[(row, j)], own[(row, j)]);
            }
        }
        SlopeProducts { white, products }
    }

    /// The normal equations at a fit, the prior of the deviations included.
    pub fn normal_equations(&self, fit: &Fit) -> NormalEquations {
        let (SlopeProducts { white, products: mut information }, count) =
            (self.products_of(&fit.slopes), fit.ids.len());
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

    /// The same covariance for errors that are correlated within each of these clusters of units in an unknown way, such as the errors
    /// of a law that is not quite right within a condition: the scatter of fits that leave out one cluster each (the jackknife over
    /// clusters, CV3 of MacKinnon, Nielsen & Webb, Journal of Applied Econometrics 38:671, 2023), with the stated uncertainty of
    /// coefficients and nuisances added. One Gauss-Newton step leaves out a cluster. If only this cluster contains information on a
    /// value, the value returns to its prior.
    fn jackknife(&self, fit: &Fit, clusters: &[Vec<usize>]) -> Option<DMatrix<f64>> {
        let normal = self.normal_equations(fit);
        let (mut information, mut pull) = (normal.information.clone(), DVector::zeros(normal.score.len()));
        for (k, (&id, at)) in fit.ids.iter().zip(fit.coordinates()).enumerate() {
            let [precision, score] = value_prior(id, at);
            information[(k, k)] += precision;
            pull[k] = score;
        }
        let all = information.clone().cholesky()?.solve(&pull);
        let step = |units: &Vec<usize>| {
            let (own, score) = self.products(&normal.white, fit, units);
            Some((&information - own).cholesky()?.solve(&(&pull - score)) - &all)
        };
        let steps: Vec<DVector<f64>> = clusters.iter().filter(|units| !units.is_empty()).filter_map(step).collect();
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
        let clusters = self.observations.repetitions();
        let (noise, scatter) = (self.covariance(fit), self.jackknife(fit, &clusters));
        let of = |k: usize| {
            half([noise[(k, k)], scatter.as_ref().map_or(f64::INFINITY, |s| s[(k, k)])], degrees, clusters.len())
        };
        (0..noise.nrows()).map(of).collect()
    }

    /// The same of a sum of all parameters, each multiplied by its entry of `direction`, with other `clusters` of units than conditions.
    pub fn reach_along(&self, fit: &Fit, direction: &DVector<f64>, degrees: f64, clusters: &[Vec<usize>]) -> f64 {
        // Covariances are infinite if the normal equations have no solution.
        let along = |covariance: &DMatrix<f64>| match covariance.iter().all(|v| v.is_finite()) {
            true => direction.dot(&(covariance * direction)),
            false => f64::INFINITY,
        };
        let scatter = self.jackknife(fit, clusters).map_or(f64::INFINITY, |scatter| along(&scatter));
        half([along(&self.covariance(fit)), scatter], degrees, clusters.len())
    }

    /// Further causes in addition to a fitted model, in order of their gain [χ²], largest first.
    pub fn further(&self, first: &Fit, candidates: &[(usize, f64)]) -> Vec<Further> {
        let normal = self.normal_equations(first);
        let others: Vec<_> = candidates.iter().filter(|c| !first.ids.contains(&c.0)).copied().collect();
        let coefficients = self.coefficients(&first.deviations);
        let states: Vec<_> = others.iter().map(|&(id, v)| (first.mechanisms.with(id, v), coefficients)).collect();
        let moved = self.model.predict_many(&states);
        let effects = others.iter().zip(&moved).map(|(other, moved)| slope(moved, &first.prediction, other.1));
        let white = self.whitener.apply_all(&effects.collect::<Vec<_>>());
        let effects: Vec<_> = others.into_iter().zip(white).collect();
        let mut found: Vec<_> = parallel::map(&effects, |&((id, value), ref white)| {
            let [score, left] = normal.beside(white, &first.white).unwrap_or_default();
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
                white: white.clone(),
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

/// Half of a 95 % interval from the variance under the noise and that from the scatter between clusters.
fn half([noise, scatter]: [f64; 2], degrees: f64, clusters: usize) -> f64 {
    let others = (clusters as f64 - 1.0).max(2.0);
    let reach = |variance: f64, degrees: f64| (student::square_at_95(degrees) * variance.max(0.0)).sqrt();
    reach(noise, degrees.max(2.0)).max(reach(scatter, others))
}

/// Precision and score of a value's prior at coordinate `at`. About 0 the prior is normal, with a standard deviation of [`USUAL`]
/// typical strengths. Beyond this the density falls with one over the value, as Jeffreys' prior of a scale does, so a value that is
/// stronger than usual is not drawn to 0.
pub fn value_prior(id: usize, at: f64) -> [f64; 2] {
    let precision = (USUAL * CATALOG[id].coordinate_typical()).max(at.abs()).powi(-2);
    [precision, -precision * at]
}

#[cfg(test)]
mod tests {
    use super::super::fit::{COEFFICIENTS, slope};
    use super::super::laws::tests::with_cohesion;
    use super::gram;
    use std::sync::Arc;

    /// Stored products of shared slopes, with those of a fit's own slopes, are the products of all.
    #[test]
    fn products_of_shared_and_own_slopes_are_those_of_all() {
        with_cohesion(|study, fit| {
            let fit = study.fit_from(&[fit]).swap_remove(0);
            let all = study.products_of(&fit.slopes);
            assert!(Arc::ptr_eq(&fit.slopes[12], &study.marginal_slopes[0][11]));
            assert_eq!(all.products, gram(&study.whitener.apply_all(&fit.slopes)));
            let wide = study.nuisances.iter().map(|n| n.with_prior(2.0 * n.sd)).collect();
            let wide = study.with_nuisances(wide);
            assert_eq!(wide.marginal_products, gram(&wide.marginal_slopes[1]));
        });
    }

    /// Without mechanisms the slopes by the coefficients are the plain model's everywhere.
    #[test]
    fn slopes_by_the_coefficients_are_the_plain_models() {
        with_cohesion(|study, _| {
            let fit = study.recalibrated();
            assert!(fit.deviations[..COEFFICIENTS].iter().any(|d| d.abs() > 0.1));
            for k in 0..COEFFICIENTS {
                let mut deviations = fit.deviations.clone();
                deviations[k] += 1.0;
                let moved = study.model.predict(&(fit.mechanisms, study.coefficients(&deviations)));
                let there = slope(&moved, &fit.prediction, 1.0);
                assert!(there.iter().zip(&*fit.slopes[k]).all(|(a, b)| (a - b).abs() < 1e-9), "coefficient {k}");
            }
        });
    }

    /// Effects of measuring that are nearly linear are computed once for each sand.
    #[test]
    fn effects_of_measuring_are_computed_once_for_each_sand() {
        with_cohesion(|study, _| {
            let plain = study.plain();
            let again = study.nuisances_of(&plain, &plain);
            assert_eq!(again.len(), study.nuisances.len());
            assert!(again.iter().zip(&study.nuisances).all(|(a, b)| Arc::ptr_eq(&a.column, &b.column)));
        });
    }

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
            let found = study.jackknife(&fit, &study.observations.repetitions()).unwrap()[(0, 0)];
            assert!((found / (scatter + stated) - 1.0).abs() < 0.02, "{found} and not {scatter} + {stated}");
        });
    }
}
