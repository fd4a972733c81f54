//! The third stage: what remains beside the best, how far its rivals are, what it is worth; all that a verdict needs.

use super::calibrate::Gates;
use super::cross_validation::HeldOut;
use super::discrepancy::{Directions, Discrepancy};
use super::fit::{Fit, Study};
use super::fitted::{Candidate, Fitted, candidate};
use super::form::{self, Asked, Form};
use super::profile;
use super::student;
use super::verdict::{Evidence, Rival};
use crate::sand::mechanism::CATALOG;

/// How sure a fit's values are.
pub struct Intervals {
    /// 95 % intervals of the values' coordinates.
    pub ranges: Vec<[f64; 2]>,
    /// Correlations of the values, row by row.
    pub correlations: Vec<Vec<f64>>,
}

/// What is known of the best candidate and its rivals.
pub struct Judged {
    pub evidence: Evidence,
    /// Beside the best, or beside the plain model where nothing was found.
    pub discrepancy: Discrepancy,
    pub intervals: Option<Intervals>,
    pub form: Option<Form>,
    /// Base and extension, chosen anew in each fold.
    pub nested: [HeldOut; 2],
}

/// Where slopes are not to be trusted: the lowest place about the best, and how far its values can be moved.
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

/// Judges what was fitted; `profiled` has the intervals of a rough model.
pub fn judged(study: &Study, fitted: &Fitted, gates: &Gates, profiled: &[[f64; 2]], nested: [HeldOut; 2]) -> Judged {
    let found = fitted.found(gates);
    let best = fitted.best().filter(|_| found);
    let directions = Directions::new(study, best.map_or(&fitted.base.fit, |c| &c.fit));
    let discrepancy = directions.about(best.map_or(&fitted.base.fit, |c| &c.fit));
    let alone = directions.about(&fitted.base.fit);
    let lack = |c: &Candidate| gates.lacking(&c.lack);
    let form = best.and_then(|_| questioned(study, fitted, gates));
    let beside = |c: &Candidate| lack(c) || discrepancy.size > 0.0;
    let excess = |c: &Candidate| c.lack.excess.max(0.0);
    let evidence = Evidence {
        found,
        misfit: lack(&fitted.base),
        remainder: beside(best.unwrap_or(&fitted.base)),
        explained: best.map_or(0.0, |c| 1.0 - excess(c) / excess(&fitted.base).max(1e-9)),
        advantage: best.map_or(0.0, |c| alone.surprise - directions.about(&c.fit).surprise),
        form_excluded: form.as_ref().is_some_and(|form| form.excluded),
        described: false,
        inflation: gates.inflation,
        rivals: best.map_or(Vec::new(), |best| rivals(fitted, best, &directions, discrepancy.size, gates)),
    };
    let intervals = best.map(|c| intervals(&c.fit, &directions, discrepancy.size, gates, profiled));
    Judged { evidence, discrepancy, intervals, form, nested }
}

/// Where a discrepancy is beside the best, it is beside the rivals as well, and takes its share of what tells them apart.
fn rivals(fitted: &Fitted, best: &Candidate, directions: &Directions, size: f64, gates: &Gates) -> Vec<Rival> {
    let of = |c: &Candidate| {
        let white: Vec<f64> = best.fit.white.iter().zip(&c.fit.white).map(|(a, b)| a - b).collect();
        let prior = best.fit.deviations.iter().zip(&c.fit.deviations).map(|(a, b)| (a - b) * (a - b)).sum::<f64>();
        let behind = match size > 0.0 {
            true => objective(&c.fit, directions, size) - objective(&best.fit, directions, size),
            false => c.fit.objective - best.fit.objective,
        };
        Rival { behind, squared: directions.square(&white, size) + prior, explains: c.delta_chi2 > gates.single }
    };
    fitted.candidates[1..fitted.finalists.max(1)].iter().map(of).collect()
}

fn objective(fit: &Fit, directions: &Directions, size: f64) -> f64 {
    directions.square(&fit.white, size) + fit.deviations.iter().map(|d| d * d).sum::<f64>()
}

/// Does the law of the best cause have the right form? Where the data exclude it, or where the cause alone in another form
/// explains as much as with a second term, which then only stands in for that, none of the causes is the right one.
fn questioned(study: &Study, fitted: &Fitted, gates: &Gates) -> Option<Form> {
    let best = &fitted.candidates[0].fit;
    let asked = Asked::of(study, best)?;
    let alone = fitted.candidates.iter().find(|c| asked.alone(&c.fit)).filter(|_| best.ids.len() > 1);
    // It was fitted under an earlier noise.
    let alone = alone.and_then(|c| form::check(study, &study.fit_from(&[&c.fit])[0], asked, gates.inflation));
    let stands_in = alone.filter(|form| form.excluded && form.objective <= best.objective);
    stands_in.or_else(|| form::check(study, best, asked, gates.inflation))
}

/// 95 % intervals, widened for the noise not being known exactly, with the discrepancy marginalised.
fn intervals(fit: &Fit, directions: &Directions, size: f64, gates: &Gates, profiled: &[[f64; 2]]) -> Intervals {
    let count = fit.ids.len();
    let inverse = directions.information(fit, size).try_inverse();
    let infinite = || nalgebra::DMatrix::from_element(count, count, f64::INFINITY);
    let covariance = inverse.map_or_else(infinite, |v| v.view((0, 0), (count, count)).into_owned());
    let plain = fit.covariance();
    let range = |k: usize| {
        let at = fit.coordinates()[k];
        let square = student::square_at_95(gates.degrees_of(&fit.ids[k..=k])) * gates.inflation;
        let reach = (square * covariance[(k, k)]).sqrt();
        let profiled = profiled.get(k).filter(|i| i.iter().all(|u| u.is_finite()));
        // A profile knows of no discrepancy: it is stretched by what that adds.
        let stretched = (covariance[(k, k)] / plain[(k, k)]).sqrt().max(1.0);
        let [low, high] = profiled.map_or([at - reach, at + reach], |p| p.map(|u| at + stretched * (u - at)));
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
