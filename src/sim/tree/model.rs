//! A tree robot as an engine needs it: its tree, motors, and what touches the ground.

use super::Tree;
use super::contact::{ContactPoint, contact_points};
use super::stance::{Stance, frames, lowest};
use crate::error::{Error, Result, check_range};
use crate::sand::GRAVITY;
use crate::sand::intruder::Plate;
use std::sync::Arc;

/// A joint's motor and servo.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TreeMotor {
    /// [N·m/rad]
    pub kp: f64,
    /// [N·m·s/rad]
    pub kd: f64,
    /// [N·m]
    pub torque_limit: Option<f64>,
    /// [rad/s]
    pub speed_limit: Option<f64>,
}

/// How hard ground gives way under a robot, at each point that touches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Compliance {
    /// [N/m]
    pub stiffness: f64,
    /// [N·s/m]
    pub damping: f64,
    /// Speed with which a point slides that is held with all its friction [m/s].
    pub creep: f64,
}

/// Static data are shared: a robot with other masses or motors is cheap.
#[derive(Clone, Debug, PartialEq)]
pub struct TreeModel {
    pub tree: Tree,
    /// One a joint.
    pub motors: Vec<TreeMotor>,
    /// What touches sand, in the frame of each body.
    pub plates: Arc<Vec<Vec<Plate>>>,
    /// What touches hard ground, in the frame of each body.
    pub contacts: Arc<Vec<Vec<ContactPoint>>>,
    pub compliance: Compliance,
    /// How it stands.
    pub stance: Arc<Stance>,
}

/// Position at which a motor without a known gain gives all of its torque [rad]: our choice, because it gives Unitree's Go1,
/// whose limit is 23.7 N·m, about the 20 N·m/rad that legged_gym takes for its sister A1.
const FULL_TORQUE_AT: f64 = 1.0;
/// kd/kp of a servo without a known one [s]: 0.5/20, as legged_gym takes for A1 (Rudin et al. 2022).
const SETTLING: f64 = 0.025;
/// Lever [m] over which the robot's weight gives the gain where not even a torque limit is known: our choice, a shank's length.
const LEVER: f64 = 0.2;

impl Compliance {
    /// The whole weight on one point sinks it by 1 mm, damping is half of what a quarter of the mass needs to stop without
    /// swinging back, and what is held creeps with up to 1e-5 m/s, as on sand. Our choices: a foot at rest sinks by less than
    /// 0.3 mm, which no gait notices.
    pub fn of_mass(mass: f64) -> Self {
        let weight = mass * GRAVITY;
        let stiffness = weight / 1e-3;
        Self { stiffness, damping: (stiffness * mass / 4.0).sqrt(), creep: 1e-5 }
    }
}

impl TreeModel {
    /// A robot whose body `i` touches sand with `plates[i]`.
    pub fn new(tree: Tree, plates: Vec<Vec<Plate>>) -> Result<Self> {
        let contacts = contact_points(&tree);
        Self::with_contacts(tree, plates, contacts)
    }

    /// The same where the points of contact are known already.
    pub fn with_contacts(tree: Tree, plates: Vec<Vec<Plate>>, contacts: Vec<Vec<ContactPoint>>) -> Result<Self> {
        check(&tree)?;
        let (motors, compliance) = (motors(&tree), Compliance::of_mass(tree.mass()));
        let stance = Arc::new(Stance::of(&tree, &contacts));
        Ok(Self { tree, motors, plates: Arc::new(plates), contacts: Arc::new(contacts), compliance, stance })
    }

    /// With `payload` [kg] at the base's centre of mass.
    pub fn with_payload(mut self, payload: f64) -> Self {
        self.tree.bodies[0].mass += payload;
        self
    }

    /// With motors that give no more than `limit` [N·m], if that is not 0.
    pub fn with_weak_motors(mut self, limit: f64) -> Self {
        for motor in self.motors.iter_mut().filter(|_| limit > 0.0) {
            motor.torque_limit = Some(motor.torque_limit.map_or(limit, |own| own.min(limit)));
        }
        self
    }

    /// Height of the level base's origin at which the lowest point touches the ground [m], with joints at `angles`.
    pub fn standing_height(&self, angles: &[f64]) -> f64 {
        let frames = frames(&self.tree, &crate::State::at_rest(0.0, angles));
        let low = frames.iter().zip(self.contacts.iter()).map(|(f, p)| lowest(f, p).z).fold(f64::INFINITY, f64::min);
        if low.is_finite() { -low } else { 0.0 }
    }

    pub fn joints(&self) -> usize {
        self.motors.len()
    }
}

/// What readers of files promise, checked once more because engines index by it.
fn check(tree: &Tree) -> Result<()> {
    for (i, body) in tree.bodies.iter().enumerate() {
        if (i > 0 && body.parent >= i) || (i > 0) != body.joint.is_some() {
            return Err(Error::invalid("robot", format!("{}: bodies are not in depth-first order", body.name)));
        }
        check_range(&format!("mass of {}", body.name), body.mass, 0.0..=1e6)?;
    }
    match tree.bodies.first() {
        Some(_) => check_range("mass", tree.mass(), 1e-6..=1e6).map(drop),
        None => Err(Error::invalid("robot", "it has no bodies")),
    }
}

fn motors(tree: &Tree) -> Vec<TreeMotor> {
    let weight = tree.mass() * GRAVITY;
    let motor = |joint: &super::TreeJoint| {
        let kp = joint.kp.unwrap_or_else(|| joint.torque_limit.map_or(weight * LEVER, |t| t / FULL_TORQUE_AT));
        TreeMotor {
            kp,
            kd: joint.kd.unwrap_or(kp * SETTLING),
            torque_limit: joint.torque_limit,
            speed_limit: joint.speed_limit,
        }
    };
    tree.joints().map(motor).collect()
}
