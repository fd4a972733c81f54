//! Effects of measuring that all trials of a force log share: sensor, clocks, mounting and stated geometry.
//!
//! Each is a column: the change of the data by one unit, at the present estimate if the effect is far from linear there.

use super::arm::{IntruderSegments, filtered, read};
use super::experiment::Intruder;
use super::fit::slope;
use super::force_model::ForceLogModel;
use super::forward::{ForwardModel, SandParameters};
use super::measuring::Measuring;
use super::nuisance::{Nuisance, NuisanceState, Priors, estimate};
use super::track::{Track, Wrench};
use crate::parallel;
use crate::sand::mechanism::Mechanisms;
use std::collections::BTreeSet;
use std::sync::Mutex;

/// Steps for derivatives: our choices, far below the prior standard deviations.
const DEPTH_STEP: f64 = 2e-4;
const TIME_STEP: f64 = 1e-3;
const TILT_STEP: f64 = 1e-4;
const ANGLE_STEP: f64 = 2e-3;
const SIZE_STEP: f64 = 2e-3;
/// An estimate below this many prior standard deviations counts as 0 for the derivative: our choice; up to there the effects
/// are nearly linear. That of the surface's height is less so: where a leg enters the sand, its force grows with the square of the depth.
const LINEAR: f64 = 1.5;
const LINEAR_DEPTH: f64 = 0.25;

/// A state of the sand, the effects of measuring in it, and their present estimates.
struct Present<'a> {
    sand: &'a SandParameters,
    m: &'a Measuring,
    values: &'a [NuisanceState],
}

/// A change of the apparatus.
#[derive(Clone, Copy)]
enum RigChange {
    Delay,
    Depth,
    Tilt,
    Plates,
    Legs,
    Size,
}

impl RigChange {
    fn step(self) -> f64 {
        match self {
            Self::Delay => TIME_STEP,
            Self::Depth => DEPTH_STEP,
            Self::Tilt => TILT_STEP,
            Self::Plates | Self::Legs => ANGLE_STEP,
            Self::Size => SIZE_STEP,
        }
    }

    /// Up to how many prior standard deviations its effect is nearly linear.
    fn linear(self) -> f64 {
        if matches!(self, Self::Depth) { LINEAR_DEPTH } else { LINEAR }
    }
}

impl ForceLogModel<'_> {
    /// The prediction with a changed apparatus.
    fn changed(&self, (m, c): &SandParameters, change: RigChange, by: f64) -> Vec<f64> {
        let with = |m: Mechanisms| self.predict(&(m, *c));
        match change {
            RigChange::Delay => with(Mechanisms { delay: m.delay + by, ..*m }),
            RigChange::Depth => with(Mechanisms { depth_zero: m.depth_zero + by, ..*m }),
            RigChange::Tilt => with(Mechanisms { sensor_tilt: m.sensor_tilt + by, ..*m }),
            RigChange::Plates | RigChange::Legs => {
                let turned = |track: &Track| {
                    let mut track = track.clone();
                    match (track.intruder, change) {
                        (Intruder::Plate { .. }, RigChange::Plates) => track.beta += by,
                        (Intruder::Leg { .. }, RigChange::Legs) => track.poses.iter_mut().for_each(|p| p.theta += by),
                        _ => (),
                    }
                    track
                };
                let tracks = self.tracks.iter().map(turned).collect();
                self.with_tracks(tracks).predict(&(*m, *c))
            }
            RigChange::Size => {
                let larger = |intruder: Intruder| match intruder {
                    Intruder::Leg { chord, width, xi_deg, thickness } => {
                        Intruder::Leg { chord: chord * (1.0 + by), width: width * (1.0 + by), xi_deg, thickness }
                    }
                    Intruder::Plate { length, width, thickness } => {
                        Intruder::Plate { length: length * (1.0 + by), width: width * (1.0 + by), thickness }
                    }
                };
                let shapes = self.experiment.file.shapes.iter();
                let cut = |(name, shape): (&String, &Intruder)| {
                    IntruderSegments::new(&larger(*shape)).ok().map(|cut| (name.clone(), cut))
                };
                let mut cuts = self.cuts.clone();
                cuts.extend(shapes.filter_map(cut));
                self.with_cuts(cuts).predict(&(*m, *c))
            }
        }
    }

    fn measuring(&self, sand: &SandParameters) -> Measuring {
        let here = self.predict(sand);
        let by = |change: RigChange| slope(&self.changed(sand, change, change.step()), &here, change.step());
        let all =
            [RigChange::Delay, RigChange::Depth, RigChange::Tilt, RigChange::Plates, RigChange::Legs, RigChange::Size];
        let [late, deep, tilted, plates, legs, larger] = all.map(by);
        let grounds = [self.ground(&sand.1)];
        let steps = parallel::map(&self.tracks, |t| self.arm(t, &sand.0, &grounds).between());
        let near = Mutex::default();
        Measuring { mechanisms: sand.0, here, late, deep, tilted, plates, legs, larger, steps, near }
    }

    /// `stack` in the trials of one shape, 0 in all others.
    fn only_shape(&self, stack: &[f64], shape: &str) -> Vec<f64> {
        let units = &self.layout.units;
        let own = |u: usize| self.tracks[self.track_of[u]].shape == shape;
        self.layout.stack(|u, c, i| if own(u) { stack[units[u].block(c).start + i] } else { 0.0 })
    }

    /// The names of all shapes in the data of one type.
    fn shapes(&self, plates: bool) -> Vec<&str> {
        let own = self.tracks.iter().filter(|t| matches!(t.intruder, Intruder::Plate { .. }) == plates);
        own.map(|t| t.shape.as_str()).collect::<BTreeSet<_>>().into_iter().collect()
    }

    /// See [`ForwardModel::nuisances`].
    pub(super) fn effects_of_measuring(&self, sand: &SandParameters, values: &[NuisanceState]) -> Vec<Nuisance> {
        let measuring = self.measuring.of(sand, || self.measuring(sand));
        let m = &*measuring;
        let present = Present { sand, m, values };
        let mut all = self.of_channels(&present);
        all.push(self.linear(m, ("clock", None), || {
            let time = self.stack(|t, _, _| t);
            m.late.iter().zip(time).map(|(l, t)| l * t).collect()
        }));
        // From 0 in the first trial to the value in the last one.
        all.push(self.linear(m, ("gain_drift", None), || {
            let last = self.layout.units.len().max(2) - 1;
            let at =
                |u: usize, c: usize, i: usize| m.here[self.layout.units[u].block(c).start + i] * u as f64 / last as f64;
            self.layout.stack(at)
        }));
        let whole = |stack: &[f64]| stack.to_vec();
        for (id, change) in [("delay", RigChange::Delay), ("depth_zero", RigChange::Depth), ("tilt", RigChange::Tilt)] {
            all.push(self.far(&present, (id, None), change, &whole));
        }
        // A mount tilts all plates alike, and each plate is mounted a little differently. The zero of the motor turns all legs.
        for (common, plates, change) in [("attitude", true, RigChange::Plates), ("joint_zero", false, RigChange::Legs)]
        {
            let shapes = self.shapes(plates);
            if !shapes.is_empty() {
                all.push(self.far(&present, (common, None), change, &whole));
            }
            for shape in shapes.iter().filter(|_| shapes.len() > 1) {
                let own = |stack: &[f64]| self.only_shape(stack, shape);
                all.push(self.far(&present, ("attitude", Some(shape)), change, &own));
            }
        }
        for shape in [self.shapes(true), self.shapes(false)].concat() {
            let own = |stack: &[f64]| self.only_shape(stack, shape);
            all.push(self.far(&present, ("size", Some(shape)), RigChange::Size, &own));
        }
        all.retain(|n| n.sd > 0.0);
        all
    }

    /// A nuisance with a linear effect; `slope` gives the change of the data by one unit.
    fn linear(
        &self,
        m: &Measuring,
        (id, of): (&'static str, Option<&str>),
        slope: impl FnOnce() -> Vec<f64>,
    ) -> Nuisance {
        m.near(id, of, || self.at_prior(id, slope()))
    }

    fn at_prior(&self, id: &'static str, slope: Vec<f64>) -> Nuisance {
        Nuisance::linear(id, Priors::unit(id), self.experiment.nuisances.sd(id), slope)
    }

    /// A nuisance whose effect is not linear if it is large.
    fn far(
        &self,
        &Present { sand, m, values }: &Present,
        (id, of): (&'static str, Option<&str>),
        change: RigChange,
        part: &dyn Fn(&[f64]) -> Vec<f64>,
    ) -> Nuisance {
        let value = estimate(values, id, of);
        let linear = change.linear() * self.experiment.nuisances.sd(id);
        let curved = |nuisance: Nuisance| Nuisance { nearly_linear: linear, ..nuisance };
        if value.abs() <= linear {
            return m.near(id, of, || curved(self.at_prior(id, part(m.rate(change)))));
        }
        let moved = self.changed(sand, change, value);
        let rate = part(&slope(&self.changed(sand, change, value + change.step()), &moved, change.step()));
        let effect = part(&slope(&moved, &m.here, 1.0));
        let bend = effect.iter().zip(&rate).map(|(e, r)| e - value * r).collect();
        let nuisance = curved(self.at_prior(id, rate).bent(bend));
        match of {
            Some(of) => nuisance.of(of),
            None => nuisance,
        }
    }

    /// Offset, gain, filter and delay of each channel, a filter of all channels, cross-talk, and the sensor's place.
    fn of_channels(&self, present: &Present) -> Vec<Nuisance> {
        let (m, values, mut all) = (present.m, present.values, Vec::new());
        for (channel, own) in self.layout.channels.iter().enumerate() {
            let (name, only) = (Some(&*own.name), |stack: &[f64]| self.only(stack, channel));
            all.push(m.near("offset", name, || {
                let zero = self.experiment.nuisances.sd("offset") * self.rms(&m.here, channel);
                Nuisance::linear("offset", own.unit, zero, only(&vec![1.0; m.here.len()]))
            }));
            all.push(self.linear(m, ("gain", name), || only(&m.here)));
            all.push(self.filter(m, values, name, &only));
            all.push(self.far(present, ("delay", name), RigChange::Delay, &only));
        }
        all.push(self.filter(m, values, None, &|stack| stack.to_vec()));
        let units = &self.layout.units;
        let from = |to: usize, of: usize, sign: f64| -> Vec<f64> {
            let at = |u: usize, i: usize| sign * m.here[units[u].block(of).start + i];
            self.layout.stack(|u, c, i| if c == to { at(u, i) } else { 0.0 })
        };
        all.push(self.linear(m, ("cross_talk", Some("Fx")), || from(0, 1, 1.0)));
        all.push(self.linear(m, ("cross_talk", Some("Fz")), || from(1, 0, 1.0)));
        if self.layout.channels.len() > 2 {
            // Ty = x Fz − z Fx about a point that is off by the value.
            all.push(self.linear(m, ("origin", Some("x")), || from(2, 1, -1.0)));
            all.push(self.linear(m, ("origin", Some("z")), || from(2, 0, 1.0)));
        }
        all
    }

    /// A filter's effect is not linear, and it is linearised about no negative time constant. A fit may make the constant negative: with 0
    /// as its bound, two causes of measured plates and legs were not named any more (tried on 2026-11-29).
    fn filter(
        &self,
        m: &Measuring,
        values: &[NuisanceState],
        of: Option<&str>,
        part: &dyn Fn(&[f64]) -> Vec<f64>,
    ) -> Nuisance {
        let tau = estimate(values, "lowpass", of).max(0.0);
        let filtered = |tau: f64| part(&m.filtered(self, tau));
        if tau == 0.0 {
            let still = || vec![0.0; m.here.len()];
            return self.linear(m, ("lowpass", of), || slope(&filtered(TIME_STEP), &still(), TIME_STEP));
        }
        let at = filtered(tau);
        let rate = slope(&filtered(tau + TIME_STEP), &at, TIME_STEP);
        let bend = slope(&at, &rate.iter().map(|r| r * tau).collect::<Vec<_>>(), 1.0);
        let nuisance = self.at_prior("lowpass", rate).bent(bend);
        match of {
            Some(of) => nuisance.of(of),
            None => nuisance,
        }
    }
}

impl Measuring {
    /// Change of the data per unit.
    fn rate(&self, change: RigChange) -> &[f64] {
        match change {
            RigChange::Delay => &self.late,
            RigChange::Depth => &self.deep,
            RigChange::Tilt => &self.tilted,
            RigChange::Plates => &self.plates,
            RigChange::Legs => &self.legs,
            RigChange::Size => &self.larger,
        }
    }

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
