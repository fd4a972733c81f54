//! Selects the cause: fits the candidates, compares them by one table of evidence, and measures the gain of the model that
//! `sand.toml` gets.

use super::candidates::{Candidates, SECOND, SearchSpace, candidates, contenders};
use super::errors::SquaredErrors;
use super::evidence::{EvidenceTable, LEAST};
use super::fit::Fit;
use super::gauss_newton::MOST_DEVIATION;
use super::laws::{FittedLaw, fitted, laws};
use super::left_out::{CandidateLaw, Contender, held_out};
use super::noise::NoiseData;
use super::nuisance::stated;
use super::profile;
use super::study::FitInputs;
use super::verdict::{Compared, Ruling, Verdict, Written, verdict};
use super::whiten::Whitener;
use crate::error::Result;
use crate::parallel;
use crate::progress::Progress;
use crate::sand::Term;
use crate::sand::mechanism::{CATALOG, Side};
use crate::student;

/// Number of folds in which noise, model and values are chosen anew: our choice; each needs its own noise.
const FOLDS: usize = 6;

/// If the place in the bed or the number of earlier passes is unknown, these mechanisms may multiply the stress by the same factor
/// everywhere, as `scale` does.
pub const FACTORS: [&str; 2] = ["packing_grad", "footprint"];

/// All results of one diagnosis.
pub struct Selection {
    pub candidates: Candidates,
    /// For each model of the table its index in `candidates.fits`; None for the plain model and for a law alone.
    pub places: Vec<Option<usize>>,
    pub table: EvidenceTable,
    pub entries: Vec<Compared>,
    pub ruling: Ruling,
    /// The fit of the written model, or of the plain model, with the noise scaled to its errors.
    pub standing: Fit,
    /// The whitening with the noise scaled to the errors of `standing`.
    pub whitener: Whitener,
    pub law: Option<FittedLaw>,
    /// Formula of the law of each entry of the table that has one.
    pub formulas: Vec<Option<String>>,
    /// 95 % intervals of the coordinates of the best cause, and the correlations of its values.
    pub intervals: Intervals,
    /// Held-out errors of the fitted plain model, and of the written model, which is chosen anew in each fold.
    pub nested: [SquaredErrors; 2],
    /// Errors of the plain model without any fit.
    pub plain: SquaredErrors,
    /// See [`SearchSpace::unseen`].
    pub unseen: Vec<usize>,
}

/// Uncertainty of a fit's values.
#[derive(Default)]
pub struct Intervals {
    pub ranges: Vec<[f64; 2]>,
    /// Row by row; empty for fewer than two values.
    pub correlations: Vec<Vec<f64>>,
}

impl Selection {
    /// The fit of an entry of the table.
    pub fn fit_of(&self, entry: usize) -> &Fit {
        self.places[entry].map_or(&self.candidates.base, |k| &self.candidates.fits[k])
    }

    /// The fit that is written; None for the plain model.
    pub fn fit(&self) -> Option<&Fit> {
        (self.ruling.model > 0).then_some(&self.standing)
    }

    /// The causes of each explanation that the data cannot distinguish. What they cannot see may be in place of `scale`.
    pub fn explanations(&self) -> Vec<Vec<String>> {
        let mut all: Vec<Vec<String>> = self.ruling.set.iter().map(|&k| self.fit_of(k).names()).collect();
        if self.ruling.set.first().is_some_and(|&k| self.entries[k].unseen) {
            all.extend(self.unseen.iter().map(|&id| vec![CATALOG[id].id.to_owned()]));
        }
        all
    }

    /// The best cause, if one is named.
    pub fn best(&self) -> Option<&Fit> {
        self.ruling.set.first().map(|&k| self.fit_of(k))
    }
}

/// Runs the whole selection. Effects of the sensor are nuisances, which are marginalised. Only if the plain model with
/// nuisances leaves no misfit, mechanisms of the sensor are tried in place of nuisances; they must predict as well as
/// the nuisances.
pub fn select(study: &FitInputs, asked: &SearchSpace, progress: &dyn Progress) -> Result<Selection> {
    let interest = &study.model.experiment().nuisances.interest;
    let marginalised = |id: &usize| {
        let entry = &CATALOG[*id];
        entry.side == Side::Sensor && !interest.iter().any(|own| own == entry.id)
    };
    let sensor: Vec<usize> = asked.ids.iter().copied().filter(marginalised).collect();
    let unnamed = [&sensor[..], asked.untestable].concat();
    let selection = attempt(study, &SearchSpace { unnamed: &unnamed, ..*asked }, progress)?;
    if sensor.is_empty() || selection.ruling.verdict != Verdict::NoiseFloor || study.nuisances.is_empty() {
        return Ok(selection);
    }
    // Selections with and without nuisances are compared under the noise of the selection with nuisances. Their
    // nuisances differ, so the densities of the stated priors are left out of the comparison. A gain below 4 is chance.
    let conditions = study.observations.conditions.len();
    let measured = |table: &EvidenceTable| table.rows[0].elpd[..conditions].iter().sum::<f64>();
    let with = measured(&selection.table);
    let bare = study.under(&selection.candidates.around.whitener, Vec::new());
    let all: Vec<usize> = (0..conditions).collect();
    let elpd =
        |fit: Fit| measured(&EvidenceTable::new(&bare, bare.whitener, &[Contender { fit: &fit, laws: None }], &all));
    if with - elpd(bare.recalibrated()) < 2.0 * LEAST {
        return Ok(selection);
    }
    let other = attempt(&bare, asked, progress)?;
    let as_well = |best: &Fit| elpd(bare.fit_from(&[best]).swap_remove(0)) > with - 2.0 * LEAST;
    Ok(if other.best().is_some_and(as_well) { other } else { selection })
}

/// Makes all fits and compares them once.
fn attempt(study: &FitInputs, asked: &SearchSpace, progress: &dyn Progress) -> Result<Selection> {
    let mut candidates = candidates(study, asked, progress)?;
    progress.report(0.8, "laws in the data")?;
    let around = candidates.around.clone();
    let renewed = around.about(study);
    let profiled = explored(&renewed, &mut candidates);
    let alone = laws(&renewed, &candidates.base);
    let leading = candidates.leading.map(|k| &candidates.fits[k]);
    let beside = leading.filter(|_| alone.is_some()).and_then(|fit| laws(&renewed, fit));
    progress.report(0.85, "held-out conditions")?;
    Ok(judged(study, &renewed, asked, candidates, [alone, beside], profiled))
}

/// Compares all models and gives the verdict. If the errors of the plain model, with nuisances, are no larger than noise may cause,
/// mechanisms of the sensor are no separate explanations, because the plain model contains them as nuisances; then all models are compared
/// again without these mechanisms. If sand cannot follow a law that was fitted with everything else, the law is taken out of the
/// dictionary, and all models are compared again.
fn judged(
    study: &FitInputs,
    renewed: &FitInputs,
    asked: &SearchSpace,
    mut candidates: Candidates,
    mut dictionary: [Option<Vec<CandidateLaw>>; 2],
    profiled: Option<Vec<[f64; 2]>>,
) -> Selection {
    let all: Vec<usize> = (0..study.observations.conditions.len()).collect();
    let marginalised = |id: &usize| asked.unnamed.contains(id) && !asked.untestable.contains(id);
    let plain = study.plain();
    let plain = SquaredErrors::of(study.observations, |k| plain.prediction[k], &all);
    loop {
        let models = models(&candidates, dictionary.each_ref().map(Option::as_deref));
        let table = EvidenceTable::new(renewed, renewed.whitener, &models, &all);
        let mut entries = entries(renewed, &table, &models, &all, asked);
        let mut ruling = verdict(&entries, SECOND);
        let measured = |&&k: &&usize| models[k].fit.ids.iter().any(marginalised);
        let mut explanations = ruling.set.iter().filter(|k| Some(**k) != ruling.added).peekable();
        if entries[0].misfit <= 0.0 && explanations.peek().is_some() && explanations.all(|k| measured(&k)) {
            candidates.without(&marginalised);
            dictionary[1] = dictionary[1].take().filter(|_| candidates.leading.is_some());
            continue;
        }
        let mut nested = nested(renewed, asked, &candidates, &models, &ruling);
        // If the models chosen anew in the folds have no smaller error than the plain model, their error replaces the written model's error, and
        // the verdict is given again.
        while !matches!(ruling.written, Written::Cause | Written::Plain) && nested[1].rmse() >= entries[0].error {
            entries[ruling.model].error = nested[1].rmse();
            ruling = verdict(&entries, SECOND);
            nested = self::nested(renewed, asked, &candidates, &models, &ruling);
        }
        // The model is fitted once more, with the variance of its errors in each condition, which is at least the variance of the noise.
        let (model, row) = (&models[ruling.model], &table.rows[ruling.model]);
        let weights = study.observations.units.iter().map(|unit| table.weight(row, unit.condition).min(1.0));
        let whitener = renewed.whitener.weighted(weights);
        let last = study.under(&whitener, renewed.nuisances.clone());
        let fit = last.fit_from(&[model.fit]).swap_remove(0);
        let term = law_of(&table, &models, ruling.model);
        let held = ruling.written == Written::Cause;
        let law = term.as_ref().and_then(|term| fitted(&last, &fit, term.clone(), held));
        if let (Some(place), None) = (table.rows[ruling.model].predicted.law.filter(|_| term.is_some()), &law) {
            let own = usize::from(entries[ruling.model].causes > 0);
            dictionary[own].iter_mut().for_each(|laws| drop(laws.remove(place)));
            continue;
        }
        let formulas = (0..models.len()).map(|k| law_of(&table, &models, k).map(|t| t.formula())).collect();
        let of = |m: &Contender| candidates.fits.iter().position(|f| std::ptr::eq(f, m.fit));
        let places: Vec<Option<usize>> = models.iter().map(of).collect();
        let best = ruling.set.first().or((ruling.model > 0).then_some(&ruling.model)).copied();
        let standing = law.as_ref().map_or(fit, |law| law.fit.clone());
        let profiled = profiled.filter(|_| best.is_some_and(|k| places[k] == candidates.leading));
        let intervals = best.map_or(Intervals::default(), |_| intervals(&last, &standing, table.degrees, profiled));
        return Selection {
            candidates,
            places,
            table,
            entries,
            ruling,
            standing,
            whitener,
            law,
            formulas,
            intervals,
            nested,
            plain,
            unseen: asked.unseen.to_vec(),
        };
    }
}

/// The models of the table: the plain one, all fits, a law alone, and a law beside the leading cause.
fn models<'a>(candidates: &'a Candidates, [alone, beside]: [Option<&'a [CandidateLaw]>; 2]) -> Vec<Contender<'a>> {
    let mut models = contenders(&candidates.base, &candidates.fits);
    models.extend(alone.map(|laws| Contender { fit: &candidates.base, laws: Some(laws) }));
    let leading = candidates.leading.map(|k| &candidates.fits[k]);
    models.extend(leading.zip(beside).map(|(fit, laws)| Contender { fit, laws: Some(laws) }));
    models
}

/// The law that entry `k` chose with no condition left out, with the coefficient of the linear fit.
fn law_of(table: &EvidenceTable, models: &[Contender], k: usize) -> Option<Term> {
    let row = &table.rows[k].predicted;
    let coefficient = *row.step.as_slice().last()?;
    models[k].laws.zip(row.law).map(|(laws, l)| Term { coefficient, ..laws[l].term.clone() })
}

/// The entries of a table over the conditions `used`, for the verdict.
fn entries(
    study: &FitInputs,
    table: &EvidenceTable,
    models: &[Contender],
    used: &[usize],
    asked: &SearchSpace,
) -> Vec<Compared> {
    let plain = study.plain();
    let plain = SquaredErrors::of(study.observations, |k| plain.prediction[k], used).rmse();
    let unlikely = |(&id, value): (&usize, f64)| {
        stated(&study.nuisances, CATALOG[id].id).is_some_and(|sd| value.abs() > MOST_DEVIATION * sd)
    };
    let of = |k: usize| {
        let ids = &models[k].fit.ids;
        let scaled = ids.iter().any(|&id| CATALOG[id].id == "scale");
        let hidden = |j: &usize| match models[*j].fit.ids[..] {
            [other] => scaled && asked.untestable.contains(&other) && FACTORS.contains(&CATALOG[other].id),
            _ => false,
        };
        let inside = |j: &usize| models[*j].laws.is_none() && *j != k && models[*j].fit.ids == *ids;
        Compared {
            causes: ids.len(),
            law: models[k].laws.is_some_and(|_| table.rows[k].predicted.law.is_some()),
            unnamed: ids.iter().any(|id| asked.unnamed.contains(id)),
            unlikely: ids.iter().zip(models[k].fit.values()).any(unlikely),
            within: (0..models.len()).filter(inside).collect(),
            alike: (0..models.len()).filter(hidden).collect(),
            unseen: scaled && !asked.unseen.is_empty(),
            elpd: table.elpd(k),
            misfit: table.misfit(k),
            unexplained: table.unexplained(k),
            beats: (0..models.len()).map(|j| table.beats(k, j)).collect(),
            ahead: table.ahead(k),
            error: if k == 0 { plain } else { table.rows[k].held_out.rmse() },
        }
    };
    (0..models.len()).map(of).collect()
}

/// For models whose slopes are not reliable: moves the leading fit to the lowest state about it. Returns the intervals
/// of its values.
fn explored(study: &FitInputs, candidates: &mut Candidates) -> Option<Vec<[f64; 2]>> {
    let leading = candidates.leading.filter(|_| study.model.roughness().is_some())?;
    let free = study.observations.repetitions().iter().map(|g| g.len() as f64 - 1.0).sum::<f64>();
    let (lowest, intervals) = profile::explore(study, &candidates.fits[leading], student::square_at_95(free.max(2.0)));
    if lowest.objective < candidates.fits[leading].objective {
        candidates.fits[leading] = lowest;
    }
    Some(intervals)
}

/// 95 % intervals of the values, and their correlations.
fn intervals(study: &FitInputs, fit: &Fit, degrees: f64, profiled: Option<Vec<[f64; 2]>>) -> Intervals {
    let (count, covariance, reach) = (fit.ids.len(), study.covariance(fit), study.reach(fit, degrees));
    let range = |k: usize| {
        let at = fit.coordinates()[k];
        let profiled = profiled.as_ref().and_then(|p| p.get(k)).filter(|i| i.iter().all(|u| u.is_finite()));
        let [low, high] = profiled.copied().unwrap_or([at - reach[k], at + reach[k]]);
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

/// Held-out errors of the fitted plain model and of the written model: in each fold the noise is learnt, the data are
/// whitened, and the model to write is chosen without the held-out conditions. In each fold, values are those of the
/// full fits, changed by one Gauss-Newton step, which is exact for a linear model.
fn nested(
    study: &FitInputs,
    asked: &SearchSpace,
    candidates: &Candidates,
    models: &[Contender],
    ruling: &Ruling,
) -> [SquaredErrors; 2] {
    let conditions = study.observations.conditions.len();
    let folds = folds(conditions);
    let made = parallel::map(&folds, |held| {
        let source = NoiseData { left_out: held, sizes: &candidates.around.sizes, ..*asked.source };
        let noise = source.noise(Some(&candidates.around.noise), &|| study.model.stopped());
        let whitener = Whitener::new(&source, &noise);
        let rest: Vec<usize> = (0..conditions).filter(|k| !held.contains(k)).collect();
        let table = EvidenceTable::new(study, &whitener, models, &rest);
        let chosen = match ruling.written {
            Written::Plain => 0,
            _ => verdict(&entries(study, &table, models, &rest, asked), SECOND).model,
        };
        [0, chosen].map(|k| {
            let row = &table.rows[k].predicted;
            held_out(study, &models[k], row.law, row.step.as_slice(), held)
        })
    });
    let mut total = [(); 2].map(|()| SquaredErrors(vec![[0.0; 2]; conditions]));
    for (held, parts) in folds.iter().zip(made) {
        for (total, part) in total.iter_mut().zip(parts) {
            held.iter().zip(part.0).for_each(|(&condition, own)| total.0[condition] = own);
        }
    }
    total
}

/// Conditions held out in each fold.
fn folds(conditions: usize) -> Vec<Vec<usize>> {
    let folds = FOLDS.min(conditions);
    // Neighbouring conditions of a design are similar. A stride that has no common divisor with the number of
    // conditions distributes them over the folds.
    let stride = (conditions / 2 + 1..conditions + 2).find(|s| gcd(*s, conditions) == 1).unwrap_or(1);
    (0..folds).map(|f| (f..conditions).step_by(folds).map(|k| k * stride % conditions).collect()).collect()
}

fn gcd(a: usize, b: usize) -> usize {
    if b == 0 { a } else { gcd(b, a % b) }
}
