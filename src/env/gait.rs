//! `sandgait/HexapodGait-v0`: follow a commanded forward speed on flat or sloping sand, one speed command a hip.

use super::locomotion::{self, BASE_COLUMNS, CONTROL_RATE, Weights};
use super::random::Random;
use super::spec::{Column, Spec};
use super::task::{Goal, Setup, Task, Transition};
use crate::error::{Error, Result};
use crate::sim::State;
use crate::sim::engine::Command;
use std::f64::consts::TAU;

/// Hip speed at action 1 [rad/s]: 5 Hz, the highest stride frequency of Li et al. 2012.
pub const TOP_SPEED: f64 = 5.0 * TAU;

/// Bound of the observed hip speed [rad/s]; what goes beyond is clipped.
const HIP_SPEED: f64 = 3.0 * TOP_SPEED;

pub struct HexapodGait {
    spec: Spec,
    weights: Weights,
}

impl HexapodGait {
    pub const ID: &'static str = "sandgait/HexapodGait-v0";

    pub fn new(setup: &Setup) -> Result<Self> {
        let (robot, options) = (&setup.model.robot, &setup.options);
        if robot.leg.link.len() != 1 {
            let reason = format!("{:?} has several joints a leg; this task drives hips", robot.name);
            return Err(Error::invalid("robot", reason));
        }
        let joints = &robot.joint_names();
        let observation = [
            locomotion::base_columns(),
            Column::each(joints, "sine of hip angle", "1", 1.0),
            Column::each(joints, "cosine of hip angle", "1", 1.0),
            Column::each(joints, "hip speed", "rad/s", HIP_SPEED),
            Column::each(joints, "hip torque", "N·m", options.torque_limit),
            Column::each(joints, "previous action", "1", 1.0),
            vec![locomotion::speed_column()],
        ];
        let info = locomotion::info_columns(&options.weights);
        let spec = Spec {
            id: Self::ID,
            summary: "Follow a commanded forward speed on sand; actions are hip speeds as fractions of 5 Hz.",
            observation: observation.concat(),
            action: Column::each(joints, "target hip speed / 5 Hz", "1", 1.0),
            reward_terms: options.weights.named().len(),
            info,
            max_episode_steps: options.max_episode_steps,
            control_rate: CONTROL_RATE,
        };
        Ok(Self { spec, weights: options.weights })
    }
}

impl Task for HexapodGait {
    fn spec(&self) -> &Spec {
        &self.spec
    }

    fn begin(&self, setup: &Setup, random: &mut Random) -> (State, Goal) {
        locomotion::begin(setup, random)
    }

    fn command(&self, action: &[f32], _state: &State, command: &mut Command) {
        for (rate, a) in command.rates.iter_mut().zip(action) {
            *rate = f64::from(*a) * TOP_SPEED;
        }
    }

    fn observe(&self, goal: &Goal, state: &State, last_action: &[f32], row: &mut [f32]) {
        let (base, rest) = row.split_at_mut(BASE_COLUMNS);
        locomotion::observe_base(state, base);
        let joints = state.angles.len();
        for i in 0..joints {
            let (sin, cos) = state.angles[i].sin_cos();
            rest[i] = sin as f32;
            rest[joints + i] = cos as f32;
            rest[2 * joints + i] = state.rates[i] as f32;
            rest[3 * joints + i] = state.torques[i] as f32;
            rest[4 * joints + i] = last_action[i];
        }
        rest[5 * joints] = goal.speed as f32;
    }

    fn judge(&self, transition: &Transition, info: &mut [f32]) -> bool {
        locomotion::judge(&self.weights, transition, info)
    }
}
