//! The servo and motor of a robot's joints, as engines need them.

use super::actuator::Actuator;
use super::robot::Servo;
use super::stop::NO_LIMIT;
use crate::sand::Mechanisms;

/// The servo at every joint. A missing limit is [`NO_LIMIT`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motor {
    /// [N·m/rad]
    pub kp: f64,
    /// [N·m·s/rad]
    pub kd: f64,
    pub actuator: Actuator,
    /// [rad/s]
    pub speed_limit: f64,
    /// Largest distance of the reference from the joint's angle [rad]. With `anti_windup` it is torque_limit/kp, at
    /// which the position gain alone demands the full torque. A larger lag would not increase the torque, but the
    /// torque would persist after the command has changed (integrator windup; clamping is the usual remedy: Åström &
    /// Murray, Feedback Systems, 2008, section 10.4).
    pub lag_limit: f64,
}

impl Motor {
    pub(super) fn new(servo: &Servo, mechanisms: &Mechanisms) -> Self {
        let own = servo.torque_limit.unwrap_or(NO_LIMIT);
        // The torque limit of mechanism `motor_torque_limit`, if it is lower.
        let weak = mechanisms.motor_torque_limit;
        let torque_limit = if weak > 0.0 { own.min(weak) } else { own };
        let lag_limit = if servo.anti_windup && servo.kp > 0.0 { torque_limit / servo.kp } else { NO_LIMIT };
        Self {
            kp: servo.kp,
            kd: servo.kd,
            actuator: Actuator { torque_limit: Some(torque_limit), ..servo.actuator() },
            speed_limit: servo.speed_limit.unwrap_or(NO_LIMIT),
            lag_limit: lag_limit.min(NO_LIMIT),
        }
    }
}
