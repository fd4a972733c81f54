//! `sandgait/HexapodGait-v1`: follow commanded forward and yaw speeds on flat or sloping sand with one joint a leg,
//! with one of four control modes.

use super::control::{Control, Driver};
use super::feature::Features;
use super::locomotion::{self, Figure, Observe, Observed, WalkStep, Weights};
use super::random::Random;
use super::reference::{TOP_SPEED, wrap_angle};
use super::spec::{CONTROL_RATE, Column, Spec};
use super::task::{Goal, Setup, Task, Transition};
use super::walking::{self, Walking};
use crate::error::{Error, Result};
use crate::options;
use crate::sim::engine::{Command, EngineKind};
use crate::sim::{Model, State};

options! {
    /// Options of HexapodGait.
    pub struct GaitOptions {
        ..walking: Walking = Walking::default();
        control: Control = Control::HipSpeed, "what an action is: hip_speed, hip_target, torque or clock";
    }
}

/// Bound of the observed hip speed [rad/s]; larger values are clipped.
const HIP_SPEED: f64 = 3.0 * TOP_SPEED;

const ABOUT: &str = "\
The robot starts at rest in the alternating tripod, its joints off by up to `angle_noise`; a speed is drawn from `command`
and a yaw speed from `turn`, and both hold for the episode. `control` selects how the hips are driven, always within `torque_limit` and, except for `torque`, 5 Hz.

With `control=\"clock\"` an action is a gait: in the share *duty factor* of a stride a leg sweeps the angle *stance sweep*
about *stance offset* (0: tip straight down) at one speed, in the rest it turns on at another, and each leg has its phase;
after the Buehler clock of RHex (Saranli, Buehler & Koditschek, Int. J. Robotics Research 20:616, 2001). Action 0 is the
alternating tripod at one constant speed of 2.5 Hz. The clock is computed from the servos' references, so an action may change at
every step; a common shift of all phases has no effect. A clock cannot walk backward.

Rewards use velocities in the base's own heading. v_forward (`speed` in `info`) and v_left are the displacement of its centre
in a control step, divided by the step's duration, along its heading on the surface and to the left of it. The heading is that
halfway through the step. `x_velocity` is the displacement along x, uphill.

An episode terminates when the base lies on its back (`flipped`) or its centre is 15 mm under the surface (`buried`); it is
truncated after `max_episode_steps`, or when its state can no longer be computed (`diverged`).

Over a stretch of steps the cost of transport is Σ`work` / (`weight` · distance), and slip is 1 − distance / (2R Σ`hip_turn`)
with 2R the leg's length, 4 cm for `xplorer`.";

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
            .each(joints, "cosine of hip angle", "1", 1.0, |o, i| o.state.angles[i].cos())
            .each(joints, "hip speed", "rad/s", HIP_SPEED, |o, i| o.state.rates[i])
            .each(joints, "hip torque", "N·m", torque_limit, |o, i| o.state.torques[i])
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

    fn begin(&self, setup: &Setup<GaitOptions>, random: &mut Random) -> (State, Goal) {
        walking::begin(&setup.with(&setup.options.walking), random)
    }

    fn command(&self, action: &[f32], state: &State, command: &mut Command) {
        self.driver.command(action, state, command);
    }

    fn observe(&self, goal: &Goal, state: &State, last_action: &[f32], row: &mut [f32]) {
        Observed::new(goal, state, last_action).fill(&self.observation, row);
    }

    fn evaluate(&self, _setup: &Setup<GaitOptions>, transition: &Transition, info: &mut [f32]) -> bool {
        let step = WalkStep::new(transition);
        step.fill(&self.weights, &self.figures, info);
        step.terminated
    }
}

/// Mean angle that the hips turned in a step [rad]; a wheel's tread would move 2R times that.
fn hip_turn(t: &Transition) -> f64 {
    let hips = t.after.angles.iter().zip(&t.before.angles);
    hips.map(|(after, before)| wrap_angle(after - before)).sum::<f64>() / t.after.angles.len() as f64
}
