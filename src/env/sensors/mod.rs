//! Sensors between the simulated robot and the observation, and the delay between the action and the motors.
//!
//! A task computes exact values. A column that belongs to a [`Sensor`] passes through the sensor's imperfections, in this order: the part
//! of the delay beyond whole control steps (the sensor samples this much before the step ends), gain and offset, bias and random walk,
//! white noise, low-pass filter, quantization, the delay's whole steps, dropout. Everything that a sensor remembers is a part of the
//! episode ([`SensorMemory`]), so snapshots contain it. Its random numbers depend on the environment's seed, the episode and the step
//! alone.
//!
//! How to add a sensor: row "a sensor" of the table in `ARCHITECTURE.md`.

mod action_delay;
mod extra;
mod hardware;
mod memory;
mod model;
mod options;
mod random;
mod signal;

pub use action_delay::ActionDelay;
pub use hardware::{HardwareFiles, motors};
pub use memory::SensorMemory;
pub use model::{Privileged, SensorInput, SensorModel};
pub use options::{Hardware, Imperfections, Motors, SensorOptions, Sensors};

use serde::{Deserialize, Serialize};

/// Declares the sensors, one line each: the variant, and its key in option `sensors`.
macro_rules! sensors {
    ($($(#[doc = $doc:literal])* $Variant:ident: $key:ident,)*) => {
        /// What measures a column of the observation.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
        #[serde(rename_all = "snake_case")]
        pub enum Sensor {
            $($(#[doc = $doc])* $Variant,)*
        }

        impl Sensor {
            pub const ALL: [Self; [$(Self::$Variant),*].len()] = [$(Self::$Variant),*];

            /// Its key in option `sensors`.
            pub fn name(self) -> &'static str {
                match self { $(Self::$Variant => stringify!($key),)* }
            }
        }

        impl Sensors {
            /// The imperfections of a sensor; None: the sensor is exact, and is not added to the observation.
            pub fn of(&self, sensor: Sensor) -> Option<Imperfections> {
                match sensor { $(Sensor::$Variant => self.$key,)* }
            }
        }
    };
}

sensors! {
    /// Direction of gravity in the base's frame, as an inertial measurement unit estimates it.
    Gravity: gravity,
    /// Velocity of the base, as an estimator of the state gives it.
    LinVel: lin_vel,
    Gyroscope: gyroscope,
    Accelerometer: accelerometer,
    JointPosition: joint_position,
    JointVelocity: joint_velocity,
    JointTorque: joint_torque,
    ContactForce: contact_force,
    ContactSwitch: contact_switch,
    Heights: heights,
    RangeFinder: range_finder,
}

/// Which function of the measured value a column is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    Value,
    /// The sine, of a value that is an angle; likewise the cosine.
    Sine,
    Cosine,
}

#[cfg(test)]
mod tests;
