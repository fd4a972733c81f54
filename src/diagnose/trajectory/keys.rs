//! Keys of an experiment file that only `kind = "trajectory"` has.

use serde::Deserialize;

/// The table `[imu]`.
#[derive(Clone, Debug, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Imu {
    /// Position in the base's frame [m].
    pub position: [f64; 3],
    /// Rotation from the IMU's frame to the base's frame, as a quaternion w, x, y, z.
    pub quat: [f64; 4],
}

impl Default for Imu {
    fn default() -> Self {
        Self { position: [0.0; 3], quat: [1.0, 0.0, 0.0, 0.0] }
    }
}

/// The table `[motor]`.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotorKeys {
    /// Torque constant of the motors [N·m/A]; if it is given, the log has currents instead of torques.
    pub torque_constant: Option<f64>,
}

/// A table `[[run]]`: the part of the log that is one run, for logs without a column `run`. `from` and `to` are values of `t` [s].
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunTable {
    pub name: Option<String>,
    pub from: Option<f64>,
    pub to: Option<f64>,
    pub condition: Option<String>,
    pub leg: Option<String>,
    pub slope_deg: Option<f64>,
    pub stride_frequency: Option<f64>,
}

impl RunTable {
    pub fn holds(&self, t: f64) -> bool {
        self.from.is_none_or(|from| t >= from) && self.to.is_none_or(|to| t < to)
    }
}

/// Largest number of runs in a log, and of runs that an experiment file lists: our choice.
pub const MOST_RUNS: usize = 1000;

/// Names of the keys. The key `topics` has no effect on a CSV file; it is for recordings that `sandgait.logs` (Python) reads.
pub const NAMES: [&str; 10] =
    ["imu", "motor", "slope_deg", "stride_frequency", "leg", "touches", "window", "topics", "run", "hardware"];
/// Length of the windows if the file gives none [s]: our choice, about a stride.
pub fn usual_window() -> f64 {
    0.5
}
