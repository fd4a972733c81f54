//! Fits mechanisms by generalised least squares with the uncertainty of the stress coefficients marginalised.
//!
//! Each coefficient is c_k (1 + s d_k), with s its relative prior sd and d_k ~ N(0, 1). The d_k are also fitted, with
//! the prior's penalty d_k². W whitens the measured numbers y and the prediction m, V is the covariance of the noise,
//! and J the derivatives of m by the s d_k. For a linear model the least value of |W (y − m)|² + |d|² is the χ² under
//! the covariance V + s² J Jᵀ. Nuisances are fitted in the same way, with their columns after the coefficients'
//! columns; they change the readings, but not the prediction of the sand.

use super::fit::{COEFFICIENTS, Fit, Stack, slope};
use super::normal_equations::NormalEquations;
use super::study::FitInputs;
use crate::number::{add_scaled, dot};
use crate::parallel;
use crate::sand::mechanism::{CATALOG, Mechanisms};
use nalgebra::{DMatrix, DVector};
use std::sync::Arc;

/// A fit ends with a step that reduces χ² by less than this: our choice, far below every threshold in use.
const SETTLED: f64 = 0.01;
/// The same for a rough model, whose χ² differs by about this much between neighbouring states: our choice.
const SETTLED_ROUGHLY: f64 = 0.25;

/// Bound of a nuisance in prior standard deviations: our choice. Without this bound, nuisances could take absurd values to compensate for
/// a large error of the model.
pub const MOST_DEVIATION: f64 = 3.0;

/// Is a deviation at its bound? The share is rounding.
pub fn at_bound(deviation: f64) -> bool {
    deviation.abs() >= MOST_DEVIATION * (1.0 - 1e-6)
}
/// Largest number of Gauss-Newton steps of a fit: our choice; most fits converge in four.
const ROUNDS: usize = 12;
/// From this step on a fit can be abandoned because another fit has a much lower objective. Not earlier, because the
/// first step may be short. Our choice.
const HEAD_START: usize = 2;
/// A fit is abandoned if its objective is higher than the best by more than this many times the gain of its last step:
/// our choice; gains shrink from step to step.
pub const REACH: f64 = 4.0;

impl FitInputs<'_> {
    /// The plain model without any fit.
    pub fn plain(&self) -> Fit {
        self.begin(&[(Vec::new(), Vec::new())]).swap_remove(0)
    }

    /// The plain model with its coefficients fitted within their prior.
    pub fn recalibrated(&self) -> Fit {
        self.fit(&[], &[])
    }

    /// Fits the values of `ids` and the coefficients from `start`.
    pub fn fit(&self, ids: &[usize], start: &[f64]) -> Fit {
        let begun = self.begin(&[(ids.to_vec(), start.to_vec())]);
        self.refine(begun, ROUNDS, ids.is_empty()).swap_remove(0)
    }

    /// Fits every set of ids from the two most promising of its starts.
    pub fn fit_all(&self, sets: &[(Vec<usize>, Vec<Vec<f64>>)]) -> Vec<Fit> {
        let from = |(ids, starts): &(Vec<usize>, Vec<Vec<f64>>)| {
            starts.iter().map(|s| (ids.clone(), s.clone())).collect::<Vec<_>>()
        };
        let mut begun = self.begin(&sets.iter().flat_map(from).collect::<Vec<_>>());
        let mut promising = Vec::new();
        for (_, starts) in sets {
            let mut own: Vec<Fit> = begun.drain(..starts.len()).collect();
            own.sort_by(|a, b| a.objective.total_cmp(&b.objective));
            own.truncate(2);
            promising.push(own.len());
            begun.extend(own); // these are tried after the starts of the remaining sets
        }
        let mut fitted = self.refine(begun, ROUNDS, false).into_iter();
        let best = |count: usize| {
            let own: Vec<Fit> = fitted.by_ref().take(count).collect();
            own.into_iter().min_by(|a, b| a.objective.total_cmp(&b.objective))
        };
        promising.into_iter().filter_map(best).collect()
    }

    /// Continues fits from their end states, in half the usual steps, because these are near the new minimum (our
    /// choice); the first step uses their slopes by causes and coefficients.
    pub fn fit_from(&self, fits: &[&Fit]) -> Vec<Fit> {
        let state = |f: &&Fit| {
            let mut deviations = f.deviations.clone();
            deviations.resize(self.marginals(), 0.0);
            (f.ids.clone(), f.mechanisms, deviations)
        };
        let mut again = self.at_all(fits.iter().map(state).collect());
        for (fit, earlier) in again.iter_mut().zip(fits).filter(|(_, earlier)| !earlier.slopes.is_empty()) {
            let sand = &earlier.slopes[..earlier.ids.len() + COEFFICIENTS];
            fit.slopes = [sand, &self.marginal_slopes[0][COEFFICIENTS..]].concat();
        }
        self.refine(again, ROUNDS / 2, true)
    }

    /// The same fit with all slopes computed at its state.
    pub fn with_slopes(&self, fit: Fit) -> Fit {
        let mut fits = vec![fit];
        self.set_coefficient_slopes(&mut fits, &[0]);
        self.set_value_slopes(&mut fits, &[0]);
        fits.swap_remove(0)
    }

    /// Fits a model that is similar to the model of an earlier fit. The fit starts at the end of the earlier one and
    /// uses its slopes by the coefficients; half the usual steps suffice (our choice).
    pub fn fit_near(&self, earlier: &Fit) -> Fit {
        self.refine(vec![self.restated(earlier)], ROUNDS / 2, false).swap_remove(0)
    }

    /// The same fit, evaluated with the data and nuisances of `self`. Nothing is fitted again, and the slopes are kept.
    pub fn restated(&self, fit: &Fit) -> Fit {
        self.moved_by(&[(fit, vec![0.0; fit.ids.len() + fit.deviations.len()])]).swap_remove(0)
    }

    /// Changes the parameters of each fit by its step. Nothing is fitted again, and the slopes are kept.
    pub fn moved_by(&self, steps: &[(&Fit, Vec<f64>)]) -> Vec<Fit> {
        let there = self.at_all(steps.iter().map(|(fit, step)| moved(fit, step, 1.0)).collect());
        there.into_iter().zip(steps).map(|(there, (fit, _))| Fit { slopes: fit.slopes.clone(), ..there }).collect()
    }

    /// A rough model has several minima. Returns start states with each value changed by a slope's step in either
    /// direction; none for a smooth model.
    pub fn beside(&self, fit: &Fit) -> Vec<Fit> {
        let values = if self.model.roughness().is_some() { fit.ids.len() } else { 0 };
        let moved = |(k, side): (usize, f64)| {
            let (id, at) = (fit.ids[k], fit.coordinates()[k]);
            let bounds = CATALOG[id].coordinate_bounds();
            let value = CATALOG[id].value((at + side * self.step_from(id, at)).clamp(bounds[0], bounds[1]));
            Fit { mechanisms: fit.mechanisms.with(id, value), ..fit.clone() }
        };
        (0..values).flat_map(|k| [(k, 1.0), (k, -1.0)]).map(moved).collect()
    }

    /// Start states of fits of given ids from given values.
    pub(super) fn begin(&self, starts: &[(Vec<usize>, Vec<f64>)]) -> Vec<Fit> {
        let state = |(ids, values): &(Vec<usize>, Vec<f64>)| {
            let set = |m: Mechanisms, (&id, &value): (&usize, &f64)| m.with(id, value);
            (ids.clone(), ids.iter().zip(values).fold(Mechanisms::default(), set), vec![0.0; self.marginals()])
        };
        self.at_all(starts.iter().map(state).collect())
    }

    /// Gauss-Newton steps within bounds, shortened until they reduce the objective. All fits step together, so that the
    /// model predicts many states at once. The objective is always exact. With `exact` the slopes by the coefficients
    /// are computed at the end state and not at the plain model. Fits that are unlikely to become the best are
    /// abandoned.
    pub(super) fn refine(&self, mut fits: Vec<Fit>, rounds: usize, exact: bool) -> Vec<Fit> {
        for fit in fits.iter_mut().filter(|f| f.slopes.is_empty()) {
            fit.slopes.clone_from(&self.marginal_slopes[0]);
        }
        let rough = self.model.roughness().is_some();
        let settled = if rough { SETTLED_ROUGHLY } else { SETTLED };
        let mut active: Vec<usize> = (0..fits.len()).collect();
        let mut unpolished = Vec::new();
        for round in 1..=rounds {
            // Slopes of a rough model are expensive and change on the way: they are computed again for the fits
            // that are not abandoned.
            if exact && (if rough { round > HEAD_START } else { round == 1 }) {
                self.set_coefficient_slopes(&mut fits, &active);
            }
            self.set_value_slopes(&mut fits, &active);
            let before: Vec<f64> = fits.iter().map(|f| f.objective).collect();
            self.advance(&mut fits, &active);
            let gained = |k: usize| before[k] - fits[k].objective;
            active.retain(|&k| gained(k) >= settled || (exact && rough && round <= HEAD_START));
            let best = fits.iter().map(|f| f.objective).fold(f64::MAX, f64::min);
            let lost = |k: usize| REACH * gained(k) < fits[k].objective - best;
            if round >= HEAD_START {
                unpolished.extend(active.extract_if(.., |k| lost(*k)));
            }
        }
        active.extend(unpolished);
        if exact && !rough {
            active = (0..fits.len()).collect();
            self.set_coefficient_slopes(&mut fits, &active);
        }
        // Converged fits keep their last slopes, because they have hardly moved since.
        self.set_value_slopes(&mut fits, &active);
        fits
    }

    /// Makes one Gauss-Newton step of each active fit, or the first of 0.35, 0.12 and 0.04 of it that reduces the
    /// objective: our choice, because a still shorter step gains little.
    fn advance(&self, fits: &mut [Fit], active: &[usize]) {
        let steps = parallel::map(active, |&k| self.step(&fits[k]));
        let mut pending: Vec<usize> = (0..active.len()).collect();
        let mut share = 1.0;
        while !pending.is_empty() && share > 0.02 {
            let state = |&i: &usize| moved(&fits[active[i]], &steps[i], share);
            let trials = self.at_all(pending.iter().map(state).collect());
            let mut left = Vec::new();
            for (i, trial) in pending.into_iter().zip(trials) {
                let fit = &mut fits[active[i]];
                if trial.objective < fit.objective {
                    *fit = Fit { slopes: std::mem::take(&mut fit.slopes), ..trial };
                } else {
                    left.push(i);
                }
            }
            pending = left;
            share *= 0.35;
        }
    }

    /// Fits at given mechanisms and deviations, without slopes.
    pub(super) fn at_all(&self, states: Vec<(Vec<usize>, Mechanisms, Vec<f64>)>) -> Vec<Fit> {
        let inputs: Vec<_> = states.iter().map(|(_, m, d)| (*m, self.coefficients(d))).collect();
        let predictions = self.model.predict_many(&inputs);
        let bends: Vec<&Stack> = self.nuisances.iter().filter_map(|n| n.bend.as_ref()).collect();
        let states: Vec<_> = states.into_iter().zip(predictions).collect();
        parallel::map(&states, |((ids, mechanisms, deviations), prediction)| {
            let mut residual: Vec<f64> = self.observations.values.iter().zip(prediction).map(|(y, m)| y - m).collect();
            bends.iter().for_each(|bend| residual.iter_mut().zip(bend.iter()).for_each(|(r, b)| *r -= b));
            let mut white = self.whitener.apply(&residual);
            // The plain model has nuisances of 0. It is computed before their whitened columns are known.
            let felt = self.nuisances.iter().zip(&deviations[COEFFICIENTS..]).filter(|(_, d)| **d != 0.0);
            felt.for_each(|(nuisance, d)| add_scaled(&mut white, -d, &self.whitened(&nuisance.column)));
            let objective = dot(&white, &white) + dot(deviations, deviations);
            let objective = if objective.is_finite() { objective } else { f64::MAX };
            let (ids, deviations, prediction) = (ids.clone(), deviations.clone(), prediction.clone());
            Fit { ids, mechanisms: *mechanisms, deviations, prediction, white, objective, slopes: Vec::new() }
        })
    }

    /// Sets the slopes of the active fits by the coefficients; [`Self::set_value_slopes`] sets the slopes by the values.
    pub(super) fn set_coefficient_slopes(&self, fits: &mut [Fit], active: &[usize]) {
        // Slopes of a linear model without mechanisms are those of the plain model, which are known.
        let plain = |fit: &Fit| fit.mechanisms == Mechanisms::default() && self.model.is_linear(&fit.mechanisms);
        let is_known = |k: &usize| !self.marginal_slopes[0].is_empty() && plain(&fits[*k]);
        let (known, active): (Vec<usize>, Vec<usize>) = active.iter().partition(|k| is_known(k));
        known.into_iter().for_each(|k| fits[k].slopes.clone_from(&self.marginal_slopes[0]));
        // The step in prior standard deviations; large for a rough model. Our choices.
        let step = if self.model.roughness().is_some() { 1.0 } else { 0.1 };
        let state = |fit: &Fit, k: usize| {
            let mut deviations = fit.deviations.clone();
            deviations[k] += step;
            (fit.mechanisms, self.coefficients(&deviations))
        };
        // A rough model is fastest with many states at once; with a smooth one they would only use memory.
        let together = if self.model.roughness().is_some() { active.len().max(1) } else { 1 };
        for part in active.chunks(together) {
            let states = part.iter().flat_map(|&k| (0..COEFFICIENTS).map(move |c| (k, c)));
            let states: Vec<_> = states.map(|(k, c)| state(&fits[k], c)).collect();
            let moved = self.model.predict_many(&states);
            for (&k, moved) in part.iter().zip(moved.chunks(COEFFICIENTS)) {
                let fit = &mut fits[k];
                fit.slopes = moved.iter().map(|m| Arc::new(slope(m, &fit.prediction, step))).collect();
                fit.slopes.extend(self.nuisances.iter().map(|n| n.column.clone()));
            }
        }
    }

    /// Computes the slopes of the active fits by the values, and puts them before the slopes by the coefficients.
    fn set_value_slopes(&self, fits: &mut [Fit], active: &[usize]) {
        let (mut steps, mut states) = (Vec::new(), Vec::new());
        for fit in active.iter().map(|&k| &fits[k]) {
            for (&id, at) in fit.ids.iter().zip(fit.coordinates()) {
                let step = self.step_from(id, at);
                steps.push(step);
                states
                    .push((fit.mechanisms.with(id, CATALOG[id].value(at + step)), self.coefficients(&fit.deviations)));
            }
        }
        let mut moved = self.model.predict_many(&states).into_iter().zip(steps);
        for &k in active {
            let fit = &mut fits[k];
            let own = moved.by_ref().take(fit.ids.len());
            let slopes: Vec<_> = own.map(|(moved, step)| Arc::new(slope(&moved, &fit.prediction, step))).collect();
            let earlier = fit.slopes.len() - fit.deviations.len();
            fit.slopes.splice(..earlier, slopes);
        }
    }

    /// Step of the numerical slope by mechanism `id` from coordinate `at`.
    fn step_from(&self, id: usize, at: f64) -> f64 {
        let entry = &CATALOG[id];
        // An upper limit has no effect down to some value, and below it the effect grows fast. So the step is a
        // twentieth of the limit. Our choice.
        let step = if entry.ceiling { 0.05 * at.max(entry.coordinate_typical()) } else { self.steps[id] };
        if at + step > entry.coordinate_bounds()[1] { -step } else { step }
    }

    /// The Gauss-Newton step; a value that would cross a bound stays at the bound.
    fn step(&self, fit: &Fit) -> Vec<f64> {
        let NormalEquations { information, score, .. } = self.normal_equations(fit);
        let (count, coordinates) = (fit.ids.len(), fit.coordinates());
        let mut held = vec![false; count + fit.deviations.len()];
        // Position of each parameter, and its bounds; coefficients have none.
        let place = |k: usize| match k.checked_sub(count) {
            None => (coordinates[k], CATALOG[fit.ids[k]].coordinate_bounds()),
            Some(d) if d < COEFFICIENTS => (0.0, [f64::MIN, f64::MAX]),
            Some(d) => (fit.deviations[d], [-MOST_DEVIATION, MOST_DEVIATION]),
        };
        loop {
            let step = solve(&information, &score, &held);
            let stuck = (0..held.len()).find(|&k| {
                let (at, bounds) = place(k);
                !held[k] && ((at <= bounds[0] && step[k] < 0.0) || (at >= bounds[1] && step[k] > 0.0))
            });
            match stuck {
                Some(k) => held[k] = true,
                None => return step,
            }
        }
    }
}

/// Causes, mechanisms and deviations of a fit after a share of a step.
fn moved(fit: &Fit, step: &[f64], share: f64) -> (Vec<usize>, Mechanisms, Vec<f64>) {
    let mut mechanisms = fit.mechanisms;
    for ((&id, at), step) in fit.ids.iter().zip(fit.coordinates()).zip(step) {
        let (entry, bounds) = (&CATALOG[id], CATALOG[id].coordinate_bounds());
        mechanisms = mechanisms.with(id, entry.value((at + share * step).clamp(bounds[0], bounds[1])));
    }
    let mut deviations = fit.deviations.clone();
    for (k, (d, s)) in deviations.iter_mut().zip(&step[fit.ids.len()..]).enumerate() {
        *d += share * s;
        if k >= COEFFICIENTS {
            *d = d.clamp(-MOST_DEVIATION, MOST_DEVIATION);
        }
    }
    (fit.ids.clone(), mechanisms, deviations)
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
        // A mechanism without effect on these data keeps its value.
        if a[(k, k)] <= 0.0 {
            a[(k, k)] = 1.0;
            b[k] = 0.0;
        }
        a[(k, k)] *= 1.0 + 1e-9; // so that equal columns have a solution
    }
    a.cholesky().map_or_else(|| vec![0.0; score.len()], |c| c.solve(&b).iter().copied().collect())
}
