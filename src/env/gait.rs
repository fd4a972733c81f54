//! `sandgait/HexapodGait-v1`: follow commanded forward and yaw speeds on flat or sloping sand with one joint a leg,
//! with one of four control modes.

use super::control::{Control, Driver};
use super::feature::Features;
use super::locomotion::{self, Figure, Observe, Observed, WalkStep, Weights};
use super::random::Random;
use super::reference::{TOP_SPEED, wrap_angle};
use super::sensors::{Part, Sensor};
use super::spec::{CONTROL_RATE, Column, Spec};
use super::task::{Setup, Task, TaskState, Transition};
use super::walking::{self, Walking};
use crate::error::{Error, Result};
use crate::options;
use crate::sim::engine::{Command, EngineKind};
use crate::sim::{Model, State};

options! {
    /// Options of HexapodGait.
    pub struct GaitOptions {
        ..walking: Walking = Walking::default();
        control: Control = Control::HipSpeed, "meaning of the actions: hip_speed, hip_target, torque or clock";
    }
}

/// Bound of the observed hip speed [rad/s]; larger values are clipped. Our choice: random actions reached 36 rad/s.
const HIP_SPEED: f64 = 3.0 * TOP_SPEED;

const ABOUT: &str = "\
The robot starts at rest in the pose of the alternating tripod, with random errors of the joint angles of up to `angle_noise`. A
commanded speed is drawn from `command` and a commanded yaw speed from `turn`; both stay the same for the episode. `control` selects
the meaning of the actions. Torques are within `torque_limit`, and hip speeds within 5 Hz except with `torque`.

With `control=\"clock\"` an action is a gait, as with the Buehler clock of RHex (Saranli, Buehler & Koditschek, Int. J. Robotics
Research 20:616, 2001). During stance, which is the share *duty factor* of a stride, a leg turns with one speed by the angle *stance
sweep*; the middle of stance is at the angle *stance offset* (0: tip straight down). During the rest of the stride it turns with another
speed to the beginning of the next stance. Each leg has a phase. Action 0 is the alternating tripod at a constant speed of 2.5 Hz. The clock is computed
from the servos' references, so the action may change in every step. A common change of all phases has no effect. A clock cannot
walk backward.

Rewards use velocities relative to the base's heading. v_forward (`speed` in `info`) and v_left are the displacements of the base's
centre in a control step, along its heading on the surface and to the left of it, divided by the step's duration. The heading is
the mean of those at the beginning and the end of the step. `x_velocity` is the displacement along x, uphill, divided by this duration.

An episode terminates when the base lies on its back (`flipped`) or its centre is 15 mm under the surface (`buried`); it is
truncated after `max_episode_steps`, or when its state can no longer be computed (`diverged`).

The cost of transport of several steps is Σ`work` / (`weight` · distance). The slip of the gait is 1 − distance / (2R Σ`hip_turn`),
where 2R is the leg's length, 4 cm for `xplorer`.";

pub struct HexapodGait {
    spec: Spec,
    weights: Weights,
    driver: Driver,
    observation: Features<Observe>,
    figures: Features<Figure>,
}

impl Task for HexapodGait {
    const ID: &'static str = "sandgait/HexapodGait-v1";
    type Options = GaitOptions;

    fn engine(options: &GaitOptions) -> EngineKind {
        options.walking.engine
    }

    fn model(options: &GaitOptions) -> Result<Model> {
        options.walking.model(options.control != Control::Torque)
    }

    fn new(setup: &Setup<GaitOptions>) -> Result<Self> {
        let (robot, options) = (&setup.model.robot, setup.options);
        let Walking { torque_limit, weights, max_episode_steps, .. } = options.walking;
        if robot.leg.link.len() != 1 {
            let reason = format!("{:?} has several joints a leg; this task drives hips", robot.name);
            return Err(Error::invalid("robot", reason));
        }
        let joints = &robot.joint_names();
        let driver = Driver::new(options.control, robot, torque_limit);
        let observation = locomotion::base_features()
            .each(joints, "sine of hip angle", "1", 1.0, |o, i| o.state.angles[i].sin())
            .sensed_as(Sensor::JointPosition, Part::Sine)
            .each(joints, "cosine of hip angle", "1", 1.0, |o, i| o.state.angles[i].cos())
            .sensed_as(Sensor::JointPosition, Part::Cosine)
            .each(joints, "hip speed", "rad/s", HIP_SPEED, |o, i| o.state.rates[i])
            .sensed(Sensor::JointVelocity)
            .each(joints, "hip torque", "N·m", torque_limit, |o, i| o.state.torques[i])
            .sensed(Sensor::JointTorque)
            .each(&driver.labels(), "previous action", "1", 1.0, |o, i| o.last_action[i].into())
            .and(locomotion::command_features());
        let figures = locomotion::figures().free("hip_turn", "rad", |w, _| hip_turn(w.t));
        let reward = weights.terms();
        let spec = Spec {
            id: Self::ID,
            summary: format!("Follow commanded forward and yaw speeds on sand; actions are {}.", driver.summary()),
            observation: observation.columns(),
            action: driver.columns(),
            about: ABOUT,
            info: [Column::rewards(&reward), figures.columns()].concat(),
            reward,
            max_episode_steps,
            control_rate: CONTROL_RATE,
        };
        Ok(Self { spec, weights, driver, observation, figures })
    }

    fn spec(&self) -> &Spec {
        &self.spec
    }

    fn begin(&self, setup: &Setup<GaitOptions>, random: &mut Random) -> (State, TaskState) {
        walking::begin(&setup.with(&setup.options.walking), random)
    }

    fn command(&self, action: &[f32], state: &State, command: &mut Command) {
        self.driver.command(action, state, command);
    }

    fn command_ranges(&self, setup: &Setup<GaitOptions>) -> Option<[[f64; 2]; 3]> {
        Some(setup.options.walking.command_ranges())
    }

    fn observe(&self, task_state: &TaskState, state: &State, last_action: &[f32], row: &mut [f32]) {
        Observed::new(task_state, state, last_action).fill(&self.observation, row);
    }

    fn evaluate(&self, _setup: &Setup<GaitOptions>, transition: &Transition, info: &mut [f32]) -> bool {
        let step = WalkStep::new(transition);
        step.fill(&self.weights, &self.figures, info);
        step.terminated
    }
}

/// Mean angle by which the hips turned in a step [rad]. A rolling wheel with the leg's length 2R as its radius would
/// advance by 2R times this angle.
fn hip_turn(t: &Transition) -> f64 {
    let hips = t.after.angles.iter().zip(&t.before.angles);
    hips.map(|(after, before)| wrap_angle(after - before)).sum::<f64>() / t.after.angles.len() as f64
}
