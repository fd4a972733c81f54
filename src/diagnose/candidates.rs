//! The candidates: fits of every cause, and of pairs of causes. The noise is learnt again from the residual of the best candidate.

use super::evidence::EvidenceTable;
use super::fit::{COEFFICIENTS, Fit, slope};
use super::left_out::Contender;
use super::measured::{self, MeasuredFit};
use super::noise::{Noise, NoiseData, Sizes, sizes_of};
use super::nuisance::Nuisance;
use super::screen::{FELT, Scores, Screen, USUAL, starts};
use super::settling::{bent, bound};
use super::study::FitInputs;
use super::verdict::{self, Compared, Effect, Role};
use super::whiten::Whitener;
use crate::error::Result;
use crate::number::dot;
use crate::progress::Progress;
use crate::sand::mechanism::{CATALOG, Mechanisms};

/// Number of pairs that are fitted, the best of the linear screen: our choice, because each fit takes time.
const PAIRS_FITTED: usize = 14;
/// How often the noise is learnt again, at most, after the best candidate has changed: our choice; two times usually
/// suffice.
const NOISES: usize = 3;
/// Number of candidates with one cause, and of pairs, that are fitted with the final noise and compared: our choice,
/// because the χ² of the others is usually larger by hundreds.
const FINALISTS: usize = 8;
/// An effect of measuring gives the noise if its objective is less than this share of the leading candidate's: our choice; the noise
/// hardly changes for less.
const FAR_BETTER: f64 = 0.9;
/// Share of a pair's evidence that its second cause must add: our choice. A weaker second cause beside a very strong first
/// cause may only describe a small error in the law of the first cause.
pub const SECOND: f64 = 0.01;

/// Noise, whitening and nuisances, computed at one candidate's fit.
#[derive(Clone)]
pub struct Surroundings {
    pub noise: Noise,
    /// Sizes of the candidate's prediction, to which a part of the noise is proportional.
    pub sizes: Sizes,
    pub whitener: Whitener,
    pub nuisances: Vec<Nuisance>,
}

impl Surroundings {
    /// A study with this noise and these nuisances.
    pub fn about<'a>(&'a self, study: &FitInputs<'a>) -> FitInputs<'a> {
        study.under(&self.whitener, self.nuisances.clone())
    }
}

/// The inputs of a selection.
#[derive(Clone, Copy)]
pub struct SearchSpace<'a> {
    pub source: &'a NoiseData<'a>,
    pub noise: &'a Noise,
    /// Catalogue indices of the causes that the data can show.
    pub ids: &'a [usize],
    /// Causes that act on these data, but cannot be tested with them.
    pub untestable: &'a [usize],
    /// Causes that would look like `scale`, and that have no effect on the prediction because a column is missing.
    pub unseen: &'a [usize],
}

/// Fits under one noise, and results of earlier steps.
pub struct Candidates {
    /// The causes that were tried, each with the value at which its effect was computed.
    pub screened: Vec<(usize, f64)>,
    /// Noise, whitening and nuisances of the last fits.
    pub around: Surroundings,
    /// Plain model with coefficients and nuisances fitted within their priors.
    pub base: Fit,
    /// The nuisances of the base. They are those of the other fits, linearised about the leading one, unless the base is at bounds
    /// there: then they are linearised about the base itself.
    pub base_nuisances: Vec<Nuisance>,
    /// The plain model: its coefficients are the stated ones, and nuisances are fitted within their priors.
    pub stated: Fit,
    /// The base, and the leading cause, each with one effect of measuring that may be far larger than stated.
    pub measured: Vec<MeasuredFit>,
    /// The base without each of the effects of `measured`; those beside the leading cause have none.
    pub absent: Vec<MeasuredFit>,
    /// Singles, then pairs, each best first, fitted with the final noise.
    pub fits: Vec<Fit>,
    /// The fit that predicts left-out conditions best, if its prediction is better than the plain model's.
    pub leading: Option<usize>,
    /// Candidates with a far larger χ², which were fitted only with an earlier noise; their stacks are empty.
    pub behind: Vec<Fit>,
    /// Objective of the plain model under that earlier noise.
    pub earlier: f64,
}

/// Fits singles and pairs. Pairs are tried if a single cause predicts left-out conditions better than the plain model.
pub fn candidates(study: &FitInputs, asked: &SearchSpace, progress: &dyn Progress) -> Result<Candidates> {
    progress.report(0.1, "effect of every cause")?;
    let ids = [asked.ids, asked.untestable].concat();
    let screen = Screen::new(study, &ids);
    let scores = screen.scores(study.whitener, &study.observations.values);
    progress.report(0.3, "single causes")?;
    // Nuisances have nonlinear effects, so they are linearised at the plain model's fit before causes are tested.
    let plain = study.recalibrated();
    let nuisances = bent(study, study.whitener, &plain);
    let (noise, sizes, whitener) = (asked.noise.clone(), asked.source.sizes.clone(), study.whitener.clone());
    let around = Surroundings { noise, sizes, whitener, nuisances };
    let straight = around.about(study);
    let mut fits = singles(&straight, &screen, &scores, &ids);
    let base = plain_beneath(&straight, straight.recalibrated(), &fits);
    let earlier = base.objective;
    let mut behind = fits.split_off(fits.len().min(FINALISTS));
    // Causes that cannot be tested are always compared, because they may look like another cause.
    fits.extend(behind.extract_if(.., |fit| asked.untestable.contains(&fit.ids[0])));
    // For the other candidates only values and objectives are reported, so their stacks, which use most of the memory, are dropped.
    for fit in &mut behind {
        (fit.prediction, fit.white, fit.slopes) = Default::default();
    }
    let leading = leading(&straight, &base, &fits);
    let screened = screen.candidates.clone();
    let (around, base_nuisances, stated) = (around.clone(), around.nuisances.clone(), base.clone());
    let (measured, absent) = (Vec::new(), Vec::new());
    let mut found =
        Candidates { screened, around, base, base_nuisances, stated, measured, absent, fits, leading, behind, earlier };
    progress.report(0.5, "singles under the noise of the best")?;
    found.settle(study, asked);
    if leading.is_some() {
        progress.report(0.6, "pairs of causes")?;
        found.add_pairs(study, asked, &screen, progress)?;
    }
    progress.report(0.78, "effects of measuring")?;
    let mut around = found.around.clone();
    let mut renewed = around.about(study);
    found.measure(&renewed);
    if let Some(next) = found.about_measured(&renewed, asked) {
        drop(renewed);
        around = next;
        renewed = around.about(study);
        found.around = around.clone();
        found.refit(&renewed);
        found.measure(&renewed);
    }
    let own = found.about_base(&renewed);
    found.stated = plain_fit(&own, &found.base);
    found.absent = measured::absent(&own, &found.base, &found.measured);
    if let Some(leading) = found.leading.map(|k| &found.fits[k]).filter(|fit| fit.ids.len() == 1) {
        found.measured.extend(measured::measured(&renewed, leading));
    }
    Ok(found)
}

/// The plain model, fitted from the nuisances of `base`.
pub fn plain_fit(study: &FitInputs, base: &Fit) -> Fit {
    let mut deviations = base.deviations.clone();
    deviations[..COEFFICIENTS].fill(0.0);
    let from = Fit { deviations, slopes: Vec::new(), ..base.clone() };
    study.stated().fit_from(&[&from]).swap_remove(0)
}

/// The base and the fits. A fit in which a cause has its value of the plain sand is left out, because this cause explains nothing.
pub fn contenders<'a>(base: &'a Fit, fits: &'a [Fit], nuisances: &'a [Nuisance]) -> Vec<Contender<'a>> {
    let fits = [base].into_iter().chain(fits.iter().filter(|fit| !fit.is_idle()));
    fits.map(|fit| Contender { fit, nuisances, columns: &[] }).collect()
}

/// The candidate that predicts left-out conditions best, if its prediction is better than the plain model's.
fn leading(study: &FitInputs, base: &Fit, fits: &[Fit]) -> Option<usize> {
    let models = contenders(base, fits, &study.nuisances);
    let table = EvidenceTable::new(study, study.whitener, &models);
    let leads = verdict::leading(&bare(&models, &table), SECOND)?;
    fits.iter().position(|fit| std::ptr::eq(fit, models[leads].fit))
}

/// The models of a table as entries, the first of them as the base.
fn bare(models: &[Contender], table: &EvidenceTable) -> Vec<Compared> {
    let of = |k: usize| Compared {
        role: if k == 0 { Role::Base } else { Role::Causes },
        effects: models[k].fit.ids.iter().map(|id| Effect::Mechanism(*id)).collect(),
        unnamed: false,
        unseen: false,
        alike: Vec::new(),
        repeats: Vec::new(),
        elpd: table.elpd(k),
        misfit: 0.0,
        unexplained: 0.0,
        beats: (0..models.len()).map(|j| table.beats(k, j)).collect(),
        error: 0.0,
        lowers: false,
    };
    (0..models.len()).map(of).collect()
}

impl Candidates {
    /// The leading fit, or the plain one.
    fn best(&self) -> &Fit {
        self.leading.map_or(&self.base, |k| &self.fits[k])
    }

    /// A study with the nuisances of the base.
    pub fn about_base<'a>(&self, study: &FitInputs<'a>) -> FitInputs<'a> {
        study.with_nuisances(self.base_nuisances.clone())
    }

    /// Finds the leading fit, and tries effects of measuring on the base.
    fn measure(&mut self, study: &FitInputs) {
        self.leading = leading(study, &self.base, &self.fits);
        self.free_base(study);
        self.measured = measured::measured(&self.about_base(study), &self.base);
    }

    /// Linearises the nuisances about the base if it is at bounds in the linearisation of the others, and fits better so: otherwise
    /// everything would seem to be better than the plain model. A rough model stays as it is, because this would take many
    /// simulations.
    fn free_base(&mut self, study: &FitInputs) {
        self.base_nuisances = study.nuisances.clone();
        if study.model.roughness().is_some() || !bound(&self.base) {
            return;
        }
        let own = study.with_nuisances(bent(study, study.whitener, &self.base));
        let from = Fit { slopes: Vec::new(), ..self.base.clone() };
        let mut still = from.clone();
        still.deviations.fill(0.0);
        let fits = own.fit_from(&[&from, &still]);
        let best = fits.into_iter().min_by(|a, b| a.objective.total_cmp(&b.objective));
        if let Some(best) = best.filter(|best| best.objective < self.base.objective) {
            (self.base, self.base_nuisances) = (best, own.nuisances);
        }
    }

    /// Learns the noise again from the leading fit's residual and fits all candidates again with this noise, until the leading fit
    /// changes by less than one σ (our choice: noise hides such a change). If no fit leads, the noise is learnt once, from the
    /// plain model's residual; the other fits of a rough model then stay, because each takes simulations.
    fn settle(&mut self, study: &FitInputs, asked: &SearchSpace) {
        let rough = study.model.roughness().is_some();
        for _ in 0..NOISES {
            let (next, before) = {
                let now = self.around.about(study);
                (surroundings(&now, asked, self.best()), now.reading(self.best()))
            };
            let renewed = next.about(study);
            if rough && self.leading.is_none() {
                self.base = renewed.fit_from(&[&self.base]).swap_remove(0);
                self.leading = leading(&renewed, &self.base, &self.fits);
            }
            let led = self.leading.is_some();
            if led || !rough {
                self.refit(&renewed);
                self.leading = leading(&renewed, &self.base, &self.fits);
            }
            let moved = next.whitener.apply(&slope(&renewed.reading(self.best()), &before, 1.0));
            self.around = next;
            if !(led || self.leading.is_some()) || dot(&moved, &moved) < 1.0 {
                break;
            }
        }
    }

    /// Noise about the effect of measuring that fits best, if this fits far better than the leading candidate: where a model is wrong by
    /// much more than noise, the noise about it is wrong, too. None for a rough model, which would take many simulations.
    fn about_measured(&self, study: &FitInputs, asked: &SearchSpace) -> Option<Surroundings> {
        let best = self.measured.iter().min_by(|a, b| a.fit.objective.total_cmp(&b.fit.objective))?;
        let better = best.fit.objective < FAR_BETTER * self.best().objective;
        (better && study.model.roughness().is_none()).then(|| {
            let own = study.with_nuisances(best.nuisances.clone());
            let (noise, sizes, whitener) = noise_about(&own, asked, &best.fit);
            let nuisances = bent(study, &whitener, &self.base);
            Surroundings { noise, sizes, whitener, nuisances }
        })
    }

    /// Repeats all fits, each from its end state.
    fn refit(&mut self, study: &FitInputs) {
        let beside = self.leading.map_or(Vec::new(), |k| study.beside(&self.fits[k]));
        let mut again = study.fit_from(&self.fits.iter().chain(&beside).collect::<Vec<_>>());
        keep_better(&mut again, self.fits.len());
        self.base = plain_beneath(study, study.fit_from(&[&self.base]).swap_remove(0), &again);
        // A model with one more cause contains the base, so it can be no worse: where it is, the fit begins again at the base.
        let count = again.len();
        let lost = again.iter().filter(|fit| fit.objective > self.base.objective);
        let from = |fit: &Fit| Fit { ids: fit.ids.clone(), slopes: Vec::new(), ..self.base.clone() };
        let nested: Vec<Fit> = lost.map(from).collect();
        if study.model.roughness().is_none() && !nested.is_empty() {
            again.extend(study.fit_from(&nested.iter().collect::<Vec<_>>()));
            keep_better(&mut again, count);
        }
        self.fits = ranked(again);
    }

    /// Tries pairs. Up to half of them are the best single cause with a second one; the others are the best of the
    /// linear screen, whose causes begin at half of their single values, because they share the effect. Our choices.
    fn add_pairs(
        &mut self,
        study: &FitInputs,
        asked: &SearchSpace,
        screen: &Screen,
        progress: &dyn Progress,
    ) -> Result<()> {
        let (fits, around) = (&self.fits, self.around.clone());
        let renewed = around.about(study);
        let scores = screen.scores(renewed.whitener, &study.observations.values);
        let Some(best) = fits.iter().find(|f| !asked.untestable.contains(&f.ids[0])) else { return Ok(()) };
        let id = best.ids[0];
        let second = renewed.further(best, &screen.candidates);
        let linear = screen.pairs(&scores.gram, &scores.score);
        let from_best = second.iter().map(|s| [id, s.id]);
        let from_all = linear.iter().map(|&(_, i, j)| [screen.candidates[i].0, screen.candidates[j].0]);
        let mut tried: Vec<[usize; 2]> = Vec::new();
        for pair in from_best.filter(|p| !asked.untestable.contains(&p[1])).take(PAIRS_FITTED / 2).chain(from_all) {
            if tried.len() < PAIRS_FITTED
                && !pair.iter().any(|id| asked.untestable.contains(id))
                && !tried.iter().any(|t| *t == pair || *t == [pair[1], pair[0]])
            {
                tried.push(pair);
            }
        }
        let start = |id: usize| fits.iter().find(|f| f.ids == [id]).map_or(0.0, |f| f.values()[0]);
        let starts = |pair: &[usize; 2]| {
            let mut ids = pair.to_vec();
            ids.sort_unstable();
            let values = if pair[0] == id {
                let other = second.iter().find(|s| s.id == pair[1]).map_or(0.0, |s| s.start);
                if ids[0] == id { [start(id), other] } else { [other, start(id)] }
            } else {
                [0.5 * start(ids[0]), 0.5 * start(ids[1])]
            };
            further_starts(&renewed, &ids, &values)
        };
        let mut pairs = ranked(renewed.fit_all(&tried.iter().map(starts).collect::<Vec<_>>()));
        pairs.truncate(FINALISTS);
        let place = fits.iter().position(|f| f.ids == [id]).unwrap_or(0);
        if let Some(lower) = pairs.first().and_then(|pair| beneath(&renewed, &fits[place], pair)) {
            self.fits[place] = lower;
        }
        self.fits.extend(pairs);
        self.leading = leading(&renewed, &self.base, &self.fits);
        if self.best().ids.len() > 1 {
            progress.report(0.75, "pairs under the noise of the best")?;
            drop(renewed);
            self.settle(study, asked);
        }
        Ok(())
    }
}

/// Keeps the first `count` fits, each replaced by a later one of the same causes that has a lower objective.
fn keep_better(fits: &mut Vec<Fit>, count: usize) {
    for other in fits.split_off(count) {
        let same = fits.iter_mut().find(|f| f.ids == other.ids && other.objective < f.objective);
        same.into_iter().for_each(|f| *f = other.clone());
    }
}

/// Sorts fits by their number of causes, and then by their objective.
fn ranked(mut fits: Vec<Fit>) -> Vec<Fit> {
    fits.sort_by(|a, b| a.ids.len().cmp(&b.ids.len()).then(a.objective.total_cmp(&b.objective)));
    fits
}

fn singles(study: &FitInputs, screen: &Screen, scores: &Scores, ids: &[usize]) -> Vec<Fit> {
    let columns: Vec<usize> = ids.iter().filter_map(|id| screen.candidates.iter().position(|c| c.0 == *id)).collect();
    let start = |&column: &usize| {
        let value = linear_start(screen, scores, column);
        let id = screen.candidates[column].0;
        let (ids, mut from) = further_starts(study, &[id], &[value]);
        from.extend(far_start(study, id, value).map(|far| vec![far]));
        (ids, from)
    };
    ranked(study.fit_all(&columns.iter().map(start).collect::<Vec<_>>()))
}

/// Start states of a fit of `ids`: `values`, and for each value its further starts.
fn further_starts(study: &FitInputs, ids: &[usize], values: &[f64]) -> (Vec<usize>, Vec<Vec<f64>>) {
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

/// Start of a fit with a single cause: the linear estimate, limited to usual strengths of the mechanism, or to eight
/// times the screen's value if that is more; a tenth of the screen's value if the estimate is 0. Our choices.
fn linear_start(screen: &Screen, scores: &Scores, column: usize) -> f64 {
    let (id, value) = screen.candidates[column];
    let entry = &CATALOG[id];
    let felt = scores.gram[(column, column)];
    if entry.ceiling {
        return value; // the effect is far from proportional to the value, so a linear estimate from the plain model has no meaning
    }
    let estimate = if felt > FELT { entry.typical * scores.score[column] / felt } else { 0.0 };
    let reach = (USUAL * entry.typical).max(8.0 * value.abs());
    let start = estimate.clamp(-reach, reach).clamp(entry.bounds[0], entry.bounds[1]);
    if start == 0.0 { value * 0.1 } else { start }
}

/// The objective of a rough model has several minima, and the linear estimate may lead into a minimum near the plain
/// model. So a fit has a second start, with the same sign, at the largest value that estimates may have. None for a
/// smooth model, for which the first start suffices.
fn far_start(study: &FitInputs, id: usize, estimate: f64) -> Option<f64> {
    let entry = &CATALOG[id];
    let far = (USUAL * entry.typical).copysign(estimate).clamp(entry.bounds[0], entry.bounds[1]);
    (study.model.roughness().is_some() && !entry.ceiling).then_some(far)
}

/// If the model is rough, a fit with fewer causes may have ended in a local minimum, and a fit with more causes may then gain
/// only because it leaves this minimum. So the fit with fewer causes is made again from the `end` of the other one. Returns
/// it if its objective is lower; None for a smooth model, and if the other fit lacks one of the causes.
fn beneath(study: &FitInputs, fit: &Fit, end: &Fit) -> Option<Fit> {
    if study.model.roughness().is_none() || !fit.ids.iter().all(|id| end.ids.contains(id)) {
        return None;
    }
    let with = |all: Mechanisms, &id: &usize| all.with(id, end.mechanisms.get(id));
    let mechanisms = fit.ids.iter().fold(Mechanisms::default(), with);
    let from = Fit { ids: fit.ids.clone(), mechanisms, slopes: Vec::new(), ..end.clone() };
    let again = study.fit_from(&[&from]).swap_remove(0);
    (again.objective < fit.objective).then_some(again)
}

/// The plain model's fit, made again from the end of the best of `fits` if this has a lower objective.
fn plain_beneath(study: &FitInputs, base: Fit, fits: &[Fit]) -> Fit {
    let best = fits.iter().min_by(|a, b| a.objective.total_cmp(&b.objective));
    let best = best.filter(|best| best.objective < base.objective);
    best.and_then(|best| beneath(study, &base, best)).unwrap_or(base)
}

/// Noise, whitening and nuisances about a fit.
fn surroundings(study: &FitInputs, asked: &SearchSpace, fit: &Fit) -> Surroundings {
    let (noise, sizes, whitener) = noise_about(study, asked, fit);
    let nuisances = bent(study, &whitener, fit);
    Surroundings { noise, sizes, whitener, nuisances }
}

/// Noise about a fit, the sizes to which it is proportional, and its whitening. The common part of a repetition's noise acts along
/// the fit's prediction.
fn noise_about(study: &FitInputs, asked: &SearchSpace, fit: &Fit) -> (Noise, Sizes, Whitener) {
    let source = asked.source;
    let mut uncertainty = study.model.uncertainty(&study.sand(fit), &fit.prediction);
    uncertainty.shared.retain(|s| source.uncertainty.shared.iter().any(|own| own.name == s.name));
    // The noise is learnt from the fit's residual, nuisances included, and is proportional to the prediction of the
    // sand.
    let reading = study.reading(fit);
    let sizes = sizes_of(study.observations, &reading);
    let source = NoiseData { prediction: &reading, sizes: &sizes, uncertainty: &uncertainty, ..*source };
    let noise = source.noise(Some(asked.noise), &|| study.model.stopped());
    let whitener = Whitener::new(&source, &noise);
    (noise, sizes, whitener)
}
