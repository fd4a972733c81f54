//! Torques at the joints: motors, bearings, springs and stops, all linearly implicit in the joint's rate.
//!
//! Each torque is τ(q̈) = torque − yielding q̈. A motor's torque is limited, and a stop only pushes. The check whether
//! a torque is at its limit assumes that the parent is held still, as in [`crate::lanes`]. A torque at its limit is
//! independent of q̈. Motors with a known stall torque are checked afterwards ([`crate::actuator`]). Dry friction is F
//! q̇⁺/max(|q̇|, v₀), with the rate q̇⁺ after the step, q̇ before it, and v₀ = [`CREEP`].

use super::dynamics::Drive;
use super::model::TreeModel;
use crate::actuator::{Actuator, CREEP, LaneActuator, LimitedTorque};
use crate::blocks::LaneJoint;
use crate::number::Real;
use crate::stop::{ImplicitTorque, NO_LIMIT, Stop};

/// The torques that drive and hold a joint, one lane each.
#[derive(Clone, Copy)]
pub struct LaneMotor<R> {
    kp: R,
    kd: R,
    pub actuator: LaneActuator<R>,
    speed_limit: R,
    damping: R,
    friction: R,
    range: [R; 2],
    /// Stiffness and rest position of a spring.
    spring: [R; 2],
}

impl<R: Real> LaneMotor<R> {
    pub fn all(model: &TreeModel) -> Vec<Self> {
        let zero = R::zero();
        let none = Self {
            kp: zero,
            kd: zero,
            actuator: LaneActuator::splat(&Actuator::default()),
            speed_limit: zero,
            damping: zero,
            friction: zero,
            range: [zero; 2],
            spring: [zero; 2],
        };
        let mut all = vec![none; model.motors.len()];
        (0..R::LANES).for_each(|lane| Self::set_lane(&mut all, lane, model));
        all
    }

    pub fn set_lane(all: &mut [Self], lane: usize, model: &TreeModel) {
        for ((out, motor), joint) in all.iter_mut().zip(&model.motors).zip(model.tree.joints()) {
            // A gear moves a follower (`super::gear`), so its servo does nothing.
            let follows = joint.mimic.is_some();
            let gain = |own: f64| if follows { 0.0 } else { own };
            out.kp.set_lane(lane, gain(motor.kp));
            out.kd.set_lane(lane, gain(motor.kd));
            let rigid = Actuator { torque_time: None, torque_constant: None, ..motor.actuator };
            out.actuator.set_lane(lane, if follows { &rigid } else { &motor.actuator });
            out.speed_limit.set_lane(lane, motor.speed_limit.unwrap_or(NO_LIMIT));
            // If a property of the gear is known, it replaces the joint's value from the file.
            let of_joint = |gear: Option<f64>, joint: f64| if gear.is_some() { 0.0 } else { joint };
            out.damping.set_lane(lane, of_joint(motor.actuator.damping, joint.damping));
            out.friction.set_lane(lane, of_joint(motor.actuator.friction, joint.friction));
            let range = joint.range.unwrap_or([-NO_LIMIT, NO_LIMIT]);
            out.range.iter_mut().zip(range).for_each(|(out, end)| out.set_lane(lane, end));
            let spring = joint.spring.unwrap_or([0.0; 2]);
            out.spring.iter_mut().zip(spring).for_each(|(out, x)| out.set_lane(lane, x));
        }
    }

    /// Speed of the reference for a command, within the motor's speed limit.
    #[inline(always)]
    pub fn reference_rate(&self, joint: &LaneJoint<R>) -> R {
        joint.command_rate.clamp(-self.speed_limit, self.speed_limit)
    }

    /// The servo's push without limits.
    #[inline(always)]
    fn servo(&self, joint: &LaneJoint<R>, dt: R) -> ImplicitTorque<R> {
        let rate_error = self.reference_rate(joint) - joint.rate;
        let error = rate_error.mul_add(dt, joint.reference - joint.position);
        let torque = self.kp.mul_add(error, self.kd.mul_add(rate_error, joint.command_torque));
        let yielding = dt * dt.mul_add(self.kp, self.kd);
        self.actuator.track(ImplicitTorque { torque, yielding }, joint.torque, dt)
    }
}

/// Computes all torques at the joints in one step.
pub struct JointTorques<'a, R> {
    pub motors: &'a [LaneMotor<R>],
    pub joints: &'a [LaneJoint<R>],
    pub limits: &'a mut [LimitedTorque<R>],
    /// Torques of gears between joints; None: there are none.
    pub geared: Option<&'a [R]>,
    pub dt: R,
}

impl<R: Real> LaneMotor<R> {
    /// The motor's torque in a step in which its joint accelerated by `acceleration`.
    #[inline(always)]
    pub fn torque(&self, joint: &LaneJoint<R>, limits: &LimitedTorque<R>, acceleration: R, dt: R) -> R {
        let [low, high] = self.actuator.limits(joint.rate);
        let flat = self.servo(joint, dt).at(acceleration).clamp(low, high);
        self.actuator.reported(flat, limits.push.at(acceleration), joint.rate, acceleration, dt)
    }
}

impl<R: Real> Drive<R> for JointTorques<'_, R> {
    #[inline(always)]
    fn push(&mut self, i: usize, own: R, load: R) -> ImplicitTorque<R> {
        let (motor, joint, dt) = (&self.motors[i], &self.joints[i], self.dt);
        let servo = motor.servo(joint, dt);
        let gear = motor.actuator.gear(joint.rate, joint.torque, dt);
        let damping = ImplicitTorque { torque: -(motor.damping * joint.rate), yielding: motor.damping * dt };
        let slows = motor.friction / joint.rate.abs().max(R::splat(CREEP));
        let rub = ImplicitTorque { torque: -(slows * joint.rate), yielding: slows * dt };
        let stops = Stop::of(motor.range, joint.position, joint.rate, own, dt);
        let [stiffness, rest] = motor.spring;
        let pulled = joint.rate.mul_add(dt, joint.position) - rest;
        let spring = ImplicitTorque { torque: -(stiffness * pulled), yielding: stiffness * (dt * dt) };
        let mut always = damping.plus(rub).plus(spring).plus(gear);
        if let Some(geared) = self.geared {
            always.torque += geared[i];
        }
        let all = servo.plus(always).plus(stops.push);
        let first = all.moves(own, load);
        let stop = stops.at(first);
        let all = motor.actuator.limited(servo, joint.rate, first, dt).plus(always).plus(stop);
        let second = all.moves(own, load);
        let limited = motor.actuator.limited(servo, joint.rate, second, dt);
        self.limits[i].pass(servo, limited).plus(always).plus(stop)
    }
}
