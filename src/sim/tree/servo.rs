//! Torques at the joints: motors, bearings and stops, all linearly implicit in the joint's rate.
//!
//! Each is τ(q̈) = torque − yielding q̈. A motor's torque is limited, and a stop only pushes. Whether a torque is at
//! its limit is computed with the parent held still, as in [`crate::lanes`]. The torque is then the limit, and
//! independent of q̈. Dry friction is F q̇⁺/max(|q̇|, v₀), with the rate q̇⁺ after the step and q̇ before it.

use super::dynamics::{Drive, JointMotion, Push};
use super::model::TreeModel;
use crate::number::Real;

/// Largest number that stands for "no limit".
const NO_LIMIT: f64 = 1e9;
/// Rate v₀ at which dry friction has its full size [rad/s]; a joint creeps more slowly under a smaller load. Our
/// choice, because even at this rate a joint turns by only 0.06° in a second.
const CREEP: f64 = 1e-3;
/// Resistance of a stop to acceleration, as a multiple of the joint's inertia: our choice, because a load then
/// accelerates a joint at its stop a thousand times less than elsewhere.
const STIFF: f64 = 1e3;
/// Number of time steps in which a stop pushes a joint back into its range: our choice, because the joint then returns
/// with an eighth of the speed of a return in one step.
const RETURN: f64 = 8.0;
/// Stall torque of a motor as a multiple of its torque limit. The largest torque falls linearly from there to zero at
/// the speed limit (the saturation effort of Isaac Lab's `DCMotor`; 2 is our choice: the full torque is available up to
/// half of the speed limit).
const STALL: f64 = 2.0;

/// The torques that drive and hold a joint, one lane each.
#[derive(Clone, Copy)]
pub struct LaneMotor<R> {
    kp: R,
    kd: R,
    torque_limit: R,
    speed_limit: R,
    damping: R,
    friction: R,
    range: [R; 2],
}

/// The servo of a joint in one step.
#[derive(Clone, Copy)]
pub struct LaneServo<R> {
    pub reference: R,
    /// Torque of the motor in the last step.
    pub torque: R,
    /// Speed of the reference.
    pub command_rate: R,
    /// Torque added to the servo's.
    pub command_torque: R,
}

impl<R: Real> LaneServo<R> {
    pub fn still() -> Self {
        let zero = R::zero();
        Self { reference: zero, torque: zero, command_rate: zero, command_torque: zero }
    }
}

impl<R: Real> LaneMotor<R> {
    pub fn all(model: &TreeModel) -> Vec<Self> {
        let zero = R::zero();
        let none = Self {
            kp: zero,
            kd: zero,
            torque_limit: zero,
            speed_limit: zero,
            damping: zero,
            friction: zero,
            range: [zero; 2],
        };
        let mut all = vec![none; model.motors.len()];
        (0..R::LANES).for_each(|lane| Self::set_lane(&mut all, lane, model));
        all
    }

    pub fn set_lane(all: &mut [Self], lane: usize, model: &TreeModel) {
        for ((out, motor), joint) in all.iter_mut().zip(&model.motors).zip(model.tree.joints()) {
            out.kp.set_lane(lane, motor.kp);
            out.kd.set_lane(lane, motor.kd);
            out.torque_limit.set_lane(lane, motor.torque_limit.unwrap_or(NO_LIMIT));
            out.speed_limit.set_lane(lane, motor.speed_limit.unwrap_or(NO_LIMIT));
            out.damping.set_lane(lane, joint.damping);
            out.friction.set_lane(lane, joint.friction);
            let range = joint.range.unwrap_or([-NO_LIMIT, NO_LIMIT]);
            out.range.iter_mut().zip(range).for_each(|(out, end)| out.set_lane(lane, end));
        }
    }

    /// Speed of the reference for a command, within the motor's speed limit.
    #[inline(always)]
    pub fn reference_rate(&self, servo: &LaneServo<R>) -> R {
        servo.command_rate.clamp(-self.speed_limit, self.speed_limit)
    }

    /// The motor's part of the push, and the limits of its torque at the joint's rate.
    #[inline(always)]
    fn servo(&self, servo: &LaneServo<R>, joint: &JointMotion<R>, dt: R) -> (Push<R>, [R; 2]) {
        let rate_error = self.reference_rate(servo) - joint.rate;
        let error = rate_error.mul_add(dt, servo.reference - joint.position);
        let torque = self.kp.mul_add(error, self.kd.mul_add(rate_error, servo.command_torque));
        let yielding = dt * dt.mul_add(self.kp, self.kd);
        let part = joint.rate / self.speed_limit;
        (Push { torque, yielding }, [-self.most(-part), self.most(part)])
    }

    /// Largest torque in the direction in which the joint turns, at `part` of its speed limit.
    #[inline(always)]
    fn most(&self, part: R) -> R {
        self.torque_limit * ((R::one() - part) * R::splat(STALL)).clamp(R::zero(), R::one())
    }
}

/// Computes all torques at the joints in one step.
pub struct Joints<'a, R> {
    pub motors: &'a [LaneMotor<R>],
    pub servos: &'a [LaneServo<R>],
    pub joints: &'a [JointMotion<R>],
    pub dt: R,
}

impl<R: Real> Joints<'_, R> {
    /// The motor's torque if the joint accelerates by `acceleration`.
    #[inline(always)]
    pub fn motor_torque(&self, i: usize, acceleration: R) -> R {
        let (push, [low, high]) = self.motors[i].servo(&self.servos[i], &self.joints[i], self.dt);
        push.at(acceleration).clamp(low, high)
    }
}

impl<R: Real> Push<R> {
    #[inline(always)]
    fn plus(self, o: Self) -> Self {
        Self { torque: self.torque + o.torque, yielding: self.yielding + o.yielding }
    }

    #[inline(always)]
    fn at(&self, acceleration: R) -> R {
        self.torque - self.yielding * acceleration
    }

    /// The acceleration under this push.
    #[inline(always)]
    fn moves(&self, own: R, load: R) -> R {
        (self.torque - load) / (own + self.yielding)
    }

    /// This push; if its torque at `acceleration` is beyond `low` or `high`, this limit as a constant torque.
    #[inline(always)]
    fn within(&self, low: R, high: R, acceleration: R) -> Self {
        let torque = self.at(acceleration);
        let limited = torque.clamp(low, high);
        let free = (limited - torque).abs().lt(R::splat(f64::from(f32::MIN_POSITIVE)));
        Self { torque: R::select(free, self.torque, limited), yielding: R::select(free, self.yielding, R::zero()) }
    }
}

impl<R: Real> Drive<R> for Joints<'_, R> {
    #[inline(always)]
    fn push(&self, i: usize, own: R, load: R) -> Push<R> {
        let (motor, joint, dt) = (&self.motors[i], &self.joints[i], self.dt);
        let zero = R::zero();
        let (servo, [low, high]) = motor.servo(&self.servos[i], joint, dt);
        let damping = Push { torque: -(motor.damping * joint.rate), yielding: motor.damping * dt };
        let slows = motor.friction / joint.rate.abs().max(R::splat(CREEP));
        let rub = Push { torque: -(slows * joint.rate), yielding: slows * dt };
        let stiff = own * R::splat(STIFF);
        let next = joint.rate.mul_add(dt, joint.position);
        let [least, most] = motor.range;
        // Distance of the joint beyond its range, now or, at its present rate, soon.
        let beyond =
            (next - most).max(joint.position - most).max(zero) + (next - least).min(joint.position - least).min(zero);
        let past = (joint.position - most).max(zero) + (joint.position - least).min(zero);
        let out = (past / (dt * R::splat(RETURN)) + joint.rate) * (stiff / dt);
        let stops = zero.lt(beyond.abs());
        let stop = Push { torque: R::select(stops, -out, zero), yielding: R::select(stops, stiff, zero) };
        // A stop only pushes back.
        let [push_low, push_high] = [
            R::select(beyond.lt(zero), zero, -R::splat(NO_LIMIT)),
            R::select(zero.lt(beyond), zero, R::splat(NO_LIMIT)),
        ];
        let always = damping.plus(rub);
        let all = servo.plus(always).plus(stop);
        let first = all.moves(own, load);
        let stop = stop.within(push_low, push_high, first);
        let all = servo.within(low, high, first).plus(always).plus(stop);
        let second = all.moves(own, load);
        servo.within(low, high, second).plus(always).plus(stop)
    }
}
