//! Proposes the experiment that would decide between two explanations.

use super::fit::COEFFICIENTS;
use super::forward::{ForwardModel, Menu, SandParameters};
use super::noise::{Noise, NoiseData, sizes};
use super::nuisance::{Nuisance, NuisanceState};
use super::observations::{Observations, Unit};
use super::report::{NextExperiment, Proposal};
use super::select::Selection;
use super::study::FitInputs;
use super::verdict::Role;
use super::whiten::Whitener;
use super::words::{after, digits};
use crate::sand::Term;
use crate::sand::mechanism::{CATALOG, Mechanisms};

/// Number of repetitions that a proposal assumes: our choice, as many as docs/diagnosis.md recommends.
const REPETITIONS: usize = 3;
/// Greatest separation that is stated [σ]: our choice; more says only that the noise of a channel is nearly 0.
const FAR: f64 = 1000.0;
/// Number of proposed conditions: our choice.
const PROPOSED: usize = 3;

/// A noise, and the names of the directions that it has.
pub struct KnownNoise<'a> {
    pub noise: &'a Noise,
    pub names: Vec<&'static str>,
}

/// An explanation: its sand with its law, the effects of measuring that it names, and its name.
pub struct Explanation {
    pub sand: SandParameters,
    pub law: Option<Term>,
    pub effects: Vec<NuisanceState>,
    pub name: String,
}

impl Explanation {
    /// The readings that it predicts for a menu. Effects of measuring are linear here.
    fn reading(&self, model: &dyn ForwardModel) -> Vec<f64> {
        let lawful = self.law.as_ref().and_then(|law| model.with_terms(std::slice::from_ref(law)));
        let mut reading = lawful.as_deref().unwrap_or(model).predict(&self.sand);
        if self.effects.is_empty() {
            return reading;
        }
        let nuisances = model.nuisances(&self.sand, &[]);
        for effect in &self.effects {
            let own = |n: &&Nuisance| n.id == effect.id && n.of == effect.of;
            let Some(own) = nuisances.iter().find(own) else { continue };
            reading.iter_mut().zip(own.column.iter()).for_each(|(r, c)| *r += effect.value / own.sd * c);
        }
        reading
    }
}

/// The trials of the menu that best separate two explanations.
fn propose(menu: &Menu, noise: &KnownNoise, pair: [&Explanation; 2]) -> Vec<Proposal> {
    let [first, second] = pair.map(|e| e.reading(&*menu.model));
    let sand = &pair[0].sand;
    let observations = Observations { values: first.clone(), ..menu.observations.clone() };
    let mut uncertainty = menu.model.uncertainty(sand, &first);
    // The separations below are multiplied by √n for n repetitions. Repetitions do not reduce the errors that they
    // share, so these errors are multiplied by √n, too.
    let errors = uncertainty.common.iter_mut().flatten().chain(&mut uncertainty.own);
    errors.for_each(|e| *e *= (REPETITIONS as f64).sqrt());
    // The noise has only the directions that the repetitions of the data support.
    uncertainty.shared.retain(|s| noise.names.contains(&s.name));
    let (sizes, uncertainty) = (&sizes(&observations), &uncertainty);
    let source = NoiseData { observations: &observations, prediction: &first, sizes, uncertainty, left_out: &[] };
    let whitener = Whitener::new(&source, noise.noise);
    let difference: Vec<f64> = first.iter().zip(&second).map(|(a, b)| a - b).collect();
    let white = whitener.apply(&difference);
    let of = |u: &Unit| white[menu.observations.span(u)].iter().map(|w| w * w).sum::<f64>();
    let separations: Vec<f64> = menu.observations.units.iter().map(|u| (of(u) * REPETITIONS as f64).sqrt()).collect();
    let mut order: Vec<usize> = (0..separations.len()).filter(|k| separations[*k].is_finite()).collect();
    order.sort_by(|i, j| separations[*j].total_cmp(&separations[*i]));
    // Trials that differ only in a quantity without effect on both explanations separate these equally, so only one
    // such trial is kept. A thousandth is our choice, above rounding.
    order.dedup_by(|a, b| (separations[*a] - separations[*b]).abs() <= 1e-3 * separations[*b]);
    let proposal = |k: usize| Proposal {
        condition: menu.observations.conditions[k].clone(),
        repetitions: REPETITIONS,
        expected_separation: Some(separations[k].min(FAR)),
    };
    order.into_iter().take(PROPOSED).map(proposal).collect()
}

/// Conditions beyond the range of the data, if no menu knows what the apparatus can do.
fn beyond(model: &dyn ForwardModel) -> Vec<Proposal> {
    let mut all = Vec::new();
    for feature in model.features() {
        let [low, high] = super::series::ends(feature.values.iter().flatten().copied());
        // The phase of a stride and an angle are no conditions.
        if ["phase", "angle", "pass", "place"].contains(&feature.name) || !(low.is_finite() && high.is_finite()) {
            continue;
        }
        let step = if high > low { 0.5 * (high - low) } else { 0.5 * high.abs().max(1.0) };
        let name = feature.name.trim_end_matches("_deg").replace('_', " ");
        all.push(Proposal {
            condition: format!("{name} {}{}, all else as in the data", digits(high + step), after(feature.unit)),
            repetitions: REPETITIONS,
            expected_separation: None,
        });
    }
    all.truncate(PROPOSED);
    all
}

/// The experiment that decides between two explanations.
fn deciding(model: &dyn ForwardModel, noise: &KnownNoise, pair: [&Explanation; 2], why: String) -> NextExperiment {
    let menu = model.menu();
    let mut conditions = menu.map_or_else(Vec::new, |menu| propose(&menu, noise, pair));
    if conditions.is_empty() {
        conditions = beyond(model);
    }
    let expected = conditions.iter().filter_map(|p| p.expected_separation).reduce(f64::max);
    NextExperiment { why, decides: pair.map(|e| e.name.clone()).to_vec(), conditions, expected }
}

/// The next experiment after a verdict on too few data.
pub fn after_too_few(model: &dyn ForwardModel, noise: &KnownNoise, lacks: &str) -> NextExperiment {
    let (plain, coefficients) = model.plain_sand();
    let stronger = Mechanisms { scale: -0.3, ..plain };
    let other = Mechanisms { depth_power: 0.3, ..plain };
    let of = |m: Mechanisms, name: &str| Explanation {
        sand: (m, coefficients),
        law: None,
        effects: Vec::new(),
        name: name.into(),
    };
    let pair = [of(stronger, "another strength of the sand"), of(other, "another law")];
    let why = format!("{lacks}: at least three conditions with three repetitions each can show a cause");
    deciding(model, noise, [&pair[0], &pair[1]], why)
}

/// The next experiment after a selection; None if everything of interest is known.
pub fn next(
    study: &FitInputs,
    selection: &Selection,
    noise: &KnownNoise,
    untestable: &[(usize, String)],
) -> Option<NextExperiment> {
    let rows = &selection.entries;
    let explanation = |k: usize| {
        let (fit, nuisances) = (selection.fits.fit(k), selection.fits.nuisances(k));
        let own = if selection.fits.is_stated(k) { study.stated() } else { study.with_nuisances(nuisances.to_vec()) };
        let effects = nuisances.iter().zip(&fit.deviations[COEFFICIENTS..]).filter(|(n, _)| n.sd > n.stated_sd);
        let ids = selection.named(k);
        Explanation {
            sand: own.sand(fit),
            law: selection.fits.law(&selection.table, k),
            effects: effects.map(|(n, d)| NuisanceState { value: n.sd * d, ..n.into() }).collect(),
            name: match (k, ids.is_empty()) {
                (0, _) => "the stated sand".into(),
                (_, true) => "the same law with fitted coefficients".into(),
                (_, false) => ids.join(" + "),
            },
        }
    };
    let of = |a: usize, b: usize, why: &str| {
        let pair = [explanation(a), explanation(b)];
        deciding(study.model, noise, [&pair[0], &pair[1]], why.to_string())
    };
    let set = &selection.ruling.set;
    if let [first, rest @ ..] = &set[..]
        && let Some(&second) = rest.iter().max_by(|a, b| rows[**a].elpd.total_cmp(&rows[**b].elpd))
    {
        return Some(of(*first, second, "these conditions separate the two explanations that predict the data best"));
    }
    if let Some((id, why)) = untestable.first().filter(|_| selection.ruling.model == 0 || !set.is_empty()) {
        let own = explanation(selection.ruling.model);
        let entry = &CATALOG[*id];
        let with = Explanation {
            sand: (own.sand.0.with(*id, 2.0 * entry.typical), own.sand.1),
            law: own.law.clone(),
            effects: own.effects.clone(),
            name: entry.id.into(),
        };
        let why = format!("{} could not be tested ({why}); log what it needs in these conditions", entry.id);
        return Some(deciding(study.model, noise, [&own, &with], why));
    }
    // The best other model that does not contain the written one.
    let model = selection.ruling.model;
    let contains = |k: usize| rows[model].effects.iter().all(|e| rows[k].effects.contains(e));
    let other = |k: &usize| {
        *k != model && *k != 0 && rows[*k].role != Role::Absent && (rows[model].effects.is_empty() || !contains(*k))
    };
    let ranked = selection.table.ranked((0..rows.len()).filter(other));
    let rival = ranked.first().copied().unwrap_or(0);
    match selection.ruling.verdict {
        super::verdict::Verdict::NoiseFloor => None,
        _ if model == 0 => {
            Some(of(0, rival, "these conditions show best whether the stated sand or the next best model is right"))
        }
        _ => Some(of(model, rival, "these conditions test best what is written against the next best model")),
    }
}
