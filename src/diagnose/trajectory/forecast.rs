//! The forward model of a robot's log: what the diagnosis requires of every forward model.

use super::model::TrajectoryModel;
use super::sensors::LoggedHardware;
use super::windows::{BINS, Window};
use crate::experiment::Experiment;
use crate::fit::slope;
use crate::forward::{Feature, ForwardModel, Menu, SandParameters, Testable, stronger};
use crate::nuisance::{Nuisance, NuisanceState};
use crate::sand::SandDescription;
use crate::sand::mechanism::CATALOG;
use crate::shared::Uncertainty;
use crate::sim::hardware::HardwareDescription;
use std::collections::HashMap;
use std::f64::consts::TAU;

/// A derivative by finite differences is reliable if its step changes all predicted data together by this many σ: our choice, as
/// for walking runs.
const ROUGHNESS: f64 = 4.0;
/// Relative step of the sand's strength for the derivative by the strength of the bed: our choice, about the scatter of beds.
const STRENGTH_STEP: f64 = 0.05;

impl ForwardModel for TrajectoryModel<'_> {
    fn stopped(&self) -> bool {
        self.latch.stopped()
    }

    fn predict_many(&self, states: &[SandParameters]) -> Vec<Vec<f64>> {
        self.simulate(states)
    }

    fn roughness(&self) -> Option<f64> {
        Some(ROUGHNESS)
    }

    /// The sizes here are not learnt from the scatter of repetitions. All strides of a run share the strength of its
    /// bed, the offsets of its sensors, and the error of the time step. At each number the model errs by a share of the
    /// channel's standard deviation within the stride, and by the scatter of [`Self::unsettled`]. The error of the time
    /// step is the difference to a replay with a quarter of it (our choice).
    fn uncertainty(&self, sand: &SandParameters, prediction: &[f64]) -> Uncertainty {
        let harder = self.predict(&stronger(sand, STRENGTH_STEP));
        let mut common = vec![slope(&harder, prediction, STRENGTH_STEP / self.prior("bed_strength").max(1e-9))];
        let torque = self.prior("torque_offset") * self.torque_rms(prediction);
        let joints = self.layout.joints;
        for channel in 0..self.layout.count() {
            let size = match channel {
                c if c < joints => torque,
                c if c < joints + 3 => self.prior("gyro_bias"),
                c if c < joints + 6 => self.prior("acc_bias"),
                c if Some(c) == self.layout.servo_channel() => torque / (joints as f64).sqrt(),
                _ => continue,
            };
            common.push(self.stack(|_, c, _| if c == channel { size } else { 0.0 }));
        }
        common.push(slope(&self.replayed(sand, 4.0, &self.hardware), prediction, 1.0));
        let share = self.prior("model_error");
        let swing = |block: &[f64]| {
            let mean = block.iter().sum::<f64>() / block.len() as f64;
            (block.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / block.len() as f64).sqrt()
        };
        let own = prediction.chunks(BINS).flat_map(|block| std::iter::repeat_n(share * swing(block), block.len()));
        let own = own.zip(self.unsettled(sand, prediction)).map(|(own, square)| (own * own + square).sqrt()).collect();
        Uncertainty { shared: Vec::new(), common, own }
    }

    fn nuisances(&self, sand: &SandParameters, values: &[NuisanceState]) -> Vec<Nuisance> {
        let here = self.predict(sand);
        let tracks = self.replays.of(sand, || self.tracks(&[(*sand, Vec::new())], 1.0).swap_remove(0));
        let mut all = self.mounting(&tracks, values);
        all.push(self.torque_delay(&tracks, values));
        // A wrong torque constant changes the logged torques of a given motion. The ratio of logged to requested torques is
        // a separate nuisance, because if a drive also computes with the wrong constant, the logged torque equals the
        // requested torque. An error of the simulated torques looks like a wrong constant, so no log gives the constant better.
        let servo = self.layout.servo_channel().map_or(0..0, |c| c..c + 1);
        let torques = 0..self.layout.joints;
        let gains = [("torque_constant", torques.clone()), ("model_scale", torques), ("servo_gain", servo)];
        for (id, own) in gains.into_iter().filter(|g| !g.1.is_empty()) {
            let of = |(k, v): (usize, &f64)| if own.contains(&(k % self.span() / BINS)) { *v } else { 0.0 };
            let gain = here.iter().enumerate().map(of).collect();
            all.push(Nuisance::linear(id, "1", self.prior(id), gain));
        }
        all.push(self.friction(self.torque_rms(&here)));
        all.extend(self.described(sand, &here, values));
        all.retain(|n| n.sd > 0.0 && !self.is_given(n.id, n.of.as_deref()));
        all
    }

    fn experiment(&self) -> &Experiment {
        &self.experiment
    }

    fn testable(&self) -> Testable {
        let why = |m: &crate::sand::mechanism::Mechanism| match m.id {
            "packing_grad" => Some("the log does not say at which position of the bed each run began".to_string()),
            "motor_torque_limit" if self.asked.is_none() => Some(
                "the log does not give the command of the hips (stride_frequency), or the robot has no servo".into(),
            ),
            _ => None,
        };
        let given = self.experiment.given.mechanisms;
        let asked = CATALOG.iter().enumerate().filter(|(index, m)| m.walking && given.get(*index) == 0.0);
        asked.map(|(index, m)| (index, why(m))).collect()
    }

    fn with_hardware(&self, sand: &SandParameters, found: &HardwareDescription) -> Option<Vec<f64>> {
        let hardware = LoggedHardware::of(found);
        (hardware != self.hardware).then(|| self.replayed(sand, 1.0, &hardware))
    }

    fn finish(&self, sand: &mut SandDescription) {
        sand.mechanisms = self.with_given(&sand.mechanisms);
    }

    fn features(&self) -> Vec<Feature> {
        let per_bin = |name, unit, f: &dyn Fn(usize, usize) -> f64| Feature {
            name,
            unit,
            values: (self.window_of.iter()).map(|&w| (0..BINS).map(|b| f(self.windows[w].run, b)).collect()).collect(),
        };
        let frequency =
            |w: &Window| w.strides.len() as f64 / (w.strides.last().map_or(1.0, |s| s[1]) - w.strides[0][0]);
        let own: HashMap<usize, f64> = self.windows.iter().map(|w| (w.run, frequency(w))).collect();
        vec![
            per_bin("stride_frequency", "Hz", &|run, _| own.get(&run).copied().unwrap_or(0.0)),
            per_bin("phase", "rad", &|_, bin| (bin as f64 + 0.5) * TAU / BINS as f64),
            per_bin("slope_deg", "°", &|run, _| self.runs[run].slope_deg),
        ]
    }

    fn menu(&self) -> Option<Menu<'_>> {
        self.planned()
    }

    fn group(&self, unit: usize) -> &str {
        self.runs[self.windows[self.window_of[unit]].run].leg.as_deref().unwrap_or("robot")
    }
}
