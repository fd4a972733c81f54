//! Nuisances: effects of measuring that occur in every laboratory. They are not causes in the sand, so they are
//! marginalised like the coefficients.
//!
//! A nuisance is a column: the change of the data by one prior standard deviation, computed at the current fit. This
//! file has the nuisances that all trials share. Effects that differ between trials (offset, drift, surface, strength
//! of the bed) are noise of low rank whose size is learnt from the repetitions ([`super::shared`]).

use super::fit::Stack;
use crate::error::{Error, Result, check_range};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::sync::Arc;

/// One nuisance of all data.
#[derive(Clone, Debug)]
pub struct Nuisance {
    /// An id such as `delay`, or `lowpass_Fx` if each channel has its own.
    pub id: String,
    pub unit: &'static str,
    /// Prior standard deviation [unit].
    pub sd: f64,
    /// Change of the data by one standard deviation.
    pub column: Stack,
    /// For a nuisance with a nonlinear effect, such as a filter: the effect at the value at which `column` was
    /// computed, minus `column` times this value.
    pub bend: Option<Stack>,
}

impl Nuisance {
    /// `slope` is the change of the data by one unit.
    pub fn linear(id: String, unit: &'static str, sd: f64, slope: Vec<f64>) -> Self {
        let column = Arc::new(slope.iter().map(|s| sd * s).collect());
        Self { id, unit, sd, column, bend: None }
    }

    pub fn bent(self, bend: Vec<f64>) -> Self {
        let bent = bend.iter().any(|b| *b != 0.0);
        Self { bend: bent.then(|| Arc::new(bend)), ..self }
    }
}

/// Kinds of nuisances with unit and default prior standard deviation. Our choices, usual in a careful laboratory:
/// the zero of a load cell is known within a tenth of what the cell reads, its gain within 2 %, its mounting within 3°;
/// the height of the surface within 2 mm; clocks within 2 ms and 0.1 %; filters up to some 5 ms; half the length of a
/// body within 1 mm, the friction of its surface within 0.15.
///
/// For a robot's log: an IMU mounted within 3°, late by 10 ms, with the blur of a filter of 7 ms (23 Hz), and offsets
/// within 0.05 rad/s and 0.1 m/s²; logged torques within 2 % of the true torques and of the torques that servos
/// request; offsets of torques and friction of joints within 5 % of the torques' rms; the mass within 2 %; beds that
/// scatter by 5 %; errors of the simulation of 10 % of a channel's standard deviation within a stride, independent
/// between parts of a stride. Two simulators of the same robot on the same sand differ by half of that, but the
/// differences in neighbouring parts are similar.
const KINDS: [(&str, &str, f64); 21] = [
    ("offset", "1", 0.1),
    ("gain", "1", 0.02),
    ("tilt", "rad", 0.05),
    ("depth_zero", "m", 2e-3),
    ("delay", "s", 2e-3),
    ("lowpass", "s", 5e-3),
    ("clock", "1", 1e-3),
    ("geometry", "m", 1e-3),
    ("surface_friction", "1", 0.15),
    ("imu_rotation", "rad", 0.05),
    ("imu_delay", "s", 0.01),
    ("imu_blur", "s²", 5e-5),
    ("gyro_bias", "rad/s", 0.05),
    ("acc_bias", "m/s²", 0.1),
    ("torque_constant", "1", 0.02),
    ("servo_gain", "1", 0.02),
    ("torque_offset", "1", 0.05),
    ("friction", "N·m", 0.05),
    ("mass", "1", 0.02),
    ("bed_strength", "1", 0.05),
    ("model_error", "1", 0.1),
];

/// The table `[nuisances]` of an experiment: kind → prior standard deviation; 0 excludes the nuisance.
#[derive(Clone, Debug, PartialEq)]
pub struct Priors {
    sd: BTreeMap<&'static str, f64>,
    /// Mechanisms of the sensor that may be named as causes.
    pub interest: Vec<String>,
}

impl Default for Priors {
    fn default() -> Self {
        Self { sd: KINDS.iter().map(|(id, _, sd)| (*id, *sd)).collect(), interest: Vec::new() }
    }
}

/// The form of the table in the file.
#[derive(Clone, Debug, Deserialize)]
#[serde(untagged)]
pub enum PriorEntry {
    Sd(f64),
    Interest(Vec<String>),
}

/// Nuisances that are the same effect as a mechanism of the sensor, by the beginning of their ids.
const SAME: [(&str, &str); 6] = [
    ("bias_x", "offset_Fx"),
    ("bias_z", "offset_Fz"),
    ("sensor_tilt", "tilt"),
    ("depth_zero", "depth_zero"),
    ("delay", "delay"),
    ("lowpass", "lowpass"),
];

/// Stated standard deviation of a mechanism of the sensor; None for all other mechanisms.
pub fn stated(nuisances: &[Nuisance], mechanism: &str) -> Option<f64> {
    let (_, same) = SAME.iter().find(|s| s.0 == mechanism)?;
    nuisances.iter().find(|n| n.id.starts_with(same)).map(|n| n.sd)
}

impl Priors {
    pub fn from_table(table: &BTreeMap<String, PriorEntry>) -> Result<Self> {
        let mut priors = Self::default();
        let known: Vec<&str> = KINDS.iter().map(|k| k.0).chain(["interest"]).collect();
        for (name, entry) in table {
            match (entry, KINDS.iter().find(|k| k.0 == name)) {
                (PriorEntry::Sd(sd), Some((id, ..))) => {
                    priors.sd.insert(id, check_range(&format!("nuisances.{name}"), *sd, 0.0..=1e3)?);
                }
                (PriorEntry::Interest(ids), None) if name == "interest" => priors.interest = ids.clone(),
                (_, None) if name != "interest" => return Err(Error::unknown("nuisance", name, &known)),
                _ => return Err(Error::invalid("nuisances", format!("{name} has the wrong type"))),
            }
        }
        let causes = SAME.map(|same| same.0);
        match priors.interest.iter().find(|id| !causes.contains(&id.as_str())) {
            Some(id) => Err(Error::unknown("nuisances.interest", id, &causes)),
            None => Ok(priors),
        }
    }

    /// Prior standard deviation of the nuisances of a kind; 0 if they are not fitted.
    pub fn sd(&self, kind: &str) -> f64 {
        self.sd.get(kind).copied().unwrap_or(0.0)
    }

    /// Unit of a kind.
    pub fn unit(kind: &str) -> &'static str {
        KINDS.iter().find(|k| k.0 == kind).map_or("1", |k| k.1)
    }
}
