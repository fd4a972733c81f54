//! Fits mechanisms by generalised least squares, the uncertainty of the stress coefficients marginalised.
//!
//! A coefficient c_k (1 + s d_k), s its declared relative sd and d_k ~ N(0, 1), joins the fit with the prior's penalty
//! d_k². For a linear model the least value of |W (y − m)|² + |d|² is the χ² under the covariance
//! V + s² J Jᵀ: the rank-9 update of the contract's section 4.

use super::forward::ForwardModel;
use super::observations::Observations;
use super::whiten::Whitener;
use crate::sand::Coefficients;
use crate::sand::mechanism::{CATALOG, Mechanisms};
use nalgebra::{DMatrix, DVector};

pub const COEFFICIENTS: usize = 9;
/// A step that gains less ends a fit: a hundredth of a unit of χ² is far below every threshold in use.
const SETTLED: f64 = 0.01;

/// Steps of the slopes by the coefficients, in multiples of the model's step: a prior sd moves the prediction about a
/// fifth as much as a mechanism's typical strength. Our choice.
const COEFFICIENT_STEP: f64 = 5.0;

/// Data, model and noise: all that a fit needs.
pub struct Study<'a> {
    pub observations: &'a Observations,
    pub model: &'a dyn ForwardModel,
    pub whitener: &'a Whitener,
    /// Relative prior sd of the coefficients.
    pub coefficient_sd: f64,
    /// Slopes by the coefficients at the plain model, as they are and whitened: good enough on the way to a fit.
    coefficient_slopes: [Vec<Vec<f64>>; 2],
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
    /// ∂m/∂(coordinate of each id, deviation of each coefficient), not whitened.
    pub slopes: Vec<Vec<f64>>,
    /// The same, whitened.
    pub white_slopes: Vec<Vec<f64>>,
}

/// Sum of products, in eight partial sums so that it vectorises.
pub fn dot(a: &[f64], b: &[f64]) -> f64 {
    let (left, right) = (a.chunks_exact(8), b.chunks_exact(8));
    let rest: f64 = left.remainder().iter().zip(right.remainder()).map(|(a, b)| a * b).sum();
    let mut sums = [0.0; 8];
    for (a, b) in left.zip(right) {
        for (sum, (a, b)) in sums.iter_mut().zip(a.iter().zip(b)) {
            *sum += a * b;
        }
    }
    sums.iter().sum::<f64>() + rest
}

impl<'a> Study<'a> {
    pub fn new(
        observations: &'a Observations,
        model: &'a dyn ForwardModel,
        whitener: &'a Whitener,
        coefficient_sd: f64,
    ) -> Self {
        let coefficient_slopes = [Vec::new(), Vec::new()];
        let mut study = Self { observations, model, whitener, coefficient_sd, coefficient_slopes };
        let plain = study.at(&[], Mechanisms::default(), [0.0; COEFFICIENTS]);
        let slopes = study.slopes_by_coefficients(&plain);
        study.coefficient_slopes = [slopes.clone(), slopes.iter().map(|s| whitener.apply(s)).collect()];
        study
    }

    /// Slopes of the plain model's prediction by the coefficients' deviations.
    pub fn coefficient_slopes(&self) -> &[Vec<f64>] {
        &self.coefficient_slopes[0]
    }

    /// The same study under another whitening.
    pub fn rewhitened(&self, whitener: &'a Whitener) -> Self {
        Self::new(self.observations, self.model, whitener, self.coefficient_sd)
    }

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
        let mut best = self.begin(ids, start);
        self.refine(&mut best, 12, ids.is_empty());
        best
    }

    /// Where a fit from `start` begins.
    fn begin(&self, ids: &[usize], start: &[f64]) -> Fit {
        let set = |m: Mechanisms, (&id, &value): (&usize, &f64)| m.with(id, value);
        let mechanisms = ids.iter().zip(start).fold(Mechanisms::default(), set);
        self.at(ids, mechanisms, [0.0; COEFFICIENTS])
    }

    /// Fits from the two most promising of several starts.
    pub fn fit_best(&self, ids: &[usize], starts: &[Vec<f64>]) -> Fit {
        let mut begun: Vec<Fit> = starts.iter().map(|s| self.begin(ids, s)).collect();
        begun.sort_by(|a, b| a.objective.total_cmp(&b.objective));
        begun.truncate(2);
        begun.iter_mut().for_each(|fit| self.refine(fit, 12, false));
        let best = begun.into_iter().min_by(|a, b| a.objective.total_cmp(&b.objective));
        best.unwrap_or_else(|| self.recalibrated())
    }

    /// Fits again from where an earlier fit ended.
    pub fn fit_from(&self, fit: &Fit) -> Fit {
        let mut again = self.at(&fit.ids, fit.mechanisms, fit.deviations);
        self.refine(&mut again, 6, true);
        again
    }

    /// Gauss-Newton steps within bounds, halved until they help. The objective is exact throughout; `exact` has the
    /// slopes by the coefficients taken at the end's own state and not at the plain model.
    fn refine(&self, best: &mut Fit, rounds: usize, exact: bool) {
        if exact {
            self.set_coefficient_slopes(best);
        } else {
            [best.slopes, best.white_slopes] = self.coefficient_slopes.clone();
        }
        for _ in 0..rounds {
            self.set_value_slopes(best);
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
            if before - best.objective < SETTLED {
                break;
            }
        }
        if exact {
            self.set_coefficient_slopes(best);
        }
        self.set_value_slopes(best);
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

    fn slopes_by_coefficients(&self, fit: &Fit) -> Vec<Vec<f64>> {
        let step = COEFFICIENT_STEP * self.model.step();
        let state = |k: usize| {
            let mut deviations = fit.deviations;
            deviations[k] += step;
            (fit.mechanisms, self.coefficients(&deviations))
        };
        let moved = self.model.predict_many(&(0..COEFFICIENTS).map(state).collect::<Vec<_>>());
        moved.iter().map(|m| slope(m, &fit.prediction, step)).collect()
    }

    /// Puts the slopes by the coefficients in place; those by the values are to follow.
    fn set_coefficient_slopes(&self, fit: &mut Fit) {
        fit.slopes = self.slopes_by_coefficients(fit);
        fit.white_slopes = fit.slopes.iter().map(|s| self.whitener.apply(s)).collect();
    }

    /// Puts the slopes by the values before those by the coefficients, or in the place of earlier ones.
    fn set_value_slopes(&self, fit: &mut Fit) {
        let coefficients = self.coefficients(&fit.deviations);
        let earlier = fit.slopes.len() - COEFFICIENTS;
        let slopes = fit.ids.iter().map(|&id| {
            let (entry, at) = (&CATALOG[id], CATALOG[id].coordinate(fit.mechanisms.get(id)));
            let step = self.model.step() * entry.coordinate_typical();
            let step = if at + step > entry.coordinate_bounds()[1] { -step } else { step };
            let moved = self.model.predict(&fit.mechanisms.with(id, entry.value(at + step)), &coefficients);
            slope(&moved, &fit.prediction, step)
        });
        let slopes: Vec<Vec<f64>> = slopes.collect();
        fit.white_slopes.splice(..earlier, slopes.iter().map(|s| self.whitener.apply(s)));
        fit.slopes.splice(..earlier, slopes);
    }

    /// The Gauss-Newton step; a value that would leave its bounds is held at the bound it is on.
    fn step(&self, fit: &Fit) -> Vec<f64> {
        let (information, score) = fit.normal_equations();
        let count = fit.ids.len();
        let mut held = vec![false; count];
        loop {
            let step = solve(&information, &score, &held);
            let stuck = (0..count).find(|&k| {
                let (bounds, at) = (CATALOG[fit.ids[k]].coordinate_bounds(), fit.coordinates()[k]);
                !held[k] && ((at <= bounds[0] && step[k] < 0.0) || (at >= bounds[1] && step[k] > 0.0))
            });
            match stuck {
                Some(k) => held[k] = true,
                None => return step,
            }
        }
    }
}

/// Change of a prediction per `step`; numbers that a diverged simulation left out change nothing.
pub fn slope(moved: &[f64], from: &[f64], step: f64) -> Vec<f64> {
    moved.iter().zip(from).map(|(a, b)| (a - b) / step).map(|s| if s.is_finite() { s } else { 0.0 }).collect()
}

fn moved(fit: &Fit, step: &[f64], share: f64) -> (Mechanisms, [f64; COEFFICIENTS]) {
    let mut mechanisms = fit.mechanisms;
    for ((&id, at), step) in fit.ids.iter().zip(fit.coordinates()).zip(step) {
        let (entry, bounds) = (&CATALOG[id], CATALOG[id].coordinate_bounds());
        mechanisms = mechanisms.with(id, entry.value((at + share * step).clamp(bounds[0], bounds[1])));
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

    /// Coordinates of the fitted mechanisms, in which they are fitted.
    pub fn coordinates(&self) -> Vec<f64> {
        self.ids.iter().map(|&id| CATALOG[id].coordinate(self.mechanisms.get(id))).collect()
    }

    /// Covariance of the fitted coordinates, the coefficients marginalised.
    pub fn covariance(&self) -> DMatrix<f64> {
        let (information, _) = self.normal_equations();
        let count = self.ids.len();
        let inverse = information.try_inverse();
        inverse.map_or_else(
            || DMatrix::from_element(count, count, f64::INFINITY),
            |v| v.view((0, 0), (count, count)).into(),
        )
    }

    /// Whitened distance² to another fit, coefficients included.
    pub fn distance_squared(&self, other: &Fit) -> f64 {
        let white: f64 = self.white.iter().zip(&other.white).map(|(a, b)| (a - b) * (a - b)).sum();
        let prior: f64 = self.deviations.iter().zip(&other.deviations).map(|(a, b)| (a - b) * (a - b)).sum();
        white + prior
    }
}
