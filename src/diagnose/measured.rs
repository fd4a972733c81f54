//! Effects of measuring as answers: models in which one of them may be far larger than stated.

use super::candidates::settled_nuisances;
use super::fit::{COEFFICIENTS, Fit};
use super::gauss_newton::MOST_DEVIATION;
use super::nuisance::{CauseKind, Nuisance, kind};
use super::study::FitInputs;
use crate::parallel;

/// Factor on the prior standard deviation of an effect that may be the answer: our choice, so wide that the prior has no say
/// (a log that is late by 120 ms, a plate that is turned by 40°).
pub const WIDE: f64 = 20.0;
/// Least gain of a wide prior [χ²] by a linear estimate for which the model is fitted: our choice, below the 4 that a difference of
/// elpd needs at least.
const WORTH: f64 = 2.0;
/// Number of such models, the most promising ones: our choice, because each fit takes time.
const MOST: usize = 8;

/// A model in which one effect of measuring has a wide prior.
pub struct MeasuredFit {
    pub fit: Fit,
    pub nuisances: Vec<Nuisance>,
}

/// Fits of the model of `base` with a wide prior for each effect of measuring that promises something.
pub fn measured(study: &FitInputs, base: &Fit) -> Vec<MeasuredFit> {
    let covariance = study.covariance(base);
    let first = base.ids.len() + COEFFICIENTS;
    let less = 1.0 - WIDE.powi(-2);
    // The drop of the least objective of a linear model if the prior of one parameter becomes wide.
    let gain = |k: usize| {
        let d = base.deviations[COEFFICIENTS + k];
        let left = 1.0 - covariance[(first + k, first + k)].min(1.0) * less;
        if d.abs() >= MOST_DEVIATION * (1.0 - 1e-6) { f64::INFINITY } else { d * d * less / left.max(1e-9) }
    };
    let open = |&k: &usize| {
        let n = &study.nuisances[k];
        n.sd == n.stated_sd && n.sd > 0.0 && kind(n.id).is_some()
    };
    let mut promising: Vec<(usize, f64)> = (0..study.nuisances.len()).filter(open).map(|k| (k, gain(k))).collect();
    promising.retain(|p| p.1 > WORTH);
    promising.sort_by(|a, b| b.1.total_cmp(&a.1));
    promising.truncate(MOST);
    parallel::map(&promising, |&(index, _)| {
        let mut nuisances = study.nuisances.clone();
        nuisances[index] = nuisances[index].with_prior(WIDE * nuisances[index].stated_sd);
        let now = study.with_nuisances(nuisances);
        let mut from = base.clone();
        from.deviations[COEFFICIENTS + index] /= WIDE;
        let at = now.fit_from(&[&from]).swap_remove(0);
        let (nuisances, at) = settled_nuisances(now, base, at);
        let last = study.with_nuisances(nuisances);
        let fit = last.fit_from(&[&at]).swap_remove(0);
        MeasuredFit { fit, nuisances: last.nuisances }
    })
}

/// Is what is wrong the robot, the measurement, or the sand?
pub fn kind_of(nuisance: &Nuisance) -> CauseKind {
    kind(nuisance.id).map_or(CauseKind::Measurement, |k| k.kind)
}

/// The id in reports of an effect of measuring.
pub fn answer(nuisance: &Nuisance) -> &'static str {
    kind(nuisance.id).map_or(nuisance.id, |k| k.answer(nuisance.of.as_deref()))
}
