//! Selects the cause in three stages: screening, fitting, judging. No stage changes the results of an earlier one.

use super::calibrate::{FELT, Screen};
use super::cross_validation::HeldOut;
use super::described::{self, Described, described};
use super::discrepancy::Discrepancy;
use super::errors::Errors;
use super::fit::Fit;
use super::fitted::{
    Candidate, FINALISTS, Fitted, Screened, Surroundings, beside_discrepancy, candidate, screened, settled, singles,
    surroundings, with_pairs,
};
use super::judged::{Judged, Standing, explored, judged};
use super::lack_of_fit;
use super::nested::{Known, nested};
use super::noise::{Noise, Source};
use super::refined::{Refined, refined};
use super::study::Study;
use super::verdict::{Evidence, MAIN_PART, Verdict, verdict};
use crate::error::Result;
use crate::progress::Progress;
use crate::sand::mechanism::{CATALOG, Side};

/// All three stages of one diagnosis.
pub struct Selection {
    pub screened: Screened,
    pub fitted: Fitted,
    pub judged: Judged,
    /// Noise, whitening and nuisances under which it was judged.
    pub around: Surroundings,
    pub verdict: Verdict,
    /// The law found in the data, if no mechanism explains them.
    pub described: Option<Described>,
    /// If a cause was found, its model for predictions where it differs from the best candidate.
    pub refined: Option<Refined>,
    /// Indices of the candidates that the data cannot distinguish from the best, including the best; empty if none
    /// is named.
    pub set: Vec<usize>,
}

impl Selection {
    /// The best candidate, if a cause was found.
    pub fn best(&self) -> Option<&Candidate> {
        self.set.first().map(|&k| &self.fitted.candidates[k])
    }

    /// Other explanations of a significant part, with their whitened distance [σ] to the best.
    pub fn rivals(&self) -> impl Iterator<Item = (&Candidate, f64)> {
        let others = self.fitted.candidates.iter().skip(1).zip(&self.judged.evidence.rivals);
        others.filter(|(_, r)| r.explains).map(|(c, r)| (c, r.squared.sqrt()))
    }

    /// The candidate in the extended model. If a cause was found, this is the cause. Otherwise, if misfit remains, this
    /// is the candidate that fits best: a proxy and not a cause. A proxy is only used if candidates chosen without the
    /// held-out conditions predict these conditions better than the plain model, with 95 % certainty.
    pub fn extension(&self) -> Option<&Candidate> {
        let helps = self.plain_errors().reduction_interval(&self.judged.nested[1].errors)[0] > 0.0;
        let proxy = || self.fitted.best().filter(|_| self.judged.evidence.found && helps);
        self.best().or_else(|| (self.verdict == Verdict::NoneOfThese).then(proxy).flatten())
    }

    /// The law in the extended model: in addition to a cause, or instead of one.
    pub fn law(&self) -> Option<&Described> {
        self.described.as_ref().or(self.refined.as_ref().and_then(|r| r.law.as_ref()))
    }

    /// The fit that the extended model is made from.
    pub fn fit(&self) -> Option<&Fit> {
        let refined = self.refined.as_ref().map(|r| &r.fit);
        let described = self.described.as_ref().map(|d| &d.fit);
        refined.or(described).or_else(|| self.extension().map(|c| &c.fit))
    }

    /// Errors of the plain model with fitted coefficients and of the extended model on held-out conditions, chosen anew
    /// in each fold.
    pub fn nested(&self) -> &[HeldOut; 2] {
        let refined = self.refined.as_ref().map(|r| &r.nested);
        refined.or(self.described.as_ref().map(|d| &d.nested)).unwrap_or(&self.judged.nested)
    }

    /// Errors of the plain model on held-out conditions.
    pub fn plain_errors(&self) -> &Errors {
        &self.fitted.plain_held_out.errors
    }
}

/// The inputs of a selection.
pub struct Asked<'a> {
    pub source: &'a Source<'a>,
    pub noise: &'a Noise,
    /// Catalogue indices of the causes that the data can show.
    pub ids: &'a [usize],
    /// Ids of sensor mechanisms that may be named as causes.
    pub interest: &'a [String],
    /// Scatter of the repetitions.
    pub floor: &'a Errors,
}

/// Runs the whole selection. Effects of the sensor are nuisances, which are marginalised while causes in sand and
/// drive are searched. Only if none of these is found, sensor mechanisms are tried; they must explain as much as
/// the nuisances do.
pub fn select(study: &Study, asked: &Asked, progress: &dyn Progress) -> Result<Selection> {
    let nuisance = |id: &usize| {
        let entry = &CATALOG[*id];
        entry.side == Side::Sensor && !asked.interest.iter().any(|own| own == entry.id)
    };
    let (sensor, others): (Vec<usize>, Vec<usize>) = asked.ids.iter().partition(|id| nuisance(id));
    let selection = attempt(study, asked, &others, progress, true)?;
    if sensor.is_empty() || selection.verdict != Verdict::NoiseFloor {
        return Ok(selection);
    }
    let bare = study.under(study.whitener, Vec::new());
    let gains = |id: &usize| {
        let column = Screen::new(&bare, &[*id]);
        let scores = column.scores(bare.whitener, &bare.observations.values);
        let felt = (0..scores.score.len()).filter(|&k| scores.gram[(k, k)] > FELT);
        felt.map(|k| scores.score[k].powi(2) / scores.gram[(k, k)]).fold(0.0, f64::max)
    };
    if sensor.iter().map(gains).fold(0.0, f64::max) < selection.screened.gates.single {
        return Ok(selection);
    }
    // If nuisances of single channels explain a misfit that a mechanism with one value for all channels does not
    // explain, this mechanism is not the cause.
    let count = study.nuisances.len() as f64;
    let allowed = count + 3.0 * (2.0 * count).sqrt();
    let gates = &selection.screened.gates;
    let explains = |c: &Candidate| {
        let fit = bare.fit_from(&[&c.fit]);
        fit[0].objective - selection.fitted.base.fit.objective < allowed * gates.inflation
    };
    let screen = Screen::new(&bare, asked.ids);
    let scores = screen.scores(bare.whitener, &bare.observations.values);
    let alone = singles(&bare, &Screened { screen, scores, gates: gates.clone(), ids: asked.ids.to_vec() });
    if !alone.candidates.iter().take(FINALISTS).any(explains) {
        return Ok(selection);
    }
    let other = attempt(&bare, asked, asked.ids, progress, false)?;
    Ok(if other.best().is_some_and(explains) { other } else { selection })
}

/// Runs the stages once.
fn attempt(study: &Study, asked: &Asked, ids: &[usize], progress: &dyn Progress, pairs: bool) -> Result<Selection> {
    let Asked { source, noise, .. } = *asked;
    progress.report(0.1, "effect of every cause")?;
    let first = screened(study, source, noise, ids);
    progress.report(0.4, "single causes")?;
    // Nuisances have nonlinear effects, so they are linearised at the plain model's fit before causes are tested.
    let base = study.recalibrated();
    let straight = study.under(study.whitener, study.nuisances_about(&base));
    let mut fitted = singles(&straight, &first);
    let mut around = None;
    if fitted.found(&first.gates) {
        progress.report(0.5, "singles under the noise of the best")?;
        (fitted, around) = settled(&straight, source, noise, fitted);
        if let Some(now) = around.as_ref().filter(|_| pairs) {
            progress.report(0.6, "pairs of causes")?;
            let renewed = study.under(&now.whitener, now.nuisances.clone());
            let (next, earns) = with_pairs(&renewed, &first, fitted);
            fitted = next;
            if earns {
                progress.report(0.8, "pairs under the noise of the best")?;
                let (next, again) = settled(&renewed, source, noise, fitted);
                (fitted, around) = (next, again.or(around));
            }
        }
    }
    let around = around.unwrap_or_else(|| surroundings(&straight, source, noise, &fitted.base.fit));
    conclude(study, asked, first, fitted, around, progress)
}

/// Judges with the final noise.
fn conclude(
    study: &Study,
    asked: &Asked,
    first: Screened,
    fitted: Fitted,
    around: Surroundings,
    progress: &dyn Progress,
) -> Result<Selection> {
    progress.report(0.9, "intervals, form of the law, held-out conditions")?;
    let (judged, fitted, refined) = {
        let renewed = study.under(&around.whitener, around.nuisances.clone());
        let fitted = match fitted.found(&first.gates) {
            true => fitted,
            // Nothing was found with the first noise, so the plain model is judged with its own noise.
            false => Fitted { base: candidate(&renewed, &renewed.recalibrated(), renewed.recalibrated()), ..fitted },
        };
        let lack = |c: &Candidate| lack_of_fit::statistic(study.observations, &c.fit.white);
        let lacks =
            [lack(&fitted.base), fitted.best().filter(|_| fitted.found(&first.gates)).map_or(lack(&fitted.base), lack)];
        let beside = match first.gates.lacking(&lacks[1]) {
            true => beside_discrepancy(study, &around, fitted),
            false => (fitted, None),
        };
        let (fitted, beside) = beside;
        let whitener = beside.as_ref().map_or(&around.whitener, |b| &b.whitener);
        let discrepancy = beside.as_ref().map_or(Discrepancy { size: 0.0, surprise: 0.0 }, |b| b.discrepancy);
        let last = study.under(whitener, around.nuisances.clone());
        let (fitted, profiled) = match fitted.found(&first.gates) {
            true => explored(&last, fitted, &first.gates),
            false => (fitted, Vec::new()),
        };
        // The remaining misfit is compared with the noise alone, without the discrepancy.
        let best = fitted.best().filter(|_| fitted.found(&first.gates)).unwrap_or(&fitted.base);
        let left = renewed.restated(&best.fit);
        let lacks = [lacks[0], lack_of_fit::statistic(study.observations, &left.white)];
        let source = Source { sizes: &around.sizes, ..*asked.source };
        let known = Known { source: &source, noise: &around.noise, beside: beside.as_ref() };
        let (nested, choices) = nested(&last, &fitted, &first.gates, &known);
        let (gates, floor) = (&first.gates, asked.floor);
        let standing = Standing { fitted: &fitted, gates, discrepancy, lacks, floor, nested, profiled };
        let judged = judged(&last, standing);
        let named = matches!(verdict(&judged.evidence).0, Verdict::Named | Verdict::Ambiguous);
        let refine = || refined(&last, &fitted, gates, (&judged.nested, &choices), judged.evidence.remainder);
        let refined = named.then(refine).flatten();
        (judged, fitted, refined)
    };
    let (ruling, set) = verdict(&judged.evidence);
    let law = match ruling {
        Verdict::NoneOfThese => law(study, asked, &around, &fitted, &first),
        _ => None,
    };
    let evidence = Evidence { described: law.is_some(), ..judged.evidence };
    let (ruling, set) = if law.is_some() { verdict(&evidence) } else { (ruling, set) };
    let judged = Judged { evidence, ..judged };
    let named = matches!(ruling, Verdict::Named | Verdict::Ambiguous);
    let set = if named { [0].into_iter().chain(set.into_iter().map(|k| k + 1)).collect() } else { Vec::new() };
    Ok(Selection { screened: first, fitted, judged, around, verdict: ruling, described: law, refined, set })
}

/// A law found in the data that explains the main part of the misfit.
fn law(study: &Study, asked: &Asked, around: &Surroundings, fitted: &Fitted, first: &Screened) -> Option<Described> {
    let renewed = study.under(&around.whitener, around.nuisances.clone());
    let base = renewed.fit_from(&[&fitted.base.fit]).swap_remove(0);
    let source = Source { sizes: &around.sizes, ..*asked.source };
    let known = Known { source: &source, noise: &around.noise, beside: None };
    let law = described(&renewed, &known, &base, &first.gates)?;
    let plain = &fitted.plain_held_out.errors;
    (described::explained(&renewed, &base, &law, [plain, asked.floor]) >= MAIN_PART).then_some(law)
}
