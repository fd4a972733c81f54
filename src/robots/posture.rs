//! Standing pose and gains: from the file, from values that replace the file's, or computed
//! ([`crate::sim::tree::stance`], [`crate::sim::tree::gains`]).

use super::Import;
use crate::error::{Error, Result};
use crate::sim::tree::contact::{ContactPoint, contact_points};
use crate::sim::tree::joint_values::by_pattern;
use crate::sim::tree::stance::Stance;
use crate::sim::tree::{Tree, TreeJoint, gains};
use serde::Deserialize;
use std::cmp::Ordering;
use std::collections::BTreeMap;

/// A joint's position counts as within its range if it is at most this far outside [rad or m]: our choice, because
/// files round numbers to three digits.
const ROUNDING: f64 = 1e-3;

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

/// Computes pose and gains for the joints that have none. Returns the stance, these joints, and, if the file's pose is
/// ignored, the reason.
pub fn settle(tree: &mut Tree, laid_over: &Posture) -> (Stance, FoundJoints, Option<&'static str>) {
    let contacts = contact_points(tree);
    let (stance, ignored) = standing(tree, &contacts, laid_over);
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
    (stance, found, ignored)
}

/// The stance in the file's pose. A computed pose replaces the file's pose if more legs stand in it, or if as many legs
/// stand in it and the joints' ranges exclude the file's pose. If the file's pose is ignored, also returns the reason.
fn standing(tree: &mut Tree, contacts: &[Vec<ContactPoint>], laid_over: &Posture) -> (Stance, Option<&'static str>) {
    let own = Stance::of(tree, contacts);
    if tree.joints().any(|j| j.rest.is_none()) {
        return (own, None);
    }
    let outside = laid_over.default_joint_angles.is_empty() && tree.joints().any(stands_outside);
    let mut free = tree.clone();
    joints(&mut free).for_each(|j| j.rest = None);
    let found = Stance::of(&free, contacts);
    let reason = match found.legs.len().cmp(&own.legs.len()) {
        Ordering::Greater => "not all legs stand in it",
        Ordering::Equal if outside => "joints cannot take it within their ranges",
        _ => return (own, None),
    };
    *tree = free;
    (found, Some(reason))
}

/// Is the joint's position in the standing pose outside of its range?
pub fn stands_outside(joint: &TreeJoint) -> bool {
    let beyond = |q: f64, [low, high]: [f64; 2]| q < low - ROUNDING || q > high + ROUNDING;
    joint.rest.zip(joint.range).is_some_and(|(q, range)| beyond(q, range))
}

impl Import {
    /// Refuses what is no legged robot.
    pub fn check_legged(&self) -> Result<()> {
        let (legs, tree) = (&self.stance.legs, &self.tree);
        let known_free = self.base_is_free && legs.first().is_some_and(|leg| leg.len() > 1);
        if legs.len() > 1 || (legs.len() == 1 && known_free) {
            return Ok(());
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
