//! Data, model, noise and nuisances: the inputs of a fit.

use super::fit::{COEFFICIENTS, Fit, Stack, slope};
use super::forward::{ForwardModel, SandParameters};
use super::gram::gram;
use super::nuisance::{Nuisance, NuisanceState};
use super::observations::Observations;
use super::whiten::Whitener;
use crate::number::dot;
use crate::sand::Coefficients;
use crate::sand::mechanism::{CATALOG, Mechanisms};
use nalgebra::DMatrix;
use std::sync::Arc;

/// Whitened slopes, and their products with each other.
pub struct SlopeProducts {
    pub white: Vec<Stack>,
    pub products: DMatrix<f64>,
}

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
    /// Products of the whitened ones with each other.
    pub marginal_products: DMatrix<f64>,
    /// Relative prior standard deviation of each stress coefficient; 0: they have their stated values.
    pub coefficient_sd: f64,
    /// Step of the numerical slope by each mechanism, in its coordinate.
    pub steps: [f64; Mechanisms::COUNT],
}

impl<'a> FitInputs<'a> {
    pub fn new(observations: &'a Observations, model: &'a dyn ForwardModel, whitener: &'a Whitener) -> Self {
        let steps = CATALOG.map(|entry| SMOOTH_STEP * entry.coordinate_typical());
        let mut study = Self {
            observations,
            model,
            whitener,
            nuisances: Vec::new(),
            marginal_slopes: [Vec::new(), Vec::new()],
            marginal_products: DMatrix::zeros(0, 0),
            coefficient_sd: model.experiment().file.coefficient_sd,
            steps,
        };
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
        let white: Vec<Stack> = self.whitener.apply_all(&slopes).into_iter().map(Arc::new).collect();
        self.marginal_products = gram(&white);
        self.marginal_slopes = [slopes, white];
    }

    /// Are the data a robot's log? Its model is a simulation with effects of measuring.
    pub fn is_robots_log(&self) -> bool {
        self.model.roughness().is_some() && !self.nuisances.is_empty()
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
        FitInputs { model, nuisances, marginal_slopes, marginal_products: self.marginal_products.clone(), ..*self }
    }

    /// The same study with another whitening and other nuisances. The slopes by the coefficients stay.
    pub fn under(&self, whitener: &'a Whitener, nuisances: Vec<Nuisance>) -> Self {
        let coefficients = self.marginal_slopes[0].iter().take(COEFFICIENTS).cloned();
        let slopes: Vec<Stack> = coefficients.chain(nuisances.iter().map(|n| n.column.clone())).collect();
        let white: Vec<Stack> = whitener.apply_all(&slopes).into_iter().map(Arc::new).collect();
        let marginal_products = gram(&white);
        let mut study = FitInputs { whitener, nuisances, marginal_slopes: [slopes, white], marginal_products, ..*self };
        if let Some(roughness) = self.model.roughness() {
            study.find_steps(roughness, &study.plain().prediction);
        }
        study
    }

    /// The same study with other nuisances under the same whitening. The slopes by the coefficients stay.
    pub fn with_nuisances(&self, nuisances: Vec<Nuisance>) -> Self {
        let coefficients = self.marginal_slopes[0].iter().take(COEFFICIENTS);
        let slopes = coefficients.chain(nuisances.iter().map(|n| &n.column)).cloned().collect();
        self.with_marginals(nuisances, slopes)
    }

    /// The same study in which the stress coefficients have their stated values.
    pub fn stated(&self) -> Self {
        let still: Stack = Arc::new(vec![0.0; self.observations.values.len()]);
        let rest = self.marginal_slopes[0].iter().skip(COEFFICIENTS).cloned();
        let slopes = std::iter::repeat_n(still, COEFFICIENTS).chain(rest).collect();
        FitInputs { coefficient_sd: 0.0, ..self.with_marginals(self.nuisances.clone(), slopes) }
    }

    /// The same study in which the stress coefficients have this share of their prior standard deviation.
    pub fn nearly_stated(&self, share: f64) -> Self {
        let less = |(k, slope): (usize, &Stack)| match k < COEFFICIENTS {
            true => Arc::new(slope.iter().map(|s| share * s).collect()),
            false => slope.clone(),
        };
        let slopes = self.marginal_slopes[0].iter().enumerate().map(less).collect();
        let coefficient_sd = share * self.coefficient_sd;
        FitInputs { coefficient_sd, ..self.with_marginals(self.nuisances.clone(), slopes) }
    }

    /// The same study with other nuisances and derivatives by coefficients and nuisances. What is known of a derivative stays.
    fn with_marginals(&self, nuisances: Vec<Nuisance>, slopes: Vec<Stack>) -> Self {
        let SlopeProducts { white, products } = self.products_of(&slopes);
        FitInputs { nuisances, marginal_slopes: [slopes, white], marginal_products: products, ..*self }
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

/// The readings that `fit` predicts: the sand and the nuisances.
pub fn reading(fit: &Fit, nuisances: &[Nuisance]) -> Vec<f64> {
    let mut reading = fit.prediction.clone();
    for (nuisance, d) in nuisances.iter().zip(&fit.deviations[COEFFICIENTS..]) {
        reading.iter_mut().zip(nuisance.column.iter()).for_each(|(r, c)| *r += d * c);
        if let Some(bend) = &nuisance.bend {
            reading.iter_mut().zip(bend.iter()).for_each(|(r, b)| *r += b);
        }
    }
    reading
}
