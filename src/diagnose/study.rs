//! Data, model, noise and nuisances: the inputs of a fit.

use super::fit::{COEFFICIENTS, Fit, Stack, slope};
use super::forward::{ForwardModel, SandParameters};
use super::left_out::reading;
use super::nuisance::{Nuisance, NuisanceState};
use super::observations::Observations;
use super::whiten::Whitener;
use crate::number::dot;
use crate::parallel;
use crate::sand::Coefficients;
use crate::sand::mechanism::{CATALOG, Mechanisms};
use std::sync::Arc;

/// Step of numerical slopes of a smooth model, in typical strengths: our choice, small, and far above the rounding of
/// laws that are computed in double precision.
const SMOOTH_STEP: f64 = 0.02;

/// Data, model and noise: the inputs of a fit.
pub struct FitInputs<'a> {
    pub observations: &'a Observations,
    pub model: &'a dyn ForwardModel,
    pub whitener: &'a Whitener,
    /// Nuisances that all data share.
    pub nuisances: Vec<Nuisance>,
    /// Derivatives of the plain model's prediction by the coefficients and the nuisances: not whitened, and whitened.
    /// They are accurate enough for the steps of a fit.
    pub marginal_slopes: [Vec<Stack>; 2],
    /// Relative prior standard deviation of each stress coefficient; 0: they have their stated values.
    pub coefficient_sd: f64,
    /// Step of the numerical slope by each mechanism, in its coordinate.
    pub steps: [f64; Mechanisms::COUNT],
}

impl<'a> FitInputs<'a> {
    pub fn new(observations: &'a Observations, model: &'a dyn ForwardModel, whitener: &'a Whitener) -> Self {
        let steps = CATALOG.map(|entry| SMOOTH_STEP * entry.coordinate_typical());
        let (nuisances, marginal_slopes) = (Vec::new(), [Vec::new(), Vec::new()]);
        let coefficient_sd = model.experiment().file.coefficient_sd;
        let mut study = Self { observations, model, whitener, nuisances, marginal_slopes, coefficient_sd, steps };
        study.set_nuisances(model.nuisances(&model.plain_sand(), &[]));
        let plain = study.plain();
        if let Some(roughness) = model.roughness() {
            study.find_steps(roughness, &plain.prediction);
        }
        study
    }

    /// Finds steps that change all data together by at least `target` σ, so that numerical slopes of a rough simulation
    /// are reliable. Each step is doubled from a tenth of the typical strength up to at most a quarter of the fitted
    /// range: our choice.
    fn find_steps(&mut self, target: f64, plain: &[f64]) {
        let mut open: Vec<usize> =
            (0..CATALOG.len()).filter(|&id| CATALOG[id].walking && !CATALOG[id].ceiling).collect();
        open.iter().for_each(|&id| self.steps[id] = 0.1 * CATALOG[id].coordinate_typical());
        let coefficients = self.model.medium().coefficients;
        while !open.is_empty() {
            let state = |&id: &usize| (Mechanisms::default().with(id, self.steps[id]), coefficients);
            let moved = self.model.predict_many(&open.iter().map(state).collect::<Vec<_>>());
            let effect = |moved: &[f64]| {
                let white = self.whitener.apply(&slope(moved, plain, 1.0));
                dot(&white, &white).sqrt()
            };
            let effects: Vec<f64> = moved.iter().map(|m| effect(m)).collect();
            let weak = |&(id, effect): &(usize, f64)| effect < target && self.steps[id] < 0.125 * CATALOG[id].bounds[1];
            let weak: Vec<usize> = open.iter().copied().zip(effects).filter(weak).map(|w| w.0).collect();
            weak.iter().for_each(|&id| self.steps[id] *= 2.0);
            open = weak;
        }
    }

    /// Sets `nuisances`, and `marginal_slopes`: the slopes by the coefficients at the plain model, then the slopes by the nuisances.
    fn set_nuisances(&mut self, nuisances: Vec<Nuisance>) {
        self.nuisances = nuisances;
        let mut plain = vec![self.plain()];
        self.set_coefficient_slopes(&mut plain, &[0]);
        let slopes = plain.swap_remove(0).slopes;
        let white = parallel::map(&slopes, |slope| self.whitened(slope));
        self.marginal_slopes = [slopes, white];
    }

    /// The sand of a fit.
    pub fn sand(&self, fit: &Fit) -> SandParameters {
        (fit.mechanisms, self.coefficients(&fit.deviations))
    }

    /// Number of slopes by coefficients and nuisances; in a fit they follow the slopes by values.
    pub fn marginals(&self) -> usize {
        COEFFICIENTS + self.nuisances.len()
    }

    /// The same study with another model, which gives the same predictions if there are no mechanisms.
    pub fn with_model<'b>(&'b self, model: &'b dyn ForwardModel) -> FitInputs<'b> {
        let (nuisances, marginal_slopes) = (self.nuisances.clone(), self.marginal_slopes.clone());
        FitInputs { model, nuisances, marginal_slopes, ..*self }
    }

    /// The same study with another whitening and other nuisances.
    pub fn under(&self, whitener: &'a Whitener, nuisances: Vec<Nuisance>) -> Self {
        let mut study =
            FitInputs { whitener, nuisances: Vec::new(), marginal_slopes: [Vec::new(), Vec::new()], ..*self };
        study.set_nuisances(nuisances);
        if let Some(roughness) = self.model.roughness() {
            study.find_steps(roughness, &study.plain().prediction);
        }
        study
    }

    /// The same study with other nuisances under the same whitening. The slopes by the coefficients stay.
    pub fn with_nuisances(&self, nuisances: Vec<Nuisance>) -> Self {
        let of = |n: &Nuisance| {
            let known = self.nuisances.iter().position(|own| Arc::ptr_eq(&own.column, &n.column));
            let known = known.and_then(|k| self.marginal_slopes[1].get(COEFFICIENTS + k));
            known.map_or_else(|| Arc::new(self.whitener.apply(&n.column)), Stack::clone)
        };
        let white = parallel::map(&nuisances, of);
        let own = nuisances.iter().map(|n| n.column.clone()).collect();
        let [slopes, whitened] = [(0, own), (1, white)].map(|(k, rest): (usize, Vec<Stack>)| {
            [&self.marginal_slopes[k][..COEFFICIENTS.min(self.marginal_slopes[k].len())], &rest].concat()
        });
        FitInputs { nuisances, marginal_slopes: [slopes, whitened], ..*self }
    }

    /// The same study in which the stress coefficients have their stated values.
    pub fn stated(&self) -> Self {
        let nuisances = self.nuisances.clone();
        let still: Stack = Arc::new(vec![0.0; self.observations.values.len()]);
        let slopes = |k: usize| {
            let rest = self.marginal_slopes[k].iter().skip(COEFFICIENTS).cloned();
            std::iter::repeat_n(still.clone(), COEFFICIENTS).chain(rest).collect()
        };
        FitInputs { nuisances, marginal_slopes: [slopes(0), slopes(1)], coefficient_sd: 0.0, ..*self }
    }

    /// This study's nuisances at `fit`, with the nuisances' values of the fit `adjusted`.
    pub fn nuisances_of(&self, fit: &Fit, adjusted: &Fit) -> Vec<Nuisance> {
        if self.nuisances.is_empty() {
            return Vec::new();
        }
        let values = self.nuisances.iter().zip(&adjusted.deviations[COEFFICIENTS..]);
        let values: Vec<NuisanceState> = values.map(|(n, d)| NuisanceState { value: n.sd * d, ..n.into() }).collect();
        let there = self.model.nuisances(&self.sand(fit), &values);
        // The sizes of some priors follow from the prediction; those of the plain model's stay.
        let own = |n: Nuisance| {
            let own = self.nuisances.iter().find(|own| own.is(&n))?;
            Some(Nuisance { stated_sd: own.stated_sd, ..n.with_prior(own.sd) })
        };
        there.into_iter().filter_map(own).collect()
    }

    /// The readings that `fit` predicts: the sand and the nuisances.
    pub fn reading(&self, fit: &Fit) -> Vec<f64> {
        reading(fit, &self.nuisances)
    }

    /// Coefficients at given deviations. A relative sd has no meaning for a coefficient that is published as (nearly)
    /// 0, such as C₋₁₁ of loose poppy seeds. So the sd of every coefficient is at least the relative sd times half the
    /// set's root mean square: our choice.
    pub fn coefficients(&self, deviations: &[f64]) -> Coefficients {
        let mut c = self.model.medium().coefficients.to_array();
        let sd = self.coefficient_sd;
        let floor = 0.5 * (c.iter().map(|c| c * c).sum::<f64>() / COEFFICIENTS as f64).sqrt();
        for (c, d) in c.iter_mut().zip(deviations) {
            *c += c.abs().max(floor) * sd * d;
        }
        Coefficients::from_array(c)
    }
}
