//! `sandgait/HexapodLegs-v1`: foot trajectories of a robot with three joints a leg; speed and turning commands.

use super::locomotion::{self, BASE_COLUMNS, CONTROL_RATE};
use super::options::{Weights, keywords};
use super::random::Random;
use super::spec::{Column, Spec};
use super::task::{Goal, Setup, Task, Transition};
use crate::error::{Error, Result};
use crate::sim::State;
use crate::sim::engine::Command;

/// Fastest a target moves [rad/s]: a small hobby servo's 60° in 0.08 s. Our choice, because the robot is our own.
const TARGET_SPEED: f64 = 13.0;

/// Bound of the observed joint speed [rad/s]; what goes beyond is clipped.
const JOINT_SPEED: f64 = 3.0 * TARGET_SPEED;

/// Observed angles may pass their range by this much [rad] under load.
const OVERSHOOT: f64 = 0.5;

const ABOUT: &str = "\
The robot starts at rest with its joints off by up to `angle_noise`; a speed is drawn from `command` and a yaw speed from
`turn`, and both hold for the episode. Each servo's reference moves to its target within the control step, at 13 rad/s or
less. `slope_deg` tilts the sand.

Velocities are paid for in the base's own heading: v_forward (`speed` in `info`) and v_left are the displacement of its centre
over a control step along its heading on the surface and to the left of it, the heading halfway through the step, over the
step's duration. `x_velocity` is the displacement along x, uphill.

An episode terminates when the base lies on its back (`flipped`) or its centre is 15 mm under the surface (`buried`); it is
truncated after `max_episode_steps`, or when its state can no longer be computed (`diverged`).

Over a stretch of steps the cost of transport is Σ`work` / (`weight` · distance).";

pub struct HexapodLegs {
    spec: Spec,
    weights: Weights,
    /// Middle and half width of each joint's range [rad].
    ranges: Vec<[f64; 2]>,
}

impl HexapodLegs {
    pub const ID: &'static str = keywords::LEGS.task;

    pub fn new(setup: &Setup) -> Result<Self> {
        let (model, options) = (&setup.model, &setup.options);
        let joints = &model.robot.joint_names();
        let bounds = model.legs.iter().flatten().map(|b| b.range).collect::<Option<Vec<_>>>();
        let bounds = bounds.ok_or_else(|| {
            Error::invalid(
                "robot",
                format!("{:?} has joints without a range; this task drives angles", model.robot.name),
            )
        })?;
        let angle = |(name, [low, high]): (&String, &[f64; 2])| {
            Column::new(format!("joint angle, {name}"), "rad", low - OVERSHOOT, high + OVERSHOOT)
        };
        let observation = [
            locomotion::base_columns(),
            joints.iter().zip(&bounds).map(angle).collect(),
            Column::each(joints, "joint speed", "rad/s", JOINT_SPEED),
            Column::each(joints, "joint torque", "N·m", options.torque_limit),
            Column::each(joints, "previous action", "1", 1.0),
            locomotion::command_columns(),
        ];
        let info = locomotion::info_columns();
        let spec = Spec {
            id: Self::ID,
            summary: "Follow commanded forward and yaw speeds with three joints a leg; actions are target angles over each joint's range."
                .into(),
            observation: observation.concat(),
            action: Column::each(joints, "target angle over the joint's range", "1", 1.0),
            about: ABOUT,
            reward: options.weights.terms(),
            info,
            max_episode_steps: options.max_episode_steps,
            control_rate: CONTROL_RATE,
        };
        let ranges = bounds.iter().map(|[low, high]| [(high + low) / 2.0, (high - low) / 2.0]).collect();
        Ok(Self { spec, weights: options.weights, ranges })
    }
}

impl Task for HexapodLegs {
    fn spec(&self) -> &Spec {
        &self.spec
    }

    fn begin(&self, setup: &Setup, random: &mut Random) -> (State, Goal) {
        locomotion::begin(setup, random)
    }

    /// The servo's reference moves to the target within the control step, no faster than [`TARGET_SPEED`].
    fn command(&self, action: &[f32], state: &State, command: &mut Command) {
        for (i, ([middle, half], a)) in self.ranges.iter().zip(action).enumerate() {
            let target = middle + half * f64::from(*a);
            command.rates[i] = ((target - state.references[i]) * CONTROL_RATE).clamp(-TARGET_SPEED, TARGET_SPEED);
        }
    }

    fn observe(&self, goal: &Goal, state: &State, last_action: &[f32], row: &mut [f32]) {
        let (base, rest) = row.split_at_mut(BASE_COLUMNS);
        locomotion::observe_base(state, base);
        let joints = state.angles.len();
        for i in 0..joints {
            rest[i] = state.angles[i] as f32;
            rest[joints + i] = state.rates[i] as f32;
            rest[2 * joints + i] = state.torques[i] as f32;
            rest[3 * joints + i] = last_action[i];
        }
        locomotion::observe_command(goal, &mut rest[4 * joints..]);
    }

    fn judge(&self, transition: &Transition, info: &mut [f32]) -> bool {
        locomotion::judge(&self.weights, transition, info)
    }
}
