//! The tests that every answer must pass before it is given a name, of whatever kind it is. What fails is said in words.

use super::candidates::SECOND;
use super::differences::NORMAL;
use super::evidence::EvidenceTable;
use super::fit::{COEFFICIENTS, Fit};
use super::form::{FreePower, free_powers};
use super::gauss_newton::at_bound;
use super::laws::{FittedLaw, fitted};
use super::left_out::Contender;
use super::nested::{Nested, simpler};
use super::nuisance::Nuisance;
use super::observations::Unit;
use super::study::FitInputs;
use super::verdict::{Compared, Effect, Role, base};
use super::whiten::Whitener;
use super::words::{after, digits, of};
use crate::number::dot;
use crate::sand::Term;
use crate::sand::mechanism::CATALOG;
use crate::student;

/// No condition and no trial may carry more than this share of the evidence (docs/diagnosis_method.md).
const MOST_SHARE: f64 = 0.5;
/// A law beside a cause may predict better by this many standard errors: our choice. Beyond it the data do not have the cause's
/// form. It is more than the two of other comparisons, because the law is the best of some hundred.
const MOST_BESIDE: f64 = 3.0;

/// Standard deviation of the simulation's own error in a value that was found in a robot's log, as a share of the value. Our choice: values from
/// logs of a hexapod in an independent simulator were off by 1 to 12 %, while slopes give intervals of 1 to 10 %.
const SIMULATED: f64 = 0.06;

/// A coefficient that is farther than this many of its stated standard deviations from its stated value contradicts the statement: our
/// choice.
const FAR: f64 = 3.0;

/// Says so if a fit needs such a coefficient.
pub fn far_coefficient(fit: &Fit) -> Option<String> {
    let furthest = fit.deviations[..COEFFICIENTS].iter().copied().max_by(|a, b| a.abs().total_cmp(&b.abs()))?;
    (furthest.abs() > FAR).then(|| format!("a stress coefficient moved by {furthest:+.1} stated sd"))
}

/// Names each of these effects that a fit needs as large as it may be: then it stands in for something that nobody has found.
pub fn at_their_bounds(own: &Assessment, counts: impl Fn(&Nuisance) -> bool) -> impl Iterator<Item = String> {
    let fitted = own.nuisances.iter().zip(&own.fit.deviations[COEFFICIENTS..]);
    fitted.filter(move |(n, d)| n.sd == n.stated_sd && counts(n) && at_bound(**d)).map(|(n, d)| {
        let of = of(n.of.as_deref());
        format!("{}{of} is at its bound, {:.3}{}", n.id, d * n.sd, after(n.unit))
    })
}

/// Says so if an answer needs one of these effects as large as it may be.
fn needs_a_bound(own: &Assessment, counts: impl Fn(&Nuisance) -> bool) -> Option<String> {
    at_their_bounds(own, counts).next().map(|said| format!("beside it {said}"))
}

/// Says so if the model needs errors of its own as large as they may be. They are errors of a robot's torques, so they say nothing against an
/// answer in its IMU.
pub fn inexact(own: &Assessment) -> Option<String> {
    let imu = |found: &FoundEffect| matches!(found.effect, Effect::Measuring(k) if own.nuisances[k].is_of_the_imu());
    needs_a_bound(own, Nuisance::is_of_the_model).filter(|_| !own.found.iter().all(imu))
}

/// An effect with its strength.
#[derive(Clone, Debug)]
pub struct FoundEffect {
    pub effect: Effect,
    pub value: f64,
    pub ci95: [f64; 2],
    pub at_bound: bool,
    /// How many halves of its interval it is from being absent.
    halves: f64,
    /// Does the interval exclude that the effect is absent?
    pub certain: bool,
}

/// A model, fitted with the noise scaled to its errors, and the strengths that it gives.
pub struct Assessment {
    pub fit: Fit,
    pub nuisances: Vec<Nuisance>,
    pub whitener: Whitener,
    /// Are its coefficients the stated ones?
    pub stated: bool,
    pub found: Vec<FoundEffect>,
    /// Correlations of the strengths, row by row; empty for fewer than two.
    pub correlations: Vec<Vec<f64>>,
    /// Does it have a law that turned out to be impossible in sand?
    pub impossible: bool,
    pub law: Option<FittedLaw>,
    pub powers: Vec<FreePower>,
}

impl Assessment {
    /// A study in which this fit was made.
    pub fn study<'a>(&'a self, study: &FitInputs<'a>) -> FitInputs<'a> {
        let own = study.under(&self.whitener, self.nuisances.clone());
        if self.stated { own.stated() } else { own }
    }
}

/// The inputs of an assessment.
pub struct Assessing<'a> {
    pub study: &'a FitInputs<'a>,
    pub whitener: Whitener,
    pub contender: Contender<'a>,
    pub effects: &'a [Effect],
    pub stated: bool,
    pub law: Option<Term>,
    /// Is the law fitted to what the causes leave?
    pub held: bool,
    /// Intervals of the coordinates, if slopes are not reliable.
    pub profiled: Option<&'a [[f64; 2]]>,
    pub degrees: f64,
}

impl Assessing<'_> {
    pub fn assess(self) -> Assessment {
        let nuisances = self.contender.nuisances.to_vec();
        let own = self.study.under(&self.whitener, nuisances.clone());
        let last = if self.stated { own.stated() } else { own };
        let mut fit = last.fit_from(&[self.contender.fit]).swap_remove(0);
        let law = self.law.as_ref().and_then(|term| fitted(&last, &fit, term.clone(), self.held));
        if let Some(law) = &law {
            fit = law.fit.clone();
        }
        let reach = last.reach(&fit, self.degrees);
        let found = self.effects.iter().map(|effect| self.found(*effect, &fit, &nuisances, &reach)).collect();
        let covariance = last.covariance(&fit);
        let places: Vec<usize> = self.effects.iter().filter_map(|effect| place(*effect, &fit)).collect();
        let of = |i: usize, j: usize| covariance[(i, j)] / (covariance[(i, i)] * covariance[(j, j)]).sqrt();
        let correlations = places.iter().map(|&i| places.iter().map(|&j| of(i, j)).collect());
        let correlations = if places.len() < 2 { Vec::new() } else { correlations.collect() };
        let powers = match self.effects.iter().any(|e| matches!(e, Effect::Mechanism(_))) {
            true => free_powers(self.study, &self.contender, self.degrees),
            false => Vec::new(),
        };
        let (impossible, stated) = (self.law.is_some() && law.is_none(), self.stated);
        drop(last);
        Assessment { fit, nuisances, whitener: self.whitener, stated, found, correlations, impossible, law, powers }
    }

    /// Half of the 95 % interval that the simulation's own errors give a value that was found in a robot's log; other models have no such
    /// errors, or have no effects of measuring.
    fn simulated(&self, value: f64) -> f64 {
        if self.study.is_robots_log() { NORMAL * SIMULATED * value.abs() } else { 0.0 }
    }

    fn found(&self, effect: Effect, fit: &Fit, nuisances: &[Nuisance], reach: &[f64]) -> FoundEffect {
        match effect {
            Effect::Measuring(k) => {
                let (own, d) = (&nuisances[k], fit.deviations[COEFFICIENTS + k]);
                let half = reach[fit.ids.len() + COEFFICIENTS + k];
                let (certain, halves) = (d.abs() > half, d.abs() / half);
                let half = half.hypot(self.simulated(d));
                let ci95 = [own.sd * (d - half), own.sd * (d + half)];
                let at_bound = at_bound(d);
                FoundEffect { effect, value: own.sd * d, ci95, at_bound, halves, certain }
            }
            Effect::Mechanism(id) => {
                let k = fit.ids.iter().position(|own| *own == id).unwrap_or(0);
                let (entry, at) = (&CATALOG[id], fit.coordinates()[k]);
                let profiled = self.profiled.and_then(|p| p.get(k)).filter(|i| i.iter().all(|u| u.is_finite()));
                let range = profiled.copied().unwrap_or([at - reach[k], at + reach[k]]);
                let certain = range[0] > 0.0 || range[1] < 0.0;
                let halves = 2.0 * at.abs() / (range[1] - range[0]);
                let more = self.simulated(at);
                let range = if more == 0.0 {
                    range
                } else {
                    [at - (at - range[0]).hypot(more), at + (range[1] - at).hypot(more)]
                };
                let bounds = entry.coordinate_bounds();
                let [low, high] = [range[0].min(at), range[1].max(at)]
                    .map(|u| entry.value(if u.is_nan() { at } else { u.clamp(bounds[0], bounds[1]) }));
                // For a mechanism whose value is an upper limit, the end of the interval may be infinite; the largest
                // allowed value replaces it.
                let most = if entry.ceiling && low == 0.0 { entry.bounds[1] } else { low };
                let ci95 = if entry.ceiling { [high, most] } else { [low, high] };
                FoundEffect { effect, value: entry.value(at), ci95, at_bound: bounds.contains(&at), halves, certain }
            }
        }
    }
}

/// The place of an effect among a fit's parameters.
fn place(effect: Effect, fit: &Fit) -> Option<usize> {
    match effect {
        Effect::Mechanism(id) => fit.ids.iter().position(|own| *own == id),
        Effect::Measuring(k) => Some(fit.ids.len() + COEFFICIENTS + k),
    }
}

/// The rows with one effect that beat the base.
pub fn singles(entries: &[Compared]) -> impl Iterator<Item = usize> {
    let base = base(entries);
    let one = move |k: &usize| {
        let own = &entries[*k];
        own.role == Role::Causes && own.effects.len() == entries[base].effects.len() + 1 && own.beats[base]
    };
    (0..entries.len()).filter(one)
}

/// The inputs of the tests.
pub struct NameTests<'a> {
    pub study: &'a FitInputs<'a>,
    pub table: &'a EvidenceTable,
    pub entries: &'a [Compared],
    /// The readings that each row predicts.
    pub contenders: &'a [Contender<'a>],
    /// How the row's kind of model predicts if it is chosen anew in each fold.
    pub nested: &'a Nested,
}

impl NameTests<'_> {
    /// The tests that `row` fails, in words.
    pub fn failed(&self, row: usize, own: &Assessment) -> Vec<String> {
        let mut failed = Vec::new();
        if own.impossible {
            failed.push("sand cannot follow this law".into());
        }
        if own.found.iter().any(|found| !found.certain) {
            failed.push("the 95 % interval of its value does not exclude that it is absent".into());
        }
        if own.found.iter().any(|found| found.at_bound && matches!(found.effect, Effect::Measuring(_))) {
            failed.push("it is as large as it may be, so it stands in for something else".into());
        }
        let strongest = own.found.iter().map(|found| found.halves.powi(2)).fold(0.0, f64::max);
        if own.found.iter().any(|found| found.halves.powi(2) < SECOND * strongest) {
            failed.push("it may be a small error in the law of the other, far stronger cause".into());
        }
        if own
            .law
            .as_ref()
            .is_some_and(|law| law.term.coefficient.abs() < student::two_sided_95(self.table.degrees.max(2.0)) * law.sd)
        {
            failed.push("the 95 % interval of its coefficient reaches 0".into());
        }
        // An effect of measuring that passes becomes a part of all models, and then must be certain, too ([`super::select`]). Here its
        // error is compared with that of fitted coefficients.
        let measuring = self.entries[row].effects.iter().all(|e| matches!(e, Effect::Measuring(_)));
        if !(if measuring { self.nested.is_denser() } else { self.nested.is_certain() }) {
            failed.push(self.nested.uncertain());
        }
        for reference in simpler(self.entries, row) {
            if !self.entries[row].beats[reference] {
                failed.push("it does not predict left-out conditions better beyond twice the standard error".into());
            }
            failed.extend(self.carried(row, reference));
        }
        failed.extend(own.powers.iter().filter_map(FreePower::said));
        failed.extend(far_coefficient(&own.fit).map(|said| format!("{said} beside it, so the force law does not fit")));
        // Beside a cause of the sand, small errors of measuring may all be there.
        let alone = measuring && self.entries[row].role == Role::Causes;
        failed.extend(inexact(own).or_else(|| needs_a_bound(own, |n| alone && n.is_answer())));
        failed.extend(self.left_to_a_law(row));
        failed.dedup();
        failed
    }

    /// Whether a law beside the causes of `row`, or beside these and another one, predicts so much better that the data do not have
    /// their form.
    fn left_to_a_law(&self, row: usize) -> Option<String> {
        let own = &self.entries[row];
        if own.role != Role::Causes {
            return None;
        }
        let gains = self
            .entries
            .iter()
            .enumerate()
            .filter(|(_, other)| other.role == Role::Beside && other.contains(own) && other.error < own.error);
        let [more, error] = gains.map(|(k, _)| self.table.difference(k, row)).find(|[m, e]| *m > MOST_BESIDE * e)?;
        Some(format!(
            "with a law beside it left-out conditions are predicted better by {more:.0} ± {error:.0}, so the data do not have its form"
        ))
    }

    /// Whether one condition or one trial carries more than half of the evidence for `row` against `reference`.
    fn carried(&self, row: usize, reference: usize) -> Option<String> {
        let o = self.study.observations;
        let share = |parts: &[f64]| {
            let total: f64 = parts.iter().sum();
            let most = (0..parts.len()).max_by(|a, b| parts[*a].total_cmp(&parts[*b]))?;
            let share = parts[most] / total;
            (total > 0.0 && share > MOST_SHARE).then_some((most, share.min(1.0)))
        };
        if let Some((most, share)) = share(&self.table.shares(row, reference)) {
            let name = &o.conditions[most];
            return Some(format!("condition {name} alone carries {} % of the evidence", digits(100.0 * share)));
        }
        // A law's reading is not that of its fit, and conditions are enough to say who carries it.
        if self.entries[row].role == Role::Law {
            return None;
        }
        let [before, after] = [reference, row].map(|k| self.densities(k));
        let parts: Vec<f64> = after.iter().zip(before).map(|(after, before)| after - before).collect();
        let (most, share) = share(&parts)?;
        Some(format!("trial {} alone carries {} % of the evidence", o.units[most].id, digits(100.0 * share)))
    }

    /// The log density of each trial at the fit of row `k`, as in [`super::evidence`]: Student's t, scaled to the errors of the model
    /// in other conditions. So a trial that no model describes is not the evidence for one of them.
    fn densities(&self, k: usize) -> Vec<f64> {
        let (o, degrees) = (self.study.observations, self.table.degrees);
        let residual: Vec<f64> = o.values.iter().zip(self.contenders[k].reading()).map(|(y, m)| y - m).collect();
        let white = self.study.whitener.apply(&residual);
        let density = |u: &Unit| {
            let (own, scale) = (&white[o.span(u)], self.table.rows[k].scales[u.condition]);
            let n = own.len() as f64;
            -0.5 * (n * scale.ln() + (degrees + n) * (dot(own, own) / (degrees * scale)).ln_1p())
        };
        o.units.iter().map(density).collect()
    }
}
