//! Positions and motions of the robots in one block.

use super::model::LaneBody;
use crate::number::{Mat3, Real, Vec3};
use crate::spatial::Twist;

/// State of the robots in one block, one lane each; see [`crate::State`].
#[derive(Clone)]
pub struct LaneState<R> {
    pub position: Vec3<R>,
    /// Origin of position.x [m], for sand that varies along the way.
    pub travelled: R,
    /// Quaternion w and (x, y, z).
    pub orientation: (R, Vec3<R>),
    pub velocity: Vec3<R>,
    pub angular_velocity: Vec3<R>,
    /// Change of both velocities in the last step.
    pub change: Twist<R>,
    pub work: R,
    pub joints: Vec<LaneJoint<R>>,
}

/// State and command of a joint.
#[derive(Clone, Copy)]
pub struct LaneJoint<R> {
    pub angle: R,
    pub rate: R,
    pub reference: R,
    pub torque: R,
    /// Change of `rate` in the last step [rad/s].
    pub change: R,
    /// Speed of the reference [rad/s].
    pub command_rate: R,
    /// Torque added to the servo's [N·m].
    pub command_torque: R,
}

/// Position and motion of a body; lengths from the base's centre of mass.
#[derive(Clone, Copy)]
pub struct LegFrame<R> {
    pub rotation: Mat3<R>,
    pub origin: Vec3<R>,
    pub velocity: Twist<R>,
    /// Acceleration that is due to velocities alone.
    pub bias: Twist<R>,
    /// Change of the velocity by the last step's accelerations.
    pub change: Twist<R>,
}

#[inline(always)]
pub fn base_frame<R: Real>(state: &LaneState<R>) -> LegFrame<R> {
    let (w, v) = state.orientation;
    let (one, two) = (R::one(), R::splat(2.0));
    let (xx, yy, zz) = (v.x * v.x, v.y * v.y, v.z * v.z);
    let (xy, xz, yz) = (v.x * v.y, v.x * v.z, v.y * v.z);
    let (wx, wy, wz) = (w * v.x, w * v.y, w * v.z);
    let rotation = Mat3::new(
        Vec3::new(one - two * (yy + zz), two * (xy + wz), two * (xz - wy)),
        Vec3::new(two * (xy - wz), one - two * (xx + zz), two * (yz + wx)),
        Vec3::new(two * (xz + wy), two * (yz - wx), one - two * (xx + yy)),
    );
    let velocity = Twist { angular: state.angular_velocity, linear: state.velocity };
    // The generalized acceleration is that of the centre of mass. If it is zero, the spatial acceleration is −ω × v.
    let bias = Twist { angular: Vec3::zero(), linear: velocity.linear.cross(velocity.angular) };
    LegFrame { rotation, origin: Vec3::zero(), velocity, bias, change: state.change }
}

/// Weight w at `place`: near 1 in smooth motion, in which the next change of velocity is about the last one, and 0 if
/// the place sticks.
#[inline(always)]
pub fn trust<R: Real>(frame: &LegFrame<R>, place: Vec3<R>) -> R {
    let (speed, change) = (frame.velocity.at(place).norm_squared(), frame.change.at(place).norm_squared());
    let share = speed / change.mul_add(R::splat(4.0), speed + R::splat(1e-30));
    share * share
}

/// Turns `body` about its hinge.
#[inline(always)]
pub fn child_frame<R: Real>(parent: &LegFrame<R>, body: &LaneBody<R>, joint: &LaneJoint<R>) -> (LegFrame<R>, Twist<R>) {
    let axis = parent.rotation.apply(body.axis);
    let origin = parent.origin + parent.rotation.apply(body.joint);
    let (sin, cos) = joint.angle.sin_cos();
    let rotation = Mat3::new(
        turned(parent.rotation.x, axis, sin, cos),
        turned(parent.rotation.y, axis, sin, cos),
        turned(parent.rotation.z, axis, sin, cos),
    );
    let hinge = Twist::hinge(axis, origin);
    let velocity = hinge.scale_add(joint.rate, &parent.velocity);
    let bias = velocity.carries(&hinge).scale_add(joint.rate, &parent.bias);
    let change = hinge.scale_add(joint.change, &parent.change);
    (LegFrame { rotation, origin, velocity, bias, change }, hinge)
}

/// `u` turned about the unit vector `axis` (Rodrigues' formula).
#[inline(always)]
fn turned<R: Real>(u: Vec3<R>, axis: Vec3<R>, sin: R, cos: R) -> Vec3<R> {
    let along = axis * (axis.dot(u) * (R::one() - cos));
    axis.cross(u).scale_add(sin, u.scale_add(cos, along))
}
