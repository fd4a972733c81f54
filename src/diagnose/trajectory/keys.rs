//! Keys of an experiment file that only `kind = "trajectory"` has.

use crate::error::{Error, Result, check_range};
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

/// Largest number of runs that an experiment file lists: our choice, the same as in a log.
const MOST_RUNS: usize = 1000;

/// Names of the keys. The key `topics` has no effect on a CSV file; it is for recordings that `sandgait.logs` (Python) reads.
pub const NAMES: [&str; 10] =
    ["imu", "motor", "slope_deg", "stride_frequency", "leg", "touches", "window", "topics", "run", "hardware"];
/// Length of the windows if the file gives none [s]: our choice, about a stride.
pub const WINDOW: f64 = 0.5;

/// The keys.
#[derive(Clone, Debug)]
pub struct Keys {
    pub imu: Imu,
    /// Torque constant of the motors [N·m/A]; if it is given, the log has currents instead of torques.
    pub torque_constant: Option<f64>,
    /// Slope of the surface [°], if the log has no column for it.
    pub slope_deg: f64,
    /// Stride frequency [Hz], if the log has no column for it.
    pub stride_frequency: Option<f64>,
    /// Leg shape, if the log has no column for it.
    pub leg: Option<String>,
    /// Bodies or shapes that touch the sand, for a robot from a URDF or MJCF file.
    pub touches: Option<Vec<String>>,
    /// Length of the windows [s] if the log has no strides, because no joint makes full turns and no stride frequency is given.
    pub window: f64,
    pub runs: Vec<RunTable>,
}

impl Keys {
    /// Checks the keys, gives runs without a name their number, and normalises the quaternion, whose norm may differ
    /// from 1 by as much as in a log. Slopes and frequencies have the ranges of a simulated walk.
    pub fn checked(mut self) -> Result<Keys> {
        // A sensor more than 10 m from the base, a torque constant above 1000 N·m/A, or a window of less than 50 ms or
        // more than a minute has a wrong unit: our choices.
        self.imu.position.iter().try_for_each(|p| check_range("imu.position", *p, -10.0..=10.0).map(drop))?;
        let norm = self.imu.quat.iter().map(|q| q * q).sum::<f64>().sqrt();
        if !(norm - 1.0).is_finite() || (norm - 1.0).abs() > 0.02 {
            return Err(Error::invalid("imu.quat", format!("the quaternion (w, x, y, z) has length {norm}, not 1")));
        }
        self.imu.quat = self.imu.quat.map(|q| q / norm);
        if self.runs.len() > MOST_RUNS {
            let reason = format!("{} runs are listed; at most {MOST_RUNS} are read", self.runs.len());
            return Err(Error::invalid("run", reason));
        }
        for (k, run) in self.runs.iter_mut().enumerate() {
            let [from, to] = [run.from.unwrap_or(0.0), run.to.unwrap_or(f64::MAX)];
            if from.is_nan() || to.is_nan() || from >= to {
                let reason = format!("run {}: from = {from} is not before to = {to}", k + 1);
                return Err(Error::invalid("run", reason));
            }
            run.name.get_or_insert_with(|| (k + 1).to_string());
        }
        self.torque_constant.map_or(Ok(0.0), |k| check_range("motor.torque_constant", k, 1e-6..=1e3))?;
        check_range("slope_deg", self.slope_deg, -35.0..=35.0)?;
        check_range("stride_frequency", self.stride_frequency.unwrap_or(0.0), -20.0..=20.0)?;
        check_range("window", self.window, 0.05..=60.0)?;
        Ok(self)
    }
}
