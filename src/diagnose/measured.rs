//! Effects of measuring as answers: models in which one of them may be far larger than stated.

use super::evidence::EvidenceTable;
use super::fit::{COEFFICIENTS, Fit};
use super::gauss_newton::at_bound;
use super::left_out::Contender;
use super::nuisance::{CauseKind, Nuisance, kind};
use super::settling::{FAR, bound, settled_nuisances};
use super::study::FitInputs;
use crate::parallel;

/// Factor on the prior standard deviation of an effect that may be the answer: our choice, so wide that the prior has no say
/// (a log that is late by 120 ms, a plate that is turned by 40°).
pub const WIDE: f64 = 20.0;
/// Least gain of a wide prior [χ²] by a linear estimate for which the model is fitted: our choice, below the 4 that a difference of
/// elpd needs at least.
const WORTH: f64 = 2.0;
/// Number of such models, the most promising ones, and the number for a rough model, whose derivatives need simulations: our choices,
/// because each fit takes time.
const MOST: [usize; 2] = [10, 3];

/// Number of effects, the most promising ones, whose fits begin at far values, too, beside those of all channels or shapes: our choice,
/// because each fit takes time.
const FAR_FITTED: usize = 3;

/// An effect that alone is the answer gives at least this share of what all together give: our choice; small errors of the other kinds, which
/// are always there, give the rest.
const MOST_OF_ALL: f64 = 0.75;

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
        if at_bound(d) { f64::INFINITY } else { d * d * less / left.max(1e-9) }
    };
    let open = |&k: &usize| {
        let n = &study.nuisances[k];
        n.sd == n.stated_sd && n.sd > 0.0 && n.is_answer()
    };
    let rough = study.model.roughness().is_some();
    let mut promising: Vec<(usize, f64)> = (0..study.nuisances.len()).filter(open).map(|k| (k, gain(k))).collect();
    // Of equally promising ones, those of all channels or shapes come first. Filters take the place of a long delay, and from there no
    // derivative shows it, so a delay is always tried.
    let common = |k: usize| study.nuisances[k].of.is_none();
    let late = |k: usize| common(k) && study.nuisances[k].id == "delay";
    promising.retain(|p| p.1 > WORTH || late(p.0));
    promising.sort_by(|a, b| late(b.0).cmp(&late(a.0)).then(b.1.total_cmp(&a.1)).then(common(b.0).cmp(&common(a.0))));
    promising.truncate(MOST[usize::from(rough)]);
    // Others may stand in for a large effect that is not linear, so its fit begins anew, without any of them, and at larger values.
    // Each fit of a rough model takes simulations, so its fits begin at the base alone.
    let far = |k: usize| !rough && (bound(base) || common(k) || promising.iter().take(FAR_FITTED).any(|p| p.0 == k));
    let free = study.observations.repetitions().iter().map(|g| g.len() as f64 - 1.0).sum::<f64>().max(2.0);
    // An effect whose value is not certain explains nothing, as a cause with the value of the plain sand does.
    let certain = |own: &MeasuredFit, index: usize| {
        let reach = study.with_nuisances(own.nuisances.clone()).reach(&own.fit, free);
        let d = own.fit.deviations[COEFFICIENTS + index].abs();
        d > reach[own.fit.ids.len() + COEFFICIENTS + index]
    };
    let made = parallel::map(&promising, |&(index, _)| {
        let mut from = base.clone();
        from.deviations[COEFFICIENTS + index] /= WIDE;
        let mut best = widened(study, base, study.nuisances.clone(), (index, from), f64::INFINITY);
        let curved = study.nuisances[index].nearly_linear.is_finite();
        for &start in FAR.iter().filter(|_| curved && far(index)) {
            let mut still = base.clone();
            still.deviations[COEFFICIENTS..].fill(0.0);
            still.deviations[COEFFICIENTS + index] = start;
            let nuisances = study.nuisances_of(base, &still);
            still.deviations[COEFFICIENTS + index] /= WIDE;
            let anew = widened(study, base, nuisances, (index, still), best.fit.objective);
            if anew.fit.objective < best.fit.objective {
                best = anew;
            }
        }
        certain(&best, index).then_some(best)
    });
    made.into_iter().flatten().collect()
}

/// The model of `base` without one effect of measuring, for each of `wide`.
pub fn absent(study: &FitInputs, base: &Fit, wide: &[MeasuredFit]) -> Vec<MeasuredFit> {
    let of = |own: &MeasuredFit| {
        let index = own.nuisances.iter().position(|n| n.sd > n.stated_sd).unwrap_or(0);
        let mut nuisances = study.nuisances.clone();
        nuisances[index] = nuisances[index].with_prior(0.0);
        let now = study.with_nuisances(nuisances);
        let mut from = Fit { slopes: Vec::new(), ..base.clone() };
        from.deviations[COEFFICIENTS + index] = 0.0;
        let fit = now.fit_from(&[&from]).swap_remove(0);
        MeasuredFit { fit, nuisances: now.nuisances }
    };
    parallel::map(wide, of)
}

/// A fit with a wide prior for the nuisance `index`, begun at `from`; abandoned if it is unlikely to reach the objective `best`.
pub fn widened(
    study: &FitInputs,
    base: &Fit,
    mut nuisances: Vec<Nuisance>,
    (index, from): (usize, Fit),
    best: f64,
) -> MeasuredFit {
    nuisances[index] = nuisances[index].with_prior(WIDE * nuisances[index].stated_sd);
    let now = study.with_nuisances(nuisances);
    let at = now.fit_from(&[&from]).swap_remove(0);
    let (nuisances, at) = settled_nuisances(now, base, at, best);
    let last = study.with_nuisances(nuisances);
    let fit = last.fit_from(&[&at]).swap_remove(0);
    MeasuredFit { fit, nuisances: last.nuisances }
}

/// The one effect of measuring that alone, with all others as stated, gives most of what all of them, within their stated priors, give to
/// the plain model. It is larger than its stated standard deviation, because a smaller
/// one is what the user expects, and no other one, and none of the `causes` (each with a value at which its fit begins), alone predicts as
/// well. `study` has the plain model.
pub fn alone(study: &FitInputs, plain: &Fit, causes: &[(usize, f64)]) -> Option<usize> {
    let nothing: Vec<Nuisance> = study.nuisances.iter().map(|n| n.with_prior(0.0)).collect();
    let exact = study.with_nuisances(nothing.clone());
    let mut from = Fit { slopes: Vec::new(), ..plain.clone() };
    from.deviations[COEFFICIENTS..].fill(0.0);
    let none = exact.fit_from(&[&from]).swap_remove(0);
    let reach = study.reach(plain, 1e6);
    let first = plain.ids.len() + COEFFICIENTS;
    let tried = |&k: &usize| {
        let (n, d) = (&study.nuisances[k], plain.deviations[COEFFICIENTS + k].abs());
        n.is_answer() && n.sd > 0.0 && (n.of.is_none() || d > reach[first + k].max(1.0))
    };
    let effects: Vec<usize> = (0..study.nuisances.len()).filter(tried).collect();
    let own = parallel::map(&effects, |&k| {
        let (mut start, mut only) = (from.clone(), nothing.clone());
        start.deviations[COEFFICIENTS + k] = plain.deviations[COEFFICIENTS + k] / WIDE;
        only[k] = study.nuisances[k].clone();
        widened(study, &from, only, (k, start), f64::INFINITY)
    });
    let others = parallel::map(causes, |&(id, value)| exact.fit(&[id], &[value]));
    let bare = |fit| Contender { fit, nuisances: &exact.nuisances, columns: &[] };
    let mut models = vec![Contender { fit: plain, nuisances: &study.nuisances, columns: &[] }, bare(&none)];
    models.extend(own.iter().map(|one| Contender { fit: &one.fit, nuisances: &one.nuisances, columns: &[] }));
    models.extend(others.iter().map(bare));
    let table = EvidenceTable::new(study, study.whitener, &models);
    let best = (0..effects.len()).max_by(|a, b| table.elpd(a + 2).total_cmp(&table.elpd(b + 2)))?;
    let large = WIDE * own[best].fit.deviations[COEFFICIENTS + effects[best]].abs() > 1.0;
    let gain = |row: usize| table.difference(row, 1)[0];
    let main = gain(best + 2) > MOST_OF_ALL * gain(0);
    let rival = |row: usize| row != best + 2 && !table.beats(best + 2, row);
    (large && main && !(1..models.len()).any(rival)).then_some(effects[best])
}

/// Is what is wrong the robot, the measurement, or the sand?
pub fn kind_of(nuisance: &Nuisance) -> CauseKind {
    kind(nuisance.id).map_or(CauseKind::Measurement, |k| k.kind)
}

/// The id in reports of an effect of measuring.
pub fn answer(nuisance: &Nuisance) -> &'static str {
    kind(nuisance.id).map_or(nuisance.id, |k| k.answer(nuisance.of.as_deref()))
}
