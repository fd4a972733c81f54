//! Simulates a robot whose joints move as logged; its base is free.
//!
//! The engines have no prescribed joint angles, only servos. So a replay has servos so stiff that they follow the log, and their
//! torque is the torque that the motion needs. A foot on firm sand makes a large force of a small lag: servos that lagged by four
//! millirads changed the torques of a trotting quadruped by a quarter.

use super::log::Run;
use super::windows::Window;
use crate::error::{Error, Result};
use crate::experiment::Experiment;
use crate::progress::Latch;
use crate::robots;
use crate::sand::Law;
use crate::series::{central_difference, interpolate};
use crate::sim::actuator::Actuator;
use crate::sim::engine::{Command, Engine, EngineKind};
use crate::sim::model::{GRAVITY, Scene};
use crate::sim::tree::{JointKind, TreeModel};
use crate::sim::{Model, Robot, State};
use std::path::Path;
use std::sync::Arc;

type V = nalgebra::Vector3<f64>;

/// Angle by which a joint of a robot from a URDF or MJCF file lags in a replay under a torque of the robot's weight times the length
/// of its legs [rad]: our choice. Numbers of 32 bits resolve an angle of 1 rad to 1e-7, so a torque to a thousandth of this one. A
/// joint that slides lags by this share of the legs' length under the weight.
const LAG: f64 = 1e-4;
/// Time in which such a lag is reached, kd/kp [s]: our choice, as that of the reference hexapod's servos.
const LAG_TIME: f64 = 0.01;
/// Stiffness of a replay's servos as a multiple of the robot's own, for our own robots, whose joints turn and turn: our choice.
/// Numbers of 32 bits then still resolve the torque to a hundredth of its rms.
const STIFFER: f64 = 20.0;
/// The law of a replay's sand: the diagnosis has no other.
pub const LAW: Law = Law::Li2013;
/// Time in which the angular velocity of a robot's base from a URDF or MJCF file follows that of the log, as a share of the time scale
/// √(length of the legs/g) of a fall: our choice. A walk on two feet is unstable, so a small error of its replay would grow to a fall.
/// The replay is the predictor of an observer with this gain (Ljung, System Identification, 1999, section 4.3): a replay of the robot
/// and the sand of the log is not changed by it.
const FOLLOWS: f64 = 0.6;
/// Number of signals in addition to the torques: angular velocity, specific force, upward direction (three each, in the base's frame),
/// horizontal speed and height.
pub const SIGNALS: usize = 11;
/// Time simulated after a window [s], for sensors with a delay: our choice, three prior standard deviations of it.
pub const BEYOND: f64 = 0.03;
/// Number of ticks between two checks for a cancellation: our choice, a quarter of a second of a walk.
const CHECK_INTERVAL: usize = 256;

/// A robot, from our own description or from a URDF or MJCF file.
#[derive(Clone)]
pub enum ReplayRobot {
    Legged(Box<Robot>),
    /// A robot from a URDF or MJCF file, and the shapes that touch sand: indices of a body and of one of its shapes.
    Tree(Arc<TreeModel>, Arc<Vec<(usize, usize)>>),
}

impl ReplayRobot {
    pub fn of(experiment: &Experiment) -> Result<Self> {
        let touches = experiment.file.touches.as_deref();
        Self::load(experiment.file.robot.as_deref().unwrap_or("xplorer"), touches)
    }

    /// A built-in robot, our own TOML, or a URDF or MJCF file.
    pub fn load(name: &str, touches: Option<&[String]>) -> Result<Self> {
        let lower = name.to_ascii_lowercase();
        if ![".urdf", ".xml", ".mjcf"].iter().any(|end| lower.ends_with(end)) {
            return match touches {
                None => Ok(Self::Legged(Box::new(Robot::load(name)?))),
                Some(_) => Err(Error::invalid("touches", "only robots from URDF and MJCF files take this key")),
            };
        }
        let import = robots::load(Path::new(name))?;
        let touching = import.touching(touches)?;
        let bare = TreeModel::new(import.tree, Vec::new())?;
        Ok(Self::Tree(Arc::new(bare.with_fine_plates(&touching, LAW)?), Arc::new(touching)))
    }

    pub fn joint_names(&self) -> Vec<String> {
        match self {
            Self::Legged(robot) => robot.joint_names(),
            Self::Tree(tree, _) => tree.tree.joints().map(|j| j.name.clone()).collect(),
        }
    }

    /// The same robot with another leg shape. Robots from URDF and MJCF files have no choice of legs.
    pub fn with_leg(&self, leg: Option<&str>) -> Result<Self> {
        match (self, leg) {
            (Self::Legged(robot), Some(leg)) => Ok(Self::Legged(Box::new(robot.as_ref().clone().with_leg_shape(leg)?))),
            (Self::Tree(..), Some(_)) => {
                Err(Error::invalid("leg", "only built-in robots and robots from TOML take a leg"))
            }
            (own, None) => Ok(own.clone()),
        }
    }

    /// Gains of each joint's servo: kp [N·m/rad], kd [N·m·s/rad]; 0 if the joint has none.
    pub fn gains(&self) -> Vec<[f64; 2]> {
        match self {
            Self::Legged(robot) => vec![[robot.servo.kp, robot.servo.kd]; robot.joint_names().len()],
            Self::Tree(tree, _) => {
                let known = |j: &crate::sim::tree::TreeJoint| [j.kp.unwrap_or(0.0), j.kd.unwrap_or(0.0)];
                tree.tree.joints().map(known).collect()
            }
        }
    }

    /// The model with stiff servos, whose joints follow their targets. If the file of one of our robots has no stiffness, the
    /// robot's own is its weight times the base's length (our choice).
    pub fn model(&self, scene: &Scene) -> Result<Model> {
        match self {
            Self::Legged(robot) => {
                let mut model = Model::new(robot, scene)?;
                let weight = model.total_mass() * GRAVITY;
                let kp = if robot.servo.kp > 0.0 { robot.servo.kp } else { weight * robot.base.size[0] };
                // If the robot's file has no damping, kd/kp is that of the reference hexapod.
                let kd = if robot.servo.kd > 0.0 { robot.servo.kd } else { LAG_TIME * kp };
                model.motor.kp = STIFFER * kp;
                model.motor.kd = STIFFER * kd;
                let free = 1e9;
                model.motor.actuator = Actuator::default();
                (model.motor.speed_limit, model.motor.lag_limit) = (free, free);
                Ok(model)
            }
            Self::Tree(tree, _) => {
                let mut stiff = tree.as_ref().clone();
                let (weight, length) = (tree.mass() * GRAVITY, tree.stance.leg_length);
                for (motor, joint) in stiff.motors.iter_mut().zip(tree.tree.joints()) {
                    let slides = joint.kind == JointKind::Slide;
                    motor.kp = if slides { weight / (LAG * length) } else { weight * length / LAG };
                    motor.kd = LAG_TIME * motor.kp;
                    (motor.speed_limit, motor.actuator) = (None, Actuator::default());
                }
                Model::of_tree(stiff, scene)
            }
        }
    }

    pub fn engine(&self) -> EngineKind {
        match self {
            Self::Legged(_) => EngineKind::Lanes,
            Self::Tree(..) => EngineKind::Tree,
        }
    }
}

/// Smooths a logged angle, which has the steps of an encoder: a cubic fitted to seven samples (Savitzky & Golay 1964).
pub fn smoothed(q: &[f64]) -> Vec<f64> {
    const WEIGHTS: [f64; 7] = [-2.0, 3.0, 6.0, 7.0, 6.0, 3.0, -2.0];
    let n = q.len();
    let at = |i: usize| {
        if i < 3 || i + 3 >= n {
            return q[i];
        }
        WEIGHTS.iter().zip(&q[i - 3..]).map(|(w, v)| w * v).sum::<f64>() / 21.0
    };
    (0..n).map(at).collect()
}

/// Cubic interpolation with slopes from the neighbouring samples (Catmull & Rom 1974).
fn between(t: &[f64], q: &[f64], at: f64) -> f64 {
    let n = t.len();
    let right = t.partition_point(|&p| p < at).clamp(1, n - 1);
    let left = right - 1;
    let h = t[right] - t[left];
    let s = ((at - t[left]) / h).clamp(0.0, 1.0);
    let [m0, m1] = [left, right].map(|i| h * central_difference(t, q, i, 1));
    let (s2, s3) = (s * s, s * s * s);
    (2.0 * s3 - 3.0 * s2 + 1.0) * q[left] + (s3 - 2.0 * s2 + s) * m0 + (3.0 * s2 - 2.0 * s3) * q[right] + (s3 - s2) * m1
}

/// The logged motion in a window, tick by tick. A tick is a time step of the engine: with several steps in a tick, the joints would be
/// accelerated in the first of them.
#[derive(Clone)]
pub struct LoggedMotion {
    pub tick: f64,
    pub ticks: usize,
    joints: usize,
    /// Joint angles, all joints one after the other [rad].
    angles: Vec<f64>,
    /// Angular velocity of the base in its own frame [rad/s]; empty if the base does not follow it.
    turning: Vec<V>,
}

impl LoggedMotion {
    /// `guide`: where the gyro is mounted; None: the base does not follow it.
    pub fn new(run: &Run, window: &Window, tick: f64, guide: Option<&Guide>) -> Self {
        let ticks = ((window.end() + BEYOND - window.from) / tick).ceil() as usize;
        let joints = run.q.len();
        let mut angles = vec![0.0; joints * (ticks + 1)];
        for (j, q) in run.q.iter().enumerate() {
            let smooth = smoothed(q);
            for k in 0..=ticks {
                angles[k * joints + j] = between(&run.t, &smooth, window.from + k as f64 * tick);
            }
        }
        let turning = match guide {
            Some(guide) if !run.gyro[0].is_empty() => {
                let at = |k: usize| guide.turning(run, window.from + k as f64 * tick);
                (0..=ticks).map(at).collect()
            }
            _ => Vec::new(),
        };
        Self { tick, ticks, joints, angles, turning }
    }

    /// The same motion with one joint's angle larger by `value` [rad].
    pub fn turned(&self, joint: usize, value: f64) -> Self {
        let mut new = self.clone();
        new.angles.iter_mut().skip(joint).step_by(self.joints).for_each(|angle| *angle += value);
        new
    }

    /// Joints that stay at these angles.
    #[cfg(test)]
    pub fn held(angles: &[f64], ticks: usize, tick: f64) -> Self {
        Self { tick, ticks, joints: angles.len(), angles: angles.repeat(ticks + 1), turning: Vec::new() }
    }

    /// Speeds of the joints over a tick [rad/s].
    fn rates(&self, tick: usize) -> impl Iterator<Item = f64> {
        self.at(tick).iter().zip(self.at(tick + 1)).map(|(from, to)| (to - from) / self.tick)
    }

    fn at(&self, tick: usize) -> &[f64] {
        let k = tick.min(self.ticks);
        &self.angles[k * self.joints..][..self.joints]
    }
}

/// The logged motion in all windows.
pub fn drives(runs: &[Run], windows: &[Window], tick: f64, guide: Option<&Guide>) -> Vec<LoggedMotion> {
    windows.iter().map(|window| LoggedMotion::new(&runs[window.run], window, tick, guide)).collect()
}

/// How the gyro is mounted.
pub struct Guide {
    /// Rotation from the IMU's frame to the base's.
    pub turn: nalgebra::Matrix3<f64>,
    /// Delay of its readings [s].
    pub delay: f64,
}

impl Guide {
    /// Angular velocity of the base in its own frame at a time [rad/s].
    fn turning(&self, run: &Run, time: f64) -> V {
        self.turn * V::from_fn(|k, _| interpolate(&run.t, &run.gyro[k], time + self.delay))
    }
}

/// The result of one replay: each signal at every tick, first the torques, then the other [`SIGNALS`] signals. The first value is
/// for the time one tick after the start.
#[derive(Clone, Default)]
pub struct Signals {
    pub signals: Vec<Vec<f64>>,
    /// Time step of the engine [s].
    pub step: f64,
}

impl Signals {
    pub fn empty(joints: usize, ticks: usize, step: f64) -> Self {
        Self { signals: vec![Vec::with_capacity(ticks); joints + SIGNALS], step }
    }

    /// The signal's value at a tick belongs to a time before the end of the tick; this is the difference [s]. The engines use the
    /// semi-implicit Euler method, which moves positions with the velocities at the end of a step. This is the leapfrog method, in
    /// which these velocities belong to the middle of the step (Hairer, Lubich & Wanner 2003, section 1). So forces belong to the
    /// start of a step. The change of a velocity from one tick to the next belongs to the middle between the last steps of the two
    /// ticks.
    pub fn lag(&self, signal: usize, joints: usize, tick: f64) -> f64 {
        match signal.checked_sub(joints) {
            None => self.step,
            Some(0..3 | 9) => 0.5 * self.step,
            Some(3..6) => 0.5 * (self.step + tick),
            _ => 0.0,
        }
    }
}

/// One replay: the model, its joints' motion, and the position of the IMU [m].
pub struct Replay<'a> {
    pub model: &'a Model,
    pub drive: &'a LoggedMotion,
    pub imu: [f64; 3],
}

/// Replays all tasks, distributed over the processors. The tracks are empty after a cancellation.
pub fn replay(engine: EngineKind, tasks: &[Replay], latch: &Latch) -> Result<Vec<Signals>> {
    // Each engine has one block of lanes. Tasks of similar length share an engine, so that few lanes are idle.
    let mut order: Vec<usize> = (0..tasks.len()).collect();
    order.sort_by_key(|&k| std::cmp::Reverse(tasks[k].drive.ticks));
    // All lanes of an engine have the same plates.
    let plates = |k: usize| tasks[k].model.tree.as_ref().map_or(0, |tree| Arc::as_ptr(&tree.patches).addr());
    order.sort_by_key(|&k| plates(k));
    let lanes = engine.lanes()?;
    let chunks: Vec<&[usize]> =
        order.chunk_by(|a, b| plates(*a) == plates(*b)).flat_map(|alike| alike.chunks(lanes)).collect();
    let done = crate::parallel::map(&chunks, |chunk| {
        let own: Vec<&Replay> = chunk.iter().map(|&k| &tasks[k]).collect();
        block(engine, &own, latch)
    });
    let mut all = vec![Signals::default(); tasks.len()];
    for (chunk, tracks) in chunks.iter().zip(done) {
        for (&k, track) in chunk.iter().zip(tracks?) {
            all[k] = track;
        }
    }
    Ok(all)
}

fn block(kind: EngineKind, tasks: &[&Replay], latch: &Latch) -> Result<Vec<Signals>> {
    let Some(first) = tasks.first() else { return Ok(Vec::new()) };
    let joints = first.drive.joints;
    let mut engine = Engine::new(kind, first.model, tasks.len())?;
    let mut before: Vec<State> = Vec::new();
    for (i, task) in tasks.iter().enumerate() {
        let state = start(task);
        engine.set_model(i, task.model);
        engine.set_state(i, &state);
        before.push(state);
    }
    let ticks = tasks.iter().map(|t| t.drive.ticks).max().unwrap_or(0);
    let mut tracks: Vec<Signals> =
        tasks.iter().map(|t| Signals::empty(joints, t.drive.ticks, first.model.scene.dt)).collect();
    let mut command = Command::still(joints);
    let mut now = before[0].clone();
    for k in 0..ticks {
        if k % CHECK_INTERVAL == 0 && latch.stopped() {
            return Ok(vec![Signals::default(); tasks.len()]);
        }
        for (i, task) in tasks.iter().enumerate() {
            if kind == EngineKind::Tree {
                command.targets.clear();
                command.targets.extend_from_slice(task.drive.at(k));
            }
            command.rates.clear();
            command.rates.extend(task.drive.rates(k));
            engine.command(i, &command);
        }
        engine.advance(1);
        for (i, task) in tasks.iter().enumerate().filter(|(_, t)| k < t.drive.ticks) {
            engine.state(i, &mut now);
            sample(task, &before[i], &now, &mut tracks[i]);
            if let Some(turning) = task.drive.turning.get(k + 1) {
                follow(task, &mut now, turning);
                engine.set_state(i, &now);
            }
            // The next call of `state` overwrites `now`.
            std::mem::swap(&mut before[i], &mut now);
        }
    }
    Ok(tracks)
}

/// The robot with its feet on the surface and its base at rest, parallel to the surface; its joints move as logged.
fn start(task: &Replay) -> State {
    let angles = task.drive.at(0);
    let height = match &task.model.tree {
        Some(tree) => tree.standing_height(angles),
        None => task.model.standing_height(angles),
    };
    State { rates: task.drive.rates(0).collect(), ..State::at_rest(height, angles) }
}

/// Time in which the base's angular velocity follows the log's [s].
pub fn following_time(tree: &TreeModel) -> f64 {
    FOLLOWS * (tree.stance.leg_length / GRAVITY).sqrt()
}

/// The base's angular velocity moves toward the logged one, `turning`.
fn follow(task: &Replay, now: &mut State, turning: &V) {
    let Some(tree) = &task.model.tree else { return };
    let omega = V::from(now.angular_velocity);
    now.angular_velocity = (omega + task.drive.tick / following_time(tree) * (turn(now) * turning - omega)).into();
}

/// Rotation from the base's frame to the world's.
fn turn(state: &State) -> nalgebra::Matrix3<f64> {
    let rows = state.rotation();
    nalgebra::Matrix3::from_fn(|i, j| rows[i][j])
}

/// Appends what the sensors read over the tick from `before` to `now`.
pub fn sample(task: &Replay, before: &State, now: &State, track: &mut Signals) {
    let tick = task.drive.tick;
    let turn = turn(now);
    let vector = V::from;
    let omega = vector(now.angular_velocity);
    let alpha = (omega - vector(before.angular_velocity)) / tick;
    // The change of the velocities belongs to an earlier time than the attitude (see `Signals::lag`).
    let attitude = |state: &State| {
        let [w, x, y, z] = state.orientation;
        nalgebra::Quaternion::new(w, x, y, z)
    };
    let (here, there) = (attitude(now), attitude(before));
    let there = if here.dot(&there) < 0.0 { -there } else { there };
    let then = here.lerp(&there, 0.5 * (1.0 + track.step / tick));
    let then = nalgebra::UnitQuaternion::from_quaternion(then).to_rotation_matrix().into_inner();
    let place = then * vector(task.imu);
    let acceleration = (vector(now.velocity) - vector(before.velocity)) / tick;
    let gravity = task.model.gravity;
    let specific = acceleration + alpha.cross(&place) + omega.cross(&omega.cross(&place)) - gravity;
    let up = -gravity / gravity.norm();
    let own = |v: V| turn.tr_mul(&v);
    let (gyro, acc, up) = (own(omega), then.tr_mul(&specific), own(up));
    let speed = now.velocity[0].hypot(now.velocity[1]);
    let signals = gyro.iter().chain(acc.iter()).chain(up.iter()).chain([&speed, &now.position[2]]);
    let all = now.torques.iter().chain(signals);
    track.signals.iter_mut().zip(all).for_each(|(to, value)| to.push(*value));
}
