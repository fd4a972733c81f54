//! `sandgait/HexapodLegs`: foot trajectories of a robot with three joints a leg; speed and turning commands. In `-v2`, stops hold
//! joints within their ranges; in `-v1`, a load can push joints beyond their ranges.

use super::feature::Features;
use super::locomotion::{self, Figure, Observe, Observed, WalkStep, Weights};
use super::random::Random;
use super::sensors::Sensor;
use super::spec::{CONTROL_RATE, Column, Spec};
use super::task::{Setup, Task, TaskState, Transition};
use super::walking::{self, Walking};
use crate::error::{Error, Result};
use crate::options;
use crate::sim::engine::{Command, EngineKind};
use crate::sim::{Model, State};

options! {
    /// Options of HexapodLegs.
    pub struct LegsOptions {
        ..walking: Walking = Walking { robot: "xplorer18".into(), leg: "flat".into(), ..Walking::default() };
    }
}

/// Largest speed of a target [rad/s], the speed of a small hobby servo: 60° in 0.08 s. Our choice, because the robot is
/// our own.
const TARGET_SPEED: f64 = 13.0;

/// Bound of the observed joint speed [rad/s]; larger values are clipped. Our choice, as for the hips of HexapodGait.
const JOINT_SPEED: f64 = 3.0 * TARGET_SPEED;

/// Observed angles may exceed their range by this much [rad] under load. Our choice, ten times the angle at which a
/// servo gives its default torque limit.
const OVERSHOOT: f64 = 0.5;

const ABOUT: &str = "\
The robot starts at rest, with random errors of the joint angles of up to `angle_noise`. A commanded speed is drawn from `command` and
a commanded yaw speed from `turn`; both stay the same for the episode. The reference of each servo moves to its target within the
control step, at 13 rad/s or less. `slope_deg` tilts the sand.

Rewards use velocities relative to the base's heading. v_forward (`speed` in `info`) and v_left are the displacements of the base's
centre in a control step, along its heading on the surface and to the left of it, divided by the step's duration. The heading is
the mean of those at the beginning and the end of the step. `x_velocity` is the displacement along x, uphill, divided by this duration.

An episode terminates when the base lies on its back (`flipped`) or its centre is 15 mm under the surface (`buried`); it is
truncated after `max_episode_steps`, or when its state can no longer be computed (`diverged`).

The cost of transport of several steps is Σ`work` / (`weight` · distance).";

/// `STOPS`: do the joints have stops at the ends of their ranges?
pub struct HexapodLegs<const STOPS: bool> {
    spec: Spec,
    weights: Weights,
    observation: Features<Observe>,
    figures: Features<Figure>,
    /// Middle and half width of each joint's range [rad].
    ranges: Vec<[f64; 2]>,
}

impl<const STOPS: bool> Task for HexapodLegs<STOPS> {
    const ID: &'static str = if STOPS { "sandgait/HexapodLegs-v2" } else { "sandgait/HexapodLegs-v1" };
    type Options = LegsOptions;

    fn engine(options: &LegsOptions) -> EngineKind {
        options.walking.engine
    }

    fn model(options: &LegsOptions) -> Result<Model> {
        let mut model = options.walking.model(true)?;
        if !STOPS {
            model.legs.iter_mut().flatten().for_each(|body| body.range = None);
        }
        Ok(model)
    }

    fn new(setup: &Setup<LegsOptions>) -> Result<Self> {
        let Walking { weights, torque_limit, max_episode_steps, .. } = setup.options.walking;
        let model = setup.model;
        let joints = &model.robot.joint_names();
        let links = model.robot.hip.iter().flat_map(|_| &model.robot.leg.link);
        let bounds = links.map(|link| link.range).collect::<Option<Vec<_>>>();
        let bounds = bounds.ok_or_else(|| {
            Error::invalid(
                "robot",
                format!("{:?} has joints without a range; this task drives angles", model.robot.name),
            )
        })?;
        let angle = |(name, [low, high]): (&String, &[f64; 2])| {
            Column::new(format!("joint angle, {name}"), "rad", low - OVERSHOOT, high + OVERSHOOT)
        };
        let observation = locomotion::base_features()
            .group(joints.iter().zip(&bounds).map(angle), |o, i| o.state.angles[i])
            .sensed(Sensor::JointPosition)
            .each(joints, "joint speed", "rad/s", JOINT_SPEED, |o, i| o.state.rates[i])
            .sensed(Sensor::JointVelocity)
            .each(joints, "joint torque", "N·m", torque_limit, |o, i| o.state.torques[i])
            .sensed(Sensor::JointTorque)
            .each(joints, "previous action", "1", 1.0, |o, i| o.last_action[i].into())
            .and(locomotion::command_features());
        let (figures, reward) = (locomotion::figures(), weights.terms());
        let spec = Spec {
            id: Self::ID,
            summary: format!(
                "Follow commanded forward and yaw speeds with three joints a leg; actions are target angles over each joint's range, {}.",
                if STOPS { "at whose ends it stops" } else { "which a load can exceed" }
            ),
            observation: observation.columns(),
            action: Column::each(joints, "target angle over the joint's range", "1", 1.0),
            about: ABOUT,
            info: [Column::rewards(&reward), figures.columns()].concat(),
            reward,
            max_episode_steps,
            control_rate: CONTROL_RATE,
        };
        let ranges = bounds.iter().map(|[low, high]| [(high + low) / 2.0, (high - low) / 2.0]).collect();
        Ok(Self { spec, weights, observation, figures, ranges })
    }

    fn spec(&self) -> &Spec {
        &self.spec
    }

    fn begin(&self, setup: &Setup<LegsOptions>, random: &mut Random) -> (State, TaskState) {
        walking::begin(&setup.with(&setup.options.walking), random)
    }

    /// Moves the servos' references to the targets within the control step, no faster than [`TARGET_SPEED`].
    fn command(&self, action: &[f32], state: &State, command: &mut Command) {
        for (i, ([middle, half], a)) in self.ranges.iter().zip(action).enumerate() {
            let target = middle + half * f64::from(*a);
            command.rates[i] = ((target - state.references[i]) * CONTROL_RATE).clamp(-TARGET_SPEED, TARGET_SPEED);
        }
    }

    fn command_ranges(&self, setup: &Setup<LegsOptions>) -> Option<[[f64; 2]; 3]> {
        Some(setup.options.walking.command_ranges())
    }

    fn observe(&self, task_state: &TaskState, state: &State, last_action: &[f32], row: &mut [f32]) {
        Observed::new(task_state, state, last_action).fill(&self.observation, row);
    }

    fn evaluate(&self, _setup: &Setup<LegsOptions>, transition: &Transition, info: &mut [f32]) -> bool {
        let step = WalkStep::new(transition);
        step.fill(&self.weights, &self.figures, info);
        step.terminated
    }
}
