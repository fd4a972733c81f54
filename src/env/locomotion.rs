//! What every walking task shares: reward terms, how episodes begin and end, and the base's part of the observation.

use super::options::{MAX_COMMAND, MAX_TURN, TaskOptions, Weights};
use super::random::Random;
use super::spec::Column;
use super::task::{Goal, Setup, Transition};
use crate::sim::State;
use crate::sim::model::GRAVITY;

/// Control steps a second: 50, usual for legged robots of this size.
pub const CONTROL_RATE: f64 = 50.0;

/// The base's centre this far under the surface [m] counts as buried: half the reference base's height.
const BURIED: f64 = -0.015;

/// Bounds of the observation, some three times what random hip speeds reach on a slope of 20°; what goes beyond is
/// clipped. gymnasium warns of spaces without bounds.
const BASE_SPEED: f64 = 5.0; // [m/s]
const BASE_TURN: f64 = 100.0; // [rad/s]

/// Numbers of the base in an observation row.
pub const BASE_COLUMNS: usize = 9;

/// Gravity's direction and the base's velocities, all in the body frame.
pub fn base_columns() -> Vec<Column> {
    let columns = [
        Column::xyz("gravity direction, body frame,", "1", 1.0),
        Column::xyz("base velocity, body frame,", "m/s", BASE_SPEED),
        Column::xyz("base angular velocity, body frame,", "rad/s", BASE_TURN),
    ];
    columns.concat()
}

/// Fills [`base_columns`].
pub fn observe_base(state: &State, row: &mut [f32]) {
    let r = state.rotation();
    let body = |v: [f64; 3]| [0, 1, 2].map(|i| r[0][i] * v[0] + r[1][i] * v[1] + r[2][i] * v[2]);
    let vectors = [body([0.0, 0.0, -1.0]), body(state.velocity), body(state.angular_velocity)];
    row.iter_mut().zip(vectors.as_flattened()).for_each(|(out, v)| *out = *v as f32);
}

/// What is commanded.
pub fn command_columns() -> Vec<Column> {
    vec![
        Column::new("commanded speed", "m/s", -MAX_COMMAND, MAX_COMMAND),
        Column::new("commanded yaw speed", "rad/s", -MAX_TURN, MAX_TURN),
    ]
}

/// Fills [`command_columns`].
pub fn observe_command(goal: &Goal, row: &mut [f32]) {
    row.copy_from_slice(&[goal.speed as f32, goal.turn as f32]);
}

/// Where the base's x axis points along the surface: cosine and sine of its heading.
pub fn heading(state: &State) -> [f64; 2] {
    let rotation = state.rotation();
    direction([rotation[0][0], rotation[1][0]]).unwrap_or([1.0, 0.0])
}

/// A vector's direction, unless it has none.
fn direction([x, y]: [f64; 2]) -> Option<[f64; 2]> {
    let norm = x.hypot(y);
    (norm > 1e-9).then(|| [x / norm, y / norm])
}

/// Mean velocity of the base's centre over a step, forward and to the left [m/s]: its displacement, seen in the heading
/// halfway between before and after. A robot that cannot observe its heading can follow this. legged_gym
/// (`_reward_tracking_lin_vel`, base frame) and Isaac Lab (`track_lin_vel_xy_yaw_frame_exp`) pay it too.
fn heading_velocity(t: &Transition) -> [f64; 2] {
    let [before, after] = [t.before, t.after].map(heading);
    // After half a turn within the step there is no halfway.
    let [cos, sin] = direction([before[0] + after[0], before[1] + after[1]]).unwrap_or(after);
    let [x, y] = [0, 1].map(|i| (t.after.position[i] - t.before.position[i]) / t.period);
    [cos * x + sin * y, cos * y - sin * x]
}

/// What a deviation of `x` tolerances costs: x² where it is small, 2 |x| where it is large (pseudo-Huber loss: Charbonnier
/// et al. 1994; Barron, CVPR 2019, eq. 1 with α = 1, doubled). Our choice: a bounded cost makes everything beyond its bound
/// free, and squares of what a tumbling robot does would swamp all other terms.
fn cost(x: f64) -> f64 {
    2.0 * ((1.0 + x * x).sqrt() - 1.0)
}

/// Weighted reward terms, then figures of the step.
pub fn info_columns() -> Vec<Column> {
    let terms = Weights::default().terms();
    let terms: Vec<_> = terms.iter().map(|t| Column::free(format!("reward_{}", t.name), "1")).collect();
    let figures = [
        Column::free("speed", "m/s"),
        Column::free("x_velocity", "m/s"),
        Column::free("commanded_speed", "m/s"),
        Column::new("work", "J", 0.0, f64::INFINITY),
        Column::new("weight", "N", 0.0, f64::INFINITY),
        Column::new("flipped", "1", 0.0, 1.0),
        Column::new("buried", "1", 0.0, 1.0),
        Column::new("diverged", "1", 0.0, 1.0),
    ];
    terms.into_iter().chain(figures).collect()
}

/// At rest on the surface, joints near their start, commands drawn from the options' ranges.
pub fn begin(setup: &Setup, random: &mut Random) -> (State, Goal) {
    let TaskOptions { angle_noise, command, turn, .. } = setup.options;
    let mut angles = setup.model.tripod_angles();
    angles.iter_mut().for_each(|a| *a += random.uniform(-angle_noise, angle_noise));
    let [speed, turn] = [command, turn].map(|[low, high]| random.uniform(low, high));
    let goal = Goal { speed, turn, ..Goal::default() };
    (State::at_rest(setup.model.standing_height(&angles), &angles), goal)
}

/// Fills an info row and says whether the robot flipped or is buried.
pub fn judge(weights: &Weights, t: &Transition, info: &mut [f32]) -> bool {
    let [forward, left] = heading_velocity(t);
    let work = t.after.work - t.before.work;
    let up = t.after.rotation()[2][2];
    let (flipped, buried) = (up < 0.0, t.after.position[2] < BURIED);
    let terminated = !t.diverged && (flipped || buried);
    let (rewards, figures) = info.split_at_mut(weights.values().len());
    let weighted = terms(t, forward, left, work, terminated).into_iter().zip(weights.values());
    rewards.iter_mut().zip(weighted).for_each(|(out, (term, w))| *out = (term * w) as f32);
    let flag = |b: bool| f32::from(u8::from(b));
    figures.copy_from_slice(&[
        forward as f32,
        ((t.after.position[0] - t.before.position[0]) / t.period) as f32,
        t.goal.speed as f32,
        work as f32,
        (t.model.total_mass() * GRAVITY) as f32,
        flag(flipped),
        flag(buried),
        flag(t.diverged),
    ]);
    terminated
}

/// The reward's terms, in the order of [`Weights`].
fn terms(t: &Transition, forward: f64, left: f64, work: f64, terminated: bool) -> [f64; 7] {
    let changes = t.action.iter().zip(t.previous_action).map(|(a, b)| f64::from(a - b).powi(2));
    let ended = f64::from(u8::from(terminated));
    [
        (-((forward - t.goal.speed) / 0.1).powi(2)).exp(),
        -cost(left / 0.1),
        -cost(t.after.angular_velocity[2] - t.goal.turn),
        -work / t.period,
        -changes.sum::<f64>() / t.action.len() as f64,
        1.0 - ended,
        -ended,
    ]
}
