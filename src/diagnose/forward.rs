//! Forward models: predictions of a data set.
//!
//! All statistics use [`ForwardModel`]; [`ForceLogModel`] predicts force logs, track by track ([`super::arm`]).

use super::arm::{Arm, Cut, filtered, read, stencils};
use super::experiment::{Experiment, Intruder};
use super::fit::slope;
use super::force_log::ForceLog;
use super::motion::moving;
use super::nuisance::{Nuisance, Priors};
use super::observations::Observations;
use super::response::{Response, Responses, is_linear};
use super::shared::Shared;
use super::track::{Pose, Track};
use crate::error::Result;
use crate::number::{Doubles, Real};
use crate::parallel;
use crate::progress::Latch;
use crate::sand::intrusion::Load;
use crate::sand::mechanism::{CATALOG, Mechanisms};
use crate::sand::mechanism_laws::{SandMechanisms, footprint};
use crate::sand::{Coefficients, Law, Medium, Regularization, SandBed, SandDescription, Term};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

/// A feature: a quantity that varies along the data and may be related to a misfit.
#[derive(Clone, Debug, PartialEq)]
pub struct Feature {
    pub name: &'static str,
    pub unit: &'static str,
    /// One value for each sample, unit by unit (not repeated over channels).
    pub values: Vec<Vec<f64>>,
}

/// Trials that could be made next.
pub struct Menu<'a> {
    pub model: Box<dyn ForwardModel + 'a>,
    pub observations: Observations,
    /// A description of each trial.
    pub descriptions: Vec<String>,
}

/// Predicts the stack of [`Observations`] for any mechanisms and coefficients.
pub trait ForwardModel: Sync {
    /// Predicts all numbers, in the order of `Observations::values`.
    fn predict(&self, mechanisms: &Mechanisms, coefficients: &Coefficients) -> Vec<f64>;
    /// Predicts for several states at once.
    fn predict_many(&self, states: &[(Mechanisms, Coefficients)]) -> Vec<Vec<f64>> {
        parallel::map(states, |(m, c)| self.predict(m, c))
    }
    /// Was the work stopped? Predictions after that are NaN.
    fn stopped(&self) -> bool {
        false
    }
    /// Change [σ of all data together] below which a numerical slope is not reliable; None if predictions are
    /// smooth.
    fn roughness(&self) -> Option<f64> {
        None
    }
    /// Step of numerical slopes by a coefficient, in its prior standard deviations.
    fn coefficient_step(&self) -> f64 {
        0.1
    }
    /// Directions of the noise that all numbers of a repetition share, computed at `prediction`, which is that of
    /// `mechanisms` and `coefficients`.
    fn shared(&self, mechanisms: &Mechanisms, coefficients: &Coefficients, prediction: &[f64]) -> Vec<Shared>;
    /// Errors of the model that are the same for all repetitions of a condition, as vectors of one standard deviation
    /// each. Empty if they are negligible.
    fn model_error(&self, _: &Mechanisms, _: &Coefficients, _prediction: &[f64]) -> Vec<Vec<f64>> {
        Vec::new()
    }
    /// Standard deviation of the model's error at each number. These errors are independent between numbers and equal
    /// in all repetitions. Empty if they are not known.
    fn own_error(&self, _: &Mechanisms, _: &Coefficients, _prediction: &[f64]) -> Vec<f64> {
        Vec::new()
    }
    /// Nuisances that all data share, computed at the prediction of `mechanisms` and `coefficients`; `values` are their
    /// present estimates.
    fn nuisances(&self, _: &Mechanisms, _: &Coefficients, _values: &[(String, f64)]) -> Vec<Nuisance> {
        Vec::new()
    }
    /// A prediction of the simulator, without the corrections of [`Self::predict`].
    fn as_simulated(&self, prediction: &[f64]) -> Vec<f64> {
        prediction.to_vec()
    }
    /// The same model with terms in its sand; None if it does not support them.
    fn with_terms(&self, _terms: &[Term]) -> Option<Box<dyn ForwardModel + '_>> {
        None
    }
    /// Greatest normal speed [m/s], greatest depth [m] and least width [m] in the data, for the ranges of terms.
    fn reach(&self) -> [f64; 3] {
        [1.0; 3]
    }
    /// Adds to a simulator's sand the settings that this kind of data is predicted with, besides the medium.
    fn finish(&self, _sand: &mut SandDescription) {}
    /// The medium of the plain model.
    fn medium(&self) -> &Medium;
    /// The mechanisms that this kind of data can test: index in the catalogue, or the reason why not.
    fn testable(&self) -> Vec<(usize, Option<String>)>;
    /// The features of the data.
    fn features(&self) -> Vec<Feature>;
    /// Trials that the same apparatus could make next.
    fn menu(&self) -> Option<Menu<'_>>;
    /// A name in reports for the group of a unit (its shape).
    fn group(&self, unit: usize) -> &str;
}

/// The arm prescribes the motion, so no segment rests in the sand and no creep speed is needed.
const PRESCRIBED: Regularization = Regularization { rest_speed: 1e-9, ..Regularization::DEFAULT };

/// Predicts force logs.
#[derive(Clone)]
pub struct ForceLogModel<'a> {
    latch: Option<&'a Latch<'a>>,
    medium: Medium,
    tracks: Vec<Track>,
    /// For each track the indices of the samples in motion.
    kept: Vec<Vec<usize>>,
    cuts: BTreeMap<String, Cut>,
    /// Track, index in the stack and samples of each unit.
    units: Vec<(usize, usize, usize)>,
    channels: usize,
    missing: Vec<&'static str>,
    priors: Priors,
    responses: Responses,
    measuring: Kept<Measuring>,
}

/// What nuisances change in the data of one state.
struct Measuring {
    mechanisms: Mechanisms,
    coefficients: Coefficients,
    here: Vec<f64>,
    /// Change of the data per unit of delay, depth and tilt.
    late: Vec<f64>,
    deep: Vec<f64>,
    tilt: Vec<f64>,
    /// Loads of each track at the steps of a filter.
    steps: Vec<Vec<[Load; 1]>>,
}

/// The last result. A clone has none, because it may be changed.
struct Kept<T>(Mutex<Option<Arc<T>>>);

impl<T> Default for Kept<T> {
    fn default() -> Self {
        Self(Mutex::new(None))
    }
}

impl<T> Clone for Kept<T> {
    fn clone(&self) -> Self {
        Self::default()
    }
}

/// Step of the depth [m] for derivatives by nuisances: our choice, as for the three steps below a small part of the
/// nuisance's usual size.
const DEPTH_STEP: f64 = 2e-4;
/// Step of times [s].
const TIME_STEP: f64 = 1e-3;
/// Step of angles [rad].
const TILT_STEP: f64 = 1e-4;
/// Relative step of the sand's strength.
const STRENGTH_STEP: f64 = 0.02;
/// Names of the nuisances that each channel of each trial has of its own.
const OFFSETS: [(&str, &str); 3] = [("offset_Fx", "drift_Fx"), ("offset_Fz", "drift_Fz"), ("offset_Ty", "drift_Ty")];
/// Number of states with the same mechanisms from which computing the response to the coefficients is cheaper.
const ANSWERS: usize = 4;
/// Names of the channels.
const CHANNELS: [&str; 3] = ["Fx", "Fz", "Ty"];

impl<'a> ForceLogModel<'a> {
    pub fn new(log: &ForceLog, experiment: &Experiment) -> Result<Self> {
        let cuts = experiment
            .shapes
            .iter()
            .map(|(name, shape)| Ok((name.clone(), Cut::new(shape)?)))
            .collect::<Result<_>>()?;
        let units = log.observations.units.iter().zip(&log.track_of).map(|(u, &t)| (t, u.start, u.samples)).collect();
        Ok(Self {
            latch: None,
            medium: experiment.medium.clone(),
            tracks: log.tracks.clone(),
            kept: log.tracks.iter().map(moving).collect(),
            cuts,
            units,
            channels: log.observations.channels.len(),
            missing: log.missing.clone(),
            priors: experiment.nuisances.clone(),
            responses: Responses::default(),
            measuring: Kept::default(),
        })
    }

    /// This model with a `latch` that may stop its computations.
    pub fn stopped_by(self, latch: &'a Latch<'a>) -> Self {
        Self { latch: Some(latch), ..self }
    }

    /// Loads along one track in a described sand.
    pub fn one(sand: &SandDescription, track: Track) -> Result<Vec<Load>> {
        let model = Self {
            latch: None,
            medium: sand.medium(),
            cuts: BTreeMap::from([(track.shape.clone(), Cut::new(&track.intruder)?)]),
            tracks: Vec::new(),
            kept: Vec::new(),
            units: Vec::new(),
            channels: 3,
            missing: Vec::new(),
            priors: Priors::default(),
            responses: Responses::default(),
            measuring: Kept::default(),
        };
        let ground = model.ground(&model.medium.coefficients);
        Ok(model.arm(&track, &sand.mechanisms, &[ground]).readings().into_iter().map(|[load]| load).collect())
    }

    /// A model of other tracks with the same intruders, for planned experiments.
    pub fn for_tracks(&self, tracks: Vec<Track>) -> (Self, Observations) {
        let log = super::force_log::planned(tracks, self.channels);
        let units = log.observations.units.iter().zip(&log.track_of).map(|(u, &t)| (t, u.start, u.samples)).collect();
        let model = Self {
            latch: self.latch,
            medium: self.medium.clone(),
            kept: log.tracks.iter().map(moving).collect(),
            tracks: log.tracks,
            cuts: self.cuts.clone(),
            units,
            channels: self.channels,
            missing: self.missing.clone(),
            priors: self.priors.clone(),
            responses: Responses::default(),
            measuring: Kept::default(),
        };
        (model, log.observations)
    }

    pub fn tracks(&self) -> &[Track] {
        &self.tracks
    }

    /// A stack of f(time since the trial began, share of the trial's time, channel).
    fn stack(&self, f: impl Fn(f64, f64, usize) -> f64) -> Vec<f64> {
        let mut stack = vec![0.0; self.units.iter().map(|u| u.2 * self.channels).sum()];
        for &(track, start, samples) in &self.units {
            let poses = &self.tracks[track].poses;
            let (first, last) = (poses[0].t, poses[poses.len() - 1].t);
            for (i, &pose) in self.kept[track].iter().enumerate() {
                let t = poses[pose].t - first;
                let share = t / (last - first).max(1e-12);
                (0..self.channels).for_each(|c| stack[start + c * samples + i] = f(t, share, c));
            }
        }
        stack
    }

    /// `stack` with all other channels 0.
    fn only(&self, stack: &[f64], channel: usize) -> Vec<f64> {
        let mut own = vec![0.0; stack.len()];
        for &(_, start, samples) in &self.units {
            let block = start + channel * samples..start + (channel + 1) * samples;
            own[block.clone()].copy_from_slice(&stack[block]);
        }
        own
    }

    /// Root mean square of one channel of a prediction; at least 1e-6 of its unit.
    fn rms(&self, prediction: &[f64], channel: usize) -> f64 {
        let blocks =
            self.units.iter().map(|&(_, start, samples)| start + channel * samples..start + (channel + 1) * samples);
        let (square, count) =
            blocks.flatten().fold((0.0, 0.0), |(s, n), k| (s + prediction[k] * prediction[k], n + 1.0));
        (square / f64::max(count, 1.0)).sqrt().max(1e-6)
    }

    /// Without the medium's ζ: only `slip_bearing` uses it, which has no effect on a body that does not travel, and in
    /// these logs none does ([`super::arm`]).
    fn sand(&self, m: &Mechanisms) -> SandMechanisms<Doubles> {
        let mut sand = SandMechanisms::new(m, self.medium.bulk_density);
        (0..Doubles::LANES).for_each(|l| sand.set_terms(l, &self.medium.terms, self.medium.bulk_density));
        sand
    }

    fn ground(&self, coefficients: &Coefficients) -> SandBed<Doubles> {
        SandBed::new(Law::Li2013, &Medium { coefficients: *coefficients, ..self.medium.clone() }, &PRESCRIBED)
    }

    fn arm<'b, const N: usize>(
        &'b self,
        track: &'b Track,
        m: &'b Mechanisms,
        grounds: &'b [SandBed<Doubles>; N],
    ) -> Arm<'b, N> {
        Arm {
            track,
            cut: &self.cuts[&track.shape],
            mechanisms: m,
            sand: self.sand(m),
            grounds,
            stencils: if m.added_mass == 0.0 { Vec::new() } else { stencils(track) },
            footprint: footprint(m.footprint, track.pass, track.pass_dx),
            drag: m.inertial_drag * self.medium.bulk_density,
        }
    }

    /// Puts loads, given track by track and pose by pose, into stacks: one stack for each of the N beds.
    fn stacks<const N: usize>(&self, loads: &[Vec<[Load; N]>]) -> Vec<Vec<f64>> {
        let mut stacks = vec![vec![0.0; self.numbers()]; N];
        for &(track, start, samples) in &self.units {
            for (i, of_pose) in self.kept[track].iter().map(|&pose| &loads[track][pose]).enumerate() {
                for (stack, load) in stacks.iter_mut().zip(of_pose) {
                    for (channel, value) in [load.fx, load.fz, load.ty].into_iter().take(self.channels).enumerate() {
                        stack[start + channel * samples + i] = value;
                    }
                }
            }
        }
        stacks
    }

    /// Length of a stack.
    fn numbers(&self) -> usize {
        self.units.iter().map(|u| u.2 * self.channels).sum()
    }

    fn in_grounds<const N: usize>(&self, m: &Mechanisms, coefficients: [Coefficients; N]) -> Vec<Vec<f64>> {
        let grounds = coefficients.map(|c| self.ground(&c));
        let loads = parallel::map(&self.tracks, |t| self.arm(t, m, &grounds).readings());
        self.stacks(&loads)
    }

    /// The response to the coefficients under `m`, computed once.
    fn response(&self, m: &Mechanisms) -> Arc<Response> {
        self.responses.of(m, || Response::new(|states| self.in_grounds(m, states)))
    }

    /// What nuisances change in the data of this state. The last result is kept.
    fn measuring(&self, m: &Mechanisms, c: &Coefficients) -> Arc<Measuring> {
        let mut kept = self.measuring.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = kept.as_ref().filter(|k| k.mechanisms == *m && k.coefficients == *c) {
            return known.clone();
        }
        let here = self.predict(m, c);
        let by = |changed: Mechanisms, step: f64| slope(&self.predict(&changed, c), &here, step);
        let late = by(Mechanisms { delay: m.delay + TIME_STEP, ..*m }, TIME_STEP);
        let deep = by(Mechanisms { depth_zero: m.depth_zero + DEPTH_STEP, ..*m }, DEPTH_STEP);
        let tilt = by(Mechanisms { sensor_tilt: m.sensor_tilt + TILT_STEP, ..*m }, TILT_STEP);
        let grounds = [self.ground(c)];
        let steps = parallel::map(&self.tracks, |t| self.arm(t, m, &grounds).between());
        let made = Arc::new(Measuring { mechanisms: *m, coefficients: *c, here, late, deep, tilt, steps });
        *kept = Some(made.clone());
        made
    }
}

impl Measuring {
    /// Change of the data by a filter of time constant `tau`.
    fn filtered(&self, model: &ForceLogModel, tau: f64) -> Vec<f64> {
        let m = &self.mechanisms;
        let through = |(steps, track): (&Vec<[Load; 1]>, &Track)| {
            let mut loads = filtered(&track.poses, steps, m.lowpass + tau);
            read(m, &mut loads);
            loads
        };
        let loads: Vec<_> = self.steps.iter().zip(&model.tracks).map(through).collect();
        slope(&model.stacks(&loads)[0], &self.here, 1.0)
    }
}

impl ForwardModel for ForceLogModel<'_> {
    fn stopped(&self) -> bool {
        self.latch.is_some_and(Latch::stopped)
    }

    /// Each trial has its own bed strength, its own zero of the surface, and its own zero of each channel of the
    /// load cell, which drifts.
    fn shared(&self, m: &Mechanisms, c: &Coefficients, prediction: &[f64]) -> Vec<Shared> {
        let rms = |channel: usize| self.rms(prediction, channel);
        let one = |name, unit, guess, stack| {
            let optional = name != "bed_strength";
            Shared { name, unit, guess, optional, stacks: vec![stack] }
        };
        let strength = Mechanisms { scale: (1.0 + m.scale) * (1.0 + STRENGTH_STEP) - 1.0, ..*m };
        let strength = slope(&self.predict(&strength, c), prediction, STRENGTH_STEP);
        let depth = Mechanisms { depth_zero: m.depth_zero + DEPTH_STEP, ..*m };
        let depth = slope(&self.predict(&depth, c), prediction, DEPTH_STEP);
        let mut all = vec![one("bed_strength", "1", 0.05, strength), one("depth_zero", "m", 3e-4, depth)];
        let constant = |channel: usize| self.stack(|_, _, own| if own == channel { 1.0 } else { 0.0 });
        let growing = |channel: usize| self.stack(|_, done, own| if own == channel { done } else { 0.0 });
        for (channel, (offset, drift)) in OFFSETS.into_iter().enumerate().take(self.channels) {
            let unit = if channel == 2 { "N·m" } else { "N" };
            all.push(one(offset, unit, 0.01 * rms(channel), constant(channel)));
            all.push(one(drift, unit, 0.01 * rms(channel), growing(channel)));
        }
        all
    }

    fn nuisances(&self, m: &Mechanisms, c: &Coefficients, values: &[(String, f64)]) -> Vec<Nuisance> {
        if self.stopped() {
            return Vec::new();
        }
        let measuring = self.measuring(m, c);
        let Measuring { here, late, deep, tilt, .. } = &*measuring;
        let sd = |kind: &str| self.priors.sd(kind);
        let mut all = Vec::new();
        for (channel, name) in CHANNELS.into_iter().enumerate().take(self.channels) {
            let own = |stack: &[f64]| self.only(stack, channel);
            let unit = if channel == 2 { "N·m" } else { "N" };
            let zero = sd("offset") * self.rms(here, channel);
            all.push(Nuisance::linear(format!("offset_{name}"), unit, zero, own(&vec![1.0; here.len()])));
            all.push(Nuisance::linear(format!("gain_{name}"), "1", sd("gain"), own(here)));
            let id = format!("lowpass_{name}");
            // A filter's time constant cannot be negative.
            let tau = values.iter().find(|v| v.0 == id).map_or(0.0, |v| v.1.max(0.0));
            let filtered = |tau: f64| own(&measuring.filtered(self, tau));
            let (at, beyond) =
                (if tau > 0.0 { filtered(tau) } else { vec![0.0; here.len()] }, filtered(tau + TIME_STEP));
            let rate = slope(&beyond, &at, TIME_STEP);
            let bend = slope(&at, &rate.iter().map(|r| r * tau).collect::<Vec<_>>(), 1.0);
            all.push(Nuisance::linear(id, "s", sd("lowpass"), rate).bent(bend));
        }
        let time = self.stack(|t, _, _| t);
        let skewed = late.iter().zip(time).map(|(l, t)| l * t).collect();
        all.push(Nuisance::linear("clock".into(), "1", sd("clock"), skewed));
        all.push(Nuisance::linear("delay".into(), "s", sd("delay"), late.clone()));
        all.push(Nuisance::linear("depth_zero".into(), "m", sd("depth_zero"), deep.clone()));
        all.push(Nuisance::linear("tilt".into(), "rad", sd("tilt"), tilt.clone()));
        all.retain(|n| n.sd > 0.0);
        all
    }

    fn predict(&self, mechanisms: &Mechanisms, coefficients: &Coefficients) -> Vec<f64> {
        if self.stopped() {
            return vec![f64::NAN; self.numbers()];
        }
        match self.responses.known(mechanisms) {
            Some(response) => response.at(coefficients),
            None => self.in_grounds(mechanisms, [*coefficients]).swap_remove(0),
        }
    }

    /// If several states differ in the coefficients alone, the response to these is computed once.
    fn predict_many(&self, states: &[(Mechanisms, Coefficients)]) -> Vec<Vec<f64>> {
        let alike = |m: &Mechanisms| states.iter().filter(|s| s.0 == *m).count();
        parallel::map(states, |(m, c)| {
            if !self.stopped() && is_linear(m) && alike(m) >= ANSWERS {
                return self.response(m).at(c);
            }
            self.predict(m, c)
        })
    }

    fn with_terms(&self, terms: &[Term]) -> Option<Box<dyn ForwardModel + '_>> {
        let medium = Medium { terms: terms.to_vec(), ..self.medium.clone() };
        Some(Box::new(Self { medium, ..self.clone() }))
    }

    fn reach(&self) -> [f64; 3] {
        let features = self.features();
        let most = |name: &str| {
            let all = features.iter().filter(|f| f.name == name).flat_map(|f| f.values.iter().flatten());
            all.copied().fold(1e-3, f64::max)
        };
        let width = |t: &Track| match t.intruder {
            Intruder::Leg { width, .. } | Intruder::Plate { width, .. } => width,
        };
        [most("speed"), most("depth"), self.tracks.iter().map(width).fold(f64::MAX, f64::min)]
    }

    fn medium(&self) -> &Medium {
        &self.medium
    }

    fn testable(&self) -> Vec<(usize, Option<String>)> {
        let asked = CATALOG.iter().enumerate().filter(|(_, m)| m.intrusion);
        asked
            .map(|(index, m)| {
                let lacking: Vec<_> = m.columns.iter().filter(|c| self.missing.contains(c)).copied().collect();
                (index, (!lacking.is_empty()).then(|| format!("the data have no column {}", lacking.join(", "))))
            })
            .collect()
    }

    fn features(&self) -> Vec<Feature> {
        let per_pose = |name, unit, f: &dyn Fn(&Track, &Pose) -> f64| Feature {
            name,
            unit,
            values: self
                .units
                .iter()
                .map(|u| (&self.tracks[u.0], &self.kept[u.0]))
                .map(|(t, kept)| kept.iter().map(|&i| f(t, &t.poses[i])).collect())
                .collect(),
        };
        vec![
            per_pose("speed", "m/s", &|t, p| match t.intruder {
                Intruder::Leg { chord, .. } => p.omega.abs() * chord,
                Intruder::Plate { .. } => p.velocity[0].hypot(p.velocity[1]),
            }),
            per_pose("depth", "m", &|t, p| {
                let z = match t.intruder {
                    Intruder::Leg { chord, .. } => t.hip_height - chord * p.theta.cos(),
                    Intruder::Plate { .. } => p.center[1],
                };
                (-z).max(0.0)
            }),
            per_pose("angle", "rad", &|t, p| match t.intruder {
                Intruder::Leg { .. } => p.theta,
                Intruder::Plate { .. } => t.beta,
            }),
            per_pose("pass", "1", &|t, _| f64::from(t.pass)),
            per_pose("place", "m", &|t, p| t.x_bed + p.center[0]),
        ]
    }

    fn menu(&self) -> Option<Menu<'_>> {
        let (tracks, descriptions): (Vec<_>, Vec<_>) = super::force_log::possible(&self.tracks).into_iter().unzip();
        let (model, observations) = self.for_tracks(tracks);
        (!descriptions.is_empty()).then(|| Menu { model: Box::new(model), observations, descriptions })
    }

    fn group(&self, unit: usize) -> &str {
        &self.tracks[self.units[unit].0].shape
    }
}
