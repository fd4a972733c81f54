//! The forward model of force logs: predicts the readings of an arm's force sensor, track by track ([`super::arm`]).

use super::acceleration::Accelerations;
use super::arm::{Arm, IntruderSegments, filtered, read};
use super::experiment::{Experiment, Intruder};
use super::fit::slope;
use super::force_log::{ForceLog, planned, possible};
use super::forward::{Feature, ForwardModel, Menu, SandParameters, Testable, stronger, testable};
use super::known::Recent;
use super::motion::moving;
use super::nuisance::Nuisance;
use super::observations::{Channel, Observations};
use super::response::{CoefficientResponse, is_linear};
use super::series::root_mean_square;
use super::shared::{SharedNoise, Uncertainty};
use super::track::{ArmPose, Track, Wrench};
use crate::error::Result;
use crate::number::{Doubles, Real};
use crate::parallel;
use crate::progress::Latch;
use crate::sand::mechanism::Mechanisms;
use crate::sand::mechanism_laws::{SandMechanisms, footprint};
use crate::sand::{Coefficients, Law, Medium, Regularization, SandBed, Term};
use std::collections::BTreeMap;

/// The arm prescribes the motion, so no load makes a segment creep, and the rest speed can be very small.
const PRESCRIBED: Regularization = Regularization { rest_speed: 1e-9, ..Regularization::DEFAULT };

/// Predicts force logs.
#[derive(Clone)]
pub struct ForceLogModel<'a> {
    latch: Option<&'a Latch<'a>>,
    experiment: Experiment,
    tracks: Vec<Track>,
    /// For each track the indices of the samples in motion.
    kept: Vec<Vec<usize>>,
    cuts: BTreeMap<String, IntruderSegments>,
    /// Channels and units of the log; its values are not used.
    layout: Observations,
    /// Track of each unit.
    track_of: Vec<usize>,
    missing: Vec<&'static str>,
    responses: Recent<Mechanisms, CoefficientResponse>,
    measuring: Recent<SandParameters, Measuring>,
}

/// Effects of nuisances on the data, for one state of the sand.
struct Measuring {
    /// Tilt, offsets and filter of the sensor in this state.
    mechanisms: Mechanisms,
    here: Vec<f64>,
    /// Change of the data per unit of delay, depth and tilt.
    late: Vec<f64>,
    deep: Vec<f64>,
    tilt: Vec<f64>,
    /// Loads of each track at the steps of a filter.
    steps: Vec<Vec<[Wrench; 1]>>,
}

/// Step of the depth [m] for derivatives with respect to nuisances: our choice. This step and the three below are at
/// most half of the nuisance's prior standard deviation.
const DEPTH_STEP: f64 = 2e-4;
/// Step of times [s].
const TIME_STEP: f64 = 1e-3;
/// Step of angles [rad].
const TILT_STEP: f64 = 1e-4;
/// Relative step of the sand's strength.
const STRENGTH_STEP: f64 = 0.02;
/// Names of the nuisances that have their own value in each channel of each trial.
const OFFSETS: [(&str, &str); 3] = [("offset_Fx", "drift_Fx"), ("offset_Fz", "drift_Fz"), ("offset_Ty", "drift_Ty")];
/// Number of responses to the coefficients that are kept: our choice. Fits need slopes and predictions at few states at a
/// time, and a response is ten stacks.
const RESPONSES: usize = 8;
/// For at least this number of states with the same mechanisms, the response to the coefficients is computed, because
/// it is cheaper than separate predictions: our choice.
const ANSWERS: usize = 4;

impl<'a> ForceLogModel<'a> {
    pub fn new(log: &ForceLog, experiment: &Experiment) -> Result<Self> {
        let cuts = experiment.file.shapes.iter().map(|(name, shape)| Ok((name.clone(), IntruderSegments::new(shape)?)));
        Ok(Self::along(log, experiment.clone(), cuts.collect::<Result<_>>()?))
    }

    /// A model of the tracks of a log.
    fn along(log: &ForceLog, experiment: Experiment, cuts: BTreeMap<String, IntruderSegments>) -> Self {
        Self {
            latch: None,
            experiment,
            kept: log.settings.iter().map(moving).collect(),
            tracks: log.settings.clone(),
            cuts,
            layout: Observations { values: Vec::new(), ..log.observations.clone() },
            track_of: log.setting_of.clone(),
            missing: log.missing.clone(),
            responses: Recent::up_to(RESPONSES),
            measuring: Recent::up_to(2),
        }
    }

    /// This model with a `latch` that may stop its computations.
    pub fn stopped_by(self, latch: &'a Latch<'a>) -> Self {
        Self { latch: Some(latch), ..self }
    }

    /// A stack of f(time since the trial began, share of the trial's time, channel).
    fn stack(&self, f: impl Fn(f64, f64, usize) -> f64) -> Vec<f64> {
        self.layout.stack(|u, channel, i| {
            let (track, kept) = (&self.tracks[self.track_of[u]], &self.kept[self.track_of[u]]);
            let (first, last) = (track.poses[0].t, track.poses[track.poses.len() - 1].t);
            let t = track.poses[kept[i]].t - first;
            f(t, t / (last - first).max(1e-12), channel)
        })
    }

    /// `stack` with all other channels 0.
    fn only(&self, stack: &[f64], channel: usize) -> Vec<f64> {
        let units = &self.layout.units;
        self.layout.stack(|u, c, i| if c == channel { stack[units[u].block(c).start + i] } else { 0.0 })
    }

    /// Root mean square of one channel of a prediction; at least 1e-6 of its unit, so that no size is 0.
    fn rms(&self, prediction: &[f64], channel: usize) -> f64 {
        let blocks = self.layout.units.iter().flat_map(|u| u.block(channel));
        root_mean_square(blocks.map(|k| prediction[k])).max(1e-6)
    }

    /// The mechanisms without the medium's ζ. Only `slip_bearing` uses ζ; it has no effect on a body that does not travel, and no
    /// body in these logs travels ([`super::arm`]).
    fn sand(&self, m: &Mechanisms) -> SandMechanisms<Doubles> {
        let Medium { bulk_density, terms, .. } = self.medium();
        let mut sand = SandMechanisms::new(m, *bulk_density);
        (0..Doubles::LANES).for_each(|l| sand.set_terms(l, terms, *bulk_density));
        sand.for_prescribed_motion()
    }

    fn ground(&self, coefficients: &Coefficients) -> SandBed<Doubles> {
        SandBed::new(Law::Li2013, &Medium { coefficients: *coefficients, ..self.medium().clone() }, &PRESCRIBED)
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
            accelerations: (m.added_mass != 0.0).then(|| Accelerations::new(&track.poses, 0.0)),
            footprint: footprint(m.footprint, track.pass, track.pass_dx),
            drag: m.inertial_drag * self.medium().bulk_density,
        }
    }

    /// Puts loads, given track by track and pose by pose, into stacks: one stack for each of the N beds.
    fn stacks<const N: usize>(&self, loads: &[Vec<[Wrench; N]>]) -> Vec<Vec<f64>> {
        let at = |bed: usize| {
            self.layout.stack(|u, channel, i| {
                let track = self.track_of[u];
                loads[track][self.kept[track][i]][bed][channel]
            })
        };
        (0..N).map(at).collect()
    }

    fn in_grounds<const N: usize>(&self, m: &Mechanisms, coefficients: [Coefficients; N]) -> Vec<Vec<f64>> {
        let grounds = coefficients.map(|c| self.ground(&c));
        let loads = parallel::map(&self.tracks, |t| self.arm(t, m, &grounds).readings());
        self.stacks(&loads)
    }

    /// Standard deviation of each number of a prediction that results from the accelerations, which samples give only
    /// roughly; empty if no force depends on accelerations.
    fn doubt(&self, (m, c): &SandParameters, prediction: &[f64]) -> Vec<f64> {
        if m.added_mass == 0.0 {
            return Vec::new();
        }
        let grounds = [self.ground(c)];
        let loads = parallel::map(&self.tracks, |t| {
            let accelerations = Some(Accelerations::new(&t.poses, 1.0));
            Arm { accelerations, ..self.arm(t, m, &grounds) }.readings()
        });
        slope(&self.stacks(&loads)[0], prediction, 1.0).into_iter().map(f64::abs).collect()
    }

    /// Effects of nuisances on the data with this sand.
    fn measuring(&self, sand: &SandParameters) -> Measuring {
        let (here, (m, c)) = (self.predict(sand), sand);
        let by = |changed: Mechanisms, step: f64| slope(&self.predict(&(changed, *c)), &here, step);
        let late = by(Mechanisms { delay: m.delay + TIME_STEP, ..*m }, TIME_STEP);
        let deep = by(Mechanisms { depth_zero: m.depth_zero + DEPTH_STEP, ..*m }, DEPTH_STEP);
        let tilt = by(Mechanisms { sensor_tilt: m.sensor_tilt + TILT_STEP, ..*m }, TILT_STEP);
        let grounds = [self.ground(c)];
        let steps = parallel::map(&self.tracks, |t| self.arm(t, m, &grounds).between());
        Measuring { mechanisms: *m, here, late, deep, tilt, steps }
    }
}

impl Measuring {
    /// Change of the data by a filter of time constant `tau`.
    fn filtered(&self, model: &ForceLogModel, tau: f64) -> Vec<f64> {
        let m = &self.mechanisms;
        let through = |(steps, track): (&Vec<[Wrench; 1]>, &Track)| {
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
    /// load cell, which drifts. The guesses are our choice; the repetitions correct them.
    fn uncertainty(&self, sand: &SandParameters, prediction: &[f64]) -> Uncertainty {
        let (m, c) = sand;
        let strength = slope(&self.predict(&stronger(sand, STRENGTH_STEP)), prediction, STRENGTH_STEP);
        let depth = Mechanisms { depth_zero: m.depth_zero + DEPTH_STEP, ..*m };
        let depth = slope(&self.predict(&(depth, *c)), prediction, DEPTH_STEP);
        let mut shared = vec![
            SharedNoise::one("bed_strength", "1", 0.05, false, strength),
            SharedNoise::one("depth_zero", "m", 3e-4, true, depth),
        ];
        for (channel, (offset, drift)) in OFFSETS.into_iter().enumerate().take(self.layout.channels.len()) {
            let (unit, guess) = (self.layout.channels[channel].unit, 0.01 * self.rms(prediction, channel));
            let constant = self.stack(|_, _, own| if own == channel { 1.0 } else { 0.0 });
            let growing = self.stack(|_, done, own| if own == channel { done } else { 0.0 });
            shared.push(SharedNoise::one(offset, unit, guess, true, constant));
            shared.push(SharedNoise::one(drift, unit, guess, true, growing));
        }
        Uncertainty { shared, own: self.doubt(sand, prediction), ..Uncertainty::default() }
    }

    fn nuisances(&self, sand: &SandParameters, values: &[(String, f64)]) -> Vec<Nuisance> {
        if self.stopped() {
            return Vec::new();
        }
        let measuring = self.measuring.of(sand, || self.measuring(sand));
        let Measuring { here, late, deep, tilt, .. } = &*measuring;
        let sd = |kind: &str| self.experiment.nuisances.sd(kind);
        let mut all = Vec::new();
        for (channel, Channel { name, unit, .. }) in self.layout.channels.iter().enumerate() {
            let own = |stack: &[f64]| self.only(stack, channel);
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

    /// For states that differ only in the coefficients, the response to the coefficients is computed once.
    fn predict_many(&self, states: &[SandParameters]) -> Vec<Vec<f64>> {
        let alike = |m: &Mechanisms| states.iter().filter(|s| s.0 == *m).count();
        parallel::map(states, |(m, c)| {
            if self.stopped() {
                return self.layout.stack(|_, _, _| f64::NAN);
            }
            if is_linear(m) && alike(m) >= ANSWERS {
                let predict = |sands| self.in_grounds(m, sands);
                return self.responses.of(m, || CoefficientResponse::new(predict)).at(c);
            }
            let known = self.responses.known(m);
            known.map_or_else(|| self.in_grounds(m, [*c]).swap_remove(0), |response| response.at(c))
        })
    }

    fn with_terms(&self, terms: &[Term]) -> Option<Box<dyn ForwardModel + '_>> {
        let mut model = self.clone();
        model.experiment.medium.terms = terms.to_vec();
        Some(Box::new(model))
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

    fn experiment(&self) -> &Experiment {
        &self.experiment
    }

    fn testable(&self) -> Testable {
        testable(|m| m.intrusion, &self.missing)
    }

    fn features(&self) -> Vec<Feature> {
        let per_pose = |name, unit, f: &dyn Fn(&Track, &ArmPose) -> f64| Feature {
            name,
            unit,
            values: self
                .track_of
                .iter()
                .map(|&t| (&self.tracks[t], &self.kept[t]))
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

    /// Other tracks with the same intruders.
    fn menu(&self) -> Option<Menu<'_>> {
        let log = planned(possible(&self.tracks), self.layout.channels.len());
        let model = Self { latch: self.latch, ..Self::along(&log, self.experiment.clone(), self.cuts.clone()) };
        Some(Menu { model: Box::new(model), observations: log.observations })
    }

    fn group(&self, unit: usize) -> &str {
        &self.tracks[self.track_of[unit]].shape
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Forces along a track in loose poppy seeds with these mechanisms: all Fx, then all Fz, then all torques.
    pub fn forces(mechanisms: Mechanisms, track: &Track) -> Vec<f64> {
        let toml = "kind = \"intrusion\"\nmedium = \"poppy-loose\"\nbulk_density = 640.0\n";
        let mut experiment = Experiment::from_toml(toml).unwrap();
        experiment.file.shapes.insert(track.shape.clone(), track.intruder);
        let model = ForceLogModel::new(&planned(vec![(track.clone(), String::new())], 3), &experiment).unwrap();
        model.predict(&(mechanisms, model.medium().coefficients))
    }
}
