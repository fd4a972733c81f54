//! Converts a diagnosis to a report.

use super::evidence::NORMAL;
use super::fit::{COEFFICIENTS, Fit};
use super::forward::Feature;
use super::gauss_newton::MOST_DEVIATION;
use super::laws::FittedLaw;
use super::noise::{Noise, NoiseData};
use super::normal_equations::Further;
use super::nuisance::stated;
use super::report::{
    Cause, EvidenceRow, Gain, LackOfFit, NextExperiment, NoiseSummary, NuisanceValue, Remainder, Report, RunMeans,
    TermFound, Tried, Untestable, UpperLimit,
};
use super::select::Selection;
use super::series::ends;
use super::study::FitInputs;
use super::summary::summary;
use super::verdict::{Verdict, Written};
use super::words::{after, digits};
use super::{misfit, next_experiment, speed_exponent};
use crate::sand::mechanism::CATALOG;
use crate::student;

/// The part of a report on the data and the plain model. If there are no repetitions, this is the whole report.
pub fn without_verdict(
    study: &FitInputs,
    untestable: Vec<Untestable>,
    data_sha256: String,
    notes: Vec<String>,
) -> Report {
    let (observations, model, plain) = (study.observations, study.model, study.plain().prediction);
    let range = |f: Feature| (f.name.to_string(), ends(f.values.iter().flatten().copied()));
    let why = match observations.repetitions().iter().any(|units| units.len() > 1) {
        true => "repetitions are copies of each other, so their scatter is no noise floor",
        false => "no condition is repeated",
    };
    let mut report = Report {
        schema: "sandgait.diagnosis.v3",
        misfit: misfit::misfit(observations, model, &plain, |_| true),
        untestable,
        valid_range: model.features().into_iter().map(range).collect(),
        warnings: vec![why.into()],
        notes,
        runs: runs(study, None),
        data_sha256,
        ..Report::default()
    };
    report.summary = summary(&report);
    report
}

/// The inputs of a report with a verdict.
pub struct ReportView<'a> {
    pub study: &'a FitInputs<'a>,
    pub source: &'a NoiseData<'a>,
    pub noise: &'a Noise,
    pub selection: &'a Selection,
}

impl ReportView<'_> {
    /// The report, from the report without a verdict.
    pub fn report(&self, mut without: Report) -> Report {
        let (study, s) = (self.study, self.selection);
        let plain = study.plain().prediction;
        let whereabouts = match s.ruling.verdict {
            Verdict::NoiseFloor => Vec::new(),
            _ => misfit::whereabouts(study.observations, study.model, &plain, "the plain model's error"),
        };
        let causes = self.causes();
        // The study with the noise scaled to the errors that remain.
        let renewed = study.under(&s.whitener, s.candidates.around.nuisances.clone());
        let shared = self.source.uncertainty.shared.iter().zip(&self.noise.shared);
        let channels = study.observations.channels.iter().zip(&self.noise.channels);
        without.notes.extend(self.left_out());
        let mut report = Report {
            verdict: s.ruling.verdict,
            written: s.ruling.written,
            evidence: self.evidence(),
            whereabouts,
            correlations: self.named().map(|s| s.intervals.correlations.clone()).unwrap_or_default(),
            warnings: self.warnings(&causes),
            causes,
            ambiguity_set: s.explanations(),
            candidates: self.tried(),
            lack_of_fit: LackOfFit {
                plain: Some(s.table.lack(0)),
                extended: s.fit().map(|_| s.table.lack(s.ruling.model)),
                limit: Some(s.table.limit),
            },
            gain: self.gain(),
            nuisances: self.nuisances(&renewed),
            remainder: Some(self.remainder()),
            terms: s.law.iter().map(|law| self.term(law)).collect(),
            upper_limits: self.upper_limits(&renewed, &without.untestable),
            degrees_of_freedom: Some(s.table.degrees),
            form: self.named().and_then(|s| speed_exponent::form(&renewed, s)),
            next_experiment: self.next_experiment(&without.untestable),
            noise: Some(NoiseSummary {
                shared: shared.map(|(s, sd)| (s.name.into(), *sd)).collect(),
                channels: channels.map(|(c, n)| (c.name.to_string(), [n.grain, n.sensor, n.phi])).collect(),
            }),
            runs: runs(study, s.fit()),
            ..without
        };
        report.summary = summary(&report);
        report
    }

    /// The selection, if a cause is named.
    fn named(&self) -> Option<&Selection> {
        Some(self.selection).filter(|s| s.ruling.written == Written::Cause)
    }

    fn evidence(&self) -> Vec<EvidenceRow> {
        let s = self.selection;
        let compared = |k: &usize| !s.ruling.left_out.contains(k);
        let best = s.table.ranked((0..s.entries.len()).filter(compared))[0];
        let of = |k: usize| {
            let [difference, standard_error] = s.table.difference(k, best);
            let terms = s.formulas[k].iter().cloned().collect();
            let (ids, written) = (s.fit_of(k).names(), k == s.ruling.model);
            EvidenceRow { ids, terms, elpd: s.table.elpd(k), difference, standard_error, written }
        };
        let order = s.table.ranked((1..s.entries.len()).filter(compared));
        [0].into_iter().chain(order).map(of).collect()
    }

    /// A note on the models that are not compared.
    fn left_out(&self) -> Option<String> {
        let s = self.selection;
        let error = |k: usize| s.entries[k].error;
        let best = *s.table.ranked(s.ruling.left_out.iter().copied()).first()?;
        let law = s.formulas[best].iter().map(|law| format!("the law {law}"));
        let named: Vec<String> = s.fit_of(best).names().into_iter().chain(law).collect();
        let count = match s.ruling.left_out.len() {
            1 => "one model is".to_string(),
            more => format!("{more} models are"),
        };
        Some(format!(
            "{count} not compared, because the sand alone would err more on left-out conditions than the plain one, although their \
             density is higher; the best, {}, errs by {}{}, and the plain one by {}",
            named.join(" with "),
            digits(error(best)),
            after(self.study.observations.error_unit()),
            digits(error(0))
        ))
    }

    fn warnings(&self, causes: &[Cause]) -> Vec<String> {
        let mut warnings: Vec<String> =
            causes.iter().filter(|c| c.at_bound).map(|c| format!("{} is at its bound", c.id)).collect();
        let fit = self.selection.fit();
        warnings.extend(far_coefficients(&self.selection.standing));
        let nuisances = self.selection.candidates.around.nuisances.iter();
        let at_end = nuisances.zip(self.selection.standing.deviations.iter().skip(COEFFICIENTS));
        let at_end = at_end.filter(|(_, d)| d.abs() >= MOST_DEVIATION * (1.0 - 1e-6));
        warnings.extend(at_end.map(|(nuisance, d)| {
            format!(
                "nuisance {} is {:.3}{}, at its bound of {MOST_DEVIATION} stated standard deviations: it may hide a cause, or the \
                 stated uncertainty is too small",
                nuisance.id,
                d * nuisance.sd,
                after(nuisance.unit)
            )
        }));
        let unfelt = fit.map(|fit| fit.mechanisms.unfelt_by_walkers()).unwrap_or_default();
        warnings.extend(unfelt.into_iter().map(|line| format!("sand.toml: {line}")));
        warnings
    }

    /// Values with 95 % intervals.
    fn causes(&self) -> Vec<Cause> {
        let Some(selection) = self.named() else { return Vec::new() };
        let Some(fit) = selection.fit() else { return Vec::new() };
        let cause = |(k, &id): (usize, &usize)| {
            let (entry, at) = (&CATALOG[id], fit.coordinates()[k]);
            let range = selection.intervals.ranges.get(k).copied().unwrap_or([at, at]);
            let [low, high] = [range[0].min(at), range[1].max(at)].map(|u| entry.value(u));
            // For a mechanism whose value is an upper limit, the end of the interval may be infinite; the largest
            // allowed value replaces it.
            let most = if entry.ceiling && low == 0.0 { entry.bounds[1] } else { low };
            Cause {
                id: entry.id.into(),
                value: entry.value(at),
                unit: entry.unit.into(),
                ci95: if entry.ceiling { [high, most] } else { [low, high] },
                at_bound: entry.coordinate_bounds().contains(&at),
            }
        };
        fit.ids.iter().enumerate().map(cause).collect()
    }

    fn term(&self, law: &FittedLaw) -> TermFound {
        let (term, reach) = (&law.term, student::two_sided_95(self.selection.table.degrees.max(2.0)));
        TermFound {
            formula: term.formula(),
            tex: term.tex(),
            on: term.on.name().into(),
            groups: term.groups.clone(),
            coefficient: term.coefficient,
            ci95: [term.coefficient - reach * law.sd, term.coefficient + reach * law.sd],
            range: term.range.clone(),
        }
    }

    /// Values of the nuisances that all data share, and standard deviations of the nuisances that differ between trials
    /// or beds.
    fn nuisances(&self, study: &FitInputs) -> Vec<NuisanceValue> {
        let (selection, fit) = (self.selection, &self.selection.standing);
        let reach = if fit.slopes.is_empty() { Vec::new() } else { study.reach(fit, selection.table.degrees) };
        let split = |id: &str| match id.split_once('_').filter(|(_, c)| ["Fx", "Fz", "Ty"].contains(c)) {
            Some((kind, channel)) => (kind.to_string(), Some(channel.to_string())),
            None => (id.to_string(), None),
        };
        let all = selection.candidates.around.nuisances.iter().zip(&fit.deviations[COEFFICIENTS..]).enumerate();
        let mut values: Vec<NuisanceValue> = all
            .map(|(k, (n, d))| {
                let (id, channel) = split(&n.id);
                let reach = reach.get(fit.ids.len() + COEFFICIENTS + k).filter(|reach| reach.is_finite());
                let share = reach.map_or(1.0, |reach| reach / NORMAL);
                NuisanceValue { id, channel, level: "log", value: d * n.sd, sd: share * n.sd, unit: n.unit }
            })
            .collect();
        values.extend(self.source.uncertainty.shared.iter().zip(&selection.candidates.around.noise.shared).map(
            |(s, sd)| {
                let (id, channel) = split(s.name);
                let level = if id == "bed_strength" { "bed" } else { "trial" };
                NuisanceValue { id, channel, level, value: 0.0, sd: *sd, unit: s.unit }
            },
        ));
        values
    }

    fn remainder(&self) -> Remainder {
        let (study, selection) = (self.study, self.selection);
        let (table, entry) = (&selection.table, selection.ruling.model);
        let significant = table.lack(entry) > table.limit;
        let left = &selection.standing.prediction;
        let place = misfit::whereabouts(study.observations, study.model, left, "what remains");
        let left = selection.entries[entry].unexplained;
        Remainder {
            significant,
            fraction: if significant { left.clamp(0.0, 1.0) } else { 0.0 },
            place: match significant {
                true if place.is_empty() => "spread over all data".into(),
                true => place.join("; "),
                false => String::new(),
            },
            lack_of_fit: table.lack(entry),
            limit: table.limit,
        }
    }

    /// Upper limits of the causes that were not found. No limit is given for an explanation that the data cannot
    /// exclude, for a cause that they cannot test, and for an effect that a nuisance already has.
    fn upper_limits(&self, study: &FitInputs, untestable: &[Untestable]) -> Vec<UpperLimit> {
        let (selection, standing) = (self.selection, &self.selection.standing);
        if standing.slopes.is_empty() {
            return Vec::new();
        }
        let (table, set) = (&selection.table, &selection.ruling.set);
        let limited = |id: usize| {
            let entry = &CATALOG[id];
            !entry.ceiling
                && !untestable.iter().any(|u| u.id == entry.id)
                && !set.iter().any(|&k| selection.fit_of(k).ids.contains(&id))
                && stated(&study.nuisances, entry.id).is_none()
        };
        let asked = selection.candidates.screened.iter().filter(|c| limited(c.0)).copied();
        let asked: Vec<(usize, f64)> = asked.collect();
        let limit = |further: &Further| {
            let entry = &CATALOG[further.id];
            let (degrees, sd) = (table.degrees.max(2.0), further.sd);
            let most = match entry.bounds[0] < 0.0 {
                true => further.estimate.abs() + student::two_sided_95(degrees) * sd,
                false => further.estimate.max(0.0) + student::one_sided_95(degrees) * sd,
            };
            let limit = UpperLimit { id: entry.id.into(), value: most, unit: entry.unit.into(), level: 0.95 };
            // Upper limits beyond the bound of the mechanism's law are left out.
            Some(limit).filter(|_| most < entry.bounds[1])
        };
        // The prediction of the written model has its law, so the predictions that it is compared with need the law too.
        let law = selection.law.as_ref().and_then(|law| study.model.with_terms(std::slice::from_ref(&law.term)));
        let further = match &law {
            Some(model) => study.with_model(&**model).further(standing, &asked),
            None => study.further(standing, &asked),
        };
        further.iter().filter_map(limit).collect()
    }

    fn tried(&self) -> Vec<Tried> {
        let s = self.selection;
        let base = s.table.rows[0].held_out.rmse();
        let n = (self.study.observations.values.len() as f64).ln();
        let best = s.best().or_else(|| s.candidates.leading.map(|k| &s.candidates.fits[k]));
        let tried = |fit: &Fit, earlier: f64, entry: Option<usize>| {
            let gained = earlier - fit.objective;
            Tried {
                ids: fit.names(),
                values: fit.values(),
                delta_chi2: gained,
                cv_gain: entry.filter(|_| base > 0.0).map(|k| 1.0 - s.table.rows[k].held_out.rmse() / base),
                lack_of_fit: entry.map(|k| s.table.lack(k)),
                delta_aic: gained - 2.0 * fit.ids.len() as f64,
                delta_bic: gained - n * fit.ids.len() as f64,
                distance_to_best: best.filter(|_| entry.is_some()).map(|b| b.distance_squared(fit).sqrt()),
            }
        };
        // Entries with a law are not candidates.
        let alone = (1..s.entries.len()).filter(|&k| s.formulas[k].is_none() && s.entries[k].causes > 0);
        let compared =
            s.table.ranked(alone).into_iter().map(|k| tried(s.fit_of(k), s.candidates.base.objective, Some(k)));
        compared.chain(s.candidates.behind.iter().map(|fit| tried(fit, s.candidates.earlier, None))).collect()
    }

    fn gain(&self) -> Gain {
        let selection = self.selection;
        let (plain, [base, chosen]) = (&selection.plain, &selection.nested);
        let extended = if selection.ruling.written == Written::Plain { plain } else { chosen };
        let repetitions = self.source.floor();
        let (before, after, floor) = (plain.rmse(), extended.rmse(), repetitions.rmse());
        // If the plain model's error is hardly larger than the scatter between repetitions, a share of the difference between the two has no meaning.
        let told = plain.reduction_interval(&repetitions)[0] > 0.0;
        Gain {
            held_out_rmse_plain: Some(before),
            held_out_rmse_recalibrated: Some(base.rmse()),
            nested: true,
            held_out_rmse_extended: Some(after),
            noise_floor: Some(floor),
            reduction: (before > 0.0).then(|| 1.0 - after / before),
            ci95: Some(plain.reduction_interval(extended)),
            achievable_fraction: (told && before > floor).then(|| (before - after) / (before - floor)),
        }
    }

    /// The experiment that separates the explanations of the set, of at most three conditions (our choice).
    fn next_experiment(&self, untestable: &[Untestable]) -> Option<NextExperiment> {
        let explanations = Some(self.selection.explanations()).filter(|all| all.len() > 1)?;
        let selection = self.selection;
        let set: Vec<&Fit> = selection.ruling.set.iter().map(|&k| selection.fit_of(k)).collect();
        let menu = self.study.model.menu();
        let noise = &selection.candidates.around.noise;
        let conditions = menu.filter(|_| set.len() > 1);
        let conditions =
            conditions.map_or(Vec::new(), |menu| next_experiment::propose(&menu, noise, self.study, &set, 3));
        let unknown = untestable.iter().filter(|u| explanations.iter().any(|ids| ids.contains(&u.id)));
        let mut why: Vec<String> =
            unknown.map(|u| format!("a test of {} needs a log that says more: {}", u.id, u.why)).collect();
        if !conditions.is_empty() {
            why.push("these conditions separate the two explanations that the data distinguish least".into());
        }
        (!why.is_empty()).then(|| NextExperiment { why: why.join("; "), conditions })
    }
}

/// Measured and predicted means of every condition, for runs, which have one number for each channel.
fn runs(study: &FitInputs, extended: Option<&Fit>) -> Vec<RunMeans> {
    let o = study.observations;
    if o.units.iter().any(|u| u.samples > 1) {
        return Vec::new();
    }
    let simulated = |prediction: &[f64]| study.model.as_simulated(prediction);
    let plain = simulated(&study.plain().prediction);
    let extended = extended.map(|f| simulated(&f.prediction));
    let groups = o.repetitions();
    let row = |(condition, units): (usize, &Vec<usize>), c: usize| {
        let mean =
            |stack: &[f64]| units.iter().map(|&u| stack[o.units[u].block(c).start]).sum::<f64>() / units.len() as f64;
        RunMeans {
            condition: o.conditions[condition].clone(),
            channel: o.channels[c].name.to_string(),
            unit: o.channels[c].unit.into(),
            measured: mean(&o.values),
            plain: mean(&plain),
            extended: extended.as_ref().map(|e| mean(e)),
        }
    };
    groups.iter().enumerate().flat_map(|g| (0..o.channels.len()).map(move |c| row(g, c))).collect()
}

/// A warning if the fit needs coefficients that deviate by more than three of their stated standard deviations: our choice.
fn far_coefficients(fit: &Fit) -> Option<String> {
    let furthest = fit.deviations[..COEFFICIENTS].iter().copied().max_by(|a, b| a.abs().total_cmp(&b.abs()))?;
    (furthest.abs() > 3.0).then(|| {
        format!(
            "the fit moves a stress coefficient by {furthest:+.1} of its declared standard deviations: the medium's table or \
             coefficient_sd does not fit this sand"
        )
    })
}
