//! The ranges that an episode of LeggedVelocity draws from.

use crate::options;
use crate::spec::CONTROL_RATE;
use serde::{Deserialize, Serialize};
use std::ops::RangeInclusive;

/// Largest commanded velocity: forward and to the left [m/s], yaw [rad/s]. Our choice: default ranges reach it only
/// with legs above 10 m or below 2 cm.
pub const MOST_COMMAND: f64 = 5.0;

/// Bounds of drawn values, for options and for saved episodes. Our choice, as for all options: factors on the friction of
/// hard ground, on the sand's stress, and on the motors; the added mass as a share of the robot's.
pub const FRICTION: RangeInclusive<f64> = 0.0..=10.0;
pub const SAND: RangeInclusive<f64> = 0.05..=20.0;
pub const MOTOR_STRENGTH: RangeInclusive<f64> = 0.1..=10.0;
pub const ADDED_MASS: RangeInclusive<f64> = -0.3..=1.0;

/// Largest velocity along an axis that a push gives the base [m/s]: our choice, as above.
pub const MOST_PUSH: f64 = 5.0;

/// Share of the episodes on ground `any` whose ground is hard: our choice.
pub const HARD_SHARE: f64 = 0.2;
/// Factors on the stress of loose sand in its other episodes, whose logarithm is uniform. Our choice: with `sand_range` the
/// strengths differ by a factor of 43. Pushes of a robot's leg into dunes differ by 18 from the 10th to the 90th percentile
/// (docs/certify.md).
pub const STRENGTHS: [f64; 2] = [1.0, 16.0];

/// All ranges from which an episode's values are drawn.
#[derive(Clone, Copy)]
pub struct Draws {
    /// Ranges of commands: forward, to the left [m/s], yaw [rad/s].
    pub commands: [[f64; 2]; 3],
    /// Time between two commands [s].
    pub resampling_time: f64,
    /// Share of commands along one axis alone.
    pub single_axis: f64,
    /// Commanded speeds below this are zero [m/s].
    pub small: f64,
    pub rand: DomainRand,
    /// Longest episode [control steps].
    pub steps: u32,
    /// Does the episode draw its ground, too?
    pub any_ground: bool,
}

/// Largest number of commands, and of pushes, that an episode draws; after that they repeat. Our choice: with the default
/// time between two commands they last 17 minutes.
pub(super) const MOST: usize = 100;

impl Draws {
    /// Numbers of commands and of pushes in an episode.
    pub fn counts(&self) -> [usize; 2] {
        let seconds = f64::from(self.steps) / CONTROL_RATE;
        let within =
            |interval: f64| if interval > 0.0 { ((seconds / interval).ceil() as usize).clamp(1, MOST) } else { 0 };
        [within(self.resampling_time), within(self.rand.push_interval)]
    }

    /// Memory of an episode's commands and pushes [bytes].
    pub fn list_bytes(&self) -> usize {
        let [commands, pushes] = self.counts();
        commands * size_of::<[f64; 3]>() + pushes * size_of::<[f64; 2]>()
    }
}

options! {
    /// Ranges of commands; the default ranges follow from the robot's size (`units`). The time is legged_gym's.
    #[derive(Copy, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Commands {
        lin_vel_x: Option<[f64; 2]> = None, [-MOST_COMMAND, MOST_COMMAND], "range of the forward speed [m/s]; None: ± 0.5 √(gℓ) with the legs' length ℓ";
        lin_vel_y: Option<[f64; 2]> = None, [-MOST_COMMAND, MOST_COMMAND], "range of the speed to the left [m/s]; None: ± 0.25 √(gℓ)";
        ang_vel_yaw: Option<[f64; 2]> = None, [-MOST_COMMAND, MOST_COMMAND], "yaw speed [rad/s]; None: ± 0.2 √(g/ℓ)";
        resampling_time: f64 = 10.0, [0.1, 1e4], "time after which commands are drawn again [s]";
        single_axis: f64 = 0.0, [0.0, 1.0], "share of commands along one axis alone";
    }
}

options! {
    /// legged_gym has friction 0.5 to 1.25, ± 1 kg of 12, and a push every 15 s of up to 1 m/s; Isaac Lab pushes by up
    /// to 0.5 m/s. Factors on sand and motors are our choice: batches of sand differ by 20-40 % (Li, Zhang & Goldman
    /// 2013), and motors may differ from their data by a tenth.
    #[derive(Copy, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct DomainRand {
        friction_range: [f64; 2] = [0.5, 1.25], [FRICTION], "factor on the friction of hard ground";
        sand_range: [f64; 2] = [0.6, 1.6], [SAND], "factor on the sand's stress";
        added_mass_range: [f64; 2] = [-0.08, 0.08], [ADDED_MASS], "mass added to the base, as a share of the robot's mass";
        motor_strength_range: [f64; 2] = [0.9, 1.1], [MOTOR_STRENGTH], "factor on torque limits and gains of the motors";
        push_interval: f64 = 15.0, [0.0, 1e4], "time between two pushes [s], at least 0.1; 0: no pushes";
        max_push_vel_xy: f64 = 0.5, [0.0, MOST_PUSH], "largest velocity along x and along y that a push gives the base [m/s]";
    }
}

impl DomainRand {
    /// Ranges without randomness.
    pub const NONE: Self = Self {
        friction_range: [1.0; 2],
        sand_range: [1.0; 2],
        added_mass_range: [0.0; 2],
        motor_strength_range: [1.0; 2],
        push_interval: 0.0,
        max_push_vel_xy: 0.0,
    };
}
