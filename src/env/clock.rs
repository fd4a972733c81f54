//! A gait as parameters: hips that follow a two-speed clock, after the Buehler clock of RHex (Saranli, Buehler &
//! Koditschek, Int. J. Robotics Research 20:616, 2001, section 3.2.1).
//!
//! A leg's stance takes the share `duty` of a stride. During stance the leg sweeps the angle `sweep`, centred on
//! `offset`, at a constant speed. During the rest of the stride, the swing, the leg turns on to the start of the sweep
//! at another speed. A leg's phase is ahead of the clock's phase by the leg's phase in the alternating tripod plus a
//! phase of its own, which is a part of the action.
//!
//! The clock has no memory of its own. Its phase is computed from the servos' references: each leg's reference gives a
//! phase, from which the amount that the leg is ahead is subtracted; the circular mean over all legs is the phase of
//! the clock. Each leg then moves toward the angle that it should have at the end of the control step. So snapshots
//! contain the phase, the clock treats all legs alike, and it waits for legs that the speed limit slows down. Speeds
//! are constant within a control step, which smooths the change between stance and swing.

use super::reference::toward;
use super::spec::{CONTROL_RATE, Column};
use crate::sim::State;
use crate::sim::engine::Command;
use crate::sim::robot::{Robot, Tripod};
use std::f64::consts::{PI, TAU};

/// Values at action −1 and 1. Our choice: action 0, the middle, is the gait of the reference experiments, the
/// alternating tripod at one constant speed, at 2.5 Hz. Duty and sweep keep the divisors of [`Stride`] above 0.
const FREQUENCY: [f64; 2] = [0.0, 5.0]; // [Hz]; 5 Hz is the highest of Li et al. 2012
const DUTY: [f64; 2] = [0.2, 0.8];
const SWEEP: [f64; 2] = [PI / 6.0, 11.0 * PI / 6.0]; // [rad]
const OFFSET: [f64; 2] = [-PI / 2.0, PI / 2.0]; // [rad]; at the ends the leg is horizontal in the middle of stance
/// Each leg's phase relative to its tripod, in strides: the range covers all values.
const PHASE: [f64; 2] = [-0.5, 0.5];

/// Number of action components that all legs share.
const SHARED: usize = 4;

/// The clock of one robot: phase of each leg in the alternating tripod, in strides.
pub struct Clock {
    tripod: Vec<f64>,
}

/// Values of the gait parameters that all legs share.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Stride {
    /// [Hz]
    frequency: f64,
    /// Share of the stride in stance.
    duty: f64,
    /// Angle that stance sweeps [rad].
    sweep: f64,
    /// Hip angle in the middle of stance [rad].
    offset: f64,
}

fn scaled(action: f32, [low, high]: [f64; 2]) -> f64 {
    low + (high - low) * (f64::from(action) + 1.0) / 2.0
}

/// `x` without whole strides, in [-0.5, 0.5).
fn wrap_stride(x: f64) -> f64 {
    (x + 0.5).rem_euclid(1.0) - 0.5
}

impl Stride {
    fn of(action: &[f32]) -> Self {
        Self {
            frequency: scaled(action[0], FREQUENCY),
            duty: scaled(action[1], DUTY),
            sweep: scaled(action[2], SWEEP),
            offset: scaled(action[3], OFFSET),
        }
    }

    /// Hip angle [rad] at `phase`, in strides from the middle of stance.
    fn angle(&self, phase: f64) -> f64 {
        let phase = wrap_stride(phase);
        let (stance, swing) = (phase.clamp(-self.duty / 2.0, self.duty / 2.0), 1.0 - self.duty);
        self.offset + stance * self.sweep / self.duty + (phase - stance) * (TAU - self.sweep) / swing
    }

    /// The phase at which the hip is at `angle` [rad]; the inverse of [`Self::angle`].
    fn phase(&self, angle: f64) -> f64 {
        let angle = wrap_stride((angle - self.offset) / TAU) * TAU;
        let stance = angle.clamp(-self.sweep / 2.0, self.sweep / 2.0);
        stance * self.duty / self.sweep + (angle - stance) * (1.0 - self.duty) / (TAU - self.sweep)
    }
}

impl Clock {
    pub fn new(robot: &Robot) -> Self {
        let phase = |t: Tripod| if t == Tripod::B { 0.5 } else { 0.0 };
        Self { tripod: robot.hip.iter().map(|h| phase(h.tripod)).collect() }
    }

    /// The meaning of each action component.
    pub fn labels(&self, joints: &[String]) -> Vec<String> {
        let shared = ["stride frequency", "duty factor", "stance sweep", "stance offset"].map(String::from);
        shared.into_iter().chain(joints.iter().map(|joint| format!("phase, {joint}"))).collect()
    }

    /// The action's table.
    pub fn columns(&self, joints: &[String]) -> Vec<Column> {
        let degrees = |range: [f64; 2]| range.map(|a| a.to_degrees().round());
        let ranges = [(FREQUENCY, " Hz"), (DUTY, ""), (degrees(SWEEP), "°"), (degrees(OFFSET), "°")];
        let shared = self.labels(&[]).into_iter().zip(ranges);
        let shared = shared.map(|(label, ([low, high], unit))| format!("{label} over [{low}, {high}]{unit}"));
        let [low, high] = PHASE;
        let phase = |joint: &String| format!("phase ahead of the tripod's over [{low}, {high}] strides, {joint}");
        let names = shared.chain(joints.iter().map(phase));
        names.map(|name| Column::new(name, "1", -1.0, 1.0)).collect()
    }

    /// Moves every reference toward the angle that it should have at the end of the control step.
    pub fn command(&self, action: &[f32], state: &State, command: &mut Command) {
        let stride = Stride::of(action);
        let (_, own) = action.split_at(SHARED);
        let ahead = |i: usize| self.tripod[i] + scaled(own[i], PHASE);
        let legs = 0..self.tripod.len();
        let (mut sine, mut cosine) = (0.0, 0.0);
        for i in legs.clone() {
            let (sin, cos) = (TAU * (stride.phase(state.references[i]) - ahead(i))).sin_cos();
            (sine, cosine) = (sine + sin, cosine + cos);
        }
        let next = f64::atan2(sine, cosine) / TAU + stride.frequency / CONTROL_RATE;
        for i in legs {
            command.rates[i] = toward(stride.angle(next + ahead(i)), state.references[i]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NARROW: Stride = Stride { frequency: 2.0, duty: 0.4, sweep: 1.0, offset: 0.3 };

    /// Stance sweeps the angle `sweep` in the share `duty` of the stride; swing turns the leg by the rest of the turn in the rest of the stride.
    #[test]
    fn two_speeds_make_one_turn() {
        let span = |a: f64, b: f64| NARROW.angle(b) - NARROW.angle(a);
        assert!((span(-0.2, 0.2) - 1.0).abs() < 1e-12);
        assert!((span(-0.1, 0.1) - 0.5).abs() < 1e-12, "stance is at one speed");
        assert!((span(0.2, 0.35) - (TAU - 1.0) / 4.0).abs() < 1e-12, "swing is at one speed");
        assert!((span(-0.5, 0.5 - 1e-12) - TAU).abs() < 1e-9);
        assert_eq!(NARROW.angle(0.0), 0.3);
    }

    #[test]
    fn the_phase_of_an_angle_is_the_inverse() {
        for i in -50..50 {
            let phase = f64::from(i) / 100.0;
            assert!((wrap_stride(NARROW.phase(NARROW.angle(phase)) - phase)).abs() < 1e-12, "{phase}");
            assert!((wrap_stride(NARROW.phase(NARROW.angle(phase) + 3.0 * TAU) - phase)).abs() < 1e-12, "{phase}");
        }
    }

    /// References follow the command of every control step, as the legs do over time.
    fn run(action: &[f32], references: &[f64], steps: usize) -> Vec<Vec<f64>> {
        let clock = Clock::new(&Robot::built_in("xplorer").unwrap());
        let mut state = State::at_rest(0.0, references);
        let mut command = Command::still(6);
        let step = |_| {
            clock.command(action, &state, &mut command);
            state.references.iter_mut().zip(&command.rates).for_each(|(r, rate)| *r += rate / CONTROL_RATE);
            state.references.clone()
        };
        (0..steps).map(step).collect()
    }

    #[test]
    fn action_0_is_the_tripod_at_half_speed() {
        let start: Vec<f64> = [0.0, PI, 0.0, PI, 0.0, PI].map(|a| a + 0.1).to_vec();
        for (k, references) in run(&[0.0; 10], &start, 100).iter().enumerate() {
            let turned = TAU * 2.5 * (k + 1) as f64 / CONTROL_RATE;
            references.iter().zip(&start).for_each(|(r, s)| assert!((r - s - turned).abs() < 1e-9));
        }
    }

    /// From any start the legs reach their phases, and then keep to the stride frequency.
    #[test]
    fn legs_fall_into_step() {
        let action = [-0.2, 0.3, -0.4, 0.2, 0.1, -0.3, 0.5, 0.0, 0.9, -0.6];
        let history = run(&action, &[0.3, -2.0, 1.0, 2.9, -0.4, 0.0], 200);
        let stride = Stride::of(&action);
        assert!((stride.frequency - 2.0).abs() < 1e-7, "{}", stride.frequency); // actions are f32
        let clock = Clock::new(&Robot::built_in("xplorer").unwrap());
        let phases = |references: &[f64]| -> Vec<f64> {
            let ahead = |i: usize| clock.tripod[i] + scaled(action[4 + i], PHASE);
            (0..6).map(|i| wrap_stride(stride.phase(references[i]) - ahead(i))).collect()
        };
        for k in [150, 160, 199] {
            let all = phases(&history[k]);
            assert!(all.iter().all(|p| wrap_stride(p - all[0]).abs() < 1e-9), "step {k}: {all:?}");
            let before = phases(&history[k - 1]);
            assert!((wrap_stride(all[0] - before[0]) - stride.frequency / CONTROL_RATE).abs() < 1e-9);
        }
    }
}
