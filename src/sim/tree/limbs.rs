//! Limbs of a robot (legs, arms, tails): the branches of its tree that end in a shape, and how each one moves.

use super::contact::ContactPoint;
use super::free_joints::{FreeJoints, MOST_MOVING};
use super::kinematics::{Low, moved};
use super::{JointKind, Tree};
use nalgebra::{Isometry3, Vector3};

type V = Vector3<f64>;

/// Largest number of limbs that are searched: our choice, more than any robot we know has; it bounds the time of a search.
pub const MOST_LIMBS: usize = 32;
/// Two branches are one limb (a hand with fingers, a foot with toes) if they share more than this part of their
/// length: our choice, because fingers and toes are short, and legs share little of a trunk.
const SHARED: f64 = 0.5;
/// Points less than this part of the limb's length above the lowest point belong to the sole. A sole must extend by
/// more than this in both horizontal directions. Our choice: a sole's rounded edges count, and a point or ball is no
/// sole.
const SOLE: f64 = 0.03;
/// A leg folds about two hinges if the cosine of their axes' angle is above this: our choice, 26°, between parallel axes
/// (hip and knee, apart by the yaw of a leg that is drawn turned out) and axes that are perpendicular (pitch and roll).
const FOLDS: f64 = 0.9;

/// A branch of the tree from the base to its last body with a shape.
#[derive(Clone, Debug)]
pub struct Limb {
    /// From the base outward, without the base.
    pub path: Vec<usize>,
    /// The limb's last body, and the last bodies of branches that part from the limb.
    pub ends: Vec<usize>,
    /// The part of `path` that a search moves.
    pub(super) moving: Vec<usize>,
    /// Sum of the distances between joints, and from the last one to its farthest point [m].
    pub length: f64,
    /// The first joint that a long part of the limb follows: more than a quarter of its length.
    pub(super) long: usize,
    /// The hip of a leg, the shoulder of an arm: the joint `long`, or an earlier one about which the limb folds.
    pub hip: usize,
    pub(super) sole: Option<Sole>,
}

/// The flat underside of a foot, in the frame of its body.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sole {
    center: V,
    pub(super) up: V,
}

/// All limbs of a robot, in the order of their ends.
pub fn limbs(tree: &Tree, contacts: &[Vec<ContactPoint>]) -> Vec<Limb> {
    let carries = |i: usize| tree.bodies.iter().skip(1).any(|b| b.parent == i);
    let step = |i: usize| tree.bodies[i].origin.translation.vector.norm();
    let mut all: Vec<Limb> = Vec::new();
    for leaf in (1..tree.bodies.len()).filter(|i| !carries(*i)) {
        let mut end = leaf;
        while end > 0 && contacts[end].is_empty() {
            end = tree.bodies[end].parent;
        }
        let path = path(tree, end);
        let length = path.iter().skip(1).map(|i| step(*i)).sum::<f64>() + farthest(&contacts[end]);
        let shared = |other: &Limb| {
            let common = other.path.iter().zip(&path).take_while(|(a, b)| a == b);
            common.skip(1).map(|(i, _)| step(*i)).sum::<f64>() > SHARED * length.min(other.length)
        };
        if end == 0 {
            continue;
        }
        if let Some(other) = all.iter_mut().find(|other| other.ends.contains(&end) || shared(other)) {
            if !other.ends.contains(&end) {
                other.ends.push(end);
            }
        } else if all.len() < MOST_LIMBS {
            let moving = path[path.len().saturating_sub(MOST_MOVING)..].to_vec();
            let first = path[0];
            all.push(Limb { path, ends: vec![end], moving, length, long: first, hip: first, sole: None });
        }
    }
    let joints = FreeJoints::of(tree);
    let mut limbs_on = vec![0; tree.bodies.len()];
    all.iter().flat_map(|limb| &limb.path).for_each(|i| limbs_on[*i] += 1);
    for limb in &mut all {
        limb.complete(tree, contacts, &joints.preferred);
        let folds = limb.folds(tree, &joints.preferred, |i| limbs_on[i] == 1);
        limb.hip = folds.map_or(limb.long, |hip| hip.min(limb.long));
    }
    all
}

fn path(tree: &Tree, end: usize) -> Vec<usize> {
    let mut path = Vec::new();
    let mut at = end;
    while at > 0 {
        path.push(at);
        at = tree.bodies[at].parent;
    }
    path.reverse();
    path
}

fn farthest(points: &[ContactPoint]) -> f64 {
    points.iter().map(|p| p.center.norm() + p.radius).fold(0.0, f64::max)
}

impl Limb {
    pub fn end(&self) -> usize {
        self.ends[0]
    }

    /// The first of the first two hinges with parallel axes, in which a leg folds: of a leg the hip's pitch, before the knee. A
    /// thigh may be short, or have joints in it. Only joints that carry no other limb are its `own`; a waist is none.
    fn folds(&self, tree: &Tree, angles: &[f64], own: impl Fn(usize) -> bool) -> Option<usize> {
        let (mut at, mut before) = (Isometry3::identity(), Vec::<(usize, V)>::new());
        for &i in &self.path {
            at *= moved(&tree.bodies[i], angles[i - 1]);
            let Some(axis) = tree.bodies[i].hinge_axis(&at).filter(|_| own(i)) else { continue };
            if let Some((first, _)) = before.iter().find(|(_, other)| axis.dot(other).abs() > FOLDS) {
                return Some(*first);
            }
            before.push((i, axis));
        }
        None
    }

    /// Finds the joint before the first long part, and the sole, with joints at `angles`.
    fn complete(&mut self, tree: &Tree, contacts: &[Vec<ContactPoint>], angles: &[f64]) {
        let next = |k: usize| {
            self.path
                .get(k + 1)
                .map_or(farthest(&contacts[self.end()]), |i| tree.bodies[*i].origin.translation.vector.norm())
        };
        let long = (0..self.path.len()).find(|k| next(*k) > 0.25 * self.length);
        self.long = self.path[long.unwrap_or(0)];
        let points = &contacts[self.end()];
        let frame = self.frame(tree, angles, self.end());
        if self.path.len() < 4 {
            return;
        }
        let at = |p: &ContactPoint| frame.transform_point(&p.center.into()).coords - V::z() * p.radius;
        let low = points.iter().map(|p| at(p).z).fold(f64::INFINITY, f64::min);
        let under: Vec<V> = points.iter().map(at).filter(|p| p.z < low + SOLE * self.length).collect();
        let [least, most] =
            under.iter().fold([V::repeat(f64::MAX), V::repeat(f64::MIN)], |[a, b], p| [a.inf(p), b.sup(p)]);
        if (most - least).xy().min() > SOLE * self.length {
            let center = V::new((least.x + most.x) / 2.0, (least.y + most.y) / 2.0, low);
            let center = frame.inverse_transform_point(&center.into()).coords;
            self.sole = Some(Sole { center, up: frame.rotation.inverse_transform_vector(&V::z()) });
        }
    }

    /// Length from the hip to the farthest point [m].
    pub fn length_behind_hip(&self, tree: &Tree, contacts: &[Vec<ContactPoint>]) -> f64 {
        let behind = self.path.iter().filter(|i| **i > self.hip);
        behind.map(|i| tree.bodies[*i].origin.translation.vector.norm()).sum::<f64>() + farthest(&contacts[self.end()])
    }

    /// Position of the knee in the base's frame [m]. The knee is the first joint after the hip that is far from the
    /// joint before it, or that a long part follows; if there is none, it is the joint of the last body.
    pub fn knee(&self, tree: &Tree, angles: &[f64]) -> V {
        if self.hip < self.long {
            return self.frame(tree, angles, self.long).translation.vector;
        }
        let after = self
            .path
            .iter()
            .find(|i| **i > self.hip && tree.bodies[**i].origin.translation.vector.norm() > 0.25 * self.length);
        self.frame(tree, angles, after.copied().unwrap_or(self.end())).translation.vector
    }

    /// Frame of a body of the limb, with the base at the origin.
    pub fn frame(&self, tree: &Tree, angles: &[f64], body: usize) -> Isometry3<f64> {
        let along = self.path.iter().take_while(|i| **i <= body);
        along.fold(Isometry3::identity(), |at, i| at * moved(&tree.bodies[*i], angles[i - 1]))
    }

    /// The point that is to stand on the ground: the middle of the sole, or the lowest point.
    pub fn tip(&self, tree: &Tree, contacts: &[Vec<ContactPoint>], angles: &[f64]) -> V {
        self.tip_of(&self.frame(tree, angles, self.end()), contacts).0
    }

    /// Distance of the tip from the joint of the limb's last body, as a part of the distance of that body's farthest
    /// point; 1 for a flat sole.
    pub fn tip_distance(&self, tree: &Tree, contacts: &[Vec<ContactPoint>], angles: &[f64]) -> f64 {
        let (frame, farthest) = (self.frame(tree, angles, self.end()), farthest(&contacts[self.end()]));
        if self.sole.is_some() || farthest == 0.0 {
            return 1.0;
        }
        (self.tip_of(&frame, contacts).0 - frame.translation.vector).norm() / farthest
    }

    /// The tip, and the point of the foot whose velocity the tip has. A ball's lowest point has the velocity of the
    /// ball's centre, because another point is the lowest when the foot turns.
    pub(super) fn tip_of(&self, frame: &Isometry3<f64>, contacts: &[Vec<ContactPoint>]) -> (V, V) {
        if let Some(sole) = &self.sole {
            let at = frame.transform_point(&sole.center.into()).coords;
            return (at, at);
        }
        let low = Low::of(frame, &contacts[self.end()]);
        (low.at, low.center)
    }

    /// For each joint of the limb: its body, and the tip's velocity when it moves with 1 rad/s or 1 m/s.
    pub fn velocities(&self, tree: &Tree, contacts: &[Vec<ContactPoint>], angles: &[f64]) -> Vec<(usize, V)> {
        let (_, point) = self.tip_of(&self.frame(tree, angles, self.end()), contacts);
        let mut at = Isometry3::identity();
        let mut all = Vec::with_capacity(self.path.len());
        for &i in &self.path {
            at *= moved(&tree.bodies[i], angles[i - 1]);
            let velocity = tree.bodies[i].axis(&at).map(|(kind, axis)| velocity(kind, axis, &at, &point));
            all.push((i, velocity.unwrap_or_default()));
        }
        all
    }
}

/// Velocity of a point when the joint at `at` moves with 1 rad/s or 1 m/s.
pub(super) fn velocity(kind: JointKind, axis: V, at: &Isometry3<f64>, point: &V) -> V {
    match kind {
        JointKind::Hinge => axis.cross(&(point - at.translation.vector)),
        JointKind::Slide => axis,
    }
}
