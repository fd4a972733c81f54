//! The parts that all walking tasks share: reward terms, how episodes end, and the base's part of the observation.

use super::feature::{Features, flag};
use super::sensors::Sensor;
use super::task::{TaskState, Transition};
use crate::reward_terms;
use crate::sim::State;
use crate::sim::model::GRAVITY;

/// Largest speed that can be commanded, forward or backward [m/s]: our choice, above the 0.7 m/s that the reference
/// robot reaches at 5 Hz.
pub const MAX_COMMAND: f64 = 2.0;

/// Largest yaw speed that can be commanded, left or right [rad/s]: our choice, half a turn a second.
pub const MAX_TURN: f64 = 3.0;

/// The robot counts as buried if the base's centre is this far below the surface [m]: our choice, half the reference
/// base's height.
const BURIED: f64 = -0.015;

/// Bounds of the observation, some three times what random hip speeds reach on a slope of 20°; values beyond are
/// clipped. gymnasium warns of spaces without bounds.
const BASE_SPEED: f64 = 5.0; // [m/s]
const BASE_TURN: f64 = 100.0; // [rad/s]

/// The arguments of an observation's functions.
pub struct Observed<'a> {
    pub task_state: &'a TaskState,
    pub state: &'a State,
    pub last_action: &'a [f32],
    /// The sand's normal, reversed, which is gravity's direction on level sand only; LeggedVelocity has gravity itself.
    /// This and the next fields, the base's velocities, are in the body frame.
    pub gravity: [f64; 3],
    pub velocity: [f64; 3],
    pub angular_velocity: [f64; 3],
}

/// Computes one number of an observation.
pub type Observe = fn(&Observed, usize) -> f64;

impl<'a> Observed<'a> {
    pub fn new(task_state: &'a TaskState, state: &'a State, last_action: &'a [f32]) -> Self {
        let r = state.rotation();
        let body = |v: [f64; 3]| [0, 1, 2].map(|i| r[0][i] * v[0] + r[1][i] * v[1] + r[2][i] * v[2]);
        let (velocity, angular_velocity) = (body(state.velocity), body(state.angular_velocity));
        Self { task_state, state, last_action, gravity: body([0.0, 0.0, -1.0]), velocity, angular_velocity }
    }

    /// Fills a row.
    pub fn fill(&self, features: &Features<Observe>, row: &mut [f32]) {
        features.fill(row, |value, place| value(self, place));
    }
}

/// The columns that every observation begins with.
pub fn base_features() -> Features<Observe> {
    Features::<Observe>::none()
        .xyz("gravity direction, body frame,", "1", 1.0, |o, i| o.gravity[i])
        .sensed(Sensor::Gravity)
        .xyz("base velocity, body frame,", "m/s", BASE_SPEED, |o, i| o.velocity[i])
        .sensed(Sensor::LinVel)
        .xyz("base angular velocity, body frame,", "rad/s", BASE_TURN, |o, i| o.angular_velocity[i])
        .sensed(Sensor::Gyroscope)
}

/// The columns of the command.
pub fn command_features() -> Features<Observe> {
    Features::<Observe>::none().one("commanded speed", "m/s", -MAX_COMMAND, MAX_COMMAND, |o, _| o.task_state.speed).one(
        "commanded yaw speed",
        "rad/s",
        -MAX_TURN,
        MAX_TURN,
        |o, _| o.task_state.turn,
    )
}

/// Direction of the base's x axis along the surface: cosine and sine of its heading.
pub fn heading(state: &State) -> [f64; 2] {
    let rotation = state.rotation();
    direction([rotation[0][0], rotation[1][0]]).unwrap_or([1.0, 0.0])
}

/// A vector's direction; None if the vector is almost zero. Our choice of 1e-9 is above the rounding of unit vectors.
fn direction([x, y]: [f64; 2]) -> Option<[f64; 2]> {
    let norm = x.hypot(y);
    (norm > 1e-9).then(|| [x / norm, y / norm])
}

/// Mean velocity of the base's centre over a step, forward and to the left [m/s]: its displacement over time, in the
/// frame of the heading halfway between the headings before and after the step. A policy that does not observe its
/// heading can follow a command in this frame. legged_gym (`_reward_tracking_lin_vel`, base frame) and Isaac Lab
/// (`track_lin_vel_xy_yaw_frame_exp`) reward the same.
fn heading_velocity(t: &Transition) -> [f64; 2] {
    let [before, after] = [t.before, t.after].map(heading);
    // If the robot makes half a turn within the step, the halfway heading is undefined.
    let [cos, sin] = direction([before[0] + after[0], before[1] + after[1]]).unwrap_or(after);
    let [x, y] = [0, 1].map(|i| (t.after.position[i] - t.before.position[i]) / t.period);
    [cos * x + sin * y, cos * y - sin * x]
}

/// Cost of a deviation of `x` tolerances: x² for small ones, 2 |x| for large ones (pseudo-Huber loss: Charbonnier
/// et al. 1994; Barron, CVPR 2019, eq. 1 with α = 1, doubled). Our choice: with a bounded cost, deviations beyond
/// the bound would cost nothing more, and the squares of a tumbling robot would dominate all other terms.
fn cost(x: f64) -> f64 {
    2.0 * ((1.0 + x * x).sqrt() - 1.0)
}

reward_terms! {
    /// Weight of each reward term. Before weighting, all terms are of order 1 in a step; `termination` counts once in
    /// an episode. Our choice: tracking dominates, and the costs decide between gaits of the same speed. `alive` and
    /// `termination` make sure that falling is never rewarded: a robot that stands gets `alive` in each step, which is
    /// more than standing costs on any slope, and a fall costs as much as 4 s of `alive` (tests/falls.rs). gymnasium's
    /// Ant has `healthy_reward`, Isaac Lab `is_alive` and `is_terminated`. v_forward, v_left: the base's mean velocity
    /// over the step in its heading frame; ω_z: its yaw speed after the step.
    pub struct Weights of WalkStep<'_>, weights in [0.0, 1e3] {
        tracking: 1.0, "exp(−((v_forward − commanded speed) / 0.1 m/s)²)", |w| (-((w.forward - w.t.task_state.speed) / 0.1).powi(2)).exp();
        lateral: 0.1, "−2 (√(1 + (v_left / 0.1 m/s)²) − 1)", |w| -cost(w.left / 0.1);
        turning: 0.05, "−2 (√(1 + ((ω_z − commanded yaw speed) / 1 rad/s)²) − 1)", |w| -cost(w.t.after.angular_velocity[2] - w.t.task_state.turn);
        power: 0.1, "−mechanical power Σ|τ ω| / 1 W", |w| -w.work / w.t.period;
        smoothness: 0.05, "−mean squared change of the action", |w| -change_of_action(w.t);
        alive: 0.1, "1, and 0 in the step that terminates the episode", |w| 1.0 - flag(w.terminated);
        termination: 20.0, "−1 in the step that terminates the episode", |w| -flag(w.terminated);
    }
}

/// The arguments of reward terms and figures.
pub struct WalkStep<'a> {
    pub t: &'a Transition<'a>,
    /// Mean velocity in the heading frame [m/s].
    pub forward: f64,
    pub left: f64,
    /// [J]
    pub work: f64,
    pub flipped: bool,
    pub buried: bool,
    pub terminated: bool,
}

/// Computes one figure of a step.
pub type Figure = fn(&WalkStep, usize) -> f64;

impl<'a> WalkStep<'a> {
    pub fn new(t: &'a Transition<'a>) -> Self {
        let [forward, left] = heading_velocity(t);
        let (flipped, buried) = (t.after.rotation()[2][2] < 0.0, t.after.position[2] < BURIED);
        let terminated = !t.diverged && (flipped || buried);
        Self { t, forward, left, work: t.after.work - t.before.work, flipped, buried, terminated }
    }

    /// Fills an info row: terms weighted by `weights`, then `figures`.
    pub fn fill(&self, weights: &Weights, figures: &Features<Figure>, info: &mut [f32]) {
        let (rewards, rest) = info.split_at_mut(info.len() - figures.len());
        weights.fill(self, 1.0, rewards);
        figures.fill(rest, |value, place| value(self, place));
    }
}

/// Info columns after the reward's terms.
pub fn figures() -> Features<Figure> {
    Features::<Figure>::none()
        .free("speed", "m/s", |w, _| w.forward)
        .free("x_velocity", "m/s", |w, _| (w.t.after.position[0] - w.t.before.position[0]) / w.t.period)
        .free("commanded_speed", "m/s", |w, _| w.t.task_state.speed)
        .one("work", "J", 0.0, f64::INFINITY, |w, _| w.work)
        .one("weight", "N", 0.0, f64::INFINITY, |w, _| w.t.model.total_mass() * GRAVITY)
        .flag("flipped", |w, _| flag(w.flipped))
        .flag("buried", |w, _| flag(w.buried))
        .flag("diverged", |w, _| flag(w.t.diverged))
}

fn change_of_action(t: &Transition) -> f64 {
    let changes = t.action.iter().zip(t.previous_action).map(|(a, b)| f64::from(a - b).powi(2));
    changes.sum::<f64>() / t.action.len() as f64
}
