//! Options of LeggedVelocity: names and defaults after legged_gym (Rudin et al. 2022, `legged_robot_config.py`) where it has
//! them.

use super::curriculum::Curriculum;
use super::draws::{Commands, DomainRand, Draws, MOST_COMMAND};
use super::reward::{Rewards, TRACKING_SIGMA};
use super::units::Units;
use crate::error::{Error, Result, check_range};
use crate::options;
use crate::options::RobotName;
use crate::sand::{Law, Medium, Regularization};
use crate::sim::Model;
use crate::sim::model::Scene;
use crate::sim::tree::gains::TreeMotor;
use crate::sim::tree::joint_values::by_pattern;
use crate::sim::tree::relief::{REPOSE_DEG, Relief};
use crate::sim::tree::{HardGround, JointKind, TreeJoint, TreeModel, heights};
use crate::walking::{MAX_STEPS, set_sand};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::sync::Arc;

/// Least of `max_velocity` [m/s or rad/s]: our choice, which catches wrong units.
const LEAST_VELOCITY: f64 = 1e-3;

options! {
    /// Options of LeggedVelocity. `dt`: our choice, twice the hexapods' time step, because hexapods' feet move faster.
    /// With this time step a trot of the test quadruped differed from a trot at 0.125 ms by up to 5 % in sand and 10 %
    /// on hard ground; with 1 ms, by 8 % on hard ground. Episodes take 20 s as in legged_gym. `angle_noise`: our
    /// choice, so that starts differ. legged_gym has an `action_scale` of 0.25 and no bounds on actions. Here actions
    /// are within ± 1, and with a scale of 0.25 Go1's feet would move too little to walk; so the scale of each joint
    /// follows from its torque limit and gain.
    pub struct LeggedOptions {
        robot: RobotName = RobotName::TREE.into(), "built-in robot sandcat, or a packed robot file (in Python its path)";
        law: Law = Law::Li2013, "resistive force law: li2013, penetration-drag-1d or agarwal2023";
        dt: f64 = 2e-3, "time step [s], which divides the control period";
        angle_noise: f64 = 0.1, [0.0, PI], reset, "largest difference of the initial joint angles from the default pose, uniformly distributed [rad]";
        sand: String = String::new(), "text of a sand.toml, for example from a diagnosis (in Python its path); it replaces medium and law";
        slope_deg: f64 = 0.0, [-Scene::MAX_SLOPE_DEG, Scene::MAX_SLOPE_DEG], reset, "slope of the surface [°]; a positive slope rises toward +x";
        payload: f64 = 0.0, [0.0, Scene::MAX_PAYLOAD], reset, "extra mass at the base's centre [kg]";
        max_episode_steps: u32 = 1000, [1.0, MAX_STEPS], "number of control steps after which an episode is truncated";
        ground: String = Medium::DEFAULT.into(), reset, "rigid, mixed (slabs of hard ground in loose poppy seeds), dunes (of loose poppy seeds), any (drawn: rigid or 1 to 16 times poppy-loose), a medium's name, zeta=VALUE, or mu=VALUE,rho=VALUE";
        curriculum: Option<Curriculum> = Some(Curriculum::default()), reset, "an environment's episodes become harder while its robot follows its commands, and easier while it does not; None: all have full difficulty";
        max_velocity: Option<[f64; 3]> = None, [LEAST_VELOCITY, MOST_COMMAND], reset, "greatest speeds forward, to the left [m/s] and yaw [rad/s]: ends of the commands' default ranges, units of tracking terms; None: 0.5 √(gℓ), 0.25 √(gℓ) and 0.2 √(g/ℓ) with the legs' length ℓ";
        commands: Commands = Commands::default(), reset, "ranges [low, high] of commands, which are drawn repeatedly";
        rewards: Rewards = Rewards::default(), reset, "weight of each reward term [1/s]";
        tracking_sigma: f64 = TRACKING_SIGMA, [1e-3, 10.0], reset, "width of the tracking terms (legged_gym: 0.25)";
        tracking_shaping: bool = false, reset, "with gait_clock: tracking terms count a step's change of the mean velocity at once";
        domain_rand: Option<DomainRand> = Some(DomainRand::default()), reset, "ranges [low, high] of the quantities that an episode draws; None: nothing is drawn";
        default_joint_angles: BTreeMap<String, f64> = BTreeMap::new(), [-100.0, 100.0], reset, "default positions of joints by pattern of their names [rad]";
        stiffness: BTreeMap<String, f64> = BTreeMap::new(), [0.0, 1e6], reset, "position gains kp of servos by pattern of joint names [N·m/rad]";
        damping: BTreeMap<String, f64> = BTreeMap::new(), [0.0, 1e5], reset, "speed gains kd of servos by pattern of joint names [N·m·s/rad]";
        action_scale: Option<f64> = None, [1e-3, 3.0], reset, "offset of a joint's target at action 1 [rad]; None: where the servo gives full torque, but 0.4 to 0.5 rad";
        joints: String = JOINTS[0].into(), "joints that actions move: all or legs; the others hold their default position";
        relief: Option<ReliefOptions> = None, "heights of the ground; None: the ground is flat, except with ground dunes";
        memory: bool = false, "sand that was moved stays moved: prints, furrows and heaps, and sand that is pressed gets stronger (docs/memory.md)";
        self_contact: bool = true, "legs do not pass through each other or the base: capsules around each body's contacts, without friction";
        gait_clock: Option<f64> = None, [0.01, 10.0], "frequency of an observed clock (sine, cosine) from the episode's start [Hz]; tracking terms then take a stride's mean velocity";
        measure_heights: bool = false, "the observation has the ground's heights at legged_gym's 187 points";
    }
}

options! {
    /// Random dunes by a seed, or heights that the user gives. Defaults: three lengths of a robot from crest to
    /// crest, and a slope that affects the gait; our choice. The spacing is legged_gym's (`horizontal_scale`).
    #[derive(Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct ReliefOptions {
        seed: u64 = 0, "seed of random dunes";
        wavelength: f64 = 2.0, [Relief::WAVELENGTH], "approximate distance from crest to crest of dunes [m]";
        slope_deg: f64 = 15.0, [0.0, REPOSE_DEG], "greatest slope of dunes [°]";
        heights: Option<Vec<Vec<f64>>> = None, "heights instead of dunes [m]: rows along y, each with heights along x";
        file: String = String::new(), "packed heights of a file (in Python and on the command line the path of a .csv or .npy file)";
        spacing: f64 = 0.1, [Relief::SPACING], "distance between neighbouring heights, from heights or from file [m]";
    }
}

impl ReliefOptions {
    fn relief(&self) -> Result<Relief> {
        let packed = match (&self.heights, &self.file[..]) {
            (_, "") => None,
            (Some(_), _) => return Err(Error::invalid("relief", "heights and file are both given")),
            (None, text) if heights::is_packed(text) => Some(heights::unpack(text)?),
            (None, _) => {
                let reason = "is no packed text; Python and the command line read a file's path, a server opens none";
                return Err(Error::invalid("relief.file", reason));
            }
        };
        match self.heights.as_ref().or(packed.as_ref()) {
            Some(rows) => Relief::new(self.spacing, rows),
            None => Relief::dunes(self.seed, self.wavelength, self.slope_deg),
        }
    }
}

impl LeggedOptions {
    pub(super) fn draws(&self, units: &Units) -> Draws {
        let rand = self.domain_rand.unwrap_or(DomainRand::NONE);
        let Commands { resampling_time, single_axis, .. } = self.commands;
        let (commands, small, steps) = (units.ranges(&self.commands), units.small(), self.max_episode_steps);
        Draws { commands, resampling_time, single_axis, small, rand, steps, any_ground: self.ground == ANY }
    }

    pub(super) fn model(&self) -> Result<Model> {
        let interval = self.domain_rand.map_or(0.0, |rand| rand.push_interval);
        // Our choice: at least five control steps from a push to the next.
        if interval != 0.0 {
            check_range("domain_rand.push_interval", interval, 0.1..=1e4)?;
        }
        let (hard, medium) = ground(&self.ground)?;
        let mut scene = Scene { hard, surface: Regularization::SOLID, ..Scene::flat(medium) };
        (scene.law, scene.slope_deg, scene.dt, scene.payload) = (self.law, self.slope_deg, self.dt, self.payload);
        set_sand(&mut scene, &self.sand)?;
        let dunes = (self.ground == DUNES).then(ReliefOptions::default);
        if let Some(relief) = self.relief.as_ref().or(dunes.as_ref()) {
            if self.slope_deg != 0.0 {
                return Err(Error::invalid("slope_deg", "a relief defines the slopes; leave out slope_deg"));
            }
            scene.relief = Some(Arc::new(relief.relief()?));
        }
        let tree = self.tree()?;
        if self.memory {
            scene.remember_tree(&tree);
        }
        Model::of_tree(tree, &scene)
    }

    /// The robot, with the pose and gains of the options.
    fn tree(&self) -> Result<TreeModel> {
        let mut tree = self.robot.tree()?;
        let values = |option, values| by_pattern(&tree.tree, option, values);
        let angles = values("default_joint_angles", &self.default_joint_angles)?;
        let (stiffness, damping) = (values("stiffness", &self.stiffness)?, values("damping", &self.damping)?);
        if !self.default_joint_angles.is_empty() {
            within_ranges(&tree, &angles)?;
            tree = tree.standing_at(&angles);
        }
        for (motor, (kp, kd)) in tree.motors.iter_mut().zip(stiffness.into_iter().zip(damping)) {
            (motor.kp, motor.kd) = (kp.unwrap_or(motor.kp), kd.unwrap_or(motor.kd));
        }
        Ok(if self.self_contact { tree.with_self_contact() } else { tree })
    }
}

/// Refuses a default pose that a joint cannot take: its stop would throw the robot. A thousandth is rounding.
fn within_ranges(tree: &TreeModel, angles: &[Option<f64>]) -> Result<()> {
    for (joint, angle) in tree.tree.joints().zip(angles) {
        let (Some(angle), Some([low, high])) = (angle, joint.range) else { continue };
        if !(low - 1e-3..=high + 1e-3).contains(angle) {
            let reason = format!("{:?} at {angle} is outside of its range, {low} to {high}", joint.name);
            return Err(Error::invalid("default_joint_angles", reason));
        }
    }
    Ok(())
}

/// Least and greatest scale of an action [rad]. The least is our choice: with it a foot moves by some 0.4 lengths of the leg.
/// The greatest is that of Isaac Lab's velocity tasks; joints without a known torque limit have it, too.
const SCALES: [f64; 2] = [0.4, 0.5];
/// Scale of a sliding joint without a range, as a part of the legs' length: our choice, less than the 0.4 of a hinge.
const SLIDING: f64 = 0.25;

/// Values of the option `joints`.
const JOINTS: [&str; 2] = ["all", LEGS];
/// With this value, joints that are in no leg are held.
pub const LEGS: &str = "legs";

/// Do actions move the joints of legs alone?
pub(super) fn legs_alone(joints: &str) -> Result<bool> {
    let place = JOINTS.iter().position(|known| *known == joints);
    place.map(|k| k == 1).ok_or_else(|| Error::unknown("joints", joints, &JOINTS))
}

/// The joints that have motors, by their places. Joints that follow others are in neither list.
pub(super) struct Driven {
    /// The joint of each action, and the offset of its target at action 1 [rad or m].
    pub by_actions: Vec<(usize, f64)>,
    /// Joints that hold their default positions.
    pub held: Vec<usize>,
}

/// What actions drive in `tree`. `given`: the option `action_scale`; `legs`: joints that are in no leg are held.
pub(super) fn driven(tree: &TreeModel, given: Option<f64>, legs: bool) -> Driven {
    let (upper, followers) = (tree.upper_joints(), tree.tree.followers());
    let scale = |(joint, motor): (&TreeJoint, &TreeMotor)| match (joint.kind, motor.actuator.torque_limit) {
        (JointKind::Slide, _) => joint.range.map_or(SLIDING * tree.stance.leg_length, |[low, high]| (high - low) / 2.0),
        (_, Some(limit)) if motor.kp > 0.0 => (limit / motor.kp).clamp(SCALES[0], SCALES[1]),
        _ => SCALES[1],
    };
    let scales = tree.tree.joints().zip(&tree.motors).map(|joint| given.unwrap_or_else(|| scale(joint)));
    let motors = scales.enumerate().filter(|(i, _)| followers.iter().all(|f| f.joint != *i));
    let (held, by_actions): (Vec<_>, Vec<_>) = motors.partition(|(i, _)| legs && upper.contains(i));
    Driven { by_actions, held: held.into_iter().map(|(i, _)| i).collect() }
}

/// Kinds of ground besides media: hard ground, slabs of hard ground in sand, dunes, and what an episode draws.
const GROUNDS: [&str; 4] = ["rigid", "mixed", DUNES, ANY];
/// Loose sand that is not flat.
const DUNES: &str = "dunes";
/// Ground that each episode draws, so that a policy learns to walk on all of it: hard ground, or sand of a hidden strength.
pub const ANY: &str = "any";
/// Depth of the hard ground below the sand of [`ANY`] [m], the largest that is allowed: no robot comes so deep.
const FAR_BELOW: f64 = 10.0;
/// Size of the slabs of `mixed`, and distance from one to the next [m]: our choice, one or two lengths of a robot.
const SLABS: [f64; 2] = [0.8, 1.6];

/// Hard ground of the given kind, and the medium of the sand.
fn ground(name: &str) -> Result<(Vec<HardGround>, Medium)> {
    let sand = || Medium::named(Medium::DEFAULT);
    let [size, every] = SLABS.map(|length| [length; 2]);
    match name {
        "rigid" => Ok((vec![HardGround::everywhere()], sand()?)),
        DUNES => Ok((Vec::new(), sand()?)),
        ANY => Ok((vec![HardGround { depth: FAR_BELOW, ..HardGround::everywhere() }], sand()?)),
        "mixed" => Ok((vec![HardGround { size, every, ..HardGround::everywhere() }], sand()?)),
        _ => {
            let media = Medium::names();
            let medium = Medium::named(name).map_err(|e| match e {
                Error::Unknown { .. } => Error::unknown("ground", name, &[&GROUNDS[..], &media].concat()),
                other => other,
            });
            Ok((Vec::new(), medium?))
        }
    }
}
