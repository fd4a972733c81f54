//! The columns of LeggedVelocity's observation, and the figures of its `info`.

use super::draws::MOST_COMMAND;
use super::reward::LeggedStep;
use crate::feature::{Features, flag};
use crate::sensors::Sensor;
use crate::sim::{Model, State};
use crate::spec::Column;
use crate::task::TaskState;

/// Bounds of the observation; values beyond are clipped. Our choice: some three times the values of a falling robot.
const SPEED: f64 = 10.0; // [m/s]
const TURN: f64 = 30.0; // [rad/s]
const JOINT_SPEED: f64 = 100.0; // [rad/s]
const JOINT_OFFSET: f64 = std::f64::consts::TAU; // [rad]

/// The arguments of an observation's functions.
pub struct LeggedObserved<'a> {
    pub task_state: &'a TaskState,
    pub state: &'a State,
    pub last_action: &'a [f32],
    /// Default position of each joint [rad].
    pub default: &'a [f64],
    pub command: [f64; 3],
    pub gravity: [f64; 3],
    pub velocity: [f64; 3],
    pub angular_velocity: [f64; 3],
    /// Direction of the base's x axis: sine and cosine of the heading.
    pub heading: (f64, f64),
    /// Sine and cosine of the clock's phase.
    pub clock: [f64; 2],
}

/// Columns of the clock. A mirror image is half a stride later, so both change sign.
pub const CLOCK: [&str; 2] = ["clock sine", "clock cosine"];

impl LeggedObserved<'_> {
    /// Height of the base's origin above the ground at measured point `i`, less 0.5 m, as in legged_gym.
    fn measured_height(&self, i: usize) -> f64 {
        let Some(model) = &self.task_state.model else { return 0.0 };
        let ([x, y, z], [a, b], (sin, cos)) = (self.state.position, measured(i), self.heading);
        let ground = model.surface_height(x + cos * a - sin * b, y + sin * a + cos * b);
        (z - 0.5 - ground).clamp(-1.0, 1.0)
    }
}

/// Computes one number of an observation.
pub type Observe = fn(&LeggedObserved, usize) -> f64;

/// Computes one figure of a step.
pub type Figure = fn(&LeggedStep, usize) -> f64;

/// `clock`: does the observation have a clock? `heights`: the ground's heights?
pub fn observation(joints: &[String], motors: &[String], clock: bool, heights: bool) -> Features<Observe> {
    let height = |i: usize| {
        let [x, y] = measured(i);
        Column::new(format!("measured_heights {x:.1} {y:.1}"), "m", -1.0, 1.0)
    };
    let measured = if heights { MEASURED[0] * MEASURED[1] } else { 0 };
    Features::<Observe>::none()
        .xyz("base_lin_vel", "m/s", SPEED, |o, i| o.velocity[i])
        .sensed(Sensor::LinVel)
        .xyz("base_ang_vel", "rad/s", TURN, |o, i| o.angular_velocity[i])
        .sensed(Sensor::Gyroscope)
        .xyz("projected_gravity", "1", 1.0, |o, i| o.gravity[i])
        .sensed(Sensor::Gravity)
        .one("commanded lin_vel_x", "m/s", -MOST_COMMAND, MOST_COMMAND, |o, _| o.command[0])
        .one("commanded lin_vel_y", "m/s", -MOST_COMMAND, MOST_COMMAND, |o, _| o.command[1])
        .one("commanded ang_vel_yaw", "rad/s", -MOST_COMMAND, MOST_COMMAND, |o, _| o.command[2])
        .each(joints, "joint_pos off its default", "rad", JOINT_OFFSET, |o, i| o.state.angles[i] - o.default[i])
        .sensed(Sensor::JointPosition)
        .each(joints, "joint_vel", "rad/s", JOINT_SPEED, |o, i| o.state.rates[i])
        .sensed(Sensor::JointVelocity)
        .each(motors, "last action", "1", 1.0, |o, i| o.last_action[i].into())
        .group(CLOCK[..if clock { 2 } else { 0 }].iter().map(|name| Column::new(*name, "1", -1.0, 1.0)), |o, i| {
            o.clock[i]
        })
        .group((0..measured).map(height), |o, i| o.measured_height(i))
        .sensed(Sensor::Heights)
}

/// Does a foot bear load?
pub fn contact(foot: &String) -> Column {
    Column::new(format!("contact, {foot}"), "1", 0.0, 1.0)
}

/// Info columns after the reward's columns.
pub fn figures(feet: &[String]) -> Features<Figure> {
    Features::<Figure>::none()
        .free("speed", "m/s", |s, _| s.velocity[0])
        .free("lin_vel_y", "m/s", |s, _| s.velocity[1])
        .free("ang_vel_yaw", "rad/s", |s, _| s.angular_velocity[2])
        .free("x_velocity", "m/s", |s, _| (s.t.after.position[0] - s.t.before.position[0]) / s.t.period)
        .free("command_lin_vel_x", "m/s", |s, _| s.legged.now[0])
        .free("command_lin_vel_y", "m/s", |s, _| s.legged.now[1])
        .free("command_ang_vel_yaw", "rad/s", |s, _| s.legged.now[2])
        .free("feet_in_contact", "1", |s, _| s.contacts.feet.iter().filter(|touches| **touches).count() as f64)
        .group(feet.iter().map(contact), |s, i| flag(s.contacts.feet[i]))
        .free("base_height", "m", |s, _| hips_height(s.t.model, s.t.after))
        .free("work", "J", |s, _| s.t.after.work - s.t.before.work)
        .free("weight", "N", |s, _| s.t.model.weight())
        .free("friction", "1", |s, _| s.legged.friction)
        .free("sand", "1", |s, _| if s.legged.hard { 0.0 } else { s.legged.sand })
        .free("level", "1", |s, _| s.legged.level)
        .free("added_mass", "kg", |s, _| s.legged.added_mass)
        .free("motor_strength", "1", |s, _| s.legged.motor_strength)
        .free("bad_orientation", "1", |s, _| flag(s.fallen && !s.t.diverged))
        .free("base_contact", "1", |s, _| flag(s.base_contact && !s.t.diverged))
        .free("diverged", "1", |s, _| flag(s.t.diverged))
        .free("base_low", "1", |s, _| flag(s.too_low && !s.t.diverged))
}

/// Height of the middle of the hips above the ground [m].
pub fn hips_height(model: &Model, state: &State) -> f64 {
    let over = |x, y| model.surface_height(x, y);
    model.tree.as_ref().map_or(0.0, |tree| tree.hips_over(state, over))
}

/// Gravity's direction, velocity and angular velocity in the base's frame. On inclined sand gravity is not along −z,
/// because z is the sand's normal. `model` is that of the episode; without an episode the sand is level.
pub fn base(model: Option<&Model>, state: &State) -> [[f64; 3]; 3] {
    let down = model.map_or([0.0, 0.0, -1.0], |model| (model.gravity / model.gravity.norm()).into());
    [down, state.velocity, state.angular_velocity].map(|v| state.to_body(v))
}

/// Points around the robot whose heights are observed: numbers of points along and across, 0.1 m apart, as in
/// legged_gym (`measured_points_x`, `measured_points_y`).
const MEASURED: [usize; 2] = [17, 11];

/// Position of point `i` [m].
fn measured(i: usize) -> [f64; 2] {
    let [ahead, aside] = [i / MEASURED[1], i % MEASURED[1]];
    [0.1 * (ahead as f64 - 8.0), 0.1 * (aside as f64 - 5.0)]
}
