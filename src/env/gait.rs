//! `sandgait/HexapodGait-v1`: follow commanded forward and yaw speeds on flat or sloping sand with one joint a leg,
//! driven in one of four ways.

use super::control::Driver;
use super::locomotion::{self, BASE_COLUMNS, CONTROL_RATE};
use super::options::{Control, Weights, keywords};
use super::random::Random;
use super::reference::{TOP_SPEED, wrapped};
use super::spec::{Column, Spec};
use super::task::{Goal, Setup, Task, Transition};
use crate::error::{Error, Result};
use crate::sim::State;
use crate::sim::engine::Command;

/// Bound of the observed hip speed [rad/s]; what goes beyond is clipped.
const HIP_SPEED: f64 = 3.0 * TOP_SPEED;

const ABOUT: &str = "\
The robot starts at rest in the alternating tripod, its joints off by up to `angle_noise`; a speed is drawn from `command`
and a yaw speed from `turn`, and both hold for the episode. `control` says how the hips are driven, always within `torque_limit` and, but for `torque`, 5 Hz.

With `control=\"clock\"` an action is a gait: in the share *duty factor* of a stride a leg sweeps the angle *stance sweep*
about *stance offset* (0: tip straight down) at one speed, in the rest it goes round at another, and each leg has its phase;
after the Buehler clock of RHex (Saranli, Buehler & Koditschek, Int. J. Robotics Research 20:616, 2001). Action 0 is the
alternating tripod at one constant speed of 2.5 Hz. The clock is read off the servos' references, so an action may change at
every step; common shifts of all phases do nothing. It does not walk backward.

Velocities are paid for in the base's own heading: v_forward (`speed` in `info`) and v_left are the displacement of its centre
over a control step along its heading on the surface and to the left of it, the heading halfway through the step, over the
step's duration. `x_velocity` is the displacement along x, uphill.

An episode terminates when the base lies on its back (`flipped`) or its centre is 15 mm under the surface (`buried`); it is
truncated after `max_episode_steps`, or when its state can no longer be computed (`diverged`).

Over a stretch of steps the cost of transport is Σ`work` / (`weight` · distance), and slip is 1 − distance / (2R Σ`hip_turn`)
with 2R the leg's length, 4 cm for `xplorer`.";

pub struct HexapodGait {
    spec: Spec,
    weights: Weights,
    driver: Driver,
}

impl HexapodGait {
    pub const ID: &'static str = keywords::GAIT.task;

    pub fn new(setup: &Setup) -> Result<Self> {
        let (robot, options) = (&setup.model.robot, &setup.options);
        if robot.leg.link.len() != 1 {
            let reason = format!("{:?} has several joints a leg; this task drives hips", robot.name);
            return Err(Error::invalid("robot", reason));
        }
        let joints = &robot.joint_names();
        let driver = Driver::new(options.control.unwrap_or(Control::HipSpeed), setup);
        let observation = [
            locomotion::base_columns(),
            Column::each(joints, "sine of hip angle", "1", 1.0),
            Column::each(joints, "cosine of hip angle", "1", 1.0),
            Column::each(joints, "hip speed", "rad/s", HIP_SPEED),
            Column::each(joints, "hip torque", "N·m", options.torque_limit),
            Column::each(&driver.labels(), "previous action", "1", 1.0),
            locomotion::command_columns(),
        ];
        let mut info = locomotion::info_columns();
        info.push(Column::free("hip_turn", "rad"));
        let spec = Spec {
            id: Self::ID,
            summary: format!("Follow commanded forward and yaw speeds on sand; actions are {}.", driver.summary()),
            observation: observation.concat(),
            action: driver.columns(),
            about: ABOUT,
            reward: options.weights.terms(),
            info,
            max_episode_steps: options.max_episode_steps,
            control_rate: CONTROL_RATE,
        };
        Ok(Self { spec, weights: options.weights, driver })
    }
}

impl Task for HexapodGait {
    fn spec(&self) -> &Spec {
        &self.spec
    }

    fn begin(&self, setup: &Setup, random: &mut Random) -> (State, Goal) {
        locomotion::begin(setup, random)
    }

    fn command(&self, action: &[f32], state: &State, command: &mut Command) {
        self.driver.command(action, state, command);
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
        }
        let (actions, commands) = rest[4 * joints..].split_at_mut(last_action.len());
        actions.copy_from_slice(last_action);
        locomotion::observe_command(goal, commands);
    }

    fn judge(&self, transition: &Transition, info: &mut [f32]) -> bool {
        let (turn, walk) = (info.len() - 1, ..info.len() - 1);
        info[turn] = hip_turn(transition) as f32;
        locomotion::judge(&self.weights, transition, &mut info[walk])
    }
}

/// By how much the hips turned in a step, on average [rad]; the distance of a wheel's tread is 2R times that.
fn hip_turn(t: &Transition) -> f64 {
    let hips = t.after.angles.iter().zip(&t.before.angles);
    hips.map(|(after, before)| wrapped(after - before)).sum::<f64>() / t.after.angles.len() as f64
}
