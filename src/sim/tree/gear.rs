//! Joints that follow others. A stiff spring with a damper holds a follower at its place, and its torque τ acts back on the
//! leader as −ratio τ, as that of a gear does. The spring is implicit in the accelerations of both joints, so it is stable at
//! any time step, however light the bodies are.
//!
//! The accelerations are first computed with the torques of the step before. Then each torque is corrected by the response
//! of the whole robot to it; several torques by the projected Gauss-Seidel method, whose matrix is positive definite.

use super::Tree;
use super::dynamics::{Folded, respond_to_torques};
use super::model::TreeModel;
use super::self_contact::StepAccelerations;
use super::servo::LaneMotor;
use crate::blocks::LaneJoint;
use crate::number::Real;
use crate::spatial::{Twist, Wrench};

/// Sweeps over several torques: our choice. Followers on different limbs hardly act on each other, and what is left is
/// corrected in the next step.
const SWEEPS: usize = 6;

/// A joint that follows another, the same in all lanes, and its spring, one lane each.
pub struct LaneGear<R> {
    pub joint: usize,
    pub leader: usize,
    ratio: R,
    offset: R,
    kp: R,
    kd: R,
}

impl<R: Real> LaneGear<R> {
    pub fn all(tree: &Tree) -> Vec<Self> {
        let gear = |f: super::Follower| Self {
            joint: f.joint,
            leader: f.leader,
            ratio: R::splat(f.ratio),
            offset: R::splat(f.offset),
            kp: R::zero(),
            kd: R::zero(),
        };
        tree.followers().into_iter().map(gear).collect()
    }

    pub fn set_lane(all: &mut [Self], lane: usize, model: &TreeModel) {
        for gear in all {
            let motor = &model.motors[gear.joint];
            gear.kp.set_lane(lane, motor.kp);
            gear.kd.set_lane(lane, motor.kd);
        }
    }

    /// The follower's place for the present position of its leader.
    #[inline(always)]
    pub fn place(&self, joints: &[LaneJoint<R>]) -> R {
        self.ratio.mul_add(joints[self.leader].position, self.offset)
    }

    /// How much faster the follower moves than its leader lets it, or accelerates.
    #[inline(always)]
    fn apart(&self, follower: R, leader: R) -> R {
        (-self.ratio).mul_add(leader, follower)
    }

    /// The torques of the step before on follower and leader.
    #[inline(always)]
    pub fn torques(&self, joints: &[LaneJoint<R>]) -> [(usize, R); 2] {
        let torque = joints[self.joint].torque;
        [(self.joint, torque), (self.leader, -(self.ratio * torque))]
    }
}

/// Work space; its contents are not kept, except `torques`, the followers' torques in this step.
pub struct GearScratch<R> {
    pub torques: Vec<R>,
    /// Responses to a torque of 1 on each follower: the joints' and the bodies' accelerations.
    joints: Vec<Vec<R>>,
    bodies: Vec<Vec<Twist<R>>>,
    wrenches: Vec<Wrench<R>>,
}

impl<R: Real> GearScratch<R> {
    pub fn new(bodies: usize, gears: usize) -> Self {
        Self {
            torques: vec![R::zero(); gears],
            joints: vec![vec![R::zero(); bodies - 1]; gears],
            bodies: vec![vec![Twist::zero(); bodies]; gears],
            wrenches: vec![Wrench::zero(); bodies],
        }
    }
}

/// Corrects the accelerations, which were computed with the torques of the step before.
#[inline(always)]
pub fn couple<R: Real>(
    gears: &[LaneGear<R>],
    motors: &[LaneMotor<R>],
    state: &[LaneJoint<R>],
    folded: &Folded<R>,
    step: &mut StepAccelerations<R>,
    (scratch, dt): (&mut GearScratch<R>, R),
) {
    let GearScratch { torques, joints, bodies, wrenches } = scratch;
    for (k, gear) in gears.iter().enumerate() {
        torques[k] = state[gear.joint].torque;
        let unit = [(gear.joint, R::one()), (gear.leader, -gear.ratio)];
        respond_to_torques(folded, unit, wrenches, &mut bodies[k], &mut joints[k]);
    }
    for _ in 0..if gears.len() == 1 { 1 } else { SWEEPS } {
        for (k, gear) in gears.iter().enumerate() {
            let (own, leader) = (&state[gear.joint], &state[gear.leader]);
            let rate = -gear.apart(own.rate, leader.rate);
            let off = rate.mul_add(dt, gear.place(state) - own.position);
            let yielding = dt * dt.mul_add(gear.kp, gear.kd);
            let free = gear.kp.mul_add(off, gear.kd * rate);
            let moves = gear.apart(joints[k][gear.joint], joints[k][gear.leader]);
            let now = gear.apart(step.joints[gear.joint], step.joints[gear.leader]);
            let missing = (-yielding).mul_add(now, free) - torques[k];
            let [low, high] = motors[gear.joint].actuator.limits(own.rate);
            let next = (torques[k] + missing / yielding.mul_add(moves, R::one())).clamp(low, high);
            let change = next - torques[k];
            torques[k] = next;
            step.joints.iter_mut().zip(&joints[k]).for_each(|(a, by)| *a = by.mul_add(change, *a));
            step.bodies.iter_mut().zip(&bodies[k]).for_each(|(a, by)| *a = by.scale_add(change, a));
        }
    }
}
