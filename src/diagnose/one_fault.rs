//! Is one thing wrong and all else as described? For data whose model has many effects of measuring, such as a robot's log.
//!
//! Each of these effects may be a few stated standard deviations off, and together they can take the place of one large difference, or of
//! sand of another strength. So before all are fitted together, every single difference is tried alone: one effect of measuring without
//! bound, or one cause in the sand, and everything else as stated. A difference is found if it predicts left-out conditions better than
//! every other one, and gives the main part of what all effects within their stated bounds give together.

use super::candidates::SearchSpace;
use super::evidence::EvidenceTable;
use super::fit::{COEFFICIENTS, Fit};
use super::left_out::Contender;
use super::measured::{MeasuredFit, WIDE, widened};
use super::nuisance::{Nuisance, kind};
use super::screen::starts;
use super::settling::FAR;
use super::study::FitInputs;
use super::verdict::{Effect, MAIN_PART};
use crate::parallel;
use crate::sand::mechanism::CATALOG;

/// The least part of the mean square of the errors that the difference takes away: our choice. Simulators of one robot differ a little, and
/// several effects describe these differences.
const LEAST: f64 = 0.2;
/// The difference must improve the prediction of at least this share of the conditions: our choice. What is wrong with a robot shows in every
/// walk; where a walk is unstable, any change may happen to predict it better.
const EVERYWHERE: f64 = 0.75;
/// A difference within this share of its stated standard deviation is as stated: our choice.
const AS_STATED: f64 = 0.5;
/// If one thing is wrong, all else is described well: the other effects have this share of their stated standard deviations. Our choice.
const NEARLY: f64 = 0.1;

/// The study in which all but one difference is nearly as described, and the cause in the sand that is left to be tried, if the difference
/// is one.
pub fn one_fault<'a>(study: &FitInputs<'a>, asked: &SearchSpace) -> Option<(FitInputs<'a>, Vec<usize>)> {
    let (fault, nuisances) = fault(study, asked)?;
    let nearly = |n: &Nuisance| if n.is_answer() { n.with_prior(NEARLY * n.stated_sd) } else { n.clone() };
    let (own, causes) = match fault {
        // What a robot's description has wrong can take the place of other sand; what its sensors have wrong cannot.
        Effect::Mechanism(id) => {
            let of = |n: &Nuisance| if kind(n.id).is_some_and(|kind| kind.geometry) { nearly(n) } else { n.clone() };
            (study.nuisances.iter().map(of).collect(), vec![id])
        }
        Effect::Measuring(k) => {
            let own = study.nuisances.iter().map(nearly).collect();
            (without_bound(study, &nuisances, own, k), Vec::new())
        }
    };
    Some((study.with_nuisances(own).nearly_stated(NEARLY), causes))
}

/// The difference, and the nuisances, linearised about it.
fn fault(study: &FitInputs, asked: &SearchSpace) -> Option<(Effect, Vec<Nuisance>)> {
    if !study.is_robots_log() {
        return None;
    }
    let exact = as_described(study);
    let plain = exact.with_slopes(exact.plain());
    let all = study.recalibrated();
    let effects: Vec<usize> = (0..study.nuisances.len()).filter(|k| study.nuisances[*k].is_answer()).collect();
    let made: Vec<MeasuredFit> = parallel::map(&effects, |&k| alone(&exact, study, &plain, k));
    let causes: Vec<Fit> =
        exact.fit_all(&asked.ids.iter().map(|&id| (vec![id], both_signs(study, id))).collect::<Vec<_>>());
    let of = |fit, nuisances| Contender { fit, nuisances, columns: &[] };
    let mut models = vec![of(&plain, &exact.nuisances[..]), of(&all, &study.nuisances[..])];
    models.extend(made.iter().map(|own| of(&own.fit, &own.nuisances[..])));
    models.extend(causes.iter().map(|fit| of(fit, &exact.nuisances[..])));
    let table = EvidenceTable::new(study, study.whitener, &models);
    let first = 2;
    let best = table.ranked(first..models.len()).first().copied()?;
    let fault = |k: usize| match effects.get(k - first) {
        Some(&effect) => Effect::Measuring(effect),
        None => Effect::Mechanism(causes[k - first - effects.len()].ids[0]),
    };
    let alike = |k: usize| match (fault(k), fault(best)) {
        (Effect::Measuring(a), Effect::Measuring(b)) => study.nuisances[a].id == study.nuisances[b].id,
        (a, b) => a == b,
    };
    let gain = |k: usize| table.elpd(k) - table.elpd(0);
    let main = gain(best) > MAIN_PART * gain(1) && table.lack(best) < (1.0 - LEAST) * table.lack(0);
    let beaten =
        (0..models.len()).filter(|k| *k != best && *k != 1 && (*k == 0 || !alike(*k))).all(|k| table.beats(best, k));
    let gains = table.shares(best, 0);
    let everywhere = gains.iter().filter(|gain| **gain > 0.0).count() as f64 >= EVERYWHERE * gains.len() as f64;
    let beyond = match fault(best) {
        Effect::Measuring(k) => {
            let (own, d) = (&made[best - first].nuisances[k], made[best - first].fit.deviations[COEFFICIENTS + k]);
            (own.sd * d).abs() > AS_STATED * own.stated_sd
        }
        Effect::Mechanism(_) => true,
    };
    let nuisances = made.get(best - first).map_or(&study.nuisances, |own| &own.nuisances);
    (main && beaten && everywhere && beyond).then(|| (fault(best), nuisances.clone()))
}

/// The same study with everything as described: stated coefficients, no effects of measuring.
pub fn as_described<'a>(study: &FitInputs<'a>) -> FitInputs<'a> {
    study.with_nuisances(study.nuisances.iter().map(|n| n.with_prior(0.0)).collect()).stated()
}

/// Effects that belong to another one. The place of a mass that the robot carries is not known, so with its mass the base's centre of mass
/// has no bound, too; and a filter is late and blurs.
const BELONGS: [[&str; 2]; 2] = [["payload", "center_of_mass"], ["imu_delay", "imu_blur"]];

/// These nuisances, of which the effect `k` has no bound. What belongs to it has none either, and is no effect of its own. `full` has the
/// columns of all of them.
fn without_bound(study: &FitInputs, full: &[Nuisance], mut nuisances: Vec<Nuisance>, k: usize) -> Vec<Nuisance> {
    for ((own, full), stated) in nuisances.iter_mut().zip(full).zip(&study.nuisances) {
        let sd = WIDE * stated.stated_sd;
        if BELONGS.contains(&[study.nuisances[k].id, stated.id]) {
            *own = Nuisance { stated_sd: sd, ..full.with_prior(sd) };
        } else if stated.is(&study.nuisances[k]) {
            *own = Nuisance { stated_sd: stated.stated_sd, ..full.with_prior(sd) };
        }
    }
    nuisances
}

/// A fit in which the effect `k` has no bound, and nothing else differs. Where steps from 0 lead astray, because the effect is not linear, it
/// begins at far values, too.
fn alone(exact: &FitInputs, study: &FitInputs, plain: &Fit, k: usize) -> MeasuredFit {
    let from = |start: f64| {
        let mut at = plain.clone();
        at.deviations[COEFFICIENTS + k] = start * study.nuisances[k].stated_sd;
        let there = || {
            let unit = study.nuisances.iter().map(|n| n.with_prior(1.0)).collect();
            exact.with_nuisances(unit).nuisances_of(plain, &at)
        };
        let nuisances = if start == 0.0 { study.nuisances.clone() } else { there() };
        let nuisances = without_bound(study, &nuisances, nuisances.iter().map(|n| n.with_prior(0.0)).collect(), k);
        at.deviations[COEFFICIENTS + k] = start / WIDE;
        widened(exact, plain, nuisances, (k, at), f64::INFINITY)
    };
    let near = from(0.0);
    if near.fit.objective <= plain.objective {
        return near;
    }
    FAR[1..].iter().map(|start| from(*start)).fold(near, |a, b| if b.fit.objective < a.fit.objective { b } else { a })
}

/// Start values of a cause, with both signs where its law has both.
fn both_signs(study: &FitInputs, id: usize) -> Vec<Vec<f64>> {
    let two =
        |value: f64| [value, -value].into_iter().filter(move |v| *v > 0.0 || CATALOG[id].coordinate_bounds()[0] < 0.0);
    starts(study, id).into_iter().flat_map(two).map(|value| vec![value]).collect()
}
