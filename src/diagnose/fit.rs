//! Fits mechanisms by generalised least squares, the uncertainty of the stress coefficients marginalised.
//!
//! A coefficient c_k (1 + s d_k), s its declared relative sd and d_k ~ N(0, 1), joins the fit with the prior's penalty
//! d_k². For a linear model the least value of |W (y − m)|² + |d|² is the χ² under the covariance
//! V + s² J Jᵀ: the rank-9 update of the contract's section 4.

use super::forward::ForwardModel;
use super::observations::Observations;
use super::whiten::Whitener;
use crate::sand::mechanism::{CATALOG, Mechanisms};
use crate::sand::Coefficients;
use nalgebra::{DMatrix, DVector};

pub const COEFFICIENTS: usize = 9;

/// Data, model and noise: all that a fit needs.
pub struct Study<'a> {
    pub observations: &'a Observations,
    pub model: &'a dyn ForwardModel,
    pub whitener: &'a Whitener,
    /// Relative prior sd of the coefficients.
    pub coefficient_sd: f64,
}

/// A fitted model.
#[derive(Clone, Debug)]
pub struct Fit {
    /// Catalogue indices of the fitted mechanisms.
    pub ids: Vec<usize>,
    pub mechanisms: Mechanisms,
    /// Deviation of each coefficient in units of its prior sd.
    pub deviations: [f64; COEFFICIENTS],
    pub prediction: Vec<f64>,
    /// W (y − m)
    pub white: Vec<f64>,
    /// |W (y − m)|² + |d|²
    pub objective: f64,
    /// ∂m/∂(value of each id, deviation of each coefficient), not whitened.
    pub slopes: Vec<Vec<f64>>,
    /// The same, whitened.
    pub white_slopes: Vec<Vec<f64>>,
}

/// Sum of products.
pub fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

impl Study<'_> {
    /// Coefficients at given deviations. A relative sd says nothing about a coefficient published as (nearly) 0, such
    /// as C₋₁₁ of loose poppy seeds: none is taken to be known better than half the set's root mean square times the
    /// relative sd. Our choice.
    pub fn coefficients(&self, deviations: &[f64; COEFFICIENTS]) -> Coefficients {
        let mut c = self.model.medium().coefficients.to_array();
        let floor = 0.5 * (c.iter().map(|c| c * c).sum::<f64>() / COEFFICIENTS as f64).sqrt();
        for (c, d) in c.iter_mut().zip(deviations) {
            *c += c.abs().max(floor) * self.coefficient_sd * d;
        }
        Coefficients::from_array(c)
    }

    /// The plain model with nothing fitted.
    pub fn plain(&self) -> Fit {
        self.at(&[], Mechanisms::default(), [0.0; COEFFICIENTS])
    }

    /// The plain model with its coefficients adjusted as far as their prior lets them.
    pub fn recalibrated(&self) -> Fit {
        self.fit(&[], &[])
    }

    /// Fits the values of `ids` and the coefficients from `start`.
    pub fn fit(&self, ids: &[usize], start: &[f64]) -> Fit {
        let mut mechanisms = Mechanisms::default();
        for (&id, &value) in ids.iter().zip(start) {
            mechanisms = mechanisms.with(id, value);
        }
        let mut best = self.at(ids, mechanisms, [0.0; COEFFICIENTS]);
        self.refine(&mut best, 10);
        best
    }

    /// Fits again from where an earlier fit ended.
    pub fn fit_from(&self, fit: &Fit) -> Fit {
        let mut again = self.at(&fit.ids, fit.mechanisms, fit.deviations);
        self.refine(&mut again, 6);
        again
    }

    /// Gauss-Newton steps within bounds, halved until they help.
    fn refine(&self, best: &mut Fit, rounds: usize) {
        self.set_slopes(best, true);
        for round in 0..rounds {
            if round > 0 {
                // The coefficients' slopes change little on the way: they wait for the end.
                self.set_slopes(best, false);
            }
            let step = self.step(best);
            let before = best.objective;
            let mut share = 1.0;
            while share > 0.02 {
                let (mechanisms, deviations) = moved(best, &step, share);
                let trial = self.at(&best.ids, mechanisms, deviations);
                if trial.objective < best.objective {
                    let slopes = (std::mem::take(&mut best.slopes), std::mem::take(&mut best.white_slopes));
                    *best = trial;
                    (best.slopes, best.white_slopes) = slopes;
                    break;
                }
                share *= 0.35;
            }
            // A hundredth of a unit of χ² is far below every threshold in use.
            if before - best.objective < 0.01 {
                break;
            }
        }
        self.set_slopes(best, true);
    }

    fn at(&self, ids: &[usize], mechanisms: Mechanisms, deviations: [f64; COEFFICIENTS]) -> Fit {
        let prediction = self.model.predict(&mechanisms, &self.coefficients(&deviations));
        let residual: Vec<f64> = self.observations.values.iter().zip(&prediction).map(|(y, m)| y - m).collect();
        let white = self.whitener.apply(&residual);
        let objective = dot(&white, &white) + dot(&deviations, &deviations);
        let objective = if objective.is_finite() { objective } else { f64::MAX };
        let (ids, slopes, white_slopes) = (ids.to_vec(), Vec::new(), Vec::new());
        Fit { ids, mechanisms, deviations, prediction, white, objective, slopes, white_slopes }
    }

    /// Slopes at the fit's state; those of the coefficients only where `coefficients_too`.
    fn set_slopes(&self, fit: &mut Fit, coefficients_too: bool) {
        let coefficients = self.coefficients(&fit.deviations);
        let slope = |moved: Vec<f64>, by: f64| -> Vec<f64> {
            moved.iter().zip(&fit.prediction).map(|(a, b)| (a - b) / by).collect()
        };
        let mut slopes: Vec<_> = fit
            .ids
            .iter()
            .map(|&id| {
                let (entry, value) = (&CATALOG[id], fit.mechanisms.get(id));
                let step = 0.02 * entry.typical;
                let step = if value + step > entry.bounds[1] { -step } else { step };
                slope(self.model.predict(&fit.mechanisms.with(id, value + step), &coefficients), step)
            })
            .collect();
        if coefficients_too {
            for k in 0..COEFFICIENTS {
                let mut deviations = fit.deviations;
                deviations[k] += 0.1;
                slopes.push(slope(self.model.predict(&fit.mechanisms, &self.coefficients(&deviations)), 0.1));
            }
        }
        let white: Vec<_> = slopes.iter().map(|s| self.whitener.apply(s)).collect();
        if coefficients_too {
            (fit.slopes, fit.white_slopes) = (slopes, white);
        } else {
            for (k, (slope, white)) in slopes.into_iter().zip(white).enumerate() {
                (fit.slopes[k], fit.white_slopes[k]) = (slope, white);
            }
        }
    }

    /// The Gauss-Newton step; a value that would leave its bounds is held at the bound it is on.
    fn step(&self, fit: &Fit) -> Vec<f64> {
        let (information, score) = fit.normal_equations();
        let count = fit.ids.len();
        let mut held = vec![false; count];
        loop {
            let step = solve(&information, &score, &held);
            let stuck = (0..count).find(|&k| {
                let (bounds, value) = (CATALOG[fit.ids[k]].bounds, fit.mechanisms.get(fit.ids[k]));
                !held[k] && ((value <= bounds[0] && step[k] < 0.0) || (value >= bounds[1] && step[k] > 0.0))
            });
            match stuck {
                Some(k) => held[k] = true,
                None => return step,
            }
        }
    }
}

fn moved(fit: &Fit, step: &[f64], share: f64) -> (Mechanisms, [f64; COEFFICIENTS]) {
    let mut mechanisms = fit.mechanisms;
    for (k, &id) in fit.ids.iter().enumerate() {
        let bounds = CATALOG[id].bounds;
        mechanisms = mechanisms.with(id, (mechanisms.get(id) + share * step[k]).clamp(bounds[0], bounds[1]));
    }
    let mut deviations = fit.deviations;
    for (d, s) in deviations.iter_mut().zip(&step[fit.ids.len()..]) {
        *d += share * s;
    }
    (mechanisms, deviations)
}

/// Solves the normal equations with the `held` parameters fixed.
fn solve(information: &DMatrix<f64>, score: &DVector<f64>, held: &[bool]) -> Vec<f64> {
    let (mut a, mut b) = (information.clone(), score.clone());
    for (k, _) in held.iter().enumerate().filter(|h| *h.1) {
        a.row_mut(k).fill(0.0);
        a.column_mut(k).fill(0.0);
        a[(k, k)] = 1.0;
        b[k] = 0.0;
    }
    for k in 0..held.len() {
        // A mechanism that these data do not feel at all stays where it is.
        if a[(k, k)] <= 0.0 {
            a[(k, k)] = 1.0;
            b[k] = 0.0;
        }
        a[(k, k)] *= 1.0 + 1e-9;
    }
    a.cholesky().map_or_else(|| vec![0.0; score.len()], |c| c.solve(&b).iter().copied().collect())
}

impl Fit {
    /// Information matrix and score of (values, deviations), the prior of the deviations included.
    pub fn normal_equations(&self) -> (DMatrix<f64>, DVector<f64>) {
        let n = self.white_slopes.len();
        let count = self.ids.len();
        let mut information = DMatrix::zeros(n, n);
        for i in 0..n {
            for j in 0..=i {
                let g = dot(&self.white_slopes[i], &self.white_slopes[j]);
                (information[(i, j)], information[(j, i)]) = (g, g);
            }
        }
        let mut score = DVector::from_fn(n, |i, _| dot(&self.white_slopes[i], &self.white));
        for k in 0..COEFFICIENTS {
            information[(count + k, count + k)] += 1.0;
            score[count + k] -= self.deviations[k];
        }
        (information, score)
    }

    /// Values of the fitted mechanisms.
    pub fn values(&self) -> Vec<f64> {
        self.ids.iter().map(|&id| self.mechanisms.get(id)).collect()
    }

    /// Covariance of the fitted values, the coefficients marginalised.
    pub fn covariance(&self) -> DMatrix<f64> {
        let (information, _) = self.normal_equations();
        let count = self.ids.len();
        let inverse = information.try_inverse();
        inverse.map_or_else(|| DMatrix::from_element(count, count, f64::INFINITY), |v| v.view((0, 0), (count, count)).into())
    }

    /// Whitened distance² to another fit, coefficients included.
    pub fn distance_squared(&self, other: &Fit) -> f64 {
        let white: f64 = self.white.iter().zip(&other.white).map(|(a, b)| (a - b) * (a - b)).sum();
        let prior: f64 = self.deviations.iter().zip(&other.deviations).map(|(a, b)| (a - b) * (a - b)).sum();
        white + prior
    }
}
