//! Standing pose and gains: from the file, from values that replace the file's, or computed
//! ([`crate::sim::tree::stance`], [`crate::sim::tree::gains`]).

use super::Import;
use super::draft::{self, BaseFrame, DraftLink, Merged};
use super::notes::Notes;
use crate::error::{Error, Result};
use crate::sand::Medium;
use crate::sim::Model;
use crate::sim::model::Scene;
use crate::sim::tree::contact::{ContactPoint, contact_points};
use crate::sim::tree::joint_values::by_pattern;
use crate::sim::tree::stability::first_to_diverge;
use crate::sim::tree::stance::Stance;
use crate::sim::tree::{HardGround, JointKind, Tree, TreeJoint, TreeModel, gains};
use nalgebra::Vector3;
use serde::Deserialize;
use std::cmp::Ordering;
use std::collections::BTreeMap;

/// A joint's position counts as within its range if it is at most this far outside [rad or m]: our choice, because
/// files round numbers to three digits.
const ROUNDING: f64 = 1e-3;
/// A joint of a leg that is at most this far outside of its range [rad; a tenth of it in m] stands at the range's end instead:
/// our choice, 3°, which moves a foot by a twentieth of the leg's length.
const SLIGHTLY: f64 = 0.05;

/// Values that replace a description's values, by patterns of joint names.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Posture {
    /// [rad or m]
    pub default_joint_angles: BTreeMap<String, f64>,
    /// [N·m/rad or N/m]
    pub stiffness: BTreeMap<String, f64>,
    /// [N·m·s/rad or N·s/m]
    pub damping: BTreeMap<String, f64>,
}

/// The joints whose pose and gains were computed, because neither the file nor a posture has them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FoundJoints {
    pub rest: Vec<bool>,
    pub kp: Vec<bool>,
    pub kd: Vec<bool>,
}

impl FoundJoints {
    pub fn none(joints: usize) -> Self {
        Self { rest: vec![false; joints], kp: vec![false; joints], kd: vec![false; joints] }
    }

    pub fn any(&self) -> bool {
        [&self.rest, &self.kp, &self.kd].into_iter().flatten().any(|found| *found)
    }
}

impl Posture {
    /// Replaces the values of the joints that the patterns match.
    pub fn lay_over(&self, tree: &mut Tree) -> Result<()> {
        type Field = fn(&mut TreeJoint) -> &mut Option<f64>;
        let fields: [(&str, &BTreeMap<String, f64>, Field); 3] = [
            ("default_joint_angles", &self.default_joint_angles, |j| &mut j.rest),
            ("stiffness", &self.stiffness, |j| &mut j.kp),
            ("damping", &self.damping, |j| &mut j.kd),
        ];
        for (option, values, field) in fields {
            let found = by_pattern(tree, option, values)?;
            for (joint, value) in joints(tree).zip(found) {
                *field(joint) = value.or(*field(joint));
            }
        }
        Ok(())
    }
}

fn joints(tree: &mut Tree) -> impl Iterator<Item = &mut TreeJoint> {
    tree.bodies.iter_mut().filter_map(|b| b.joint.as_mut())
}

/// Height of an origin above the ground, as a part of that of the hips, for which the origin counts as in the body: our
/// choice. Robots have their origins between their bellies and their chests; `base_footprint` (ROS, REP 120) is near 0.
const IN_BODY: std::ops::RangeInclusive<f64> = 0.5..=2.0;

/// A robot that stands in its pose.
pub struct StandingRobot {
    pub merged: Merged,
    pub stance: Stance,
    pub found: FoundJoints,
    pub pose: FilePose,
    /// The base's origin in the frame of the file's root [m].
    pub base_at: Vector3<f64>,
}

impl StandingRobot {
    fn of(mut merged: Merged, posture: &Posture, base_at: Vector3<f64>) -> Result<Self> {
        posture.lay_over(&mut merged.tree)?;
        let (stance, found, pose) = settle(&mut merged.tree, posture);
        Ok(Self { merged, stance, found, pose, base_at })
    }

    /// The robot with its base's frame in the body. A root's frame outside, as one on the ground, is replaced by that of the
    /// link in the body that is nearest to the hips' height, or else by the middle of the hips, so that heights and velocities
    /// of the base are those of the body.
    pub fn in_body(merged: Merged, links: &[DraftLink], posture: &Posture, notes: &mut Notes) -> Result<Self> {
        let joints: Vec<Option<TreeJoint>> = merged.tree.bodies.iter().map(|b| b.joint.clone()).collect();
        let own = Self::of(merged, posture, Vector3::zeros())?;
        let (tree, stance) = (&own.merged.tree, &own.stance);
        if stance.legs.is_empty() || is_in_body(tree, stance, Vector3::zeros()) {
            return Ok(own);
        }
        let others = BaseFrame::others(links, stance.hips);
        let off = |frame: &BaseFrame| (frame.place(links).z - stance.hips.z).abs();
        let (hips, linked) = others.split_last().map_or((None, &others[..]), |(last, linked)| (Some(last), linked));
        let inside = |frame: &&BaseFrame| is_in_body(tree, stance, frame.place(links));
        let nearest = linked.iter().filter(inside).min_by(|a, b| off(a).total_cmp(&off(b)));
        let Some(frame) = nearest.or(hips.filter(inside)).copied() else { return Ok(own) };
        let mut moved = draft::merged(&tree.name, links, frame)?;
        (moved.base_is_free, moved.tree.gravity) = (own.merged.base_is_free, tree.gravity);
        for (body, joint) in moved.tree.bodies.iter_mut().zip(joints) {
            body.joint = joint;
        }
        let place = frame.place(links);
        let [x, y, z]: [f64; 3] = place.into();
        notes.say(format!(
            "the root's frame lies outside of the body; here the base's origin is at {x:.3} {y:.3} {z:.3} m in it"
        ));
        Self::of(moved, posture, place)
    }
}

/// Is this place of the base's frame in the body: near the height of the hips, or between the base's lowest and highest
/// point, and not farther than half of the hips' height (our choice, as for heights) beside base and hips?
fn is_in_body(tree: &Tree, stance: &Stance, place: Vector3<f64>) -> bool {
    let share = (stance.height + place.z) / stance.hips_height();
    let points = contact_points(tree);
    let ends = |p: &ContactPoint| [p.center.add_scalar(-p.radius), p.center.add_scalar(p.radius)];
    let corners = || points[0].iter().flat_map(ends).chain([tree.bodies[0].center, stance.hips]);
    let within = |k: usize, beside: f64, more: &[Vector3<f64>]| {
        let all = corners().chain(more.iter().copied());
        let [low, high] = all.fold([f64::MAX, f64::MIN], |[low, high], p| [low.min(p[k]), high.max(p[k])]);
        (low - beside..=high + beside).contains(&place[k])
    };
    let first = |leg: &Vec<usize>| leg.first().map(|body| tree.bodies[*body].origin.translation.vector);
    let starts: Vec<Vector3<f64>> = stance.legs.iter().filter_map(first).collect();
    let beside = IN_BODY.start() * stance.hips_height();
    (IN_BODY.contains(&share) || within(2, 0.0, &[])) && (0..2).all(|k| within(k, beside, &starts))
}

/// What became of the file's standing pose.
#[derive(Clone, Debug, PartialEq)]
pub enum FilePose {
    Kept,
    /// These joints were moved to the ends of their ranges.
    Clamped(Vec<String>),
    /// Why another pose was found.
    Ignored(&'static str),
}

impl FilePose {
    pub fn note(&self, notes: &mut Notes) {
        match self {
            Self::Kept => {}
            Self::Clamped(joints) => joints.iter().for_each(|joint| {
                let done = "its position in the file's standing pose is outside of its range; it stands at the end of its range";
                notes.part("joint", joint, done);
            }),
            Self::Ignored(reason) => notes.say(format!(
                "the file's standing pose is left out, because {reason}; a pose was found in its place"
            )),
        }
    }
}

/// Computes pose and gains for the joints that have none. Returns the stance, these joints, and what became of the file's
/// pose.
pub fn settle(tree: &mut Tree, laid_over: &Posture) -> (Stance, FoundJoints, FilePose) {
    let contacts = contact_points(tree);
    let (stance, pose) = standing(tree, &contacts, laid_over);
    let motors = gains::motors(tree, &contacts, &stance);
    let found = FoundJoints {
        rest: tree.joints().map(|j| j.rest.is_none()).collect(),
        kp: tree.joints().map(|j| j.kp.is_none()).collect(),
        kd: tree.joints().map(|j| j.kd.is_none()).collect(),
    };
    for ((joint, motor), angle) in joints(tree).zip(motors).zip(&stance.angles) {
        (joint.kp, joint.kd) = (joint.kp.or(Some(motor.kp)), joint.kd.or(Some(motor.kd)));
        joint.rest = joint.rest.or(Some(*angle));
    }
    (stance, found, pose)
}

/// The stance in the file's pose. A computed pose replaces the file's pose if more legs stand in it, or if as many legs
/// stand in it and the joints' ranges exclude the file's pose.
fn standing(tree: &mut Tree, contacts: &[Vec<ContactPoint>], laid_over: &Posture) -> (Stance, FilePose) {
    let mut own = Stance::of(tree, contacts);
    if tree.joints().any(|j| j.rest.is_none()) {
        return (own, FilePose::Kept);
    }
    let (mut outside, mut pose) = (false, FilePose::Kept);
    if laid_over.default_joint_angles.is_empty() && tree.joints().any(stands_outside) {
        let clamped = clamp(tree, &own.legs);
        if !clamped.is_empty() {
            (own, pose) = (Stance::of(tree, contacts), FilePose::Clamped(clamped));
        }
        outside = tree.joints().any(stands_outside);
    }
    let mut free = tree.clone();
    joints(&mut free).for_each(|j| j.rest = None);
    let found = Stance::of(&free, contacts);
    let reason = match found.legs.len().cmp(&own.legs.len()) {
        Ordering::Greater => "not all legs stand in it",
        Ordering::Equal if outside => "joints cannot take it within their ranges",
        _ => return (own, pose),
    };
    *tree = free;
    (found, FilePose::Ignored(reason))
}

/// Moves joints that stand outside of their ranges to the ends of these: those beside the legs, and those that are slightly
/// outside.
/// Returns their names.
fn clamp(tree: &mut Tree, legs: &[Vec<usize>]) -> Vec<String> {
    let mut names = Vec::new();
    for (i, body) in tree.bodies.iter_mut().enumerate() {
        let Some(joint) = body.joint.as_mut().filter(|joint| stands_outside(joint)) else { continue };
        let Some((q, [low, high])) = joint.rest.zip(joint.range) else { continue };
        let (end, beside) = (q.clamp(low, high), !legs.is_empty() && !legs.iter().any(|leg| leg.contains(&i)));
        let slight = SLIGHTLY * if joint.kind == JointKind::Slide { 0.1 } else { 1.0 };
        if beside || (q - end).abs() <= slight {
            joint.rest = Some(end);
            names.push(joint.name.clone());
        }
    }
    names
}

/// Is the joint's position in the standing pose outside of its range?
pub fn stands_outside(joint: &TreeJoint) -> bool {
    let beyond = |q: f64, [low, high]: [f64; 2]| q < low - ROUNDING || q > high + ROUNDING;
    joint.rest.zip(joint.range).is_some_and(|(q, range)| beyond(q, range))
}

/// Time steps that are tried for a robot's file [s]: LeggedVelocity's default, and by halves to the finest that `--check`
/// can ask for.
const STEPS: [f64; 4] = [2e-3, 1e-3, 5e-4, 2.5e-4];

impl Import {
    /// The time step that the robot's motion needs to be computed at all; None: the default.
    ///
    /// # Errors
    /// No time step suffices; names the joint that moves fastest.
    pub fn needed_step(&self) -> Result<Option<f64>> {
        let mut joint = String::new();
        for dt in STEPS {
            let plates = vec![Vec::new(); self.tree.bodies.len()];
            let tree = TreeModel::new(self.tree.clone(), plates)?.with_self_contact();
            let scene =
                Scene { dt, hard: vec![HardGround::everywhere()], ..Scene::flat(Medium::named(Medium::DEFAULT)?) };
            match first_to_diverge(&Model::of_tree(tree, &scene)?)? {
                None => return Ok((dt < STEPS[0]).then_some(dt)),
                Some(fastest) => joint = fastest,
            }
        }
        let reason = format!(
            "{:?}: its motion cannot be computed, even with time steps of {} ms; joint {joint:?} moves fastest: look at its \
             limits, gains and inertia",
            self.tree.name,
            1e3 * STEPS[STEPS.len() - 1]
        );
        Err(Error::invalid("robot", reason))
    }

    /// Refuses what is no legged robot.
    pub fn check_legged(&self) -> Result<()> {
        let (legs, tree) = (&self.stance.legs, &self.tree);
        let known_free = self.base_is_free && legs.first().is_some_and(|leg| leg.len() > 1);
        if legs.len() > 1 || (legs.len() == 1 && known_free) {
            return Ok(());
        }
        if tree.bodies.iter().all(|body| body.shapes.is_empty()) {
            let reason = format!(
                "{:?} has no collision shapes, with which legs touch the ground: add <collision> or <geom>",
                tree.name
            );
            return Err(Error::invalid("robot", reason));
        }
        let found = match legs.first().and_then(|leg| leg.last()) {
            Some(end) => format!("one branch, which ends in {:?}", tree.bodies[*end].name),
            None => "none".into(),
        };
        let fixed = if legs.len() == 1 { "; with one leg, a base that moves freely (<freejoint/>)" } else { "" };
        Err(Error::invalid(
            "robot",
            format!(
                "{:?} is no legged robot: looked for two branches of joints that end in a collision shape below the base and \
                 move it up and down{fixed}; found {found} among {} joints",
                tree.name,
                tree.joints().count()
            ),
        ))
    }
}
