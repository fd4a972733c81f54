//! Diagnosis: show what the simulation gets wrong, name the cause, extend the model, measure the gain.
//!
//! data ([`force_log`] or [`walking_log`], [`experiment`]) → [`forward`] model ([`walking_model`] for runs) →
//! [`noise`] from repetitions, with what they have in common ([`shared`]) → [`whiten`] → [`fit`]
//! → gates on simulated nulls ([`calibrate`]) → [`select`] with [`cross_validation`] and [`lack_of_fit`] → [`report`].
//!
//! Everything from `noise` on sees only [`observations`] and a [`forward::ForwardModel`]: another kind of data needs its
//! own reader and forward model, nothing else.

pub mod arm;
pub mod calibrate;
pub mod chi_squared;
pub mod cli;
pub mod cross_validation;
pub mod errors;
pub mod experiment;
pub mod fit;
pub mod force_log;
pub mod form;
pub mod forward;
pub mod lack_of_fit;
pub mod minimise;
pub mod misfit;
pub mod motion;
pub mod next_experiment;
pub mod noise;
pub mod observations;
pub mod page;
pub mod profile;
pub mod report;
pub mod select;
pub mod shared;
pub mod walking_log;
pub mod walking_model;
pub mod whiten;
pub mod words;

use crate::error::Result;
use crate::progress::{Latch, Progress};
use crate::sand::SandDescription;
use crate::sand::mechanism::{CATALOG, Mechanisms};
use cross_validation::HeldOut;
use errors::Errors;
use experiment::{Experiment, Kind};
use fit::{Fit, Study};
use form::Form;
use forward::{ForceLogModel, ForwardModel};
use noise::{Noise, Source, scatters, sizes};
use observations::Observations;
use report::{
    Cause, Curves, Diagnosis, Gain, LackOfFit, NextExperiment, NoiseSummary, Report, RunMeans, Tried, Untestable,
};
use select::{Candidate, Selection, Verdict, select};
use std::path::Path;
use walking_model::WalkingModel;
use whiten::Whitener;
use words::{after, digits};

pub use cli::run;

/// Reads the data and diagnoses them. Errors name file, row and column of what cannot be read; an error of `progress`
/// stops the work and is handed back.
pub fn diagnose(data: &Path, experiment: &Experiment, progress: &dyn Progress) -> Result<Diagnosis> {
    let progress = &Latch::new(progress);
    progress.report(0.0, "reading the data")?;
    let coefficient_sd = experiment.coefficient_sd;
    match experiment.kind {
        Kind::Intrusion => {
            let log = force_log::read(data, experiment)?;
            let model = ForceLogModel::new(&log, experiment)?.heeding(progress);
            let (observations, sha256, notes) = (log.observations, log.sha256, log.notes);
            diagnose_measured(Measured { observations, coefficient_sd, sha256, notes }, &model, progress)
        }
        Kind::Walking => {
            let log = walking_log::read(data, experiment)?;
            let model = WalkingModel::new(&log, experiment, progress)?;
            let (observations, note) = model.at_default_step(&log.observations)?;
            let (sha256, notes) = (log.sha256, vec![note]);
            diagnose_measured(Measured { observations, coefficient_sd, sha256, notes }, &model, progress)
        }
    }
}

/// Measured numbers, and what is known of them beside.
pub struct Measured {
    pub observations: Observations,
    /// Relative prior standard deviation of each stress coefficient.
    pub coefficient_sd: f64,
    /// Of the data file.
    pub sha256: String,
    /// What a reader of the report should know about how the numbers were prepared.
    pub notes: Vec<String>,
}

/// Diagnoses measured numbers with a forward model of them.
pub fn diagnose_measured(measured: Measured, model: &dyn ForwardModel, progress: &dyn Progress) -> Result<Diagnosis> {
    let Measured { observations, coefficient_sd, sha256, notes } = measured;
    progress.report(0.02, "noise from the repetitions")?;
    let coefficients = model.medium().coefficients;
    let plain = model.predict(&Mechanisms::default(), &coefficients);
    let shared = model.shared(&Mechanisms::default(), &coefficients, &plain);
    let model_error = model.model_error(&Mechanisms::default(), &coefficients, &plain);
    let sizes = sizes(&observations);
    let source = Source {
        observations: &observations,
        prediction: &plain,
        sizes: &sizes,
        shared: &shared,
        model_error: &model_error,
    };
    let noise = source.noise(None, &|| model.stopped());
    let whitener = Whitener::new(&source, &noise);
    let study = Study::new(&observations, model, &whitener, coefficient_sd);
    let (ids, untestable) = testable(&study);
    let floor = source.floor();
    let selection = match scatters(&observations, &floor) {
        true => Some(select(&study, &source, &noise, &ids, progress)?),
        false => None,
    };
    progress.report(0.95, "report")?;
    let view = View { study: &study, source: &source, noise: &noise, selection: selection.as_ref(), floor };
    let report = view.report(untestable, sha256, notes);
    let extension = selection.as_ref().and_then(extension);
    let mut sand = SandDescription::plain(model.medium());
    if let Some(fit) = extension.map(|c| &c.fit) {
        sand.name = format!("{}-extended", sand.name);
        sand.source = format!("sandgait diagnose, data {}: {}", report.data_sha256, report.summary);
        sand.coefficients = study.coefficients(&fit.deviations);
        sand.mechanisms = fit.mechanisms;
    }
    let extended = extension.map(|c| c.fit.prediction.clone());
    let band = noise.standard_deviation(&source);
    let groups = (0..observations.units.len()).map(|u| model.group(u).to_string()).collect();
    let curves = Curves { groups, plain, extended, band, observations: observations.clone() };
    Ok(Diagnosis { report, sand, curves })
}

/// Causes that the data can be asked about, and the others with the reason.
fn testable(study: &Study) -> (Vec<usize>, Vec<Untestable>) {
    let (mut ids, mut untestable) = (Vec::new(), Vec::new());
    let coefficients = study.model.medium().coefficients;
    let asked = study.model.testable();
    let tried = asked.iter().flat_map(|&(id, _)| calibrate::starts(study, id).into_iter().map(move |v| (id, v)));
    let tried: Vec<(usize, f64)> = tried.collect();
    let states: Vec<_> = tried.iter().map(|&(id, v)| (Mechanisms::default().with(id, v), coefficients)).collect();
    let there = study.model.predict_many(&states);
    let plain = study.plain().prediction;
    let felt = |moved: &[f64]| {
        let white = study.whitener.apply(&fit::slope(moved, &plain, 1.0));
        fit::dot(&white, &white) > calibrate::FELT
    };
    for (id, why) in asked {
        let moves = tried.iter().zip(&there).any(|(t, moved)| t.0 == id && felt(moved));
        let why = why.or_else(|| (!moves).then(|| "no trial of these data excites it".to_string()));
        match why {
            Some(why) => untestable.push(Untestable { id: CATALOG[id].id.into(), why }),
            None => ids.push(id),
        }
    }
    (ids, untestable)
}

/// The candidate that extends the model: the cause found; failing that, where misfit remains, whichever candidate
/// surely predicts held-out conditions better, as a proxy and not as a cause.
fn extension(selection: &Selection) -> Option<&Candidate> {
    let helps = |c: &&Candidate| selection.plain_held_out.reduction_interval(&c.held_out)[0] > 0.0;
    let proxy = || best_held_out(selection.candidates.iter().filter(helps));
    selection.best().or_else(|| (selection.verdict == Verdict::NoneOfThese).then(proxy).flatten())
}

/// Which of them predicts held-out conditions best.
fn best_held_out<'a>(candidates: impl Iterator<Item = &'a Candidate>) -> Option<&'a Candidate> {
    candidates.min_by(|a, b| a.held_out.rmse().total_cmp(&b.held_out.rmse()))
}

fn names(fit: &Fit) -> Vec<String> {
    fit.ids.iter().map(|&id| CATALOG[id].id.to_string()).collect()
}

/// Everything a report is made from.
struct View<'a> {
    study: &'a Study<'a>,
    source: &'a Source<'a>,
    noise: &'a Noise,
    selection: Option<&'a Selection>,
    floor: Errors,
}

impl View<'_> {
    fn report(&self, untestable: Vec<Untestable>, data_sha256: String, notes: Vec<String>) -> Report {
        let observations = self.study.observations;
        let misfit = misfit::misfit(observations, self.study.model, &self.study.plain().prediction);
        let significant = self.selection.is_some_and(|s| s.verdict != Verdict::NoiseFloor);
        let whereabouts = misfit::whereabouts(observations, self.study.model, &self.study.plain().prediction);
        let whereabouts = whereabouts.filter(|_| significant);
        let best = self.selection.and_then(Selection::best);
        let causes = best.map(|c| self.causes(&c.fit)).unwrap_or_default();
        let ranges = self.study.model.features().into_iter().map(|f| {
            let all = f.values.iter().flatten().copied();
            (f.name.to_string(), all.fold([f64::MAX, f64::MIN], |r, v| [r[0].min(v), r[1].max(v)]))
        });
        let set = self.selection.map_or(Vec::new(), |s| s.set.iter().map(|&k| names(&s.candidates[k].fit)).collect());
        let mut warnings: Vec<String> =
            causes.iter().filter(|c| c.at_bound).map(|c| format!("{} sits at its bound", c.id)).collect();
        let extension = self.selection.and_then(extension);
        warnings.extend(extension.and_then(|c| far_coefficients(&c.fit)));
        let unfelt = extension.map(|c| c.fit.mechanisms.unfelt_by_walkers()).unwrap_or_default();
        warnings.extend(unfelt.into_iter().map(|line| format!("sand.toml: {line}")));
        let mut notes = notes;
        let form = self.selection.and_then(|s| s.form.clone());
        let powers =
            best.iter().flat_map(|c| &c.fit.ids).filter(|&&id| form.is_none() && CATALOG[id].exponent.is_some());
        notes.extend(
            powers.map(|&id| format!("these data were not asked for another power of the speed in {}", CATALOG[id].id)),
        );
        let channels = observations.channels.iter().zip(&self.noise.channels);
        Report {
            schema: "sandgait.diagnosis.v1",
            verdict: self.selection.map_or(Verdict::InsufficientData, |s| s.verdict),
            summary: self.summary(&causes, whereabouts.as_deref()),
            whereabouts,
            correlations: best.map(|c| correlations(&c.fit)).unwrap_or_default(),
            causes,
            ambiguity_set: set,
            candidates: self.tried(),
            lack_of_fit: LackOfFit {
                plain: self.selection.map(|s| s.base_lack_of_fit),
                extended: extension.map(|c| c.lack_of_fit),
                limit: self.selection.map(|s| s.gates.lack_of_fit),
            },
            gain: self.gain(),
            form,
            misfit,
            correlates_with: self.correlates(),
            untestable,
            next_experiment: self.next_experiment(),
            valid_range: ranges.collect(),
            noise: self.selection.map(|_| NoiseSummary {
                shared: self.source.shared.iter().zip(&self.noise.shared).map(|(s, sd)| (s.name.into(), *sd)).collect(),
                channels: channels.map(|(c, n)| (c.name.to_string(), [n.grain, n.sensor, n.phi])).collect(),
            }),
            warnings,
            notes,
            runs: self.runs(),
            data_sha256,
        }
    }

    /// Values with 95 % intervals, widened for the noise not being known exactly.
    fn causes(&self, fit: &Fit) -> Vec<Cause> {
        let covariance = fit.covariance();
        let inflation = self.selection.map_or(1.0, |s| s.gates.inflation);
        let cause = |(k, &id): (usize, &usize)| {
            let (entry, at) = (&CATALOG[id], fit.coordinates()[k]);
            let reach = (chi_squared::AT_95_PERCENT * covariance[(k, k)] * inflation).sqrt();
            let profiled = self.selection.and_then(|s| s.intervals.get(k)).filter(|i| i.iter().all(|u| u.is_finite()));
            let [low, high] = profiled.copied().unwrap_or([at - reach, at + reach]);
            let bounds = entry.coordinate_bounds();
            let held = |u: f64| entry.value(u.clamp(bounds[0], bounds[1]));
            // A ceiling may be so high as to be none: its greatest value stands for that.
            let most = if entry.ceiling && held(low) == 0.0 { entry.bounds[1] } else { held(low) };
            Cause {
                id: entry.id.into(),
                value: entry.value(at),
                unit: entry.unit.into(),
                ci95: if entry.ceiling { [held(high), most] } else { [held(low), held(high)] },
                at_bound: bounds.contains(&at),
            }
        };
        fit.ids.iter().enumerate().map(cause).collect()
    }

    fn tried(&self) -> Vec<Tried> {
        let Some(selection) = self.selection else {
            return Vec::new();
        };
        let base = selection.base_held_out.rmse();
        let n = (self.study.observations.values.len() as f64).ln();
        let best = selection.candidates.first();
        let tried = |c: &Candidate| Tried {
            ids: names(&c.fit),
            values: c.fit.values(),
            delta_chi2: c.delta_chi2,
            cv_gain: (base > 0.0).then(|| 1.0 - c.held_out.rmse() / base),
            lack_of_fit: c.lack_of_fit,
            delta_aic: c.delta_chi2 - 2.0 * c.fit.ids.len() as f64,
            delta_bic: c.delta_chi2 - n * c.fit.ids.len() as f64,
            distance_to_best: best.map(|b| b.fit.distance_squared(&c.fit).sqrt()),
        };
        selection.candidates.iter().map(tried).collect()
    }

    fn gain(&self) -> Gain {
        let Some(selection) = self.selection else {
            return Gain {
                held_out_rmse_plain: None,
                held_out_rmse_recalibrated: None,
                held_out_rmse_extended: None,
                noise_floor: None,
                reduction: None,
                ci95: None,
                achievable_fraction: None,
            };
        };
        let plain = &selection.plain_held_out;
        let extended: &HeldOut = extension(selection).map_or(plain, |c| &c.held_out);
        let (before, after, floor) = (plain.rmse(), extended.rmse(), self.floor.rmse());
        // Where the plain model's error can hardly be told from the scatter, a share of their difference is any number.
        let told = plain.errors.reduction_interval(&self.floor)[0] > 0.0;
        Gain {
            held_out_rmse_plain: Some(before),
            held_out_rmse_recalibrated: Some(selection.base_held_out.rmse()),
            held_out_rmse_extended: Some(after),
            noise_floor: Some(floor),
            reduction: (before > 0.0).then(|| 1.0 - after / before),
            ci95: Some(plain.reduction_interval(extended)),
            achievable_fraction: (told && before > floor).then(|| (before - after) / (before - floor)),
        }
    }

    fn correlates(&self) -> Vec<misfit::Correlate> {
        let Some(selection) = self.selection.filter(|s| s.verdict == Verdict::NoneOfThese) else {
            return Vec::new();
        };
        let base = &selection.base;
        let whiten = |column: &[f64]| self.study.whitener.apply(column);
        misfit::correlates(
            self.study.observations,
            self.study.model,
            &base.prediction,
            &base.white,
            whiten,
            selection.gates.single,
        )
    }

    /// Measured and predicted means of every condition; for runs, of which each is one number a channel.
    fn runs(&self) -> Vec<RunMeans> {
        let o = self.study.observations;
        if o.units.iter().any(|u| u.samples > 1) {
            return Vec::new();
        }
        let plain = self.study.plain().prediction;
        let extended = self.selection.and_then(extension).map(|c| &c.fit.prediction);
        let groups = o.repetitions();
        let row = |(condition, units): (usize, &Vec<usize>), c: usize| {
            let mean = |stack: &[f64]| {
                units.iter().map(|&u| stack[o.units[u].block(c).start]).sum::<f64>() / units.len() as f64
            };
            RunMeans {
                condition: o.conditions[condition].clone(),
                channel: o.channels[c].name.into(),
                unit: o.channels[c].unit.into(),
                measured: mean(&o.values),
                plain: mean(&plain),
                extended: extended.map(|e| mean(e)),
            }
        };
        groups.iter().enumerate().flat_map(|g| (0..o.channels.len()).map(move |c| row(g, c))).collect()
    }

    fn next_experiment(&self) -> Option<NextExperiment> {
        let selection = self.selection.filter(|s| s.set.len() > 1)?;
        let menu = self.study.model.menu()?;
        let set: Vec<&Fit> = selection.set.iter().map(|&k| &selection.candidates[k].fit).collect();
        let conditions = next_experiment::propose(&menu, self.noise, self.study, &set, 3);
        let why = "these conditions separate the two explanations that the data tell apart least".to_string();
        Some(NextExperiment { why, conditions })
    }

    fn summary(&self, causes: &[Cause], whereabouts: Option<&str>) -> String {
        let Some(selection) = self.selection else {
            let why = match self.study.observations.has_replicates() {
                true => "repetitions are copies of each other, so their scatter is no noise floor",
                false => "no condition is repeated",
            };
            return format!("{why}: without a noise floor nothing can be said");
        };
        let said = |c: &Cause| {
            let [value, low, high] = [c.value, c.ci95[0], c.ci95[1]].map(digits);
            format!("{} = {value}{} (95 % interval {low} to {high})", c.id, after(&c.unit))
        };
        let found = causes.iter().map(said).collect::<Vec<_>>().join(" with ");
        let verdict = match selection.verdict {
            Verdict::NoiseFloor => {
                "no significant misfit: the plain model is as good as the data repeat themselves".into()
            }
            Verdict::Named => format!("the misfit is explained by {found}{}", nearest_rival(selection)),
            Verdict::Ambiguous => {
                let rivals: Vec<_> =
                    selection.set.iter().skip(1).map(|&k| names(&selection.candidates[k].fit).join(" + ")).collect();
                format!("the misfit is explained by {found}, or by {}: these data cannot tell", rivals.join(", or by "))
            }
            Verdict::NoneOfThese => self.not_enough(selection),
            Verdict::InsufficientData => String::new(),
        };
        // Where other misfit remains, the power is fitted to that.
        let form = selection.form.as_ref().filter(|form| form.lack_of_fit <= selection.gates.lack_of_fit);
        let verdict = verdict + &form.map_or(String::new(), Form::said);
        whereabouts.map_or(verdict.clone(), |place| format!("{verdict}; {place}"))
    }

    /// What stands in for the cause that was not found: how much better, or how surely not, conditions held out are predicted.
    fn stand_in(&self, selection: &Selection) -> String {
        let Some(best) = extension(selection).or_else(|| best_held_out(selection.candidates.iter())) else {
            return String::new();
        };
        let plain = &selection.plain_held_out;
        let unit = after(self.study.observations.channels.iter().find(|c| c.in_rmse).map_or("", |c| c.unit));
        let (before, now) = (plain.rmse(), best.held_out.rmse());
        let [low, high] = plain.reduction_interval(&best.held_out).map(|share| format!("{:.0}", 100.0 * share));
        let name = names(&best.fit).join(" with ");
        let gain = format!(
            "from {} to {}{unit} on conditions held out ({:.0} %, 95 % interval {low} to {high} %)",
            digits(before),
            digits(now),
            100.0 * (1.0 - now / before)
        );
        match extension(selection) {
            None if now >= before => "; none of them predicts conditions held out better than the plain model".into(),
            Some(_) => format!("; as a stand-in and not as the cause, {name} lowers the error {gain}"),
            None => format!(
                "; nothing surely helps: {name}, which does best, changes the error {gain}, so the sand stays plain"
            ),
        }
    }

    fn not_enough(&self, selection: &Selection) -> String {
        let limit = selection.gates.lack_of_fit;
        let excluded = selection.form.as_ref().filter(|form| form.excluded);
        match selection.candidates.first() {
            Some(best) if excluded.is_some_and(|form| best.lack_of_fit.min(form.lack_of_fit) <= limit) => {
                let name = names(&best.fit).join(" with ");
                format!("none of the known causes has the right form: {name} comes nearest") + &self.stand_in(selection)
            }
            Some(best) if best.delta_chi2 > selection.gates.single => {
                format!(
                    "none of the known causes is enough: the nearest, {}, leaves a lack of fit of {} where noise leaves up to {}",
                    names(&best.fit).join(" with "),
                    digits(best.lack_of_fit),
                    digits(selection.gates.lack_of_fit)
                ) + &self.stand_in(selection)
            }
            _ => "misfit remains and none of the known causes explains any of it".into(),
        }
    }
}

/// A warning where the fit needs coefficients that their declared uncertainty hardly allows: beyond three of its standard
/// deviations, our choice.
fn far_coefficients(fit: &Fit) -> Option<String> {
    let furthest = fit.deviations.iter().copied().max_by(|a, b| a.abs().total_cmp(&b.abs()))?;
    (furthest.abs() > 3.0).then(|| {
        format!(
            "the fit moves a stress coefficient by {furthest:+.1} of its declared standard deviations: the medium's table or \
             coefficient_sd does not fit this sand"
        )
    })
}

/// Which rival comes nearest to the one cause named, and how near.
fn nearest_rival(selection: &Selection) -> String {
    let nearest = selection.rivals().min_by(|a, b| a.1.total_cmp(&b.1));
    nearest.map_or(String::new(), |(rival, away)| {
        format!("; the nearest rival, {}, is {} σ away", names(&rival.fit).join(" + "), digits(away))
    })
}

fn correlations(fit: &Fit) -> Vec<Vec<f64>> {
    let covariance = fit.covariance();
    let n = fit.ids.len();
    let of = |i: usize, j: usize| covariance[(i, j)] / (covariance[(i, i)] * covariance[(j, j)]).sqrt();
    if n < 2 { Vec::new() } else { (0..n).map(|i| (0..n).map(|j| of(i, j)).collect()).collect() }
}
