//! What a motor can do, for all engines: its torque–speed line, and the time that its torque needs.
//!
//! The torque in the direction of motion is at most
//!
//! ```text
//!  τ(ω) = min(τ_limit, τ_stall (1 − ω/ω₀)),   not below 0
//! ```
//!
//! with the stall torque and the no-load speed of a DC motor behind its gear, at the joint (the same as Isaac Lab's
//! `DCMotor`, whose saturation effort is the stall torque). The servo's torque is tracked with a first-order lag:
//! τ ← τ_old + (τ_servo − τ_old) dt/(T + dt), the backward Euler step of T dτ/dt = τ_servo − τ.

use super::stop::{NO_LIMIT, Push};
use crate::number::Real;

/// Stall torque as a multiple of the torque limit where it is not known: our choice, so that the full torque is available up to half of
/// the no-load speed.
const STALL: f64 = 2.0;

/// The motor of a joint. None: no limit; for `stall_torque`, twice the torque limit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Actuator {
    /// [N·m]
    pub torque_limit: Option<f64>,
    /// [N·m]
    pub stall_torque: Option<f64>,
    /// [rad/s]
    pub no_load_speed: Option<f64>,
    /// T [s]
    pub time_constant: f64,
}

/// The motors of a joint, one lane each.
#[derive(Clone, Copy)]
pub struct LaneActuator<R> {
    torque_limit: R,
    stall_torque: R,
    no_load_speed: R,
    time_constant: R,
}

impl Actuator {
    fn numbers(&self) -> [f64; 4] {
        let limit = self.torque_limit.unwrap_or(NO_LIMIT);
        let stall = self.stall_torque.unwrap_or(STALL * limit);
        [limit, stall, self.no_load_speed.unwrap_or(NO_LIMIT), self.time_constant]
    }
}

impl<R: Real> LaneActuator<R> {
    pub fn splat(actuator: &Actuator) -> Self {
        let [torque_limit, stall_torque, no_load_speed, time_constant] = actuator.numbers().map(R::splat);
        Self { torque_limit, stall_torque, no_load_speed, time_constant }
    }

    pub fn set_lane(&mut self, lane: usize, actuator: &Actuator) {
        let all = [&mut self.torque_limit, &mut self.stall_torque, &mut self.no_load_speed, &mut self.time_constant];
        all.into_iter().zip(actuator.numbers()).for_each(|(out, x)| out.set_lane(lane, x));
    }

    /// Least and greatest torque at the joint's rate.
    #[inline(always)]
    pub fn limits(&self, rate: R) -> [R; 2] {
        let part = rate / self.no_load_speed;
        let most = |part: R| (self.stall_torque * (R::one() - part)).clamp(R::zero(), self.torque_limit);
        [-most(-part), most(part)]
    }

    /// The torque that follows the servo's `push` in this step, if it was `before` in the last one.
    #[inline(always)]
    pub fn track(&self, push: Push<R>, before: R, dt: R) -> Push<R> {
        let share = dt / (self.time_constant + dt);
        let torque = (push.torque - before).mul_add(share, before);
        // Exactly the servo's without a lag.
        let free = R::one().lt(share + R::splat(f64::from(f32::EPSILON)));
        Push { torque: R::select(free, push.torque, torque), yielding: push.yielding * share }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn torque_falls_along_the_line() {
        let motor = Actuator {
            torque_limit: Some(10.0),
            stall_torque: Some(15.0),
            no_load_speed: Some(30.0),
            time_constant: 0.0,
        };
        let motor = LaneActuator::<f64>::splat(&motor);
        for (rate, low, high) in [
            (0.0, -10.0, 10.0),
            (10.0, -10.0, 10.0),
            (20.0, -10.0, 5.0),
            (30.0, -10.0, 0.0),
            (40.0, -10.0, 0.0),
            (-20.0, -5.0, 10.0),
        ] {
            let [least, most] = motor.limits(rate);
            assert!((least - low).abs() < 1e-12 && (most - high).abs() < 1e-12, "{rate}: {least} {most}");
        }
        let ideal = LaneActuator::<f32>::splat(&Actuator { torque_limit: Some(0.05), ..Actuator::default() });
        assert_eq!(ideal.limits(40.0), [-0.05_f32, 0.05]);
    }

    #[test]
    fn a_lag_follows_the_servo() {
        let push = Push { torque: 2.0, yielding: 0.5 };
        let at_once = LaneActuator::<f64>::splat(&Actuator::default()).track(push, 1.0, 1e-3);
        assert_eq!((at_once.torque, at_once.yielding), (2.0, 0.5));
        let slow = LaneActuator::<f64>::splat(&Actuator { time_constant: 0.02, ..Actuator::default() });
        let mut torque = 0.0;
        for _ in 0..20 {
            torque = slow.track(push, torque, 1e-3).torque;
        }
        assert!((torque / 2.0 - (1.0 - (-1.0_f64).exp())).abs() < 0.02, "{torque}");
    }
}
