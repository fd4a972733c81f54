//! Converts a diagnosis to a report.

use super::differences::NORMAL;
use super::errors::SquaredErrors;
use super::fit::{COEFFICIENTS, Fit, slope};
use super::gate::{FoundEffect, at_their_bounds, far_coefficient};
use super::gauss_newton::at_bound;
use super::headline::{ALARM, kind_of_mechanism};
use super::laws::FittedLaw;
use super::next_experiment::KnownNoise;
use super::noise::{Noise, NoiseData};
use super::normal_equations::Further;
use super::nuisance::kind;
use super::opening::{runs, worded};
use super::report::{
    Cause, EvidenceRow, Gain, LackOfFit, NextExperiment, NoiseSummary, NuisanceValue, RawErrors, Recalibration,
    Remainder, Report, TermFound, Tried, Untestable, UpperLimit, Withheld,
};
use super::select::Selection;
use super::study::FitInputs;
use super::verdict::{Effect, Role, Verdict, Written};
use super::words::{after, digits, of};
use super::{measured, misfit, next_experiment, strength};
use crate::number::dot;
use crate::sand::mechanism::{CATALOG, Side};
use crate::student;
use std::collections::BTreeMap;

/// Names of the stress coefficients in sand.toml.
const COEFFICIENT_NAMES: [&str; COEFFICIENTS] = ["a00", "a10", "b11", "b01", "bm11", "c11", "c01", "cm11", "d10"];

/// An error of measuring is said if it is larger than this many stated standard deviations, and than this many of its own: our
/// choices. The stated one makes the first unlikely (5 %), the second leaves no doubt of the sign.
const UNLIKELY: f64 = 2.0;
const CERTAIN: f64 = 3.0;

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
        let renewed = s.standing.study(study);
        let shared = self.source.uncertainty.shared.iter().zip(&self.noise.shared);
        let channels = study.observations.channels.iter().zip(&self.noise.channels);
        self.recalibrate(&mut without);
        let named = (s.ruling.written == Written::Cause).then_some(s);
        let nuisances = self.nuisances(&renewed);
        let report = Report {
            verdict: s.ruling.verdict,
            written: s.ruling.written,
            evidence: self.evidence(),
            whereabouts,
            correlations: named.map(|s| s.standing.correlations.clone()).unwrap_or_default(),
            warnings: self.warnings(&causes, &nuisances),
            causes,
            ambiguity_set: s.explanations(),
            withheld: self.withheld(),
            candidates: self.tried(),
            lack_of_fit: LackOfFit {
                plain: Some(s.table.lack(0)),
                extended: (s.ruling.model > 0).then(|| s.table.lack(s.ruling.model)),
                limit: Some(s.table.limit),
            },
            gain: self.gain(),
            nuisances,
            remainder: Some(self.remainder()),
            terms: s.standing.law.iter().map(|law| self.term(law)).collect(),
            upper_limits: self.upper_limits(&renewed, &without.untestable),
            degrees_of_freedom: Some(s.table.degrees),
            form: s.form(study),
            free_powers: s.standing.powers.clone(),
            next_experiment: self.next_experiment(&without.untestable),
            noise: Some(NoiseSummary {
                shared: shared.map(|(s, sd)| (s.name.into(), *sd)).collect(),
                channels: channels.map(|(c, n)| (c.name.to_string(), [n.grain, n.sensor, n.phi])).collect(),
            }),
            runs: runs(study, (s.ruling.model > 0).then_some(&s.standing.fit)),
            ..without
        };
        worded(report)
    }

    fn evidence(&self) -> Vec<EvidenceRow> {
        let s = self.selection;
        // A cause whose column is missing was compared at an assumed place, so it has no row; `untestable` says why.
        let shown = |k: &usize| s.entries[*k].role != Role::Absent && !s.entries[*k].unnamed;
        let best = s.table.ranked((0..s.entries.len()).filter(shown))[0];
        let of = |k: usize| {
            let [difference, standard_error] = s.table.difference(k, best);
            let model = match s.entries[k].role {
                Role::Plain => "plain",
                Role::Established => "established",
                Role::Base => "recalibrated",
                Role::Causes | Role::Beside | Role::Absent => "causes",
                Role::Law => "law",
            };
            let lawful = matches!(s.entries[k].role, Role::Law | Role::Beside);
            let terms = s.fits.law(&s.table, k).filter(|_| lawful).map(|law| law.formula()).into_iter().collect();
            let (ids, written) = (s.ids(k), k == s.ruling.model);
            EvidenceRow { model, ids, terms, elpd: s.table.elpd(k), difference, standard_error, written }
        };
        [0].into_iter().chain(s.table.ranked((1..s.entries.len()).filter(shown))).map(of).collect()
    }

    fn withheld(&self) -> Vec<Withheld> {
        let s = self.selection;
        let of = |(k, why): &(usize, Vec<String>)| {
            let lawful = s.entries[*k].role == Role::Law;
            let terms = s.fits.law(&s.table, *k).filter(|_| lawful).map(|law| law.formula()).into_iter().collect();
            Withheld { ids: s.ids(*k), terms, why: why.clone() }
        };
        s.withheld.iter().map(of).collect()
    }

    /// Says how strong the sand is, and its coefficients. If no fit gives the strength, the ratio of the forces remains, and a note says so.
    fn recalibrate(&self, report: &mut Report) {
        let c = &self.selection.fits.candidates;
        let around = c.around.about(self.study);
        let own = c.about_base(&around);
        let coefficients = self.coefficients();
        match (strength::factor(&own, &c.base, &c.fits, self.selection.table.degrees), &mut report.recalibration) {
            (Some((factor, ci95)), own) => *own = Some(Recalibration { factor, ci95, coefficients }),
            (None, Some(own)) => {
                own.coefficients = coefficients;
                report.notes.push(
                    "no fit gives the strength of the sand, so the ratio of measured to predicted values stands for it"
                        .into(),
                );
            }
            (None, None) => (),
        }
    }

    /// Each coefficient: stated, fitted without a cause, and the standard deviation of the fitted one.
    fn coefficients(&self) -> BTreeMap<String, [f64; 3]> {
        let s = self.selection;
        let standing = s.ruling.model > 0 && !s.standing.stated;
        let own = standing.then(|| (s.standing.study(self.study), &s.standing.fit));
        let (c, around) = (&s.fits.candidates, s.fits.candidates.around.about(self.study));
        let (study, fit) = own.unwrap_or((c.about_base(&around), &c.base));
        let reach = study.reach(fit, s.table.degrees);
        let [stated, fitted, moved] = [0.0, 1.0, 2.0].map(|step| {
            // At 2: each coefficient one stated standard deviation above its fitted value.
            let d = fit.deviations[..COEFFICIENTS].iter().map(|d| if step == 0.0 { 0.0 } else { d + step - 1.0 });
            study.coefficients(&d.collect::<Vec<_>>()).to_array()
        });
        let of = |k: usize| {
            let half = reach.get(fit.ids.len() + k).copied().filter(|r| r.is_finite()).unwrap_or(NORMAL);
            (COEFFICIENT_NAMES[k].to_string(), [stated[k], fitted[k], (moved[k] - fitted[k]).abs() * half / NORMAL])
        };
        (0..COEFFICIENTS).map(of).collect()
    }

    /// Errors of measuring that no answer names, but that are certain and larger than what is stated of the apparatus: the fit has
    /// absorbed them, and the user can mend them. `values`: see [`Self::nuisances`]. The largest comes first.
    fn absorbed(&self, values: &[NuisanceValue]) -> Vec<String> {
        let own = &self.selection.standing;
        let mut large: Vec<(f64, String)> = Vec::new();
        for ((n, d), value) in own.nuisances.iter().zip(&own.fit.deviations[COEFFICIENTS..]).zip(values) {
            let known = kind(n.id).filter(|kind| !kind.remedy.is_empty());
            let within = n.sd == n.stated_sd && !at_bound(*d);
            if let Some(known) =
                known.filter(|_| within && d.abs() > UNLIKELY && value.value.abs() > CERTAIN * value.sd)
            {
                let size = format!("{}{} {}{}", n.id, of(n.of.as_deref()), digits(value.value), after(n.unit));
                large.push((d.abs(), format!("{ALARM}{} ({size})", known.said(Some(value.value)))));
            }
        }
        large.sort_by(|a, b| b.0.total_cmp(&a.0));
        large.into_iter().map(|(_, said)| said).collect()
    }

    fn warnings(&self, causes: &[Cause], values: &[NuisanceValue]) -> Vec<String> {
        let mut warnings: Vec<String> =
            causes.iter().filter(|c| c.at_bound).map(|c| format!("{} is at its bound", c.id)).collect();
        let of_several = "these data cannot tell of which channel or shape; the one that predicts best is written";
        warnings.extend(self.selection.is_of_several().then(|| of_several.to_string()));
        let own = &self.selection.standing;
        warnings.extend(far_coefficient(&own.fit).map(|said| format!("{ALARM}{said}")));
        warnings.extend(at_their_bounds(own, |_| true).map(|said| format!("{ALARM}{said}")));
        warnings.extend(self.absorbed(values));
        let unfelt = own.fit.mechanisms.unfelt_by_walkers();
        warnings.extend(unfelt.into_iter().map(|line| format!("sand.toml: {line}")));
        warnings
    }

    /// Values with 95 % intervals.
    fn causes(&self) -> Vec<Cause> {
        let s = self.selection;
        if s.ruling.written != Written::Cause {
            return Vec::new();
        }
        let cause = |found: &FoundEffect| {
            let (id, of, kind, unit) = match found.effect {
                Effect::Mechanism(id) => (CATALOG[id].id, None, kind_of_mechanism(id), CATALOG[id].unit),
                Effect::Measuring(k) => {
                    let own = &s.standing.nuisances[k];
                    (measured::answer(own), own.of.clone(), measured::kind_of(own), own.unit)
                }
            };
            let (id, unit) = (id.into(), unit.into());
            Cause { id, of, kind, value: found.value, unit, ci95: found.ci95, at_bound: found.at_bound }
        };
        s.standing.found.iter().map(cause).collect()
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
        let (selection, own) = (self.selection, &self.selection.standing);
        let reach = if own.fit.slopes.is_empty() { Vec::new() } else { study.reach(&own.fit, selection.table.degrees) };
        let all = own.nuisances.iter().zip(&own.fit.deviations[COEFFICIENTS..]).enumerate();
        let mut values: Vec<NuisanceValue> = all
            .map(|(k, (n, d))| {
                let reach = reach.get(own.fit.ids.len() + COEFFICIENTS + k).filter(|reach| reach.is_finite());
                let share = reach.map_or(1.0, |reach| reach / NORMAL);
                let (id, of) = (n.id.to_string(), n.of.clone());
                NuisanceValue { id, of, level: "log", value: d * n.sd, sd: share * n.sd, unit: n.unit }
            })
            .collect();
        let split = |id: &str| match id.split_once('_').filter(|(_, c)| ["Fx", "Fz", "Ty"].contains(c)) {
            Some((kind, channel)) => (kind.to_string(), Some(channel.to_string())),
            None => (id.to_string(), None),
        };
        let shared = self.source.uncertainty.shared.iter().zip(&selection.fits.candidates.around.noise.shared);
        values.extend(shared.map(|(s, sd)| {
            let (id, of) = split(s.name);
            let level = if id == "bed_strength" { "bed" } else { "trial" };
            NuisanceValue { id, of, level, value: 0.0, sd: *sd, unit: s.unit }
        }));
        values
    }

    fn remainder(&self) -> Remainder {
        let (study, selection) = (self.study, self.selection);
        let (table, entry) = (&selection.table, selection.ruling.model);
        let significant = table.lack(entry) > table.limit;
        let left = &selection.standing.fit.prediction;
        let place = misfit::whereabouts(study.observations, study.model, left, "what remains");
        let left = table.unexplained(entry, 0);
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

    /// Upper limits of the causes that were not found. They limit the sum of what the fit absorbed and of what it did not: fitted
    /// coefficients and effects of measuring may have taken the place of the cause. No limit is given for an explanation that the
    /// data cannot exclude, and for a cause that they cannot test.
    fn upper_limits(&self, study: &FitInputs, untestable: &[Untestable]) -> Vec<UpperLimit> {
        let (selection, standing) = (self.selection, &self.selection.standing.fit);
        if standing.slopes.is_empty() {
            return Vec::new();
        }
        let (table, set) = (&selection.table, &selection.ruling.set);
        let limited = |id: usize| {
            let entry = &CATALOG[id];
            !entry.ceiling
                && !untestable.iter().any(|u| u.id == entry.id)
                && !set.iter().any(|&k| selection.fits.fit(k).ids.contains(&id))
        };
        let asked = selection.fits.candidates.screened.iter().filter(|c| limited(c.0)).copied();
        let asked: Vec<(usize, f64)> = asked.collect();
        // What coefficients and nuisances changed in the readings.
        let bare = study.model.predict(&(standing.mechanisms, study.model.medium().coefficients));
        let taken = study.whitener.apply(&slope(&study.reading(standing), &bare, 1.0));
        let limit = |further: &Further| {
            let entry = &CATALOG[further.id];
            let (degrees, sd) = (table.degrees.max(2.0), further.sd);
            let sum = further.estimate + dot(&further.white, &taken) / dot(&further.white, &further.white).max(1e-300);
            let most = match entry.bounds[0] < 0.0 {
                true => further.estimate.abs().max(sum.abs()) + student::two_sided_95(degrees) * sd,
                false => further.estimate.max(sum).max(0.0) + student::one_sided_95(degrees) * sd,
            };
            let limit = UpperLimit { id: entry.id.into(), value: most, unit: entry.unit.into(), level: 0.95 };
            // Upper limits beyond the bound of the mechanism's law are left out.
            Some(limit).filter(|_| most < entry.bounds[1])
        };
        // The prediction of the written model has its law, so the predictions that it is compared with need the law too.
        let law = selection.standing.law.as_ref();
        let law = law.and_then(|law| study.model.with_terms(std::slice::from_ref(&law.term)));
        let further = match &law {
            Some(model) => study.with_model(&**model).further(standing, &asked),
            None => study.further(standing, &asked),
        };
        further.iter().filter_map(limit).collect()
    }

    fn tried(&self) -> Vec<Tried> {
        let s = self.selection;
        let base = super::verdict::base(&s.entries);
        let before = s.table.error(base);
        let n = (self.study.observations.values.len() as f64).ln();
        let best = s.ruling.set.first().map(|&k| s.fits.fit(k));
        let best = best.or_else(|| s.fits.candidates.leading.map(|k| &s.fits.candidates.fits[k]));
        let tried = |fit: &Fit, ids: Vec<String>, earlier: f64, entry: Option<usize>| {
            let gained = earlier - fit.objective;
            Tried {
                values: fit.values(),
                delta_chi2: gained,
                cv_gain: entry.filter(|_| before > 0.0).map(|k| 1.0 - s.table.error(k) / before),
                lack_of_fit: entry.map(|k| s.table.lack(k)),
                delta_aic: gained - 2.0 * ids.len() as f64,
                delta_bic: gained - n * ids.len() as f64,
                distance_to_best: best
                    .filter(|b| entry.is_some() && b.deviations.len() == fit.deviations.len())
                    .map(|b| b.distance_squared(fit).sqrt()),
                ids,
            }
        };
        let causes = (1..s.entries.len()).filter(|&k| s.entries[k].role == Role::Causes);
        let objective = s.fits.candidates.base.objective;
        let compared = s.table.ranked(causes).into_iter().map(|k| tried(s.fits.fit(k), s.ids(k), objective, Some(k)));
        let behind = &s.fits.candidates.behind;
        compared.chain(behind.iter().map(|fit| tried(fit, fit.names(), s.fits.candidates.earlier, None))).collect()
    }

    fn gain(&self) -> Gain {
        let (own, plain) = (&self.selection.nested, self.selection.ruling.written == Written::Plain);
        let [before, base, chosen] = own.errors;
        let after = if plain { before } else { chosen };
        let (reduction, ci95) = if plain { (0.0, [0.0; 2]) } else { own.reduction() };
        // If the plain model's error is hardly larger than noise, a share of the difference between the two has no meaning.
        let told = self.selection.table.misfit(0) > 0.0 && before > 1.0;
        let [raw, raw_base, raw_chosen] = own.raw.each_ref().map(SquaredErrors::rmse);
        Gain {
            held_out_rmse_plain: Some(before),
            held_out_rmse_recalibrated: Some(base),
            held_out_rmse_extended: Some(after),
            noise_floor: Some(1.0),
            reduction: Some(reduction),
            ci95: Some(ci95),
            achievable_fraction: told.then(|| (before - after) / (before - 1.0)),
            nested: true,
            in_units: Some(RawErrors {
                unit: self.study.observations.error_unit().into(),
                plain: raw,
                recalibrated: raw_base,
                extended: if plain { raw } else { raw_chosen },
                noise_floor: self.source.floor().rmse(),
            }),
        }
    }

    fn next_experiment(&self, untestable: &[Untestable]) -> Option<NextExperiment> {
        let names = self.source.uncertainty.shared.iter().map(|s| s.name).collect();
        let noise = KnownNoise { noise: &self.selection.fits.candidates.around.noise, names };
        // Causes that act on the data if a column says so.
        let id = |u: &Untestable| CATALOG.iter().position(|m| m.id == u.id && m.side == Side::Sand);
        let of_interest = untestable.iter().filter(|u| u.why.starts_with("the data have no column"));
        let of_interest: Vec<(usize, String)> = of_interest.filter_map(|u| Some((id(u)?, u.why.clone()))).collect();
        next_experiment::next(self.study, self.selection, &noise, &of_interest)
    }
}
