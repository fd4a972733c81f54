//! One time step of a tree robot: positions → sand → hard ground → joints → accelerations → motion.

use super::Follower;
use super::dynamics::{self, Folded, LaneTreeBody, LaneTreeMotion, LinkFrame, LinkLoad, TreeHinge};
use super::floor::{BodyContacts, Floor, Touch};
use super::patches::BodyPatches;
use super::relief::LaneRelief;
use super::sand;
use super::self_contact::{SelfContact, SelfContactScratch, StepAccelerations};
use super::servo::{JointTorques, LaneMotor, LaneServo};
use crate::actuator::{self, NEWTON, TorqueLimits};
use crate::number::{Real, Vec3};
use crate::sand::SandBed;
use crate::spatial::Twist;
use crate::used::Surfaces;
use std::sync::Arc;

/// All data of the robots that do not change while they move, one robot in each lane.
pub struct LaneTree<R> {
    pub bodies: Vec<LaneTreeBody<R>>,
    pub motors: Vec<LaneMotor<R>>,
    /// Joints that follow others, the same in all lanes.
    pub followers: Vec<Follower>,
    pub patches: Arc<Vec<BodyPatches>>,
    pub contacts: Vec<BodyContacts>,
    /// None: parts of the robot pass through each other.
    pub self_contact: Option<Arc<SelfContact>>,
    pub ground: SandBed<R>,
    pub floor: Floor<R>,
    /// None: the surface is flat.
    pub relief: Option<LaneRelief>,
    pub gravity: Vec3<R>,
    /// Time step, equal in all lanes [s].
    pub dt: R,
}

/// See [`crate::State`].
#[derive(Clone)]
pub struct LaneTreeState<R> {
    /// Position of the base link's origin.
    pub position: Vec3<R>,
    /// Origin of x and y, for ground that varies with position [m].
    pub travelled: [R; 2],
    pub motion: LaneTreeMotion<R>,
    pub servos: Vec<LaneServo<R>>,
    pub work: R,
}

impl<R: Real> LaneTreeState<R> {
    /// Position of the base's origin in the world [m].
    #[inline(always)]
    pub fn place(&self) -> Vec3<R> {
        self.position + Vec3::new(self.travelled[0], self.travelled[1], R::zero())
    }
}

/// Work space of a step; its contents are not kept.
pub struct TreeScratch<R> {
    pub frames: Vec<LinkFrame<R>>,
    loads: Vec<LinkLoad<R>>,
    /// Loads without those of hard ground.
    bare: Vec<LinkLoad<R>>,
    /// Loads before they are folded.
    unfolded: Vec<LinkLoad<R>>,
    hinges: Vec<TreeHinge<R>>,
    pub accelerations: Vec<Twist<R>>,
    joints: Vec<R>,
    limits: Vec<TorqueLimits<R>>,
    pub touches: Vec<Touch<R>>,
    self_contact: SelfContactScratch<R>,
}

impl<R: Real> TreeScratch<R> {
    pub fn new(bodies: usize) -> Self {
        let still = Twist { angular: Vec3::zero(), linear: Vec3::zero() };
        Self {
            frames: vec![LinkFrame::at_rest(); bodies],
            loads: vec![LinkLoad::none(); bodies],
            bare: vec![LinkLoad::none(); bodies],
            unfolded: vec![LinkLoad::none(); bodies],
            hinges: vec![TreeHinge::free(); bodies - 1],
            accelerations: vec![still; bodies],
            joints: vec![R::zero(); bodies - 1],
            limits: vec![TorqueLimits::none(); bodies - 1],
            touches: Vec::new(),
            self_contact: SelfContactScratch::new(),
        }
    }
}

/// Advances all lanes by one time step.
#[inline(always)]
pub fn step<R: Real>(
    model: &LaneTree<R>,
    state: &mut LaneTreeState<R>,
    scratch: &mut TreeScratch<R>,
    found: Option<&Surfaces<R>>,
) {
    for follower in &model.followers {
        let leader = state.motion.joints[follower.leader];
        let (ratio, servo) = (R::splat(follower.ratio), &mut state.servos[follower.joint]);
        servo.reference = ratio.mul_add(leader.position, R::splat(follower.offset));
        // The leader is expected to accelerate as in the step before.
        servo.command_rate = ratio * (leader.rate + leader.change);
    }
    accelerate(model, state, scratch, found);
    move_joints(model, state, &scratch.joints, &scratch.limits);
    move_base(state, &scratch.accelerations[0], model.dt);
}

/// Computes the accelerations in a time step.
#[inline(always)]
pub fn accelerate<R: Real>(
    model: &LaneTree<R>,
    state: &LaneTreeState<R>,
    scratch: &mut TreeScratch<R>,
    found: Option<&Surfaces<R>>,
) {
    let surface = &model.relief;
    let dt = model.dt;
    let place = state.place();
    dynamics::place(&model.bodies, &state.motion, &mut scratch.frames);
    dynamics::load(&model.bodies, &scratch.frames, model.gravity, &mut scratch.loads);
    sand::press(&model.ground, &model.patches, &scratch.frames, &place, surface, found, &mut scratch.loads, dt);
    model.floor.find(&model.contacts, &scratch.frames, &place, surface, &mut scratch.touches);
    if scratch.touches.is_empty() {
        solve(model, state, scratch);
    } else {
        scratch.bare.copy_from_slice(&scratch.loads);
        model.floor.press(&scratch.touches, &mut scratch.loads, dt);
        solve(model, state, scratch);
        model.floor.classify(&mut scratch.touches, &scratch.accelerations, dt);
        scratch.loads.copy_from_slice(&scratch.bare);
        model.floor.press(&scratch.touches, &mut scratch.loads, dt);
        solve(model, state, scratch);
    }
    if let Some(contact) = &model.self_contact {
        let TreeScratch { frames, loads, hinges, accelerations, joints, self_contact, .. } = scratch;
        let folded = Folded { bodies: &model.bodies, frames, hinges, base: &loads[0].inertia };
        contact.keep_apart(&folded, &mut StepAccelerations { bodies: accelerations, joints }, self_contact, dt);
    }
}

#[inline(always)]
fn solve<R: Real>(model: &LaneTree<R>, state: &LaneTreeState<R>, s: &mut TreeScratch<R>) {
    let (dt, joints) = (model.dt, &state.motion.joints);
    s.limits.iter_mut().for_each(TorqueLimits::begin);
    // `fold` changes the loads; where motors have lines, it may be made several times.
    let lines = model.motors.iter().any(|motor| motor.actuator.has_lines());
    if lines {
        s.unfolded.copy_from_slice(&s.loads);
    }
    for pass in 0..NEWTON + joints.len() {
        let mut drive =
            JointTorques { motors: &model.motors, servos: &state.servos, joints, limits: &mut s.limits, dt };
        let base = dynamics::fold(&model.bodies, &s.frames, &mut drive, &mut s.loads, &mut s.hinges);
        dynamics::unfold(&model.bodies, &s.frames, &s.hinges, &base, &mut s.accelerations, &mut s.joints);
        let joint = |i: usize| (&model.motors[i].actuator, joints[i].rate, s.joints[i]);
        if !lines || !actuator::again(&mut s.limits, joint, dt, pass) {
            break;
        }
        s.loads.copy_from_slice(&s.unfolded);
    }
}

/// Computes rates, positions and servos after the step.
#[inline(always)]
fn move_joints<R: Real>(
    model: &LaneTree<R>,
    state: &mut LaneTreeState<R>,
    accelerations: &[R],
    limits: &[TorqueLimits<R>],
) {
    let dt = model.dt;
    for (i, acceleration) in accelerations.iter().enumerate() {
        let (joint, servo) = (&mut state.motion.joints[i], &mut state.servos[i]);
        let torque = model.motors[i].torque(servo, joint, &limits[i], *acceleration, dt);
        joint.change = *acceleration * dt;
        joint.rate += joint.change;
        joint.position = joint.rate.mul_add(dt, joint.position);
        servo.torque = torque;
        servo.reference = model.motors[i].reference_rate(servo).mul_add(dt, servo.reference);
        state.work += (torque * joint.rate).abs() * dt;
    }
}

/// Moves the base by semi-implicit Euler; the rotation by the exponential map to third order, then normalised.
#[inline(always)]
fn move_base<R: Real>(state: &mut LaneTreeState<R>, acceleration: &Twist<R>, dt: R) {
    let motion = &mut state.motion;
    motion.change = acceleration.scaled(dt);
    motion.velocity.linear += motion.change.linear;
    motion.velocity.angular += motion.change.angular;
    state.position = motion.velocity.linear.scale_add(dt, state.position);
    let half = motion.velocity.angular * (dt * R::splat(0.5));
    let squared = half.norm_squared();
    let real = squared.mul_add(R::splat(-0.5), R::one());
    let half = half * squared.mul_add(R::splat(-1.0 / 6.0), R::one());
    let (w, v) = motion.orientation;
    let new_w = real * w - half.dot(v);
    let new_v = v.scale_add(real, half.scale_add(w, half.cross(v)));
    let norm = R::splat(1.5) - R::splat(0.5) * new_w.mul_add(new_w, new_v.norm_squared());
    motion.orientation = (new_w * norm, new_v * norm);
}
