//! Refuses robots that no engine can simulate, because a body has no mass or a joint moves no inertia.

use super::draft::Merged;
use crate::error::{Error, Result};
use crate::notes::Notes;
use crate::sim::tree::{JointKind, TreeBody};
use nalgebra::{Isometry3, Matrix3, Matrix6, UnitQuaternion, Vector3, Vector6};

/// Smallest inertia at a joint, as a share of the inertia that it carries: our choice, far above rounding and far below
/// that of any real robot.
const LEAST_SHARE: f64 = 1e-9;
/// Joint positions of a pose without symmetry [rad]; a slide takes a tenth of the number [m]. Our choice.
const POSE: [f64; 5] = [0.31, -0.47, 0.73, -0.19, 0.57];

/// Refuses robots that cannot be simulated.
pub fn check(merged: &Merged, notes: &mut Notes) -> Result<()> {
    let bodies = &merged.tree.bodies;
    for (i, body) in bodies.iter().enumerate() {
        let wrong = |reason: &str| Error::invalid(format!("body {:?}", body.name), reason);
        let carries = bodies.iter().skip(1).any(|b| b.parent == i);
        if body.mass == 0.0 && i == 0 {
            let none = bodies.iter().all(|b| b.mass == 0.0);
            let whose = if none { "no body has a mass" } else { "the base has no mass" };
            return Err(wrong(&format!("{whose}: add <inertial> with its mass and inertia")));
        }
        if body.mass == 0.0 && !(merged.massless[i] && carries) {
            return Err(wrong("moves without mass"));
        }
        if body.mass == 0.0 && !body.name.contains(':') {
            notes.part("body", &body.name, "has no mass of its own; it moves with what it carries");
        }
    }
    names(merged)?;
    inertias(bodies)
}

fn names(merged: &Merged) -> Result<()> {
    let mut joints = std::collections::HashSet::new();
    if let Some(twice) = merged.tree.joints().find(|j| !joints.insert(&j.name)) {
        return Err(Error::invalid(format!("joint {:?}", twice.name), "a second one of this name"));
    }
    for joint in merged.tree.joints() {
        let Some(mimic) = &joint.mimic else { continue };
        let wrong = |reason: String| Error::invalid(format!("joint {:?}", joint.name), reason);
        match merged.tree.joints().find(|j| j.name == mimic.leader) {
            None => {
                return Err(wrong(format!(
                    "is to mimic joint {:?}, which does not exist or does not move",
                    mimic.leader
                )));
            }
            Some(leader) if leader.mimic.is_some() => {
                return Err(wrong(format!(
                    "is to mimic joint {:?}, which follows another itself: name that one",
                    leader.name
                )));
            }
            Some(_) => {}
        }
    }
    Ok(())
}

/// Spatial inertia about the body's frame, angular part first.
fn spatial(body: &TreeBody) -> Matrix6<f64> {
    let c = body.center.cross_matrix();
    let mut inertia = Matrix6::zeros();
    inertia.fixed_view_mut::<3, 3>(0, 0).copy_from(&(body.inertia - c * c * body.mass));
    inertia.fixed_view_mut::<3, 3>(0, 3).copy_from(&(c * body.mass));
    inertia.fixed_view_mut::<3, 3>(3, 0).copy_from(&(c.transpose() * body.mass));
    inertia.fixed_view_mut::<3, 3>(3, 3).copy_from(&(Matrix3::identity() * body.mass));
    inertia
}

/// Transforms motions in a parent's frame to motions in the frame whose pose in the parent is `at`.
fn motion(at: &Isometry3<f64>) -> Matrix6<f64> {
    let turn = at.rotation.inverse().to_rotation_matrix().into_inner();
    let mut x = Matrix6::zeros();
    x.fixed_view_mut::<3, 3>(0, 0).copy_from(&turn);
    x.fixed_view_mut::<3, 3>(3, 3).copy_from(&turn);
    x.fixed_view_mut::<3, 3>(3, 0).copy_from(&(-turn * at.translation.vector.cross_matrix()));
    x
}

/// The articulated inertia (Featherstone 2008, section 7.2) must be positive at every joint, and at the base in
/// every direction.
fn inertias(bodies: &[TreeBody]) -> Result<()> {
    let mut articulated: Vec<Matrix6<f64>> = bodies.iter().map(spatial).collect();
    let mut carried = articulated.clone();
    for i in (1..bodies.len()).rev() {
        let body = &bodies[i];
        let Some(joint) = &body.joint else { continue };
        let q = POSE[i % POSE.len()];
        let axis = joint.axis.into_inner();
        let (angular, linear, moved) = match joint.kind {
            JointKind::Hinge => {
                (axis, Vector3::zeros(), turned(&body.origin, UnitQuaternion::from_axis_angle(&joint.axis, q)))
            }
            JointKind::Slide => (Vector3::zeros(), axis, body.origin * super::draft::shift(axis * (0.1 * q))),
        };
        let s = Vector6::new(angular.x, angular.y, angular.z, linear.x, linear.y, linear.z);
        let push = articulated[i] * s;
        let (own, all) = (s.dot(&push) + joint.armature, s.dot(&(carried[i] * s)));
        if own.is_nan() || own <= LEAST_SHARE * all || own <= 0.0 {
            return Err(Error::invalid(
                format!("joint {:?}", joint.name),
                "has no inertia to move: give its body a mass away from the joint's line, or the joint an `armature` \
                 (MJCF); of two joints along one line, each needs one",
            ));
        }
        let x = motion(&moved);
        let left = articulated[i] - push * push.transpose() / own;
        articulated[body.parent] += x.transpose() * left * x;
        let below = x.transpose() * carried[i] * x;
        carried[body.parent] += below;
    }
    let base = &bodies[0];
    match articulated[0].cholesky() {
        Some(_) => Ok(()),
        None => Err(Error::invalid(format!("body {:?}", base.name), "the base's inertia is not positive definite")),
    }
}

fn turned(origin: &Isometry3<f64>, by: UnitQuaternion<f64>) -> Isometry3<f64> {
    Isometry3::from_parts(origin.translation, origin.rotation * by)
}
