//! Keys of an experiment file that only `kind = "trajectory"` has.

use crate::error::{Error, Result, check_range};
use serde::Deserialize;
use serde::de::IgnoredAny;

/// The table `[imu]`.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ImuTable {
    position: Option<[f64; 3]>,
    quat: Option<[f64; 4]>,
}

/// The table `[motor]`.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotorTable {
    torque_constant: Option<f64>,
}

/// A table `[[run]]`: the part of the log that is one run, for logs without a column `run`. `from` and `to` are values of `t` [s].
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Cut {
    pub name: Option<String>,
    pub from: Option<f64>,
    pub to: Option<f64>,
    pub condition: Option<String>,
    pub leg: Option<String>,
    pub slope_deg: Option<f64>,
    pub stride_frequency: Option<f64>,
}

impl Cut {
    pub fn holds(&self, t: f64) -> bool {
        self.from.is_none_or(|from| t >= from) && self.to.is_none_or(|to| t < to)
    }
}

/// Largest number of runs that an experiment file lists: our choice, the same as that of a log.
const MOST_CUTS: usize = 1000;

/// The keys as the file has them, not checked yet.
#[derive(Clone, Debug, Default)]
pub struct Given {
    pub imu: Option<ImuTable>,
    pub motor: Option<MotorTable>,
    pub slope_deg: Option<f64>,
    pub stride_frequency: Option<f64>,
    pub leg: Option<String>,
    pub touches: Option<Vec<String>>,
    pub window: Option<f64>,
    /// The topics of a recording that `sandgait.logs` (Python) reads; a CSV has none.
    pub topics: Option<IgnoredAny>,
    pub run: Vec<Cut>,
}

/// The keys after the check, with defaults.
#[derive(Clone, Debug)]
pub struct Keys {
    /// Position of the IMU in the base's frame [m].
    pub imu_position: [f64; 3],
    /// Mounting of the IMU: rotation from its frame to the base's frame, as a quaternion w, x, y, z.
    pub imu_quat: [f64; 4],
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
    /// Length of the windows if the log has no strides: no joint turns round and no stride frequency is given [s].
    pub window: f64,
    pub cuts: Vec<Cut>,
}

impl Default for Keys {
    fn default() -> Self {
        Self {
            imu_position: [0.0; 3],
            imu_quat: [1.0, 0.0, 0.0, 0.0],
            torque_constant: None,
            slope_deg: 0.0,
            stride_frequency: None,
            leg: None,
            touches: None,
            // Our choice: about a stride.
            window: 0.5,
            cuts: Vec::new(),
        }
    }
}

impl Given {
    /// The first key that is given.
    pub fn first(&self) -> Option<&'static str> {
        let all = [
            ("imu", self.imu.is_some()),
            ("motor", self.motor.is_some()),
            ("slope_deg", self.slope_deg.is_some()),
            ("stride_frequency", self.stride_frequency.is_some()),
            ("leg", self.leg.is_some()),
            ("touches", self.touches.is_some()),
            ("window", self.window.is_some()),
            ("topics", self.topics.is_some()),
            ("run", !self.run.is_empty()),
        ];
        all.iter().find(|k| k.1).map(|k| k.0)
    }

    pub fn checked(self) -> Result<Keys> {
        let own = Keys::default();
        let imu = self.imu.unwrap_or_default();
        let position = imu.position.unwrap_or(own.imu_position);
        // A sensor more than 10 m from the base, or a torque constant above 1000 N·m/A, has a wrong unit: our choices.
        position.iter().try_for_each(|p| check_range("imu.position", *p, -10.0..=10.0).map(drop))?;
        let quat = imu.quat.unwrap_or(own.imu_quat);
        let norm = quat.iter().map(|q| q * q).sum::<f64>().sqrt();
        if !(norm - 1.0).is_finite() || (norm - 1.0).abs() > 0.02 {
            return Err(Error::invalid("imu.quat", format!("the quaternion (w, x, y, z) has length {norm}, not 1")));
        }
        let mut cuts = self.run;
        if cuts.len() > MOST_CUTS {
            return Err(Error::invalid("run", format!("{} runs are listed; at most {MOST_CUTS} are read", cuts.len())));
        }
        for (k, cut) in cuts.iter_mut().enumerate() {
            let ends = [cut.from.unwrap_or(0.0), cut.to.unwrap_or(f64::MAX)];
            if ends.iter().any(|e| e.is_nan()) || ends[0] >= ends[1] {
                return Err(Error::invalid(
                    "run",
                    format!("run {}: from = {} is not before to = {}", k + 1, ends[0], ends[1]),
                ));
            }
            cut.name.get_or_insert_with(|| (k + 1).to_string());
        }
        let constant = self.motor.and_then(|m| m.torque_constant);
        Ok(Keys {
            imu_position: position,
            imu_quat: quat.map(|q| q / norm),
            torque_constant: constant.map(|k| check_range("motor.torque_constant", k, 1e-6..=1e3)).transpose()?,
            slope_deg: check_range("slope_deg", self.slope_deg.unwrap_or(0.0), -35.0..=35.0)?,
            stride_frequency: self
                .stride_frequency
                .map(|f| check_range("stride_frequency", f, -20.0..=20.0))
                .transpose()?,
            leg: self.leg,
            touches: self.touches,
            window: check_range("window", self.window.unwrap_or(own.window), 0.05..=60.0)?,
            cuts,
        })
    }
}
