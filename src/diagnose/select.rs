//! Which cause: singles, then pairs, behind gates; what stands beside them; whether anything is left over.

use super::calibrate::{FELT, Gates, Scores, Screen, gates, starts};
use super::chi_squared;
use super::cross_validation::{HeldOut, leave_condition_out, unfitted};
use super::fit::{Fit, Study, dot, slope};
use super::form::{self, Asked, Form};
use super::lack_of_fit;
use super::noise::{Noise, Source};
use super::profile;
use super::whiten::Whitener;
use crate::error::Result;
use crate::parallel;
use crate::progress::Progress;
use crate::sand::mechanism::CATALOG;
use serde::Serialize;

/// The outcome of a diagnosis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// The plain model is as good as the data's own repeatability.
    NoiseFloor,
    /// One cause, or one pair, stands alone.
    Named,
    /// Causes that these data cannot tell apart.
    Ambiguous,
    /// Misfit remains after every extension tried.
    NoneOfThese,
    /// No repetitions, or only copies, so no noise floor.
    InsufficientData,
}

/// Chance that a true cause is thrown out of the ambiguity set by chance, over all its rivals together.
const REJECTION: f64 = 1e-3;
/// Two explanations nearer to each other than this [σ] are not told apart, whatever their χ²: the contract claims no right
/// names below, and noise learnt from a few repetitions does not have tails to be trusted so far out.
const APART: f64 = 5.0;
/// A second term must earn this share of the deviance that the pair explains on held-out conditions (contract, 4).
const SECOND_TERM_SHARE: f64 = 0.01;
/// Pairs fitted in full, the best of the linear screen: our choice, for the time they take.
const PAIRS_FITTED: usize = 14;
/// Times that the noise is made anew for a best candidate that it has moved: our choice, two are usually enough.
const NOISES: usize = 3;
/// Rivals fitted again under the final whitening: our choice; one further behind is hundreds of χ² away.
const FINALISTS: usize = 8;

/// Typical strengths within which a linear estimate is held: our choice, beyond it a line from the plain model says little.
const USUAL: f64 = 4.0;

/// One cause or pair that was tried.
pub struct Candidate {
    pub fit: Fit,
    pub delta_chi2: f64,
    pub held_out: HeldOut,
    pub lack_of_fit: f64,
}

pub struct Selection {
    pub verdict: Verdict,
    /// Plain model, nothing fitted.
    pub plain: Fit,
    pub plain_held_out: HeldOut,
    /// Plain model with its coefficients adjusted within their prior.
    pub base: Fit,
    pub base_held_out: HeldOut,
    pub base_lack_of_fit: f64,
    /// Best first: smallest χ² of the size chosen, then the others.
    pub candidates: Vec<Candidate>,
    /// Places in `candidates` of what the data cannot tell from the best, the best included.
    pub set: Vec<usize>,
    pub gates: Gates,
    /// 95 % intervals of the best's coordinates where slopes are not to be trusted; else empty.
    pub intervals: Vec<[f64; 2]>,
    /// What the data say of the form of the best's law, where that can be asked.
    pub form: Option<Form>,
    /// How many of `candidates`, from the first, were fitted under the final whitening and can be compared.
    finalists: usize,
}

impl Selection {
    /// Lets go of all slopes but the best's: a smooth model's fits take them anew, and they fill the memory.
    fn slim(&mut self, study: &Study) {
        if study.model.roughness().is_none() {
            let fits = self.candidates.iter_mut().skip(1).map(|c| &mut c.fit);
            fits.for_each(|f| (f.slopes, f.white_slopes) = (Vec::new(), Vec::new()));
        }
    }

    /// The best candidate, where a cause was found.
    pub fn best(&self) -> Option<&Candidate> {
        self.set.first().map(|&k| &self.candidates[k])
    }

    /// What else explains a significant part, fitted under the final whitening, with its whitened distance [σ] to the best.
    pub fn rivals(&self) -> impl Iterator<Item = (&Candidate, f64)> {
        let others = self.candidates.iter().take(self.finalists).skip(1);
        let explains = others.filter(|c| c.delta_chi2 > self.gates.single);
        explains.map(|c| (c, self.candidates[0].fit.distance_squared(&c.fit).sqrt()))
    }
}

fn candidate(study: &Study, base: &Fit, fit: Fit) -> Candidate {
    Candidate {
        delta_chi2: base.objective - fit.objective,
        held_out: leave_condition_out(study, &fit),
        lack_of_fit: lack_of_fit::statistic(study.observations, &fit.white),
        fit,
    }
}

/// Starts of a fit of `ids`: `values`, and every further start of each.
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

/// Start of a single fit: the linear estimate, held within what is usual for the mechanism.
fn linear_start(screen: &Screen, scores: &Scores, column: usize) -> f64 {
    let (id, value) = screen.candidates[column];
    let entry = &CATALOG[id];
    let felt = scores.gram[(column, column)];
    if entry.ceiling {
        return value; // its effect is far from proportional: an estimate from afar means nothing
    }
    let estimate = if felt > FELT { entry.typical * scores.score[column] / felt } else { 0.0 };
    let reach = (USUAL * entry.typical).max(8.0 * value.abs());
    let start = estimate.clamp(-reach, reach).clamp(entry.bounds[0], entry.bounds[1]);
    if start == 0.0 { value * 0.1 } else { start }
}

/// A rough model's objective has minima beside the lowest, and the linear estimate may lead into one near the plain model: a
/// second start, as far out on the same side as estimates are held. None of a smooth model, where the first one has to do.
fn far_start(study: &Study, id: usize, estimate: f64) -> Option<f64> {
    let entry = &CATALOG[id];
    let far = (USUAL * entry.typical).copysign(estimate).clamp(entry.bounds[0], entry.bounds[1]);
    (study.model.roughness().is_some() && !entry.ceiling).then_some(far)
}

/// Runs the whole selection on `ids`. Once a cause is found, what a repetition has in common acts along the extended
/// model's prediction, no longer along the plain one's: noise and whitening are made again, before second terms are tried
/// and once more where one earns its place.
pub fn select(
    study: &Study,
    source: &Source,
    noise: &Noise,
    ids: &[usize],
    progress: &dyn Progress,
) -> Result<Selection> {
    progress.report(0.1, "effect of every cause")?;
    let screen = Screen::new(study, ids);
    let scores = screen.scores(study.whitener, &study.observations.values);
    progress.report(0.2, "gates on simulated nulls")?;
    let gates = gates(study, source, &screen, noise, &scores);
    progress.report(0.4, "single causes")?;
    let mut selection = singles(study, &screen, &scores, gates, ids);
    if selection.candidates.first().is_none_or(|c| c.delta_chi2 <= selection.gates.single) {
        if selection.base_lack_of_fit > selection.gates.lack_of_fit {
            selection.verdict = Verdict::NoneOfThese;
        }
        return Ok(selection);
    }
    progress.report(0.5, "singles under the noise of the best")?;
    let mut whitener = settle(study, source, noise, &mut selection);
    progress.report(0.6, "pairs of causes")?;
    let renewed = study.rewhitened(&whitener);
    let scores = screen.scores(&whitener, &study.observations.values);
    if add_pairs(&renewed, &screen, &scores, &mut selection) {
        progress.report(0.85, "pairs under the noise of the best")?;
        whitener = settle(study, source, noise, &mut selection);
    }
    progress.report(0.9, "intervals and the form of the law")?;
    let renewed = study.rewhitened(&whitener);
    if study.model.roughness().is_some() {
        explore(&renewed, &mut selection);
    }
    decide(&mut selection);
    question_form(&renewed, &mut selection);
    Ok(selection)
}

/// Finds the lowest place about the best, and how far its values can be moved.
fn explore(study: &Study, selection: &mut Selection) {
    let best = &selection.candidates[0];
    let allowed = chi_squared::AT_95_PERCENT * selection.gates.inflation;
    let (lowest, intervals) = profile::explore(study, &best.fit, allowed);
    if lowest.objective < best.fit.objective {
        selection.candidates[0] = candidate(study, &study.recalibrated(), lowest);
    }
    selection.intervals = intervals;
}

/// Asks whether the law of the best cause has the right form. Where the data exclude it, or where the cause alone in another
/// form explains as much as with a second term, which then only stands in for that, none of the causes is the right one.
fn question_form(study: &Study, selection: &mut Selection) {
    let best = &selection.candidates[0].fit;
    let Some(asked) = Asked::of(study, best) else { return };
    let inflation = selection.gates.inflation;
    let alone = selection.candidates.iter().find(|c| asked.alone(&c.fit)).filter(|_| best.ids.len() > 1);
    // It was fitted under an earlier noise.
    let alone = alone.and_then(|c| form::check(study, &study.fit_from(&[&c.fit])[0], asked, inflation));
    let stands_in = alone.filter(|form| form.excluded && form.objective <= best.objective);
    selection.form = stands_in.or_else(|| form::check(study, best, asked, inflation));
    if selection.form.as_ref().is_some_and(|form| form.excluded) {
        selection.verdict = Verdict::NoneOfThese;
        selection.set.clear();
    }
}

/// Makes the noise that belongs to the best candidate and fits it and its rivals again under it, until that moves the best by
/// less than one σ; gives the last whitening.
fn settle(study: &Study, source: &Source, noise: &Noise, selection: &mut Selection) -> Whitener {
    let mut round = 1;
    loop {
        let best = &selection.candidates[0].fit;
        let coefficients = study.coefficients(&best.deviations);
        let shared = study.model.shared(&best.mechanisms, &coefficients, &best.prediction);
        let model_error = study.model.model_error(&best.mechanisms, &coefficients, &best.prediction);
        let prediction = &best.prediction.clone();
        let source = Source { prediction, shared: &shared, model_error: &model_error, ..*source };
        let whitener = Whitener::new(&source, &source.noise(Some(noise), &|| study.model.stopped()));
        refit(&study.rewhitened(&whitener), selection);
        let moved = whitener.apply(&slope(&selection.candidates[0].fit.prediction, prediction, 1.0));
        if round == NOISES || dot(&moved, &moved) < 1.0 {
            return whitener;
        }
        round += 1;
    }
}

fn singles(study: &Study, screen: &Screen, scores: &Scores, gates: Gates, ids: &[usize]) -> Selection {
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
    let mut candidates = parallel::map(&fits, |fit| candidate(study, &base, fit.clone()));
    candidates.sort_by(|a, b| b.delta_chi2.total_cmp(&a.delta_chi2));
    let mut selection = Selection {
        verdict: Verdict::NoiseFloor,
        plain_held_out: unfitted(study, &plain),
        base_held_out: leave_condition_out(study, &base),
        base_lack_of_fit: lack_of_fit::statistic(study.observations, &base.white),
        plain,
        base,
        candidates,
        set: Vec::new(),
        gates,
        intervals: Vec::new(),
        form: None,
        finalists: 0,
    };
    selection.slim(study);
    selection
}

/// Fits the best and its nearest rivals again, from where they stand, under a new whitening; the others keep their
/// distance to the best.
fn refit(study: &Study, selection: &mut Selection) {
    let size = selection.candidates[0].fit.ids.len();
    let same: Vec<usize> = (0..selection.candidates.len())
        .filter(|&k| selection.candidates[k].fit.ids.len() == size)
        .take(FINALISTS)
        .collect();
    let base = study.recalibrated();
    let candidates = &selection.candidates;
    let beside = study.beside(&candidates[0].fit);
    let mut again = study.fit_from(&same.iter().map(|&k| &candidates[k].fit).chain(&beside).collect::<Vec<_>>());
    for other in again.split_off(same.len()) {
        if other.objective < again[0].objective {
            again[0] = other;
        }
    }
    let again = parallel::map(&again, |fit| candidate(study, &base, fit.clone()));
    for (k, fresh) in same.into_iter().zip(again) {
        selection.candidates[k] = fresh;
    }
    let finalists = FINALISTS.min(selection.candidates.iter().take_while(|c| c.fit.ids.len() == size).count());
    selection.candidates[..finalists].sort_by(|a, b| b.delta_chi2.total_cmp(&a.delta_chi2));
    selection.finalists = finalists;
    selection.slim(study);
}

/// Tries second terms; pairs go to the front where the best of them earns its place: does it?
fn add_pairs(study: &Study, screen: &Screen, scores: &Scores, selection: &mut Selection) -> bool {
    let best = &selection.candidates[0];
    let id = best.fit.ids[0];
    let Some(column) = screen.candidates.iter().position(|c| c.0 == id) else {
        return false;
    };
    let base = study.recalibrated();
    let gate = screen.second_gate(&scores.gram, column, best.fit.values()[0], selection.gates.inflation);
    let mut tried: Vec<[usize; 2]> = Vec::new();
    let second = study.second_terms(&best.fit, screen);
    let from_best = second.iter().map(|s| [id, s.0]);
    let linear = screen.pairs(&scores.gram, &scores.score);
    let from_all = linear.iter().map(|&(_, i, j)| [screen.candidates[i].0, screen.candidates[j].0]);
    for pair in from_best.take(PAIRS_FITTED / 2).chain(from_all) {
        if tried.len() < PAIRS_FITTED && !tried.iter().any(|t| *t == pair || *t == [pair[1], pair[0]]) {
            tried.push(pair);
        }
    }
    let start = |id: usize| {
        let single = selection.candidates.iter().find(|c| c.fit.ids == [id]);
        single.map_or(0.0, |c| c.fit.values()[0])
    };
    let starts = |pair: &[usize; 2]| {
        let mut ids = pair.to_vec();
        ids.sort_unstable();
        let values = if pair[0] == id {
            let other = second.iter().find(|s| s.0 == pair[1]).map_or(0.0, |s| s.1);
            if ids[0] == id { [start(id), other] } else { [other, start(id)] }
        } else {
            [0.5 * start(ids[0]), 0.5 * start(ids[1])]
        };
        further_starts(study, &ids, &values)
    };
    let fits = study.fit_all(&tried.iter().map(starts).collect::<Vec<_>>());
    let mut pairs = parallel::map(&fits, |fit| candidate(study, &base, fit.clone()));
    pairs.sort_by(|a, b| b.delta_chi2.total_cmp(&a.delta_chi2));
    let earns = pairs.first().is_some_and(|pair| {
        // What coefficients far from their prior explain is not explained: their deviations are charged as in a fit.
        let charged = |fit: &Fit, held_out: &HeldOut| held_out.deviance + dot(&fit.deviations, &fit.deviations);
        let [none, one, two] = [
            charged(&base, &leave_condition_out(study, &base)),
            charged(&best.fit, &best.held_out),
            charged(&pair.fit, &pair.held_out),
        ];
        let share = (one - two) / (none - two).max(1e-9);
        pair.delta_chi2 - best.delta_chi2 > gate && share >= SECOND_TERM_SHARE
    });
    if earns {
        pairs.append(&mut selection.candidates);
        selection.candidates = pairs;
    } else {
        selection.candidates.append(&mut pairs);
    }
    selection.slim(study);
    earns
}

/// Lack of fit, then what the data cannot tell from the best.
fn decide(selection: &mut Selection) {
    let best = &selection.candidates[0];
    if best.lack_of_fit > selection.gates.lack_of_fit {
        selection.verdict = Verdict::NoneOfThese;
        return;
    }
    let size = best.fit.ids.len();
    let rivals = selection.candidates.iter().filter(|c| c.fit.ids.len() == size).count().saturating_sub(1).max(1);
    let limit = normal_quantile(1.0 - REJECTION / rivals as f64) * selection.gates.inflation.sqrt();
    let stays = |c: &Candidate| {
        // If the rival were true, χ²_rival − χ²_best would be −d² ± 2d, d the whitened distance between the two.
        let behind = c.fit.objective - best.fit.objective;
        let squared = best.fit.distance_squared(&c.fit);
        let stands = behind + squared <= limit * 2.0 * squared.sqrt() || squared < APART * APART;
        stands && c.delta_chi2 > selection.gates.single
    };
    let set: Vec<usize> = (0..selection.finalists).filter(|&k| k == 0 || stays(&selection.candidates[k])).collect();
    selection.verdict = if set.len() == 1 { Verdict::Named } else { Verdict::Ambiguous };
    selection.set = set;
}

/// Quantile of the standard normal distribution (Acklam's rational approximation for the upper tail, |error| < 1e-4).
fn normal_quantile(share: f64) -> f64 {
    // Abramowitz & Stegun 26.2.23
    let t = (-2.0 * (1.0 - share).ln()).sqrt();
    let top = 2.515517 + t * (0.802853 + t * 0.010328);
    t - top / (1.0 + t * (1.432788 + t * (0.189269 + t * 0.001308)))
}

impl Study<'_> {
    /// Second terms beside a fitted single, best first: catalogue index, linear estimate, Δχ².
    fn second_terms(&self, first: &Fit, screen: &Screen) -> Vec<(usize, f64, f64)> {
        let coefficients = self.coefficients(&first.deviations);
        let (information, _) = first.normal_equations();
        let Some(inverse) = information.try_inverse() else {
            return Vec::new();
        };
        let others: Vec<_> = screen.candidates.iter().filter(|c| !first.ids.contains(&c.0)).copied().collect();
        let states: Vec<_> = others.iter().map(|&(id, v)| (first.mechanisms.with(id, v), coefficients)).collect();
        let moved: Vec<_> = others.into_iter().zip(self.model.predict_many(&states)).collect();
        let mut found: Vec<_> = parallel::map(&moved, |&((id, value), ref moved)| {
            let column = slope(moved, &first.prediction, value);
            let white = self.whitener.apply(&column);
            let cross =
                nalgebra::DVector::from_fn(first.white_slopes.len(), |i, _| dot(&first.white_slopes[i], &white));
            let left = dot(&white, &white) - (cross.transpose() * &inverse * &cross)[0];
            let score = dot(&white, &first.white);
            let estimate = if left > 1e-12 { score / left } else { 0.0 };
            let entry = &CATALOG[id];
            let held =
                estimate.clamp(entry.bounds[0], entry.bounds[1]).clamp(-USUAL * entry.typical, USUAL * entry.typical);
            let held = if entry.ceiling { value } else { held };
            (
                id,
                if held == 0.0 { 0.05 * value } else { held },
                if held * estimate > 0.0 { score * estimate } else { 0.0 },
            )
        });
        found.sort_by(|a, b| b.2.total_cmp(&a.2));
        let mut seen = Vec::new();
        found.retain(|f| {
            !seen.contains(&f.0) && {
                seen.push(f.0);
                true
            }
        });
        found
    }
}
