//! One time step of a tree robot: positions → sand → hard ground → joints → accelerations → motion.

use super::Follower;
use super::dynamics::{self, Folded, LaneTreeBody, LinkLoad, TreeHinge};
use super::floor::{BodyContacts, Floor, Touch};
use super::patches::BodyPatches;
use super::relief::LaneRelief;
use super::sand;
use super::self_contact::{SelfContact, SelfContactScratch, StepAccelerations};
use super::servo::{JointTorques, LaneMotor};
use crate::actuator::{self, LimitedTorque, NEWTON};
use crate::blocks::{LaneState, LinkFrame};
use crate::number::{Kernel, Real, Vec3};
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

/// Work space of a step; its contents are not kept.
pub struct TreeScratch<R> {
    pub frames: Vec<LinkFrame<R>>,
    loads: Vec<LinkLoad<R>>,
    /// Loads without the forces of hard ground.
    bare: Vec<LinkLoad<R>>,
    /// Loads before they are folded.
    unfolded: Vec<LinkLoad<R>>,
    hinges: Vec<TreeHinge<R>>,
    pub accelerations: Vec<Twist<R>>,
    joints: Vec<R>,
    limits: Vec<LimitedTorque<R>>,
    pub touches: Vec<Touch<R>>,
    self_contact: SelfContactScratch<R>,
}

impl<R: Real> TreeScratch<R> {
    pub fn new(bodies: usize) -> Self {
        Self {
            frames: vec![LinkFrame::at_rest(); bodies],
            loads: vec![LinkLoad::none(); bodies],
            bare: vec![LinkLoad::none(); bodies],
            unfolded: vec![LinkLoad::none(); bodies],
            hinges: vec![TreeHinge::free(); bodies - 1],
            accelerations: vec![Twist::zero(); bodies],
            joints: vec![R::zero(); bodies - 1],
            limits: vec![LimitedTorque::none(); bodies - 1],
            touches: Vec::new(),
            self_contact: SelfContactScratch::new(),
        }
    }
}

/// Advances all lanes by one time step.
#[inline(always)]
pub fn step<R: Real>(
    model: &LaneTree<R>,
    state: &mut LaneState<R>,
    scratch: &mut TreeScratch<R>,
    found: Option<&Surfaces<R>>,
) {
    for follower in &model.followers {
        let leader = state.joints[follower.leader];
        let (ratio, joint) = (R::splat(follower.ratio), &mut state.joints[follower.joint]);
        joint.reference = ratio.mul_add(leader.position, R::splat(follower.offset));
        // The leader is expected to accelerate as in the step before.
        joint.command_rate = ratio * (leader.rate + leader.change);
    }
    accelerate(model, state, scratch, found);
    move_joints(model, state, &scratch.joints, &scratch.limits);
    state.move_base(&scratch.accelerations[0], model.dt);
}

/// Computes the accelerations in a time step.
#[inline(always)]
pub fn accelerate<R: Real>(
    model: &LaneTree<R>,
    state: &LaneState<R>,
    scratch: &mut TreeScratch<R>,
    found: Option<&Surfaces<R>>,
) {
    R::dispatch(AccelerateTrees { model, state, scratch, found });
}

/// A call of [`accelerate`], the same for steps and pictures.
struct AccelerateTrees<'a, R: Real> {
    model: &'a LaneTree<R>,
    state: &'a LaneState<R>,
    scratch: &'a mut TreeScratch<R>,
    found: Option<&'a Surfaces<R>>,
}

impl<R: Real> Kernel for AccelerateTrees<'_, R> {
    #[inline(always)]
    fn run(self) {
        accelerations(self.model, self.state, self.scratch, self.found);
    }
}

#[inline(always)]
fn accelerations<R: Real>(
    model: &LaneTree<R>,
    state: &LaneState<R>,
    scratch: &mut TreeScratch<R>,
    found: Option<&Surfaces<R>>,
) {
    let surface = &model.relief;
    let dt = model.dt;
    let place = state.place();
    dynamics::place(&model.bodies, state, &mut scratch.frames);
    dynamics::load(&model.bodies, &scratch.frames, model.gravity, &mut scratch.loads);
    sand::press(&model.ground, &model.patches, &scratch.frames, &place, surface, found, &mut scratch.loads, dt);
    model.floor.find(&model.contacts, &scratch.frames, &place, surface, &mut scratch.touches);
    // The first solution on hard ground tells which points push, hold and slide in the second.
    let rounds = if scratch.touches.is_empty() { 1 } else { 2 };
    if rounds > 1 {
        scratch.bare.copy_from_slice(&scratch.loads);
    }
    for round in 0..rounds {
        if round > 0 {
            model.floor.classify(&mut scratch.touches, &scratch.accelerations, dt);
            scratch.loads.copy_from_slice(&scratch.bare);
        }
        model.floor.press(&scratch.touches, &mut scratch.loads, dt);
        R::dispatch(SolveTrees { model, state, scratch });
    }
    if let Some(contact) = &model.self_contact {
        let TreeScratch { frames, loads, hinges, accelerations, joints, self_contact, .. } = scratch;
        let folded = Folded { bodies: &model.bodies, frames, hinges, base: &loads[0].inertia };
        contact.keep_apart(&folded, &mut StepAccelerations { bodies: accelerations, joints }, self_contact, dt);
    }
}

/// Solves for the accelerations of base and joints under the present loads.
struct SolveTrees<'a, R: Real> {
    model: &'a LaneTree<R>,
    state: &'a LaneState<R>,
    scratch: &'a mut TreeScratch<R>,
}

impl<R: Real> Kernel for SolveTrees<'_, R> {
    #[inline(always)]
    fn run(self) {
        solve(self.model, self.state, self.scratch);
    }
}

#[inline(always)]
fn solve<R: Real>(model: &LaneTree<R>, state: &LaneState<R>, s: &mut TreeScratch<R>) {
    let (dt, joints) = (model.dt, &state.joints);
    s.limits.iter_mut().for_each(LimitedTorque::begin);
    // `fold` changes the loads, so a copy is needed if it runs several times, which it does for motors with lines of torque over speed.
    let lines = model.motors.iter().any(|motor| motor.actuator.has_lines());
    if lines {
        s.unfolded.copy_from_slice(&s.loads);
    }
    for pass in 0..NEWTON + joints.len() {
        let mut drive = JointTorques { motors: &model.motors, joints, limits: &mut s.limits, dt };
        let base = dynamics::fold(&model.bodies, &s.frames, &mut drive, &mut s.loads, &mut s.hinges);
        dynamics::unfold(&model.bodies, &s.frames, &s.hinges, &base, &mut s.accelerations, &mut s.joints);
        let joint = |i: usize| (&model.motors[i].actuator, joints[i].rate, s.joints[i]);
        if !lines || !actuator::next_pass(&mut s.limits, joint, dt, pass) {
            break;
        }
        s.loads.copy_from_slice(&s.unfolded);
    }
}

/// Computes rates, positions, torques and servos' references after the step.
#[inline(always)]
fn move_joints<R: Real>(
    model: &LaneTree<R>,
    state: &mut LaneState<R>,
    accelerations: &[R],
    limits: &[LimitedTorque<R>],
) {
    let dt = model.dt;
    for (i, acceleration) in accelerations.iter().enumerate() {
        let joint = &mut state.joints[i];
        let torque = model.motors[i].torque(joint, &limits[i], *acceleration, dt);
        joint.change = *acceleration * dt;
        joint.rate += joint.change;
        joint.position = joint.rate.mul_add(dt, joint.position);
        joint.torque = torque;
        joint.reference = model.motors[i].reference_rate(joint).mul_add(dt, joint.reference);
        state.work += (torque * joint.rate).abs() * dt;
    }
}
