//! The forward model of force logs: predicts the readings of an arm's force sensor, track by track ([`super::arm`]).

use super::acceleration::Accelerations;
use super::arm::{Arm, IntruderSegments};
use super::experiment::{Experiment, Intruder};
use super::fit::slope;
use super::force_log::{ForceLog, planned, possible};
use super::form::vary;
use super::forward::{Division, Feature, ForwardModel, Menu, SandParameters, Testable, stronger, testable};
use super::known::Recent;
use super::measuring::Measuring;
use super::nuisance::{Nuisance, NuisanceState};
use super::observations::Observations;
use super::response::{CoefficientResponse, is_linear};
use super::select::OF_SIZE;
use super::series::root_mean_square;
use super::shared::{SharedNoise, Uncertainty};
use super::track::{ArmPose, Track, Wrench};
use crate::error::Result;
use crate::number::{Doubles, Real};
use crate::parallel;
use crate::progress::Latch;
use crate::sand::mechanism::{CATALOG, Mechanisms};
use crate::sand::mechanism_laws::{SandMechanisms, footprint, of_size};
use crate::sand::{Coefficients, Law, Medium, Regularization, SandBed, Term};
use std::collections::BTreeMap;

/// The arm prescribes the motion, so no load makes a segment creep, and the rest speed can be very small.
const PRESCRIBED: Regularization = Regularization { rest_speed: 1e-9, ..Regularization::DEFAULT };

/// Predicts force logs.
#[derive(Clone)]
pub struct ForceLogModel<'a> {
    latch: Option<&'a Latch<'a>>,
    pub(super) experiment: Experiment,
    pub(super) tracks: Vec<Track>,
    pub(super) cuts: BTreeMap<String, IntruderSegments>,
    /// Channels and units of the log; its values are not used.
    pub(super) layout: Observations,
    /// Track of each unit.
    pub(super) track_of: Vec<usize>,
    missing: Vec<&'static str>,
    responses: Recent<Mechanisms, CoefficientResponse>,
    pub(super) measuring: Recent<SandParameters, Measuring>,
}

/// Step of the depth [m] for the derivative by the height of the surface: our choice, far below the nuisance's prior standard deviation.
const DEPTH_STEP: f64 = 2e-4;
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

    /// The same apparatus on other tracks.
    pub(super) fn with_tracks(&self, tracks: Vec<Track>) -> Self {
        Self { tracks, ..self.clone() }
    }

    /// The same with intruders of other sizes.
    pub(super) fn with_cuts(&self, cuts: BTreeMap<String, IntruderSegments>) -> Self {
        Self { cuts, ..self.clone() }
    }

    /// A stack of f(time since the trial began, share of the trial's time, channel).
    pub(super) fn stack(&self, f: impl Fn(f64, f64, usize) -> f64) -> Vec<f64> {
        self.layout.stack(|u, channel, i| {
            let track = &self.tracks[self.track_of[u]];
            let (first, last) = (track.poses[0].t, track.poses[track.poses.len() - 1].t);
            let t = track.poses[track.compared[i]].t - first;
            f(t, t / (last - first).max(1e-12), channel)
        })
    }

    /// `stack` with all other channels 0.
    pub(super) fn only(&self, stack: &[f64], channel: usize) -> Vec<f64> {
        let units = &self.layout.units;
        self.layout.stack(|u, c, i| if c == channel { stack[units[u].block(c).start + i] } else { 0.0 })
    }

    /// Root mean square of one channel of a prediction; at least 1e-6 of its unit, so that no size is 0.
    pub(super) fn rms(&self, prediction: &[f64], channel: usize) -> f64 {
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

    pub(super) fn ground(&self, coefficients: &Coefficients) -> SandBed<Doubles> {
        SandBed::new(Law::Li2013, &Medium { coefficients: *coefficients, ..self.medium().clone() }, &PRESCRIBED)
    }

    pub(super) fn arm<'b, const N: usize>(
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
            factor: footprint(m.footprint, track.pass, track.pass_dx) * of_size(m.size_power, track.intruder.sides()),
            drag: m.inertial_drag * self.medium().bulk_density,
        }
    }

    /// Puts loads, given track by track and pose by pose, into stacks: one stack for each of the N beds.
    pub(super) fn stacks<const N: usize>(&self, loads: &[Vec<[Wrench; N]>]) -> Vec<Vec<f64>> {
        let at = |bed: usize| {
            self.layout.stack(|u, channel, i| {
                let track = self.track_of[u];
                loads[track][self.tracks[track].compared[i]][bed][channel]
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
}

impl ForwardModel for ForceLogModel<'_> {
    fn stopped(&self) -> bool {
        self.latch.is_some_and(Latch::stopped)
    }

    fn is_linear(&self, mechanisms: &Mechanisms) -> bool {
        is_linear(mechanisms)
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

    fn nuisances(&self, sand: &SandParameters, values: &[NuisanceState]) -> Vec<Nuisance> {
        if self.stopped() { Vec::new() } else { self.effects_of_measuring(sand, values) }
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
        let width = |t: &Track| t.intruder.sides()[1];
        [most("speed"), most("depth"), self.tracks.iter().map(width).fold(f64::MAX, f64::min)]
    }

    fn experiment(&self) -> &Experiment {
        &self.experiment
    }

    fn testable(&self) -> Testable {
        let mut all = testable(|m| m.intrusion, &self.missing);
        // With one size it is a part of the sand's strength.
        let of_size = all.iter_mut().filter(|t| CATALOG[t.0].id == OF_SIZE && !vary(&self.sizes()));
        of_size.for_each(|t| {
            t.1 = Some("the sizes of the intruders of each type hardly vary (by less than a factor of 1.2, rms)".into())
        });
        all
    }

    fn features(&self) -> Vec<Feature> {
        let per_pose = |name, unit, f: &dyn Fn(&Track, &ArmPose) -> f64| Feature {
            name,
            unit,
            values: self
                .track_of
                .iter()
                .map(|&t| &self.tracks[t])
                .map(|t| t.compared.iter().map(|&i| f(t, &t.poses[i])).collect())
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

    fn sizes(&self) -> Vec<f64> {
        let size = |t: &Track| {
            let [length, width] = t.intruder.sides();
            (length * width).sqrt()
        };
        // A plate and a leg differ in more than their size, so each is compared with others of its type.
        let plate = |t: &Track| matches!(t.intruder, Intruder::Plate { .. });
        let mean = |plates: bool| {
            let own: Vec<f64> = self.tracks.iter().filter(|t| plate(t) == plates).map(|t| size(t).ln()).collect();
            (own.iter().sum::<f64>() / own.len().max(1) as f64).exp()
        };
        let means = [false, true].map(mean);
        let of = |t: &Track| size(t) / means[usize::from(plate(t))];
        self.track_of.iter().map(|&t| of(&self.tracks[t])).collect()
    }

    fn divisions(&self) -> Vec<Division> {
        let of = |by, names: [&str; 2], f: &dyn Fn(&Track, &ArmPose) -> f64| Division {
            by,
            names: names.map(Into::into),
            parts: (self.track_of.iter())
                .map(|&t| {
                    let track = &self.tracks[t];
                    let usual = track.poses.iter().map(|p| f(track, p).abs()).fold(0.0, f64::max);
                    // A speed below a tenth of the greatest is neither: our choice.
                    let part = |&i: &usize| Some(f(track, &track.poses[i])).filter(|v| v.abs() > 0.1 * usual);
                    track.compared.iter().map(|i| part(i).map(|v| v > 0.0)).collect()
                })
                .collect(),
        };
        let rise = |t: &Track, p: &ArmPose| match t.intruder {
            Intruder::Leg { chord, .. } => chord * p.omega * p.theta.sin(),
            Intruder::Plate { .. } => p.velocity[1],
        };
        let forward = |t: &Track, p: &ArmPose| match t.intruder {
            Intruder::Leg { chord, .. } => chord * p.omega * p.theta.cos(),
            Intruder::Plate { .. } => p.velocity[0],
        };
        vec![
            of("direction", ["going in", "coming out"], &rise),
            of("side", ["moving to the left", "moving to the right"], &forward),
        ]
    }

    /// Other tracks with the same intruders, none of which is in the data.
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
