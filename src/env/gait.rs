//! `sandgait/HexapodGait-v0`: follow a commanded forward speed on flat or sloping sand, one speed command a hip.

use super::options::{MAX_COMMAND, TaskOptions};
use super::random::Random;
use super::spec::{Column, Spec};
use super::task::{Goal, Setup, Task, Transition};
use crate::error::{Error, Result, check_range};
use crate::sim::State;
use crate::sim::engine::Command;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// Hip speed at action 1 [rad/s]: 5 Hz, the highest stride frequency of Li et al. 2012.
const TOP_SPEED: f64 = 5.0 * TAU;

/// Control steps a second: 50, usual for legged robots of this size.
const CONTROL_RATE: f64 = 50.0;

/// The base's centre this far under the surface [m] counts as buried: half the reference base's height.
const BURIED: f64 = -0.015;

/// Bounds of the observation, some three times what random hip speeds reach on a slope of 20°; what goes beyond is
/// clipped. gymnasium warns of spaces without bounds.
const BASE_SPEED: f64 = 5.0; // [m/s]
const BASE_TURN: f64 = 100.0; // [rad/s]
const HIP_SPEED: f64 = 3.0 * TOP_SPEED; // [rad/s]

/// Weight of each reward term; all terms are of order 1 a step before weighting. Our choice: tracking dominates, the
/// others only break ties between gaits of the same speed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Weights {
    /// exp(−((v − v_cmd)/0.1 m/s)²), v the base's mean forward speed over the control step.
    pub tracking: f64,
    /// −(lateral speed / 0.1 m/s)², at least −1.
    pub lateral: f64,
    /// −(yaw speed / 1 rad/s)², at least −1.
    pub turning: f64,
    /// −mechanical power / 1 W, at least −1.
    pub power: f64,
    /// −mean squared change of action.
    pub smoothness: f64,
}

impl Default for Weights {
    fn default() -> Self {
        Self { tracking: 1.0, lateral: 0.1, turning: 0.05, power: 0.1, smoothness: 0.05 }
    }
}

impl Weights {
    /// Name and value, in the order of the info columns.
    fn named(&self) -> [(&'static str, f64); 5] {
        [
            ("tracking", self.tracking),
            ("lateral", self.lateral),
            ("turning", self.turning),
            ("power", self.power),
            ("smoothness", self.smoothness),
        ]
    }

    pub fn validate(&self) -> Result<()> {
        self.named().iter().try_for_each(|(name, w)| check_range(&format!("weights.{name}"), *w, 0.0..=1e3).map(drop))
    }
}

pub struct HexapodGait {
    spec: Spec,
    weights: [f64; 5],
}

impl HexapodGait {
    pub const ID: &'static str = "sandgait/HexapodGait-v0";

    pub fn new(setup: &Setup) -> Result<Self> {
        let robot = &setup.model.robot;
        if robot.leg.link.len() != 1 {
            return Err(Error::invalid(
                "robot",
                format!("{:?} has several joints a leg; this task drives hips", robot.name),
            ));
        }
        Ok(Self {
            spec: Self::table(&robot.joint_names(), &setup.options),
            weights: setup.options.weights.named().map(|w| w.1),
        })
    }

    fn table(joints: &[String], options: &TaskOptions) -> Spec {
        let observation = [
            Column::xyz("gravity direction, body frame,", "1", 1.0),
            Column::xyz("base velocity, body frame,", "m/s", BASE_SPEED),
            Column::xyz("base angular velocity, body frame,", "rad/s", BASE_TURN),
            Column::each(joints, "sine of hip angle", "1", 1.0),
            Column::each(joints, "cosine of hip angle", "1", 1.0),
            Column::each(joints, "hip speed", "rad/s", HIP_SPEED),
            Column::each(joints, "hip torque", "N·m", options.torque_limit),
            Column::each(joints, "previous action", "1", 1.0),
            vec![Column::new("commanded speed", "m/s", -MAX_COMMAND, MAX_COMMAND)],
        ];
        let terms = options.weights.named().map(|(name, _)| Column::free(format!("reward_{name}"), "1"));
        let figures = [
            Column::free("speed", "m/s"),
            Column::free("commanded_speed", "m/s"),
            Column::new("work", "J", 0.0, f64::INFINITY),
            Column::new("flipped", "1", 0.0, 1.0),
            Column::new("buried", "1", 0.0, 1.0),
            Column::new("diverged", "1", 0.0, 1.0),
        ];
        Spec {
            id: Self::ID,
            summary: "Follow a commanded forward speed on sand; actions are hip speeds as fractions of 5 Hz.",
            observation: observation.concat(),
            action: Column::each(joints, "target hip speed / 5 Hz", "1", 1.0),
            reward_terms: terms.len(),
            info: terms.into_iter().chain(figures).collect(),
            max_episode_steps: options.max_episode_steps,
            control_rate: CONTROL_RATE,
        }
    }
}

impl Task for HexapodGait {
    fn spec(&self) -> &Spec {
        &self.spec
    }

    /// At rest on the surface, legs near the alternating tripod's start.
    fn begin(&self, setup: &Setup, random: &mut Random) -> (State, Goal) {
        let options = &setup.options;
        let mut angles = setup.model.tripod_angles();
        angles.iter_mut().for_each(|a| *a += random.uniform(-options.angle_noise, options.angle_noise));
        let goal = Goal { speed: random.uniform(options.command[0], options.command[1]) };
        (State::at_rest(setup.model.standing_height(&angles), &angles), goal)
    }

    fn command(&self, action: &[f32], _state: &State, command: &mut Command) {
        for (rate, a) in command.rates.iter_mut().zip(action) {
            *rate = f64::from(*a) * TOP_SPEED;
        }
    }

    fn observe(&self, goal: &Goal, state: &State, last_action: &[f32], row: &mut [f32]) {
        let r = state.rotation();
        let body = |v: [f64; 3]| [0, 1, 2].map(|i| r[0][i] * v[0] + r[1][i] * v[1] + r[2][i] * v[2]);
        let joints = state.angles.len();
        let (head, rest) = row.split_at_mut(9);
        let vectors = [body([0.0, 0.0, -1.0]), body(state.velocity), body(state.angular_velocity)];
        head.iter_mut().zip(vectors.as_flattened()).for_each(|(out, v)| *out = *v as f32);
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

    fn judge(&self, t: &Transition, info: &mut [f32]) -> bool {
        let speed = (t.after.position[0] - t.before.position[0]) / t.period;
        let lateral = (t.after.position[1] - t.before.position[1]) / t.period;
        let work = t.after.work - t.before.work;
        let changes = t.action.iter().zip(t.previous_action).map(|(a, b)| f64::from(a - b).powi(2));
        let terms = [
            (-((speed - t.goal.speed) / 0.1).powi(2)).exp(),
            -(lateral / 0.1).powi(2).min(1.0),
            -t.after.angular_velocity[2].powi(2).min(1.0),
            -(work / t.period).min(1.0),
            -changes.sum::<f64>() / t.action.len() as f64,
        ];
        let up = t.after.rotation()[2][2];
        let (flipped, buried) = (up < 0.0, t.after.position[2] < BURIED);
        let flag = |b: bool| f32::from(u8::from(b));
        let (rewards, figures) = info.split_at_mut(terms.len());
        rewards.iter_mut().zip(terms.iter().zip(self.weights)).for_each(|(out, (term, w))| *out = (term * w) as f32);
        figures.copy_from_slice(&[
            speed as f32,
            t.goal.speed as f32,
            work as f32,
            flag(flipped),
            flag(buried),
            flag(t.diverged),
        ]);
        !t.diverged && (flipped || buried)
    }
}
