//! The second stage: fits every cause, learns the noise again about the best, and tries second causes. Values are
//! never changed: each step returns a new [`Fitted`].

use super::calibrate::{FELT, Gates, Scores, Screen, gates, starts};
use super::cross_validation::{HeldOut, leave_condition_out, unfitted};
use super::discrepancy::{Directions, Discrepancy};
use super::fit::{COEFFICIENTS, Fit, slope};
use super::lack_of_fit::{self, Lack};
use super::noise::{Noise, Sizes, Source, sizes_of};
use super::nuisance::Nuisance;
use super::study::Study;
use super::whiten::Whitener;
use crate::number::dot;
use crate::parallel;
use crate::sand::mechanism::{CATALOG, Mechanisms};

/// A second term must explain this share of the deviance that the pair explains on held-out conditions.
const SECOND_TERM_SHARE: f64 = 0.01;
/// Number of pairs that are fitted, the best of the linear screen: our choice, because each fit takes time.
const PAIRS_FITTED: usize = 14;
/// How often the noise is learnt again, at most, after the best candidate has changed: our choice; two times usually
/// suffice.
const NOISES: usize = 3;
/// Number of rivals that are fitted again under the final whitening: our choice; rivals further behind differ by
/// hundreds of χ².
pub const FINALISTS: usize = 8;
/// Bound of a linear estimate in typical strengths: our choice; further from the plain model the linear estimate is
/// not reliable.
pub const USUAL: f64 = 4.0;

/// Results of the first stage: the effect of every cause at the plain model, and gates.
pub struct Screened {
    pub screen: Screen,
    pub scores: Scores,
    pub gates: Gates,
    /// Catalogue indices of the causes that are tested.
    pub ids: Vec<usize>,
}

/// The first stage.
pub fn screened(study: &Study, source: &Source, noise: &Noise, ids: &[usize]) -> Screened {
    let screen = Screen::new(study, ids);
    let scores = screen.scores(study.whitener, &study.observations.values);
    let gates = gates(study, source, &screen, noise, &scores);
    Screened { screen, scores, gates, ids: ids.to_vec() }
}

/// One cause or pair that was tried.
#[derive(Clone)]
pub struct Candidate {
    pub fit: Fit,
    pub delta_chi2: f64,
    pub held_out: HeldOut,
    pub lack: Lack,
}

/// Noise, whitening and nuisances about one candidate.
pub struct Surroundings {
    pub noise: Noise,
    /// Sizes of the candidate's prediction, to which a part of the noise is proportional.
    pub sizes: Sizes,
    pub whitener: Whitener,
    pub nuisances: Vec<Nuisance>,
}

/// Plain model and candidates, fitted under one noise.
pub struct Fitted {
    /// Plain model, nothing fitted.
    pub plain: Fit,
    pub plain_held_out: HeldOut,
    /// Plain model with coefficients and nuisances fitted within their priors.
    pub base: Candidate,
    /// Best first: smallest χ² of the selected size, then the other sizes.
    pub candidates: Vec<Candidate>,
    /// How many of `candidates`, from the first, were fitted under the final whitening and can be compared.
    pub finalists: usize,
    /// The gain that a second cause needed; None if none was tried.
    pub second_gate: Option<f64>,
}

impl Fitted {
    pub fn best(&self) -> Option<&Candidate> {
        self.candidates.first()
    }

    /// No cause is found if the best gains less than the gate.
    pub fn found(&self, gates: &Gates) -> bool {
        self.best().is_some_and(|c| c.delta_chi2 > gates.single)
    }
}

pub fn candidate(study: &Study, base: &Fit, fit: Fit) -> Candidate {
    Candidate {
        delta_chi2: base.objective - fit.objective,
        held_out: leave_condition_out(study, &fit),
        lack: lack_of_fit::statistic(study.observations, &fit.white),
        fit,
    }
}

/// Sorts candidates: first those with `size` causes, and among these the best first. Only the first fits of a smooth
/// model keep their slopes, because slopes use most of the memory and can be computed again.
fn ranked(study: &Study, base: &Fit, fits: &[Fit], size: usize) -> Vec<Candidate> {
    let mut candidates = parallel::map(fits, |fit| candidate(study, base, fit.clone()));
    candidates.sort_by(|a, b| b.delta_chi2.total_cmp(&a.delta_chi2));
    candidates.sort_by_key(|c| c.fit.ids.len() != size);
    if study.model.roughness().is_none() {
        let fits = candidates.iter_mut().skip(FINALISTS).map(|c| &mut c.fit);
        fits.for_each(|f| (f.slopes, f.white_slopes) = (Vec::new(), Vec::new()));
    }
    candidates
}

/// Start states of a fit of `ids`: `values`, and every further start of each.
fn further_starts(study: &Study, ids: &[usize], values: &[f64]) -> (Vec<usize>, Vec<Vec<f64>>) {
    let mut from = vec![values.to_vec()];
    for (k, &id) in ids.iter().enumerate() {
        for &start in starts(study, id).iter().skip(1) {
            let mut other = values.to_vec();
            other[k] = start;
            from.push(other);
        }
    }
    (ids.to_vec(), from)
}

/// Start of a fit with a single cause: the linear estimate, limited to usual strengths of the mechanism.
fn linear_start(screen: &Screen, scores: &Scores, column: usize) -> f64 {
    let (id, value) = screen.candidates[column];
    let entry = &CATALOG[id];
    let felt = scores.gram[(column, column)];
    if entry.ceiling {
        return value; // its effect is far from proportional, so a linear estimate from the plain model is meaningless
    }
    let estimate = if felt > FELT { entry.typical * scores.score[column] / felt } else { 0.0 };
    let reach = (USUAL * entry.typical).max(8.0 * value.abs());
    let start = estimate.clamp(-reach, reach).clamp(entry.bounds[0], entry.bounds[1]);
    if start == 0.0 { value * 0.1 } else { start }
}

/// The objective of a rough model has several minima, and the linear estimate may lead into one near the plain model.
/// So there is a second start with the same sign, at the largest value that estimates may have. None for a smooth
/// model, for which the first start suffices.
fn far_start(study: &Study, id: usize, estimate: f64) -> Option<f64> {
    let entry = &CATALOG[id];
    let far = (USUAL * entry.typical).copysign(estimate).clamp(entry.bounds[0], entry.bounds[1]);
    (study.model.roughness().is_some() && !entry.ceiling).then_some(far)
}

/// The plain fit of a rough model may have ended in a local minimum, and a cause may then gain only by leading out
/// of it. So the plain model is fitted again from the end of the best of `fits`, and replaces `base` if its
/// objective is lower.
fn beneath(study: &Study, base: Fit, fits: &[Fit]) -> Fit {
    let best = fits.iter().min_by(|a, b| a.objective.total_cmp(&b.objective));
    let Some(best) = best.filter(|best| study.model.roughness().is_some() && best.objective < base.objective) else {
        return base;
    };
    let (ids, mechanisms) = (Vec::new(), Mechanisms::default());
    let from = Fit { ids, mechanisms, slopes: Vec::new(), white_slopes: Vec::new(), ..best.clone() };
    let again = study.fit_from(&[&from]).swap_remove(0);
    if again.objective < base.objective { again } else { base }
}

/// Fits every single cause.
pub fn singles(study: &Study, Screened { screen, scores, ids, .. }: &Screened) -> Fitted {
    let (plain, base) = (study.plain(), study.recalibrated());
    let columns: Vec<usize> = ids.iter().filter_map(|id| screen.candidates.iter().position(|c| c.0 == *id)).collect();
    let start = |&column: &usize| {
        let value = linear_start(screen, scores, column);
        let id = screen.candidates[column].0;
        let (ids, mut from) = further_starts(study, &[id], &[value]);
        from.extend(far_start(study, id, value).map(|far| vec![far]));
        (ids, from)
    };
    let fits = study.fit_all(&columns.iter().map(start).collect::<Vec<_>>());
    let base = beneath(study, base, &fits);
    Fitted {
        plain_held_out: unfitted(study, &plain),
        candidates: ranked(study, &base, &fits, 1),
        base: candidate(study, &base, base.clone()),
        plain,
        finalists: 0,
        second_gate: None,
    }
}

/// Noise, whitening and nuisances about a fit. The common part of a repetition's noise acts along the fit's
/// prediction.
pub fn surroundings(study: &Study, source: &Source, start: &Noise, fit: &Fit) -> Surroundings {
    let coefficients = study.coefficients(&fit.deviations);
    let mut shared = study.model.shared(&fit.mechanisms, &coefficients, &fit.prediction);
    shared.retain(|s| source.shared.iter().any(|own| own.name == s.name));
    let model_error = study.model.model_error(&fit.mechanisms, &coefficients, &fit.prediction);
    let own_error = study.model.own_error(&fit.mechanisms, &coefficients, &fit.prediction);
    // The noise is learnt from the fit's residual, nuisances included, and is proportional to the prediction of the
    // sand.
    let reading = study.reading(fit);
    let sizes = sizes_of(study.observations, &reading);
    let source = Source {
        prediction: &reading,
        sizes: &sizes,
        shared: &shared,
        model_error: &model_error,
        own_error: &own_error,
        ..*source
    };
    let noise = source.noise(Some(start), &|| study.model.stopped());
    let whitener = Whitener::new(&source, &noise);
    let nuisances = bent(study, &whitener, fit);
    Surroundings { noise, sizes, whitener, nuisances }
}

/// Largest number of rounds for nuisances with a nonlinear effect: our choice; most fits need two.
const BENDS: usize = 6;
/// A change by less than this share of a prior standard deviation counts as converged: our choice.
const STRAIGHT: f64 = 0.02;

/// Nuisances linearised at `fit` under a whitening. Fit and nuisances are adjusted to each other in turns, because the
/// first estimate is inaccurate if a filter is slow compared with the fastest trials. A step that does not help is
/// halved.
fn bent(study: &Study, whitener: &Whitener, fit: &Fit) -> Vec<Nuisance> {
    let mut now = study.under(whitener, study.nuisances_about(fit));
    let mut at = now.fit_from(&[fit]).swap_remove(0);
    let mut least = f64::INFINITY;
    let mut before = fit.clone();
    for _ in 0..BENDS {
        let bends = study.nuisances.iter().zip(&at.deviations[COEFFICIENTS..]).zip(&before.deviations[COEFFICIENTS..]);
        let turned = bends
            .filter(|((n, _), _)| n.id.starts_with("lowpass") || n.id.starts_with("imu"))
            .map(|((_, a), b)| (a - b).abs());
        if turned.fold(0.0, f64::max) < STRAIGHT {
            break;
        }
        // The effect of a filter depends on its time constant, and hardly on the small changes of other parameters
        // here.
        let next = study.under(whitener, now.nuisances_of(fit, &at));
        let there = next.restated(&at);
        if there.objective > least {
            let half = at.deviations.iter().zip(&before.deviations).map(|(a, b)| 0.5 * (a + b)).collect();
            at = Fit { deviations: half, ..at };
            continue;
        }
        (least, before) = (there.objective, at);
        at = next.fit_from(&[&there]).swap_remove(0);
        now = next;
    }
    now.nuisances_of(fit, &at)
}

/// Fits the best and its nearest rivals again with the noise about the best, until that changes the best by less
/// than one σ; returns the last surroundings.
pub fn settled(study: &Study, source: &Source, noise: &Noise, fitted: Fitted) -> (Fitted, Option<Surroundings>) {
    let mut fitted = fitted;
    let mut around: Option<Surroundings> = None;
    for _ in 0..NOISES {
        let Some(best) = fitted.best().map(|c| c.fit.clone()) else { break };
        let (next, before) = {
            let now = around.as_ref().map(|a| study.under(&a.whitener, a.nuisances.clone()));
            let now = now.as_ref().unwrap_or(study);
            (surroundings(now, source, noise, &best), now.reading(&best))
        };
        let renewed = study.under(&next.whitener, next.nuisances.clone());
        fitted = refitted(&renewed, fitted);
        let after = fitted.best().map(|c| renewed.reading(&c.fit));
        let moved = after.map(|after| next.whitener.apply(&slope(&after, &before, 1.0)));
        around = Some(next);
        if moved.is_none_or(|moved| dot(&moved, &moved) < 1.0) {
            break;
        }
    }
    (fitted, around)
}

/// The misfit beyond noise that the best candidate does not explain, represented as a part of the noise; and the whitening with this
/// noise.
pub struct Beside {
    pub discrepancy: Discrepancy,
    /// Directions of the discrepancy without whitening; none where it is too large to have any.
    pub raw: Vec<Vec<f64>>,
    /// Factor on the noise's variance; 1 where there are directions.
    pub dispersion: f64,
    pub whitener: Whitener,
}

impl Beside {
    /// The same whitening of other conditions.
    pub fn on(&self, own: Whitener) -> Whitener {
        let sized = |column: &Vec<f64>| own.apply(column).iter().map(|v| self.discrepancy.size * v).collect();
        let directions = self.raw.iter().map(sized).collect();
        own.beside(directions).dispersed(self.dispersion)
    }
}

/// Largest number of rounds in which a discrepancy's size and the fits are computed again: our choice; two usually
/// suffice.
const DISCREPANCIES: usize = 2;

/// If the best candidate leaves a smooth misfit beyond noise, fits everything again with a discrepancy, which explains
/// its share of the differences between explanations. Without it the least noisy samples alone would decide. None if
/// the data need no discrepancy.
///
/// If even the largest discrepancy is too small, one that fits would also explain what a cause explains. Then the
/// variance of the noise is multiplied by the best candidate's lack of fit instead (overdispersion: McCullagh & Nelder
/// 1989, section 4.5).
pub fn beside_discrepancy(study: &Study, around: &Surroundings, fitted: Fitted) -> (Fitted, Option<Beside>) {
    let mut fitted = fitted;
    let mut found = None;
    for _ in 0..DISCREPANCIES {
        let standing = fitted.best().map_or(&fitted.base.fit, |c| &c.fit);
        let plain = study.under(&around.whitener, around.nuisances.clone());
        let directions = Directions::new(&plain, standing);
        let own = plain.fit_from(&[standing]).swap_remove(0);
        let discrepancy = directions.about(&own);
        if discrepancy.size == 0.0 {
            break;
        }
        let own_lack = lack_of_fit::statistic(study.observations, &own.white).mean;
        let (raw, dispersion) = if discrepancy.too_large() { (Vec::new(), own_lack) } else { (directions.raw, 1.0) };
        let mut beside = Beside { discrepancy, raw, dispersion, whitener: around.whitener.clone() };
        beside.whitener = beside.on(around.whitener.clone());
        fitted = all_refitted(&study.under(&beside.whitener, around.nuisances.clone()), fitted);
        found = Some(beside);
    }
    (fitted, found)
}

/// Fits the likeliest candidates of the selected size again from their ends, best first; the others keep their
/// distance to the best. A new whitening may change the ranks; one step of each tells which are the likeliest.
fn all_refitted(study: &Study, fitted: Fitted) -> Fitted {
    let size = fitted.best().map_or(1, |c| c.fit.ids.len());
    let (same, others): (Vec<Candidate>, Vec<Candidate>) =
        fitted.candidates.into_iter().partition(|c| c.fit.ids.len() == size);
    let stepped = study.stepped(&same.iter().map(|c| &c.fit).collect::<Vec<_>>());
    let mut order: Vec<usize> = (0..same.len()).collect();
    order.sort_by(|a, b| stepped[*a].total_cmp(&stepped[*b]));
    let again = study.fit_from(&order.iter().take(FINALISTS).map(|&k| &same[k].fit).collect::<Vec<_>>());
    let base = beneath(study, study.recalibrated(), &again);
    let mut candidates = ranked(study, &base, &again, size);
    let finalists = candidates.len();
    let mut same: Vec<Option<Candidate>> = same.into_iter().map(Some).collect();
    candidates.extend(order[finalists..].iter().filter_map(|&k| same[k].take()));
    candidates.extend(others);
    Fitted { base: candidate(study, &base, base.clone()), candidates, finalists, ..fitted }
}

/// Fits the best and its nearest rivals again, from their ends; the others keep their distance to the best.
fn refitted(study: &Study, fitted: Fitted) -> Fitted {
    let Fitted { plain, plain_held_out, candidates, second_gate, .. } = fitted;
    let size = candidates[0].fit.ids.len();
    let same: Vec<usize> =
        (0..candidates.len()).filter(|&k| candidates[k].fit.ids.len() == size).take(FINALISTS).collect();
    let beside = study.beside(&candidates[0].fit);
    let mut again = study.fit_from(&same.iter().map(|&k| &candidates[k].fit).chain(&beside).collect::<Vec<_>>());
    for other in again.split_off(same.len()) {
        if other.objective < again[0].objective {
            again[0] = other;
        }
    }
    let base = beneath(study, study.recalibrated(), &again);
    let mut front = ranked(study, &base, &again, size);
    let finalists = front.len();
    front.extend(candidates.into_iter().enumerate().filter(|(k, _)| !same.contains(k)).map(|(_, c)| c));
    let base = candidate(study, &base, base.clone());
    Fitted { plain, plain_held_out, base, candidates: front, finalists, second_gate }
}

/// The single cause of a rough model may have ended in a local minimum, and a pair may then gain only by leading
/// out of it: fits the single cause again from the pair's end, and keeps it if its objective is lower.
fn beyond(study: &Study, single: &Candidate, pair: &Fit) -> Option<Fit> {
    let id = *single.fit.ids.first().filter(|id| study.model.roughness().is_some() && pair.ids.contains(id))?;
    let mechanisms = Mechanisms::default().with(id, pair.mechanisms.get(id));
    let from = Fit { ids: vec![id], mechanisms, slopes: Vec::new(), white_slopes: Vec::new(), ..pair.clone() };
    let again = study.fit_from(&[&from]).swap_remove(0);
    (again.objective < single.fit.objective).then_some(again)
}

/// Tries second causes in addition to the best. If the best pair passes its tests, pairs move to the front. Returns whether
/// it does.
pub fn with_pairs(study: &Study, first: &Screened, fitted: Fitted) -> (Fitted, bool) {
    let Screened { screen, gates, .. } = first;
    let scores = screen.scores(study.whitener, &study.observations.values);
    let best = &fitted.candidates[0];
    let id = best.fit.ids[0];
    let Some(column) = screen.candidates.iter().position(|c| c.0 == id) else {
        return (fitted, false);
    };
    let gate = screen.second_gate(&scores.gram, column, best.fit.values()[0], gates);
    let second = study.further(&best.fit, &screen.candidates);
    let linear = screen.pairs(&scores.gram, &scores.score);
    let from_best = second.iter().map(|s| [id, s.id]);
    let from_all = linear.iter().map(|&(_, i, j)| [screen.candidates[i].0, screen.candidates[j].0]);
    let mut tried: Vec<[usize; 2]> = Vec::new();
    for pair in from_best.take(PAIRS_FITTED / 2).chain(from_all) {
        if tried.len() < PAIRS_FITTED && !tried.iter().any(|t| *t == pair || *t == [pair[1], pair[0]]) {
            tried.push(pair);
        }
    }
    let start = |id: usize| {
        let single = fitted.candidates.iter().find(|c| c.fit.ids == [id]);
        single.map_or(0.0, |c| c.fit.values()[0])
    };
    let starts = |pair: &[usize; 2]| {
        let mut ids = pair.to_vec();
        ids.sort_unstable();
        let values = if pair[0] == id {
            let other = second.iter().find(|s| s.id == pair[1]).map_or(0.0, |s| s.start);
            if ids[0] == id { [start(id), other] } else { [other, start(id)] }
        } else {
            [0.5 * start(ids[0]), 0.5 * start(ids[1])]
        };
        further_starts(study, &ids, &values)
    };
    let fits = study.fit_all(&tried.iter().map(starts).collect::<Vec<_>>());
    let base = fitted.base.fit.clone();
    let mut pairs = ranked(study, &base, &fits, 2);
    let lower = pairs.first().and_then(|pair| beyond(study, &fitted.candidates[0], &pair.fit));
    let mut fitted = fitted;
    if let Some(lower) = lower {
        fitted.candidates[0] = candidate(study, &base, lower);
    }
    let (best, base) = (&fitted.candidates[0], &base);
    let earns = pairs.first().is_some_and(|pair| {
        // An explanation by coefficients far from their prior is penalised: their deviations count as in a fit.
        let charged = |fit: &Fit, held_out: &HeldOut| held_out.deviance + dot(&fit.deviations, &fit.deviations);
        let none = charged(base, &fitted.base.held_out);
        let [one, two] = [best, pair].map(|c| charged(&c.fit, &c.held_out));
        let share = (one - two) / (none - two).max(1e-9);
        // If the model is wrong by much more than the noise, a term may lower χ² by fitting a few samples with little
        // noise. A true second cause also lowers the error of held-out conditions, in the data's own units.
        let predicts = pair.held_out.errors.rmse() < best.held_out.errors.rmse();
        pair.delta_chi2 - best.delta_chi2 > gate && share >= SECOND_TERM_SHARE && predicts
    });
    let mut candidates = fitted.candidates;
    if earns {
        pairs.append(&mut candidates);
        candidates = pairs;
    } else {
        candidates.append(&mut pairs);
    }
    (Fitted { candidates, second_gate: Some(gate), ..fitted }, earns)
}
