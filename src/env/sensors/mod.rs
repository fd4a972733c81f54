//! Sensors between the simulated robot and the observation, and the delay between the action and the motors.
//!
//! A task computes exact values. A column that belongs to a [`Sensor`] passes through the sensor's imperfections, in this
//! order: bias and random walk, white noise, low-pass filter, quantization, delay, dropout. Everything that a sensor
//! remembers is a part of the episode ([`SensorMemory`]), so snapshots contain it. Its random numbers depend on the
//! environment's seed, the episode and the step alone.
//!
//! To add a sensor: a variant of [`Sensor`], with `ALL` and `name`; a line in [`Sensors`] and its arm of `of`; and the mark
//! [`Features::sensed`] at the columns that a task has of it, or, if no task has it, its columns in [`extra`]. In [`plan`]: `IMU` if it is
//! a vector of the inertial measurement unit.
//!
//! [`Features::sensed`]: super::feature::Features::sensed

mod delay;
mod extra;
mod hardware;
mod memory;
mod options;
mod plan;
mod random;
mod signal;

pub use delay::ActionDelay;
pub use hardware::{HardwareFiles, motors};
pub use memory::SensorMemory;
pub use options::{Hardware, Imperfections, Motors, SensorOptions, Sensors};
pub use plan::{Plan, Privileged, Seen};

use serde::{Deserialize, Serialize};

/// What measures a column of the observation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Sensor {
    /// Direction of gravity in the base's frame, as an inertial measurement unit estimates it.
    Gravity,
    /// Velocity of the base, as an estimator of the state gives it.
    LinVel,
    Gyroscope,
    Accelerometer,
    JointPosition,
    JointVelocity,
    JointTorque,
    ContactForce,
    ContactSwitch,
    Heights,
    RangeFinder,
}

/// Which function of the measured value a column is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    Value,
    /// Of an angle.
    Sine,
    Cosine,
}

impl Sensor {
    pub const ALL: [Self; 11] = [
        Self::Gravity,
        Self::LinVel,
        Self::Gyroscope,
        Self::Accelerometer,
        Self::JointPosition,
        Self::JointVelocity,
        Self::JointTorque,
        Self::ContactForce,
        Self::ContactSwitch,
        Self::Heights,
        Self::RangeFinder,
    ];

    /// Its key in option `sensors`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Gravity => "gravity",
            Self::LinVel => "lin_vel",
            Self::Gyroscope => "gyroscope",
            Self::Accelerometer => "accelerometer",
            Self::JointPosition => "joint_position",
            Self::JointVelocity => "joint_velocity",
            Self::JointTorque => "joint_torque",
            Self::ContactForce => "contact_force",
            Self::ContactSwitch => "contact_switch",
            Self::Heights => "heights",
            Self::RangeFinder => "range_finder",
        }
    }
}

#[cfg(test)]
mod tests;
