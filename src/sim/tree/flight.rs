//! Functions for checks, in `f64`: accelerations of a tree in free flight, and the sand's forces on a tree in a given motion.

use super::dynamics::{Drive, LaneTreeBody, LinkLoad, TreeHinge, fold, load, place, unfold};
use super::relief::LaneRelief;
use super::{Tree, sand};
use crate::Model;
use crate::blocks::{LaneJoint, LaneState, LinkFrame};
use crate::number::{Real, Vec3};
use crate::spatial::Twist;
use crate::stop::ImplicitTorque;

/// Gravity in [`accelerations`] [m/s²] unless the robot's file has another, as in the reference programs.
pub const GRAVITY: f64 = 9.81;

/// Applies given torques; joints have no resistance.
struct FixedTorques<'a, R>(&'a [R]);

impl<R: Real> Drive<R> for FixedTorques<'_, R> {
    #[inline(always)]
    fn push(&mut self, joint: usize, _own: R, _load: R) -> ImplicitTorque<R> {
        ImplicitTorque { torque: self.0[joint], yielding: R::zero() }
    }
}

/// Accelerations of a tree in free flight.
#[derive(Clone, Debug, PartialEq)]
pub struct TreeAccelerations {
    /// Classical acceleration of the base link's origin [m/s²], world axes.
    pub a: [f64; 3],
    /// Angular acceleration of the base [rad/s²], world axes.
    pub alpha: [f64; 3],
    /// Accelerations of the joints, in the order of [`Tree::joints`] [rad/s² or m/s²].
    pub qdd: Vec<f64>,
}

/// Position and motion of a tree at one moment.
#[derive(Clone, Debug, PartialEq)]
pub struct TreePose {
    /// Unit quaternion w, x, y, z of the base.
    pub quat: [f64; 4],
    /// Velocity of the base link's origin [m/s] and angular velocity of the base [rad/s], world axes.
    pub v: [f64; 3],
    pub w: [f64; 3],
    /// Positions, speeds and torques of the joints, in the order of [`Tree::joints`].
    pub q: Vec<f64>,
    pub qd: Vec<f64>,
    pub tau: Vec<f64>,
}

impl TreePose {
    fn state<R: Real>(&self) -> LaneState<R> {
        let [w, x, y, z] = self.quat;
        let joint =
            |(q, qd): (&f64, &f64)| LaneJoint { position: R::splat(*q), rate: R::splat(*qd), ..LaneJoint::still() };
        LaneState {
            orientation: (R::splat(w), Vec3::splat([x, y, z])),
            velocity: Twist { angular: Vec3::splat(self.w), linear: Vec3::splat(self.v) },
            joints: self.q.iter().zip(&self.qd).map(joint).collect(),
            ..LaneState::hovering(0)
        }
    }
}

/// Force of the sand [N] on each body, and its moment about the body's frame [N·m], world axes, with the base at `position`.
pub fn sand_loads(model: &Model, position: [f64; 3], pose: &TreePose) -> Vec<[[f64; 3]; 2]> {
    let Some(tree) = &model.tree else { return Vec::new() };
    let bodies = LaneTreeBody::<f64>::all(&tree.tree);
    let count = bodies.len();
    let (mut frames, mut loads) = (vec![LinkFrame::at_rest(); count], vec![LinkLoad::none(); count]);
    place(&bodies, &pose.state(), &mut frames);
    let ground = model.ground();
    let relief = model.scene.relief.as_ref().map(|r| LaneRelief(vec![r.clone()]));
    sand::press(&ground, &tree.patches, &frames, &Vec3::splat(position), &relief, None, &mut loads, model.scene.dt);
    let of_body = |(frame, load): (&LinkFrame<f64>, &LinkLoad<f64>)| {
        let (force, moment) = (-load.bias.force, -load.bias.moment);
        [force, moment - frame.origin.cross(force)].map(|v| v.lane(0))
    };
    frames.iter().zip(&loads).map(of_body).collect()
}

/// Accelerations in free flight under gravity (0, 0, −9.81), or that of the robot's file; springs, armature, damping, friction and limits are
/// left out: add a spring's torque to `tau`.
/// `pose` has as many joints as the tree.
pub fn accelerations(tree: &Tree, pose: &TreePose) -> TreeAccelerations {
    accelerations_by::<f64>(tree, pose)
}

/// The same as [`accelerations`], computed with numbers of type `R`; the result is that of lane 0.
pub fn accelerations_by<R: Real>(tree: &Tree, pose: &TreePose) -> TreeAccelerations {
    let mut bodies = LaneTreeBody::<R>::all(tree);
    bodies.iter_mut().for_each(|b| b.armature = R::zero());
    let torques: Vec<R> = pose.tau.iter().map(|t| R::splat(*t)).collect();
    let count = bodies.len();
    let (mut frames, mut loads) = (vec![LinkFrame::at_rest(); count], vec![LinkLoad::none(); count]);
    let (mut hinges, mut moved) = (vec![TreeHinge::free(); count - 1], vec![Twist::zero(); count]);
    let mut joints = vec![R::zero(); count - 1];
    place(&bodies, &pose.state(), &mut frames);
    load(&bodies, &frames, Vec3::splat([0.0, 0.0, -tree.gravity.unwrap_or(GRAVITY)]), &mut loads);
    let base = fold(&bodies, &frames, &mut FixedTorques(&torques), &mut loads, &mut hinges);
    unfold(&bodies, &frames, &hinges, &base, &mut moved, &mut joints);
    TreeAccelerations {
        a: base.linear.lane(0),
        alpha: base.angular.lane(0),
        qdd: joints.iter().map(|q| q.lane(0)).collect(),
    }
}
