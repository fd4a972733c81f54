//! The third stage: the remaining misfit in addition to the best candidate, the distances of its rivals and its gain; the
//! evidence for the verdict.

use super::calibrate::Gates;
use super::cross_validation::HeldOut;
use super::discrepancy::Discrepancy;
use super::errors::Errors;
use super::fit::Fit;
use super::fitted::{Candidate, Fitted, candidate};
use super::lack_of_fit::Lack;
use super::nested::{Nested, errors_of};
use super::profile;
use super::speed_exponent::{self, SpeedExponent, SpeedLaw};
use super::study::Study;
use super::verdict::{Evidence, Rival};
use crate::sand::mechanism::{CATALOG, Mechanisms};
use crate::student;

/// The plain model's error counts as clearly larger than the scatter if its 95 % interval exceeds the scatter by this
/// share of the error: our choice. If it is not, a share of their difference has no meaning.
const CLEAR: f64 = 0.1;

/// Uncertainty of a fit's values.
pub struct Intervals {
    /// 95 % intervals of the values' coordinates.
    pub ranges: Vec<[f64; 2]>,
    /// Correlations of the values, row by row.
    pub correlations: Vec<Vec<f64>>,
}

/// The evidence on the best candidate and its rivals.
pub struct Judged {
    pub evidence: Evidence,
    /// The smooth error in addition to the best candidate, or in addition to the plain model if nothing was found.
    pub discrepancy: Discrepancy,
    /// Lack of fit of base and best under the noise alone, without a discrepancy.
    pub lacks: [Lack; 2],
    pub intervals: Option<Intervals>,
    pub form: Option<SpeedExponent>,
    /// Errors of the plain model and of the extension, chosen anew in each fold.
    pub nested: [HeldOut; 2],
}

/// For models whose slopes are not reliable: the lowest state about the best, and the intervals of its values.
pub fn explored(study: &Study, fitted: Fitted, gates: &Gates) -> (Fitted, Vec<[f64; 2]>) {
    let Some(best) = fitted.best().filter(|_| study.model.roughness().is_some()) else { return (fitted, Vec::new()) };
    let allowed = student::square_at_95(gates.degrees_of(&best.fit.ids)) * gates.inflation;
    let (lowest, intervals) = profile::explore(study, &best.fit, allowed);
    let mut candidates = fitted.candidates;
    if lowest.objective < candidates[0].fit.objective {
        candidates[0] = candidate(study, &fitted.base.fit, lowest);
    }
    (Fitted { candidates, ..fitted }, intervals)
}

/// Fits and their noise, and the remaining misfit.
pub struct Standing<'a> {
    pub fitted: &'a Fitted,
    pub gates: &'a Gates,
    pub discrepancy: Discrepancy,
    /// Lack of fit of base and best under the noise alone, without a discrepancy.
    pub lacks: [Lack; 2],
    /// Scatter of the repetitions.
    pub floor: &'a Errors,
    pub nested: Nested,
    /// Intervals of a rough model.
    pub profiled: Vec<[f64; 2]>,
}

/// Judges the fits.
pub fn judged(study: &Study, standing: Standing) -> Judged {
    let Standing { fitted, gates, discrepancy, lacks, floor, nested, profiled } = standing;
    let best = fitted.best().filter(|_| fitted.found(gates));
    let form = best.and_then(|_| questioned(study, fitted, gates));
    let evidence = Evidence {
        found: best.is_some(),
        misfit: gates.lacking(&lacks[0]),
        remainder: gates.lacking(&lacks[1]),
        slight: gates.slight(&lacks[1]),
        explained: explained(study, fitted, &lacks, &nested, floor),
        form_excluded: form.as_ref().is_some_and(|form| form.excluded),
        described: false,
        inflation: gates.inflation,
        rivals: best.map_or(Vec::new(), |best| rivals(fitted, best, gates)),
    };
    let intervals = best.map(|c| intervals(&c.fit, gates, &profiled));
    Judged { evidence, discrepancy, lacks, intervals, form, nested: nested.sand }
}

/// Share of the misfit beyond noise that the best candidate explains. If the plain model's error on held-out conditions
/// is clearly larger than the scatter, this is the share of that error, and otherwise the share of the whitened error.
/// Only conditions in which the candidate acts count.
fn explained(study: &Study, fitted: &Fitted, lacks: &[Lack; 2], nested: &Nested, floor: &Errors) -> f64 {
    let of = |e: &Errors| e.among(&reached(study, fitted, floor));
    let [plain, sand, reading, floor] =
        [&fitted.plain_held_out.errors, &nested.sand[1].errors, &nested.reading[1].errors, floor].map(of);
    // The part of the misfit that nuisances explain (for example a filter or a tilt) is no misfit of the sand.
    let misfit = plain.less(&sand, &reading);
    if misfit.reduction_interval(&floor)[0] > CLEAR {
        let [before, after, least] = [misfit, reading, floor].map(|e| e.rmse().powi(2));
        return 1.0 - (after - least).max(0.0) / (before - least).max(1e-300);
    }
    1.0 - lacks[1].excess.max(0.0) / lacks[0].excess.max(1e-9)
}

/// The conditions whose prediction the best candidate changes by more than their scatter; all, if there are none.
fn reached(study: &Study, fitted: &Fitted, floor: &Errors) -> Vec<usize> {
    let all: Vec<usize> = (0..study.observations.conditions.len()).collect();
    let Some(best) = fitted.best() else { return all };
    let without = study.model.predict(&Mechanisms::default(), &study.coefficients(&best.fit.deviations));
    let moved = |k: usize| study.observations.values[k] + best.fit.prediction[k] - without[k];
    let moved = errors_of(study, moved, &all).errors;
    let further = |k: &usize| moved.square[*k] / moved.count[*k].max(1.0) > floor.square[*k] / floor.count[*k].max(1.0);
    let reached: Vec<usize> = all.iter().copied().filter(further).collect();
    if reached.is_empty() { all } else { reached }
}

fn rivals(fitted: &Fitted, best: &Candidate, gates: &Gates) -> Vec<Rival> {
    let of = |c: &Candidate| Rival {
        behind: c.fit.objective - best.fit.objective,
        squared: best.fit.distance_squared(&c.fit),
        explains: c.delta_chi2 > gates.single,
    };
    fitted.candidates[1..fitted.finalists.max(1)].iter().map(of).collect()
}

/// Tests whether the law of the best cause has the right form. No cause is named in two cases. Either the data exclude the
/// form; or the best cause alone explains as much with another form as it does with this form and a second cause.
fn questioned(study: &Study, fitted: &Fitted, gates: &Gates) -> Option<SpeedExponent> {
    let best = &fitted.candidates[0].fit;
    let asked = SpeedLaw::of(study, best)?;
    let alone = fitted.candidates.iter().find(|c| asked.alone(&c.fit)).filter(|_| best.ids.len() > 1);
    // The single cause was fitted with an earlier noise.
    let alone = alone.and_then(|c| speed_exponent::check(study, &study.fit_from(&[&c.fit])[0], asked, gates.inflation));
    let stands_in = alone.filter(|form| form.excluded && form.objective <= best.objective);
    stands_in.or_else(|| speed_exponent::check(study, best, asked, gates.inflation))
}

/// 95 % intervals, widened because the noise is only estimated.
fn intervals(fit: &Fit, gates: &Gates, profiled: &[[f64; 2]]) -> Intervals {
    let (count, covariance) = (fit.ids.len(), fit.covariance());
    let range = |k: usize| {
        let at = fit.coordinates()[k];
        let square = student::square_at_95(gates.degrees_of(&fit.ids[k..=k])) * gates.inflation;
        let reach = (square * covariance[(k, k)]).sqrt();
        let profiled = profiled.get(k).filter(|i| i.iter().all(|u| u.is_finite()));
        let [low, high] = profiled.copied().unwrap_or([at - reach, at + reach]);
        let bounds = CATALOG[fit.ids[k]].coordinate_bounds();
        [low.clamp(bounds[0], bounds[1]), high.clamp(bounds[0], bounds[1])]
    };
    let of = |i: usize, j: usize| covariance[(i, j)] / (covariance[(i, i)] * covariance[(j, j)]).sqrt();
    let correlations = (0..count).map(|i| (0..count).map(|j| of(i, j)).collect());
    Intervals {
        ranges: (0..count).map(range).collect(),
        correlations: if count < 2 { Vec::new() } else { correlations.collect() },
    }
}
