//! Predicts steady states of a body under its load: horizontal forces and sinkage.

use super::experiment::{BodyDescription, Experiment};
use super::fit::slope;
use super::forward::{Feature, ForwardModel, SandParameters, Testable, stronger};
use super::intruder_log::{CHANNELS, IntruderLog, SteadyRow};
use super::nuisance::{Nuisance, NuisanceState, Priors};
use super::shared::{SharedNoise, Uncertainty};
use crate::error::{Error, Result};
use crate::parallel;
use crate::progress::Latch;
use crate::sand::SandDescription;
use crate::sand::intruder::{BodyShape, DepthOrLoad, PlatedBody, Status, Trial, compute, without_effect};
use crate::sand::mechanism::{CATALOG, Mechanisms, Side};
use std::collections::BTreeMap;

/// Plates along a body's longest side: our choice. Forces differ by at most 2 % from forces with plates three times as
/// fine, which is a quarter of the scatter of measured forces.
const ALONG: f64 = 16.0;
/// Step of lengths for derivatives with respect to nuisances [m]: our choice. This step and the two below are small,
/// and far above rounding.
const GEOMETRY_STEP: f64 = 5e-4;
/// Step of the friction coefficient.
const FRICTION_STEP: f64 = 0.02;
/// Relative step of the sand's strength.
const STRENGTH_STEP: f64 = 0.02;

/// A body cut into plates: once as described, and once slightly larger.
struct BodyPlates {
    /// μ_s
    friction: f64,
    nominal: PlatedBody,
    larger: PlatedBody,
}

/// Predicts the rows of an intruder log.
pub struct IntruderModel<'a> {
    latch: &'a Latch<'a>,
    experiment: Experiment,
    states: Vec<SteadyRow>,
    cuts: BTreeMap<String, BodyPlates>,
}

/// Error of the law itself, as a share of the load: resistive force theory differs from measured forces by 10 to 15 %
/// (Li, Zhang & Goldman 2013; Agarwal, Goldman & Kamrin 2023), and repetitions scatter by much less. Without this
/// error, the rows with the least scatter would dominate the choice of a cause.
const LAW_ERROR: f64 = 0.1;

/// Deviations of a body from its description.
#[derive(Clone, Copy, Default)]
struct Changed {
    larger: bool,
    /// Added to μ_s.
    friction: f64,
}

impl<'a> IntruderModel<'a> {
    pub fn new(log: &IntruderLog, experiment: &Experiment, latch: &'a Latch<'a>) -> Result<Self> {
        let cut = |(name, description): (&String, &BodyDescription)| {
            let shape = BodyShape::named(&description.body)?;
            let named = |e: Error| Error::invalid(format!("body.{name}"), e.to_string());
            let coarse = PlatedBody::cut(&shape, None).map_err(named)?;
            let longest = 50.0 * coarse.plate_size; // see `PlatedBody::cut`
            let nominal = PlatedBody::cut(&shape, Some(longest / ALONG)).map_err(named)?;
            let larger = nominal.scaled(1.0 + 2.0 * GEOMETRY_STEP / longest);
            Ok((name.clone(), BodyPlates { friction: description.friction, nominal, larger }))
        };
        Ok(Self {
            latch,
            experiment: experiment.clone(),
            states: log.settings.clone(),
            cuts: experiment.file.bodies.iter().map(cut).collect::<Result<_>>()?,
        })
    }

    /// The sand in contact with a body with this μ_s.
    fn sand(&self, friction: f64, (mechanisms, coefficients): &SandParameters) -> SandDescription {
        let friction_clip = 1.0 / friction.max(0.1);
        SandDescription {
            law: self.experiment.law,
            coefficients: *coefficients,
            mechanisms: Mechanisms { friction_clip, ..*mechanisms },
            ..SandDescription::plain(self.medium())
        }
    }

    fn predict_changed(&self, sand: &SandParameters, changed: Changed) -> Vec<f64> {
        let bodies = self.cuts.iter().map(|(name, cut)| {
            let body = if changed.larger { &cut.larger } else { &cut.nominal };
            (name, (body, self.sand(cut.friction + changed.friction, sand)))
        });
        let bodies: BTreeMap<_, _> = bodies.collect();
        let of = |state: &SteadyRow| {
            if self.latch.stopped() {
                return [f64::NAN; 3];
            }
            let (body, sand) = &bodies[&state.body];
            under_load(body, sand, &state.trial)
        };
        self.states.iter().flat_map(of).collect()
    }

    /// Derivative of the prediction with respect to a change of the body.
    fn felt(&self, sand: &SandParameters, changed: Changed, step: f64) -> Vec<f64> {
        slope(&self.predict_changed(sand, changed), &self.predict(sand), step)
    }
}

/// Fx, Fy and depth under the load; if the sand cannot carry the load, the values for the fully covered body.
fn under_load(body: &PlatedBody, sand: &SandDescription, trial: &Trial) -> [f64; 3] {
    let outcome = compute(body, sand, trial);
    let outcome = match outcome.status {
        Status::Ok => outcome,
        Status::NoEquilibrium => {
            let [low, high] = body.heights();
            compute(body, sand, &Trial { given: DepthOrLoad::Depth(high - low), ..*trial })
        }
    };
    [outcome.force[0], outcome.force[1], outcome.depth]
}

/// The reason why steady states in sand with all mechanisms cannot show one of them, if they cannot.
fn lacking(sand: &SandDescription, id: &str) -> Option<String> {
    let said = if without_effect(sand).contains(&id) {
        "it is not defined for a body in steady motion"
    } else if id == "packing_grad" {
        "rows of steady states have no position in the bed"
    } else if id == "friction_clip" {
        "the friction of the body's surface is a nuisance here (surface_friction)"
    } else {
        return None;
    };
    Some(said.into())
}

impl ForwardModel for IntruderModel<'_> {
    fn stopped(&self) -> bool {
        self.latch.stopped()
    }

    fn predict_many(&self, sands: &[SandParameters]) -> Vec<Vec<f64>> {
        parallel::map(sands, |sand| self.predict_changed(sand, Changed::default()))
    }

    /// Beds differ in strength, and readings of a steady state fluctuate in time. The error of the law is a tenth of
    /// the load in each of the two forces, and in the sinkage the change that a tenth of the sand's strength causes.
    /// These errors are independent between conditions and channels. The guesses are our choice, as in force logs.
    fn uncertainty(&self, sand: &SandParameters, prediction: &[f64]) -> Uncertainty {
        let strength = slope(&self.predict(&stronger(sand, STRENGTH_STEP)), prediction, STRENGTH_STEP);
        // f(row, channel) in one channel only
        let only = |channel: usize, f: &dyn Fn(usize) -> f64| -> Vec<f64> {
            (0..prediction.len()).map(|k| if k % 3 == channel { f(k / 3) } else { 0.0 }).collect()
        };
        let load = |row: usize| LAW_ERROR * self.states[row].load();
        let sinkage = |row: usize| LAW_ERROR * strength[3 * row + 2].abs();
        let common = vec![only(0, &load), only(1, &load), only(2, &sinkage)];
        let mut shared = vec![SharedNoise::one("bed_strength", "1", 0.05, true, strength.clone())];
        if self.states.iter().any(|s| s.unsteadiness.iter().any(|sd| *sd > 0.0)) {
            let of = |c: usize| only(c, &|row| self.states[row].unsteadiness[c]);
            let stacks = (0..CHANNELS.len()).map(of).collect();
            shared.push(SharedNoise { name: "unsteadiness", unit: "1", guess: 0.3, optional: true, stacks });
        }
        Uncertainty { shared, common, own: Vec::new() }
    }

    /// Nuisances: zero of the sinkage, size of the body, friction of its surface.
    fn nuisances(&self, sand: &SandParameters, _values: &[NuisanceState]) -> Vec<Nuisance> {
        let zero = (0..3 * self.states.len()).map(|k| if k % 3 == 2 { -1.0 } else { 0.0 }).collect();
        let larger = Changed { larger: true, ..Changed::default() };
        let rougher = Changed { friction: FRICTION_STEP, ..Changed::default() };
        let slopes = [
            ("depth_zero", zero),
            ("geometry", self.felt(sand, larger, GEOMETRY_STEP)),
            ("surface_friction", self.felt(sand, rougher, FRICTION_STEP)),
        ];
        let of = |(id, slope): (&'static str, Vec<f64>)| {
            Nuisance::linear(id, Priors::unit(id), self.experiment.nuisances.sd(id), slope)
        };
        slopes.into_iter().map(of).filter(|n| n.sd > 0.0).collect()
    }

    fn finish(&self, sand: &mut SandDescription) {
        sand.law = self.experiment.law;
        if let [cut] = self.cuts.values().collect::<Vec<_>>()[..] {
            sand.mechanisms.friction_clip = 1.0 / cut.friction;
        }
    }

    fn experiment(&self) -> &Experiment {
        &self.experiment
    }

    fn testable(&self) -> Testable {
        let mechanisms = Mechanisms::from_values([1.0; Mechanisms::COUNT]);
        let all = SandDescription { mechanisms, ..SandDescription::plain(self.medium()) };
        // `sliding_face` is left out: a fit needs a force that is smooth in the strength, but as κ goes to 0 a face that
        // moves along itself loses its force, while with κ = 0 it has all of it.
        let sand = CATALOG.iter().enumerate().filter(|(_, m)| m.side == Side::Sand && m.id != "sliding_face");
        sand.map(|(index, m)| (index, lacking(&all, m.id))).collect()
    }

    fn features(&self) -> Vec<Feature> {
        let per_row = |name, unit, f: &dyn Fn(&SteadyRow) -> f64| Feature {
            name,
            unit,
            values: self.states.iter().map(|s| vec![f(s)]).collect(),
        };
        vec![
            per_row("slip", "1", &|s| self.slip(s)),
            per_row("slip_angle", "rad", &|s| (-s.trial.velocity[1]).atan2(s.trial.velocity[0].abs())),
            per_row("load", "N", &SteadyRow::load),
        ]
    }

    fn group(&self, unit: usize) -> &str {
        &self.states[unit].body
    }
}

impl IntruderModel<'_> {
    /// (rim speed − V)/max(rim speed, V) of the lowest point; 0 if the body does not travel.
    fn slip(&self, state: &SteadyRow) -> f64 {
        let [low, _] = self.cuts[&state.body].nominal.heights();
        let (v, rim) = (state.trial.velocity[0].hypot(state.trial.velocity[1]), -low * state.trial.spin[1]);
        if v > 0.0 { (rim - v) / v.max(rim.abs()) } else { 0.0 }
    }
}
