//! Values for predictions, and a law for what remains, once a cause is named.
//!
//! Weights from the noise are the best ones if the model is right. If the model's error is much larger than the noise,
//! a fit with these weights follows the samples with the least noise, and nuisances absorb errors of the model. Then
//! the fitted values predict left-out conditions badly. So the values are fitted a second time with equal weights
//! (ordinary least squares, without nuisances). These values are used if they predict left-out conditions clearly
//! better.
//!
//! The remaining misfit may follow a law of [`super::described`]'s dictionary. This law is a description in addition to
//! the named cause. It is searched only if the remaining misfit is significant, or if the values with equal weights are
//! used. In each fold weights and law are chosen again, by leaving out further conditions of the other folds.

use super::calibrate::Gates;
use super::cross_validation::{HeldOut, leave_condition_out, left_out};
use super::described::{self, Described};
use super::errors::Errors;
use super::fit::{COEFFICIENTS, Column, Fit};
use super::fitted::Fitted;
use super::lack_of_fit;
use super::nested::{Choice, together};
use super::study::Study;
use super::whiten::Whitener;
use crate::number::add_scaled;
use crate::parallel;
use crate::sand::Term;
use crate::sand::mechanism::CATALOG;
use crate::student;
use std::sync::Arc;

/// Values from the fit with equal weights are used if their error on left-out conditions is smaller by this share: our
/// choice, because if the model is right they are never better by so much.
const CLEARLY: f64 = 0.1;
/// Least number of conditions for the comparison of the two fits on left-out conditions: our choice, because with fewer
/// each fit would have at most two conditions.
const FEWEST: usize = 4;
/// Rounds in which the variance of the numbers and the values are computed again: our choice, the variance matters only
/// against the prior of the coefficients.
const ROUNDS: usize = 2;

/// The model for predictions.
pub struct Refined {
    /// Cause, coefficients and law, fitted together.
    pub fit: Fit,
    /// What the law explains of the rest.
    pub law: Option<Described>,
    /// Do the values come from the fit with equal weights?
    pub even: bool,
    /// Errors of the fitted plain model and of this one on held-out conditions, chosen anew in each fold.
    pub nested: [HeldOut; 2],
    /// Half widths of the 95 % intervals of the causes' coordinates, from the scatter of values with one condition
    /// left out (jackknife).
    pub reach: Vec<f64>,
}

impl Refined {
    /// The 95 % interval of coordinate `k` about `at`, as wide as that of the weighted fit or as the jackknife's,
    /// whichever is wider.
    pub fn around(&self, k: usize, at: f64, weighted: [f64; 2]) -> [f64; 2] {
        let bounds = CATALOG[self.fit.ids[k]].coordinate_bounds();
        let reach = self.reach[k].max(0.5 * (weighted[1] - weighted[0]));
        [at - reach, at + reach].map(|u| u.clamp(bounds[0], bounds[1]))
    }
}

/// The fit of the best cause that predicts conditions left out best, with a law for the rest if one holds. `study` has
/// the final noise, `nested` its errors. None if nothing changes, if there are few conditions,
/// or for a model without laws.
pub fn refined(
    study: &Study,
    fitted: &Fitted,
    gates: &Gates,
    (nested, choices): (&[HeldOut; 2], &[Choice]),
    remainder: bool,
) -> Option<Refined> {
    let best = fitted.best()?;
    let few = study.observations.conditions.len() < FEWEST;
    if few || study.model.roughness().is_some() || study.model.with_terms(&[]).is_none() {
        return None;
    }
    let (whitener, alike) = alike(study, &best.fit);
    let even = clearly(&best.held_out.errors, &leave_condition_out(study, &alike).errors);
    if !even && !remainder {
        return None;
    }
    let counting_alike = study.under(&whitener, Vec::new());
    let (own, base) = if even { (&counting_alike, &alike) } else { (study, &best.fit) };
    let laws = described::dictionary(study.model.reach());
    let search = Search { study, gates, columns: described::columns(study, base, &laws)?, laws, alike: &alike };
    let found = search.law(base, own.whitener, even);
    let held: Vec<Vec<usize>> = choices.iter().map(|c| c.held.clone()).collect();
    let parts = parallel::map(choices, |choice| search.fold(choice, remainder));
    let (pairs, chosen): (Vec<[HeldOut; 2]>, Vec<Option<usize>>) = parts.into_iter().unzip();
    let errors = together(&held, pairs, study.observations.conditions.len());
    let law =
        found.filter(|(k, _)| described::holds(&search.laws, *k, &chosen, &errors)).and_then(|(k, coefficient)| {
            let term = Term { coefficient, ..search.laws[k].clone() };
            let (degrees, inflation) = search.degrees(even);
            let reach = student::two_sided_95(degrees) * inflation.sqrt();
            described::fitted(own, base, term, reach, [nested[0].clone(), errors[1].clone()])
        });
    if law.is_none() && !even {
        return None;
    }
    let fit = law.as_ref().map_or(base, |l| &l.fit).clone();
    let nested = [nested[0].clone(), errors[usize::from(law.is_some())].clone()];
    Some(Refined { reach: reach(study, &fit), fit, law, even, nested })
}

fn clearly(before: &Errors, after: &Errors) -> bool {
    after.rmse() < (1.0 - CLEARLY) * before.rmse()
}

/// The fit with equal weights, and its whitening.
fn alike(study: &Study, from: &Fit) -> (Whitener, Fit) {
    let o = study.observations;
    let mut whitener = Whitener::even(o, smooth_variance(study, &from.prediction, &[]));
    let mut fit = from.clone();
    for _ in 0..ROUNDS {
        fit = study.under(&whitener, Vec::new()).fit_from(&[&fit]).swap_remove(0);
        whitener = Whitener::even(o, smooth_variance(study, &fit.prediction, &[]));
    }
    (whitener.clone(), study.under(&whitener, Vec::new()).fit_from(&[&fit]).swap_remove(0))
}

/// Mean square of the smooth part of a prediction's error: the variance that independent numbers with an error of this
/// size would have. Conditions in `held` do not count.
fn smooth_variance(study: &Study, prediction: &[f64], held: &[usize]) -> f64 {
    let o = study.observations;
    let whitener = Whitener::even(o, 1.0).without(o, held);
    let lack = lack_of_fit::statistic(o, &whitener.apply(&residual(study, prediction)));
    let conditions = 1.0 - held.len() as f64 / o.conditions.len() as f64;
    (lack.excess + lack.count) / (smooth_numbers(study) * conditions).max(1.0)
}

/// The number of smooth parts of the error in the channels that count.
fn smooth_numbers(study: &Study) -> f64 {
    let o = study.observations;
    let channels = o.channels.iter().filter(|c| c.in_rmse).count() as f64 / o.channels.len() as f64;
    lack_of_fit::statistic(o, &vec![0.0; o.values.len()]).count * channels
}

fn residual(study: &Study, prediction: &[f64]) -> Vec<f64> {
    study.observations.values.iter().zip(prediction).map(|(y, m)| y - m).collect()
}

/// A fit under another whitening, at the same state; with `nuisances`, or without.
fn seen(study: &Study, fit: &Fit, whitener: &Whitener, nuisances: bool) -> Fit {
    let left_away = if nuisances { 0 } else { fit.deviations.len() - COEFFICIENTS };
    let predicted = if nuisances { study.reading(fit) } else { fit.prediction.clone() };
    let slopes = fit.slopes[..fit.slopes.len() - left_away].to_vec();
    let white_slopes = parallel::map(&slopes, |s| Arc::new(whitener.apply(s)));
    let deviations = fit.deviations[..fit.deviations.len() - left_away].to_vec();
    Fit { white: whitener.apply(&residual(study, &predicted)), slopes, white_slopes, deviations, ..fit.clone() }
}

/// Half widths of the values' intervals, by the jackknife over conditions (Efron 1982).
fn reach(study: &Study, fit: &Fit) -> Vec<f64> {
    let steps = left_out(study, fit);
    let n = steps.len() as f64;
    let of = |k: usize| {
        let mean = steps.iter().map(|s| s[k]).sum::<f64>() / n;
        let square = steps.iter().map(|s| (s[k] - mean).powi(2)).sum::<f64>() * (n - 1.0) / n;
        student::two_sided_95((n - 1.0).max(2.0)) * square.sqrt()
    };
    (0..fit.ids.len()).map(of).collect()
}

/// Searches laws for what remains.
struct Search<'a> {
    study: &'a Study<'a>,
    gates: &'a Gates,
    laws: Vec<Term>,
    /// Change of the prediction by each law with the coefficient 1.
    columns: Vec<Vec<f64>>,
    /// The best cause in the fit with equal weights.
    alike: &'a Fit,
}

impl Search<'_> {
    /// The law that gains most in addition to `fit`, its coefficient, and whether it gains more than by chance.
    fn chosen(&self, fit: &Fit, white: &[Column], even: bool) -> Option<(usize, f64, bool)> {
        let scores = described::scores(&fit.white_slopes, &fit.white, &fit.deviations, white)?;
        let (law, coefficient, gain) = described::best(self.study, fit, &self.laws, &scores)?;
        let (degrees, inflation) = self.degrees(even);
        Some((law, coefficient, gain > inflation * described::gate(&scores, degrees)))
    }

    /// Degrees of freedom of the variance, and the factor on χ² differences. With equal weights, the variance comes
    /// from the fit's own error and not from the repetitions.
    fn degrees(&self, even: bool) -> (f64, f64) {
        if even { (smooth_numbers(self.study), 1.0) } else { (self.gates.degrees_of(&[]), self.gates.inflation) }
    }

    /// `fit` with a law as the first of its values.
    fn with(&self, fit: &Fit, law: usize, white: &Column) -> Fit {
        let mut fit = fit.clone();
        fit.slopes.insert(0, Arc::new(self.columns[law].clone()));
        fit.white_slopes.insert(0, white.clone());
        fit
    }

    /// The law in addition to the fit of all data, if it gains more than by chance and predicts conditions left out better, and
    /// its coefficient.
    fn law(&self, base: &Fit, whitener: &Whitener, even: bool) -> Option<(usize, f64)> {
        let white = parallel::map(&self.columns, |c| Arc::new(whitener.apply(c)));
        let (law, coefficient, gains) = self.chosen(base, &white, even)?;
        let [without, with] =
            [base, &self.with(base, law, &white[law])].map(|f| leave_condition_out(self.study, f).errors);
        (gains && with.rmse() < without.rmse()).then_some((law, coefficient))
    }

    /// The fit of the cause with equal weights to all conditions that are not held out, from the state of `start`.
    fn alike_without(&self, start: &Fit, held: &[usize]) -> (Whitener, Fit) {
        let o = self.study.observations;
        let at = |prediction: &[f64]| {
            let whitener = Whitener::even(o, smooth_variance(self.study, prediction, held)).without(o, held);
            let fit = seen(self.study, start, &whitener, false);
            (whitener, fit)
        };
        let (_, first) = at(&start.prediction);
        let step = held.first().map_or(Vec::new(), |k| left_out(self.study, &first).swap_remove(*k));
        let mut prediction = start.prediction.clone();
        first.slopes.iter().zip(step).for_each(|(slope, share)| add_scaled(&mut prediction, share, slope));
        at(&prediction)
    }

    /// Errors on the conditions of a fold, without a law and with that of the fold, and this law.
    fn fold(&self, choice: &Choice, remainder: bool) -> ([HeldOut; 2], Option<usize>) {
        let (study, o) = (self.study, self.study.observations);
        let rest: Vec<usize> = (0..o.conditions.len()).filter(|k| !choice.held.contains(k)).collect();
        let outcome = |fit: &Fit| leave_condition_out(study, fit).errors;
        let noisy = seen(study, &choice.fit, &choice.whitener, true);
        let start = if choice.fit.ids == self.alike.ids { self.alike } else { &choice.fit };
        let (whitener, alike) = self.alike_without(start, &choice.held);
        let [of_noisy, of_alike] = [outcome(&noisy), outcome(&alike)];
        let even = clearly(&of_noisy.among(&rest), &of_alike.among(&rest));
        let (base, own, errors) = if even { (alike, &whitener, of_alike) } else { (noisy, &choice.whitener, of_noisy) };
        let held = |errors: &Errors| HeldOut { errors: errors.among(&choice.held), deviance: 0.0 };
        let without = held(&errors);
        if !even && !remainder {
            return ([without.clone(), without], None);
        }
        let white = parallel::map(&self.columns, |c| Arc::new(own.apply(c)));
        let found = self.chosen(&base, &white, even).map(|c| (c.0, outcome(&self.with(&base, c.0, &white[c.0]))));
        match found.filter(|(_, with)| with.among(&rest).rmse() < errors.among(&rest).rmse()) {
            Some((law, with)) => ([without, held(&with)], Some(law)),
            None => ([without.clone(), without], None),
        }
    }
}
