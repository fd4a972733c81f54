//! Converts a diagnosis to a report.

use super::described::Described;
use super::errors::Errors;
use super::fit::{COEFFICIENTS, Fit};
use super::fitted::Candidate;
use super::noise::{Noise, Source};
use super::refined::Refined;
use super::report::{
    Cause, Gain, LackOfFit, NextExperiment, NoiseSummary, NuisanceValue, Remainder, Report, RunMeans, TermFound, Tried,
    Untestable, UpperLimit, Written,
};
use super::select::Selection;
use super::study::Study;
use super::summary::{far_coefficients, names, summary};
use super::verdict::Verdict;
use super::words::digits;
use super::{lack_of_fit, misfit, next_experiment};
use crate::sand::mechanism::CATALOG;
use crate::sand::term::On;
use crate::student;

/// The inputs of a report.
pub struct View<'a> {
    pub study: &'a Study<'a>,
    pub source: &'a Source<'a>,
    pub noise: &'a Noise,
    pub selection: Option<&'a Selection>,
    pub floor: Errors,
}

impl View<'_> {
    pub fn report(&self, untestable: Vec<Untestable>, data_sha256: String, notes: Vec<String>) -> Report {
        let observations = self.study.observations;
        let misfit = misfit::misfit(observations, self.study.model, &self.study.plain().prediction);
        let significant = self.selection.is_some_and(|s| s.verdict != Verdict::NoiseFloor);
        let whereabouts = misfit::whereabouts(observations, self.study.model, &self.study.plain().prediction);
        let whereabouts = whereabouts.filter(|_| significant);
        let best = self.selection.and_then(Selection::best);
        let intervals = self.selection.and_then(|s| s.judged.intervals.as_ref());
        let refined = self.selection.and_then(|s| s.refined.as_ref());
        let causes = best.map(|c| self.causes(refined.map_or(&c.fit, |r| &r.fit))).unwrap_or_default();
        let ranges = self.study.model.features().into_iter().map(|f| {
            let all = f.values.iter().flatten().copied();
            (f.name.to_string(), all.fold([f64::MAX, f64::MIN], |r, v| [r[0].min(v), r[1].max(v)]))
        });
        let set =
            self.selection.map_or(Vec::new(), |s| s.set.iter().map(|&k| names(&s.fitted.candidates[k].fit)).collect());
        let mut warnings: Vec<String> =
            causes.iter().filter(|c| c.at_bound).map(|c| format!("{} is at its bound", c.id)).collect();
        let extension = self.selection.and_then(Selection::extension);
        warnings.extend(self.selection.and_then(Selection::fit).and_then(far_coefficients));
        let unfelt = extension.map(|c| c.fit.mechanisms.unfelt_by_walkers()).unwrap_or_default();
        warnings.extend(unfelt.into_iter().map(|line| format!("sand.toml: {line}")));
        let mut notes = notes;
        let form = self.selection.and_then(|s| s.judged.form.clone());
        let powers =
            best.iter().flat_map(|c| &c.fit.ids).filter(|&&id| form.is_none() && CATALOG[id].exponent.is_some());
        notes.extend(powers.map(|&id| format!("no other power of the speed was tested in {}", CATALOG[id].id)));
        notes.extend(refined.filter(|r| r.even).map(|r| even_note(best, r)));
        let channels = observations.channels.iter().zip(&self.noise.channels);
        Report {
            schema: "sandgait.diagnosis.v3",
            verdict: self.selection.map_or(Verdict::InsufficientData, |s| s.verdict),
            written: self.written(),
            evidence: Vec::new(),
            summary: summary(self.study, self.selection, &causes, whereabouts.as_deref()),
            whereabouts,
            correlations: best.and(intervals).map(|i| i.correlations.clone()).unwrap_or_default(),
            causes,
            ambiguity_set: set,
            candidates: self.tried(),
            lack_of_fit: LackOfFit {
                plain: self.selection.map(|s| s.judged.lacks[0].mean),
                extended: self.selection.and_then(|s| match &s.described {
                    Some(law) => Some(lack_of_fit::statistic(observations, &law.fit.white).mean),
                    None => extension.map(|_| s.judged.lacks[1].mean),
                }),
                limit: self.selection.map(|s| s.screened.gates.lack_of_fit),
            },
            gain: self.gain(),
            nuisances: self.nuisances(),
            remainder: self.remainder(),
            terms: self.terms(),
            upper_limits: self.upper_limits(),
            degrees_of_freedom: self.selection.map(|s| s.screened.gates.degrees_of(best.map_or(&[], |c| &c.fit.ids))),
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

    fn written(&self) -> Written {
        let Some(selection) = self.selection else { return Written::Plain };
        match selection.verdict {
            Verdict::Named | Verdict::Ambiguous => Written::Cause,
            Verdict::Described => Written::Description,
            _ if selection.fit().is_some() => Written::Proxy,
            _ => Written::Plain,
        }
    }

    /// Values with 95 % intervals.
    fn causes(&self, fit: &Fit) -> Vec<Cause> {
        let ranges = self.selection.and_then(|s| s.judged.intervals.as_ref()).map(|i| i.ranges.clone());
        let refined = self.selection.and_then(|s| s.refined.as_ref());
        let cause = |(k, &id): (usize, &usize)| {
            let (entry, at) = (&CATALOG[id], fit.coordinates()[k]);
            let range = ranges.as_ref().and_then(|r| r.get(k)).copied().unwrap_or([at, at]);
            let range = refined.map_or(range, |r| r.around(k, at, range));
            let [low, high] = range.map(|u| entry.value(u));
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

    fn terms(&self) -> Vec<TermFound> {
        let found = |law: &Described| TermFound {
            formula: law.term.formula(),
            tex: law.term.tex(),
            on: if law.term.on == On::Normal { "normal".into() } else { "tangential".into() },
            groups: law.term.groups.clone(),
            coefficient: law.term.coefficient,
            ci95: law.ci95,
            range: law.term.range.clone(),
        };
        self.selection.and_then(Selection::law).map(found).into_iter().collect()
    }

    /// The final fit: the extension, or the fitted plain model.
    fn standing(&self) -> Option<&Candidate> {
        self.selection.map(|s| s.extension().unwrap_or(&s.fitted.base))
    }

    /// Values of the nuisances that all data share, and standard deviations of those that differ between trials or
    /// beds.
    fn nuisances(&self) -> Vec<NuisanceValue> {
        let (Some(selection), Some(standing)) = (self.selection, self.standing()) else { return Vec::new() };
        let fit = &standing.fit;
        let count = fit.ids.len() + COEFFICIENTS;
        let inverse = (!fit.slopes.is_empty()).then(|| fit.normal_equations().0.try_inverse()).flatten();
        let split = |id: &str| match id.split_once('_').filter(|(_, c)| ["Fx", "Fz", "Ty"].contains(c)) {
            Some((kind, channel)) => (kind.to_string(), Some(channel.to_string())),
            None => (id.to_string(), None),
        };
        let all = selection.around.nuisances.iter().zip(&fit.deviations[COEFFICIENTS..]).enumerate();
        let mut values: Vec<NuisanceValue> = all
            .map(|(k, (n, d))| {
                let (id, channel) = split(&n.id);
                let share = inverse.as_ref().map_or(1.0, |v| v[(count + k, count + k)].max(0.0).sqrt());
                NuisanceValue { id, channel, level: "log", value: d * n.sd, sd: share * n.sd, unit: n.unit }
            })
            .collect();
        values.extend(self.source.shared.iter().zip(&selection.around.noise.shared).map(|(s, sd)| {
            let (id, channel) = split(s.name);
            let level = if id == "bed_strength" { "bed" } else { "trial" };
            NuisanceValue { id, channel, level, value: 0.0, sd: *sd, unit: s.unit }
        }));
        values
    }

    fn remainder(&self) -> Option<Remainder> {
        let (selection, standing) = (self.selection?, self.standing()?);
        let evidence = &selection.judged.evidence;
        let o = self.study.observations;
        let extends = selection.extension().is_some();
        let of_law = selection.described.as_ref().map(|l| lack_of_fit::statistic(o, &l.fit.white));
        let lack = of_law.as_ref().unwrap_or(&selection.judged.lacks[usize::from(extends)]);
        let significant = selection.screened.gates.lacking(lack);
        let after = &selection.nested()[usize::from(selection.fit().is_some())];
        let predicted = &selection.fit().unwrap_or(&standing.fit).prediction;
        let [plain, after, floor] =
            [selection.plain_errors().rmse(), after.rmse(), self.floor.rmse()].map(|rmse| rmse * rmse);
        let told = plain > floor && selection.plain_errors().reduction_interval(&self.floor)[0] > 0.0;
        let by_error = told.then(|| ((after - floor) / (plain - floor)).max(0.0));
        let place = misfit::whereabouts_of(o, self.study.model, predicted, "what remains");
        let unlocated = || "spread over all data".to_string();
        Some(Remainder {
            significant,
            fraction: by_error.unwrap_or((1.0 - evidence.explained).clamp(0.0, 1.0)),
            place: if significant { place.unwrap_or_else(unlocated) } else { String::new() },
            lack_of_fit: lack.mean,
            limit: selection.screened.gates.lack_of_fit,
            worst: lack.worst,
            worst_limit: selection.screened.gates.worst,
            discrepancy: selection.judged.discrepancy.size,
            explained: evidence.explained,
        })
    }

    /// Upper limits of the causes that were not found.
    fn upper_limits(&self) -> Vec<UpperLimit> {
        let (Some(selection), Some(standing)) = (self.selection, self.standing()) else { return Vec::new() };
        if standing.fit.slopes.is_empty() {
            return Vec::new();
        }
        let gates = &selection.screened.gates;
        let study = self.study.under(&selection.around.whitener, selection.around.nuisances.clone());
        let asked: Vec<(usize, f64)> =
            selection.screened.screen.candidates.iter().filter(|c| !CATALOG[c.0].ceiling).copied().collect();
        let limit = |further: &super::further::Further| {
            let entry = &CATALOG[further.id];
            let degrees = gates.degrees_of(&[further.id]);
            let sd = further.sd * gates.inflation.sqrt();
            let most = match entry.bounds[0] < 0.0 {
                true => further.estimate.abs() + student::two_sided_95(degrees) * sd,
                false => further.estimate.max(0.0) + student::one_sided_95(degrees) * sd,
            };
            UpperLimit { id: entry.id.into(), value: most, unit: entry.unit.into(), level: 0.95 }
        };
        let all = study.further(&standing.fit, &asked);
        // An upper limit beyond the law's bound is left out.
        all.iter().map(|f| (f.id, limit(f))).filter(|(id, l)| l.value < CATALOG[*id].bounds[1]).map(|l| l.1).collect()
    }

    fn tried(&self) -> Vec<Tried> {
        let Some(selection) = self.selection else {
            return Vec::new();
        };
        let base = selection.fitted.base.held_out.rmse();
        let n = (self.study.observations.values.len() as f64).ln();
        let best = selection.fitted.best();
        let tried = |c: &Candidate| Tried {
            ids: names(&c.fit),
            values: c.fit.values(),
            delta_chi2: c.delta_chi2,
            cv_gain: (base > 0.0).then(|| 1.0 - c.held_out.rmse() / base),
            lack_of_fit: c.lack.mean,
            delta_aic: c.delta_chi2 - 2.0 * c.fit.ids.len() as f64,
            delta_bic: c.delta_chi2 - n * c.fit.ids.len() as f64,
            distance_to_best: best.map(|b| b.fit.distance_squared(&c.fit).sqrt()),
        };
        selection.fitted.candidates.iter().map(tried).collect()
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
                nested: false,
            };
        };
        let plain = selection.plain_errors();
        let [base, chosen] = selection.nested();
        let extended = if selection.fit().is_some() { &chosen.errors } else { plain };
        let (before, after, floor) = (plain.rmse(), extended.rmse(), self.floor.rmse());
        // If the plain model's error is hardly larger than the scatter, a share of their difference has no meaning.
        let told = plain.reduction_interval(&self.floor)[0] > 0.0;
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

    fn correlates(&self) -> Vec<misfit::Correlate> {
        let Some(selection) = self.selection.filter(|s| s.verdict == Verdict::NoneOfThese) else {
            return Vec::new();
        };
        let base = &selection.fitted.base.fit;
        let whiten = |column: &[f64]| selection.around.whitener.apply(column);
        misfit::correlates(
            self.study.observations,
            self.study.model,
            &base.prediction,
            &base.white,
            whiten,
            selection.screened.gates.single,
        )
    }

    /// Measured and predicted means of every condition, for runs, which have one number for each channel.
    fn runs(&self) -> Vec<RunMeans> {
        let o = self.study.observations;
        if o.units.iter().any(|u| u.samples > 1) {
            return Vec::new();
        }
        let simulated = |prediction: &[f64]| self.study.model.as_simulated(prediction);
        let plain = simulated(&self.study.plain().prediction);
        let extended = self.selection.and_then(Selection::fit).map(|f| simulated(&f.prediction));
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
                extended: extended.as_ref().map(|e| mean(e)),
            }
        };
        groups.iter().enumerate().flat_map(|g| (0..o.channels.len()).map(move |c| row(g, c))).collect()
    }

    fn next_experiment(&self) -> Option<NextExperiment> {
        let selection = self.selection.filter(|s| s.set.len() > 1)?;
        let menu = self.study.model.menu()?;
        let set: Vec<&Fit> = selection.set.iter().map(|&k| &selection.fitted.candidates[k].fit).collect();
        let conditions = next_experiment::propose(&menu, &selection.around.noise, self.study, &set, 3);
        let why = "these conditions separate the two explanations that the data distinguish least".to_string();
        Some(NextExperiment { why, conditions })
    }
}

/// A note on values from a fit in which all numbers have equal weights.
fn even_note(best: Option<&Candidate>, refined: &Refined) -> String {
    let weighted = best.map_or(Vec::new(), |c| c.fit.values());
    let values: Vec<String> = weighted.into_iter().map(digits).collect();
    format!(
        "the model's error is much larger than the noise, so all numbers have equal weights in the fit, which predicts \
         left-out conditions better; with weights from the noise the values are {} ({})",
        values.join(", "),
        names(&refined.fit).join(", ")
    )
}
