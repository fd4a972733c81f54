//! Robots in lanes of an instruction set, one robot in each lane: what the engines [`super::lanes`] and [`super::tree`]
//! share.
//!
//! * [`LaneEngine`]: robots in blocks, one robot in each lane of a block.
//! * [`LaneState`]: positions and motions of the robots in a block.
//! * [`LinkFrame`]: position and motion of one body of each robot.

use super::command::Command;
use super::integrator::Integrator;
use super::spatial::Twist;
use super::{Model, State};
use crate::error::Result;
use crate::number::{Isa, Mat3, Real, Vec3, Work};
use crate::sand::memory::Moved;
use std::f64::consts::TAU;

/// Robots in blocks; a block holds as many robots as the instruction set has lanes. Each block is an engine, in which a
/// robot's index is the index of its lane.
pub struct LaneEngine {
    blocks: Vec<Box<dyn Integrator>>,
    lanes: usize,
}

impl LaneEngine {
    /// `count` robots with `model`, motionless until their state is set; `block` makes a block.
    pub fn new(
        isa: Isa,
        model: &Model,
        count: usize,
        block: impl Work<Out = Box<dyn Integrator>> + Copy,
    ) -> Result<Self> {
        let lanes = isa.lanes();
        let blocks = (0..count.div_ceil(lanes)).map(|_| isa.with(block)).collect::<Result<_>>()?;
        let mut engine = Self { blocks, lanes };
        (0..count).for_each(|index| engine.set_model(index, model));
        Ok(engine)
    }
}

impl Integrator for LaneEngine {
    fn set_model(&mut self, index: usize, model: &Model) {
        self.blocks[index / self.lanes].set_model(index % self.lanes, model);
    }

    fn set_footing(&mut self, index: usize, model: &Model, shares: &[f64]) {
        self.blocks[index / self.lanes].set_footing(index % self.lanes, model, shares);
    }

    fn set_state(&mut self, index: usize, state: &State) {
        self.blocks[index / self.lanes].set_state(index % self.lanes, state);
    }

    fn state(&self, index: usize, out: &mut State) {
        self.blocks[index / self.lanes].state(index % self.lanes, out);
    }

    fn sand(&self, index: usize) -> Option<&Moved> {
        self.blocks[index / self.lanes].sand(index % self.lanes)
    }

    fn command(&mut self, index: usize, command: &Command) {
        self.blocks[index / self.lanes].command(index % self.lanes, command);
    }

    fn advance_in_parts(&mut self, steps: usize, ends: bool) {
        self.blocks.iter_mut().for_each(|block| block.advance_in_parts(steps, ends));
    }

    fn normal_forces(&self, index: usize, out: &mut Vec<f64>) {
        self.blocks[index / self.lanes].normal_forces(index % self.lanes, out);
    }

    fn foot_loads(&self, index: usize, out: &mut Vec<f64>) {
        self.blocks[index / self.lanes].foot_loads(index % self.lanes, out);
    }
}

/// State of the robots in one block, one lane each; see [`State`]. `position` is the base's centre of mass in engine
/// `lanes`, and the origin of the base's link in engine `tree`.
#[derive(Clone)]
pub struct LaneState<R> {
    /// Position of the base from the lane's origin.
    pub position: Vec3<R>,
    /// `origins` as lanes [m], for ground that varies along the way.
    pub travelled: [R; 2],
    /// Quaternion w and (x, y, z).
    pub orientation: (R, Vec3<R>),
    pub velocity: Twist<R>,
    /// Change of the velocity in the last step.
    pub change: Twist<R>,
    /// Work since the last control step [J].
    pub work: R,
    pub joints: Vec<LaneJoint<R>>,
    /// Origin of each lane's x and y [m]. Distances from it stay small, so `f32` keeps its accuracy however far a
    /// robot walks.
    pub origins: Vec<[f64; 2]>,
    /// Work of each lane up to the last control step [J]. It is separate from `work`, so that adding small amounts to a large sum loses no accuracy.
    pub works: Vec<f64>,
}

/// State and command of a joint.
#[derive(Clone, Copy)]
pub struct LaneJoint<R> {
    pub position: R,
    pub rate: R,
    pub reference: R,
    /// Torque of the motor in the last step.
    pub torque: R,
    /// Change of `rate` in the last step [rad/s].
    pub change: R,
    /// Speed of the reference [rad/s].
    pub command_rate: R,
    /// Torque added to the servo's [N·m].
    pub command_torque: R,
}

impl<R: Real> LaneJoint<R> {
    pub fn still() -> Self {
        let zero = R::zero();
        Self {
            position: zero,
            rate: zero,
            reference: zero,
            torque: zero,
            change: zero,
            command_rate: zero,
            command_torque: zero,
        }
    }

    /// The whole turns in the joint's angle [rad].
    #[inline(always)]
    pub fn whole_turns(&self) -> R {
        (self.position * R::splat(1.0 / TAU)).round() * R::splat(TAU)
    }

    #[inline(always)]
    pub fn turn_back(&mut self, turns: R) {
        self.position -= turns;
        self.reference -= turns;
    }
}

impl<R: Real> LaneState<R> {
    /// Robots that hover motionless 1 km above the ground (our choice, above all dunes); lanes without an environment
    /// hold such robots.
    pub fn hovering(joints: usize) -> Self {
        Self {
            position: Vec3::splat([0.0, 0.0, 1e3]),
            travelled: [R::zero(); 2],
            orientation: (R::one(), Vec3::zero()),
            velocity: Twist::zero(),
            change: Twist::zero(),
            work: R::zero(),
            joints: vec![LaneJoint::still(); joints],
            origins: vec![[0.0; 2]; R::LANES],
            works: vec![0.0; R::LANES],
        }
    }

    pub fn set_lane(&mut self, lane: usize, state: &State) {
        let ([x, y, z], [w, i, j, k]) = (state.position, state.orientation);
        self.origins[lane] = [x, y];
        self.position.set_lane(lane, [0.0, 0.0, z]);
        self.travelled.iter_mut().zip([x, y]).for_each(|(out, x)| out.set_lane(lane, x));
        self.orientation.0.set_lane(lane, w);
        self.orientation.1.set_lane(lane, [i, j, k]);
        self.velocity.linear.set_lane(lane, state.velocity);
        self.velocity.angular.set_lane(lane, state.angular_velocity);
        self.change.linear.set_lane(lane, state.velocity_change);
        self.change.angular.set_lane(lane, state.angular_velocity_change);
        self.works[lane] = state.work;
        self.work.set_lane(lane, 0.0);
        for (i, joint) in self.joints.iter_mut().enumerate() {
            joint.position.set_lane(lane, state.angles[i]);
            joint.rate.set_lane(lane, state.rates[i]);
            joint.reference.set_lane(lane, state.references[i]);
            joint.torque.set_lane(lane, state.torques[i]);
            joint.change.set_lane(lane, state.rate_changes[i]);
        }
    }

    pub fn lane(&self, lane: usize, out: &mut State) {
        let ([x, y, z], [x0, y0]) = (self.position.lane(lane), self.origins[lane]);
        out.position = [x0 + x, y0 + y, z];
        let [i, j, k] = self.orientation.1.lane(lane);
        out.orientation = [self.orientation.0.lane(lane), i, j, k];
        out.velocity = self.velocity.linear.lane(lane);
        out.angular_velocity = self.velocity.angular.lane(lane);
        out.velocity_change = self.change.linear.lane(lane);
        out.angular_velocity_change = self.change.angular.lane(lane);
        out.work = self.works[lane] + self.work.lane(lane);
        for (i, joint) in self.joints.iter().enumerate() {
            out.angles[i] = joint.position.lane(lane);
            out.rates[i] = joint.rate.lane(lane);
            out.references[i] = joint.reference.lane(lane);
            out.torques[i] = joint.torque.lane(lane);
            out.rate_changes[i] = joint.change.lane(lane);
        }
    }

    pub fn command(&mut self, lane: usize, command: &Command) {
        for (i, joint) in self.joints.iter_mut().enumerate() {
            joint.command_rate.set_lane(lane, command.rates[i]);
            joint.command_torque.set_lane(lane, command.torques[i]);
            if let Some(target) = command.targets.get(i) {
                joint.reference.set_lane(lane, *target);
            }
        }
    }

    /// Position of the base in the world [m].
    #[inline(always)]
    pub fn place(&self) -> Vec3<R> {
        self.position + Vec3::new(self.travelled[0], self.travelled[1], R::zero())
    }

    /// At the end of a control step: adds each lane's x and y to its origin, and its work to the sum in `works`.
    #[inline(always)]
    pub fn fold(&mut self) {
        for lane in 0..R::LANES {
            let [x, y, z] = self.position.lane(lane);
            let origin = &mut self.origins[lane];
            *origin = [origin[0] + x, origin[1] + y];
            self.travelled[0].set_lane(lane, origin[0]);
            self.travelled[1].set_lane(lane, origin[1]);
            self.position.set_lane(lane, [0.0, 0.0, z]);
            self.works[lane] += self.work.lane(lane);
        }
        self.work = R::zero();
    }

    /// Moves the base by the semi-implicit Euler method. The rotation uses the exponential map to third order and is
    /// then normalised by a step of Newton's method.
    #[inline(always)]
    pub fn move_base(&mut self, acceleration: &Twist<R>, dt: R) {
        self.change = acceleration.scaled(dt);
        self.velocity.linear += self.change.linear;
        self.velocity.angular += self.change.angular;
        self.position = self.velocity.linear.scale_add(dt, self.position);
        let half = self.velocity.angular * (dt * R::splat(0.5));
        let squared = half.norm_squared();
        let real = squared.mul_add(R::splat(-0.5), R::one());
        let half = half * squared.mul_add(R::splat(-1.0 / 6.0), R::one());
        let (w, v) = self.orientation;
        let new_w = real * w - half.dot(v);
        let new_v = v.scale_add(real, half.scale_add(w, half.cross(v)));
        let norm = R::splat(1.5) - R::splat(0.5) * new_w.mul_add(new_w, new_v.norm_squared());
        self.orientation = (new_w * norm, new_v * norm);
    }
}

/// Position and motion of a body; lengths from the base's place, world axes.
#[derive(Clone, Copy)]
pub struct LinkFrame<R> {
    pub rotation: Mat3<R>,
    pub origin: Vec3<R>,
    pub velocity: Twist<R>,
    /// Acceleration that is due to velocities alone.
    pub bias: Twist<R>,
    /// Change of the velocity by the last step's accelerations.
    pub change: Twist<R>,
    /// Axis of the joint that carries the body.
    pub axis: Twist<R>,
}

impl<R: Real> LinkFrame<R> {
    pub fn at_rest() -> Self {
        let still = Twist::zero();
        let (rotation, origin) = (Mat3::identity(), Vec3::zero());
        Self { rotation, origin, velocity: still, bias: still, change: still, axis: still }
    }

    #[inline(always)]
    pub fn base(state: &LaneState<R>) -> Self {
        let (velocity, change) = (state.velocity, state.change);
        // If the classical acceleration of the base's place is zero, the spatial one is −ω × v.
        let bias = Twist { angular: Vec3::zero(), linear: velocity.linear.cross(velocity.angular) };
        let (rotation, origin) = (turned_by(state.orientation), Vec3::zero());
        Self { rotation, origin, velocity, bias, change, axis: Twist::zero() }
    }

    /// The frame of a child body at `rotation` and `origin`, which a joint with this axis moves relative to the present body.
    #[inline(always)]
    pub fn carry(&self, rotation: Mat3<R>, origin: Vec3<R>, axis: Twist<R>, joint: &LaneJoint<R>) -> Self {
        let velocity = axis.scale_add(joint.rate, &self.velocity);
        let bias = velocity.carries(&axis).scale_add(joint.rate, &self.bias);
        let change = axis.scale_add(joint.change, &self.change);
        Self { rotation, origin, velocity, bias, change, axis }
    }

    /// Position of the body's point `p`.
    #[inline(always)]
    pub fn point(&self, p: Vec3<R>) -> Vec3<R> {
        self.origin + self.rotation.apply(p)
    }

    /// Weight w of the expected change of velocity at `place`: near 1 in smooth motion, where the next change is about
    /// equal to the last one, and 0 if the place sticks. `lanes/dynamics.rs` has the reason for the factor 4; 1e-30
    /// avoids 0/0 at rest.
    #[inline(always)]
    pub fn trust(&self, place: Vec3<R>) -> R {
        let (speed, change) = (self.velocity.at(place).norm_squared(), self.change.at(place).norm_squared());
        let share = speed / change.mul_add(R::splat(4.0), speed + R::splat(1e-30));
        share * share
    }
}

/// Columns of the rotation of a unit quaternion.
#[inline(always)]
pub fn turned_by<R: Real>((w, v): (R, Vec3<R>)) -> Mat3<R> {
    let (one, two) = (R::one(), R::splat(2.0));
    let (xx, yy, zz) = (v.x * v.x, v.y * v.y, v.z * v.z);
    let (xy, xz, yz) = (v.x * v.y, v.x * v.z, v.y * v.z);
    let (wx, wy, wz) = (w * v.x, w * v.y, w * v.z);
    Mat3::new(
        Vec3::new(one - two * (yy + zz), two * (xy + wz), two * (xz - wy)),
        Vec3::new(two * (xy - wz), one - two * (xx + zz), two * (yz + wx)),
        Vec3::new(two * (xz + wy), two * (yz - wx), one - two * (xx + yy)),
    )
}

/// `rotation` turned by `angle` about the unit vector `axis`.
#[inline(always)]
pub fn turned_about<R: Real>(rotation: &Mat3<R>, axis: Vec3<R>, angle: R) -> Mat3<R> {
    let (sin, cos) = angle.sin_cos();
    let Mat3 { x, y, z } = *rotation;
    Mat3::new(turned(x, axis, sin, cos), turned(y, axis, sin, cos), turned(z, axis, sin, cos))
}

/// `u` turned about the unit vector `axis` (Rodrigues' formula). A closure would not always be inlined, and then takes most
/// of a step's time.
#[inline(always)]
fn turned<R: Real>(u: Vec3<R>, axis: Vec3<R>, sin: R, cos: R) -> Vec3<R> {
    let along = axis * (axis.dot(u) * (R::one() - cos));
    axis.cross(u).scale_add(sin, u.scale_add(cos, along))
}
