//! Nuisances: effects of measuring that occur in every laboratory. They are not causes in the sand, so they are
//! marginalised like the coefficients.
//!
//! A nuisance is a column: the change of the data by one prior standard deviation, computed at the current fit. This
//! file has the nuisances that all trials share. Effects that differ between trials (offset, drift, surface, strength
//! of the bed) are noise of low rank whose size is learnt from the repetitions ([`super::shared`]).

use super::fit::Stack;
use crate::error::{Error, Result, check_range};
use serde::Serialize;
use std::collections::BTreeMap;
use std::sync::Arc;

/// One nuisance of all data.
#[derive(Clone, Debug)]
pub struct Nuisance {
    /// An id such as `delay`. Ids of reports do not say of what it is the error; see `of`.
    pub id: &'static str,
    /// The channel or the shape whose error this is; None: of all.
    pub of: Option<String>,
    pub unit: &'static str,
    /// Prior standard deviation [unit], and the one that is stated: a model may have a wider prior.
    pub sd: f64,
    pub stated_sd: f64,
    /// Up to this size the effect is nearly linear.
    pub nearly_linear: f64,
    /// Change of the data by one standard deviation.
    pub column: Stack,
    /// For a nuisance with a nonlinear effect, such as a filter: the effect at the value at which `column` was
    /// computed, minus `column` times this value.
    pub bend: Option<Stack>,
}

impl Nuisance {
    /// `slope` is the change of the data by one unit.
    pub fn linear(id: &'static str, unit: &'static str, sd: f64, slope: Vec<f64>) -> Self {
        let column = Arc::new(slope.iter().map(|s| sd * s).collect());
        Self { id, of: None, unit, sd, stated_sd: sd, nearly_linear: f64::INFINITY, column, bend: None }
    }

    /// The same error of one channel or shape.
    pub fn of(self, of: impl Into<String>) -> Self {
        Self { of: Some(of.into()), ..self }
    }

    /// The same nuisance with another prior standard deviation; with 0 it is excluded.
    pub fn with_prior(&self, sd: f64) -> Self {
        if sd == self.sd {
            return self.clone();
        }
        let column = Arc::new(self.column.iter().map(|c| c * sd / self.sd).collect());
        Self { sd, column, ..self.clone() }
    }

    /// May it be the answer of a diagnosis?
    pub fn is_answer(&self) -> bool {
        kind(self.id).is_some_and(|kind| !kind.remedy.is_empty())
    }

    /// Is it an error of a robot's IMU?
    pub fn is_of_the_imu(&self) -> bool {
        ["imu_rotation", "imu_delay", "imu_blur", "gyro_bias", "acc_bias"].contains(&self.id)
    }

    /// Is it an error of the model itself?
    pub fn is_of_the_model(&self) -> bool {
        kind(self.id).is_some_and(|kind| kind.kind == CauseKind::Robot && kind.remedy.is_empty())
    }

    pub fn is(&self, other: &Self) -> bool {
        self.id == other.id && self.of == other.of
    }

    pub fn bent(self, bend: Vec<f64>) -> Self {
        let bent = bend.iter().any(|b| *b != 0.0);
        Self { bend: bent.then(|| Arc::new(bend)), ..self }
    }
}

/// The present estimate of a nuisance.
#[derive(Clone, Debug)]
pub struct NuisanceState {
    pub id: &'static str,
    pub of: Option<String>,
    pub value: f64,
    /// Is it fitted? If not, its column is of no use.
    pub free: bool,
}

impl From<&Nuisance> for NuisanceState {
    fn from(n: &Nuisance) -> Self {
        Self { id: n.id, of: n.of.clone(), value: 0.0, free: n.sd > 0.0 }
    }
}

/// The estimate of a nuisance among `all`; 0 if there is none.
pub fn estimate(all: &[NuisanceState], id: &str, of: Option<&str>) -> f64 {
    all.iter().find(|s| s.id == id && s.of.as_deref() == of).map_or(0.0, |s| s.value)
}

/// What is wrong if this is the answer of a diagnosis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum CauseKind {
    /// The sand.
    Sand,
    /// Sensors, their mounting, the log, or the intruder's stated geometry.
    Measurement,
    /// The robot.
    Robot,
}

/// One kind of nuisance.
pub struct NuisanceKind {
    pub id: &'static str,
    pub unit: &'static str,
    /// Default prior standard deviation.
    sd: f64,
    pub kind: CauseKind,
    /// Id of the mechanism of a sensor with the same effect, for the channel in the second field.
    mechanism: &'static [(&'static str, &'static str)],
    /// Is it an error of stated geometry, whose prior is in the table `[uncertainty]`?
    pub geometry: bool,
    /// What is wrong, in words.
    pub words: &'static str,
    /// What to do about it; empty if it is no answer. Clocks differ by far less than one percent, so a clock that would have to differ by
    /// more only stands in for something else.
    pub remedy: &'static str,
}

macro_rules! kinds {
    ($($id:literal $unit:literal $sd:literal $kind:ident $geometry:literal $mechanism:expr, $words:literal, $remedy:literal;)*) => {
        /// All kinds. The default priors are our choices, usual in a careful laboratory: the zero of a load cell is known within a
        /// tenth of what the cell reads, its gain within 2 %, and it changes by 0.5 % from the first trial to the last one (data sheets:
        /// 0.01 to 0.05 % for each kelvin); its mounting within 3°; the height of the surface within 2 mm; clocks
        /// within 2 ms and 0.1 %; filters up to some 5 ms; half the length of a body within 1 mm, the friction of its surface within
        /// 0.15. A plate or leg is mounted within 2° and measured within 2 %, a motor's zero is known within 0.02 rad, the place of
        /// the sensor within 1 mm, and 2 % of one channel's load appear in another one (data sheets of six-axis load cells: 1 to 3 %).
        ///
        /// For a robot's log: an IMU mounted within 3°, late by 10 ms, with the blur of a filter of 7 ms (23 Hz), and offsets
        /// within 0.05 rad/s and 0.1 m/s²; logged torques within 2 % of the true torques and of the torques that servos
        /// request; offsets of torques and friction of joints within 5 % of the torques' rms; beds that scatter by 5 %; errors of the
        /// simulation of 10 % of a channel's standard deviation within a stride, independent between parts of a stride. Two
        /// simulators of the same robot on the same sand differ by half of that, but the differences in neighbouring parts are similar. All
        /// torques together differ by 1 %.
        /// Torques are logged within 5 ms of the joints. The mass and the size of the feet are known within 2 %, the base's centre of
        /// mass within 5 % of the legs' length; as an answer, none of them has a bound.
        const KINDS: &[NuisanceKind] = &[$(NuisanceKind {
            id: $id, unit: $unit, sd: $sd, kind: CauseKind::$kind, mechanism: &$mechanism, geometry: $geometry, words: $words,
            remedy: $remedy,
        }),*];
    };
}

kinds! {
    "offset" "1" 0.1 Measurement false [("Fx", "bias_x"), ("Fz", "bias_z")], "the zero of the load cell is off", "Zero the load cell before each trial, or subtract the value";
    "gain" "1" 0.02 Measurement false [], "the gain of the load cell is wrong", "Calibrate the load cell, or divide its readings by 1 + the value";
    "tilt" "rad" 0.05 Measurement false [("", "sensor_tilt")], "the force sensor is tilted", "Turn the logged forces back by the value, or align the sensor";
    "depth_zero" "m" 2e-3 Measurement false [("", "depth_zero")], "the height of the surface is off", "Add the value to the logged depths, or measure the surface again";
    "delay" "s" 2e-3 Measurement false [], "the force log is late", "Shift the rows of these channels earlier by the value";
    "lowpass" "s" 5e-3 Measurement false [], "the force channels are filtered", "Switch off the filter of these channels, or filter the motion with the same constant";
    "clock" "1" 1e-3 Measurement false [], "the clock of the force log runs at another rate", "";
    "attitude" "rad" 0.035 Measurement true [], "the plate or leg is tilted", "Add the value to the logged angle, or align the intruder";
    "joint_zero" "rad" 0.02 Measurement true [], "the zero of the leg's angle is off", "Add the value to the logged angle, or calibrate the encoder";
    "size" "1" 0.02 Measurement true [], "the intruder has another size than stated", "Measure the intruder, and state its true length and width";
    "origin" "m" 1e-3 Measurement true [], "torques are taken about another point than stated", "State the place of the sensor, or move the torques to the hip or plate centre";
    "gain_drift" "1" 0.005 Measurement false [], "forces change from trial to trial in the order of the file: the load cell, or the beds", "Calibrate the load cell before and after the session, and prepare all beds alike";
    "cross_talk" "1" 0.02 Measurement true [], "a part of one force channel appears in the other", "Calibrate the load cell with loads along each axis";
    "geometry" "m" 1e-3 Measurement false [], "the body has another size than stated", "Measure the body";
    "surface_friction" "1" 0.15 Measurement false [], "the body's surface has another friction than stated", "Measure the friction of the body's surface";
    "imu_rotation" "rad" 0.05 Robot false [], "the IMU is turned", "State the rotation of the IMU in [imu] quat, or train with hardware.toml";
    "imu_delay" "s" 0.01 Robot false [], "the IMU is late", "Shift the IMU's rows earlier by the value, or train with hardware.toml";
    "imu_blur" "s²" 5e-5 Robot false [], "the IMU is filtered", "Train with hardware.toml";
    "gyro_bias" "rad/s" 0.05 Robot false [], "the gyroscope's zero is off", "Calibrate the gyroscope";
    "acc_bias" "m/s²" 0.1 Robot false [], "the accelerometer's zero is off", "Calibrate the accelerometer";
    "torque_constant" "1" 0.02 Robot false [], "logged torques are wrong by a factor", "Calibrate the motors' torque constant, or train with hardware.toml";
    "servo_gain" "1" 0.02 Robot false [], "motors give another torque than requested", "Check the motors' gains and supply, or train with hardware.toml";
    "torque_offset" "1" 0.05 Robot false [], "the zero of the torques is off", "Calibrate the torque sensors";
    "friction" "N·m" 0.05 Robot false [], "the joints have friction", "Train with hardware.toml";
    "torque_delay" "s" 5e-3 Robot false [], "the logged torques are late", "Shift the torques' rows earlier by the value";
    "payload" "1" 0.02 Robot true [], "the robot carries more or less than its description", "Weigh the robot, and state its mass";
    "center_of_mass" "1" 0.05 Robot true [], "the base's centre of mass is elsewhere than described", "Balance the robot, and state where its centre of mass is";
    "foot_size" "1" 0.02 Robot true [], "the feet have another size than described", "Measure the feet, and state their size";
    "bed_strength" "1" 0.05 Measurement false [], "beds differ in strength", "Prepare the beds alike";
    "model_scale" "1" 0.01 Robot false [], "the simulated torques are inexact", "";
    "model_error" "1" 0.1 Robot false [], "the simulation is inexact", "";
}

/// The kind of an id.
pub fn kind(id: &str) -> Option<&'static NuisanceKind> {
    KINDS.iter().find(|k| k.id == id)
}

impl NuisanceKind {
    /// May beds that change look the same? Then nobody can say that it is not the sand.
    pub fn may_be_of_beds(&self) -> bool {
        matches!(self.id, "gain_drift" | "bed_strength")
    }

    /// The words for an error of this value, or of unknown sign: what is late by less than nothing is early.
    pub fn said(&self, value: Option<f64>) -> String {
        let late = match value {
            None => " is late or early",
            Some(value) if value < 0.0 => " is early",
            Some(_) => " is late",
        };
        self.words.replace(" is late", late)
    }

    /// The id in reports of this error as the answer of a diagnosis: that of the mechanism with the same effect, if there is one.
    pub fn answer(&self, of: Option<&str>) -> &'static str {
        let same = self.mechanism.iter().find(|(channel, _)| *channel == of.unwrap_or(""));
        same.map_or(self.id, |(_, id)| id)
    }
}

/// The table `[nuisances]` of an experiment: kind → prior standard deviation; 0 excludes the nuisance.
#[derive(Clone, Debug, PartialEq)]
pub struct Priors {
    sd: BTreeMap<&'static str, f64>,
}

impl Default for Priors {
    fn default() -> Self {
        Self { sd: KINDS.iter().map(|k| (k.id, k.sd)).collect() }
    }
}

impl Priors {
    /// The priors with the tables `[nuisances]` and `[uncertainty]`, which has those of stated geometry.
    pub fn from_tables(nuisances: &BTreeMap<String, f64>, uncertainty: &BTreeMap<String, f64>) -> Result<Self> {
        let mut priors = Self::default();
        for (table, name, given) in [("nuisances", nuisances, false), ("uncertainty", uncertainty, true)]
            .into_iter()
            .flat_map(|(table, entries, geometry)| entries.iter().map(move |(name, sd)| (table, name, (*sd, geometry))))
        {
            let (sd, geometry) = given;
            let known: Vec<&str> = KINDS.iter().filter(|k| k.geometry == geometry).map(|k| k.id).collect();
            let Some(id) = known.iter().find(|id| *id == name) else { return Err(Error::unknown(table, name, &known)) };
            priors.sd.insert(id, check_range(&format!("{table}.{name}"), sd, 0.0..=1e3)?);
        }
        Ok(priors)
    }

    /// Prior standard deviation of the nuisances of a kind; 0 if they are not fitted.
    pub fn sd(&self, kind: &str) -> f64 {
        self.sd.get(kind).copied().unwrap_or(0.0)
    }

    /// Unit of a kind.
    pub fn unit(id: &str) -> &'static str {
        kind(id).map_or("1", |k| k.unit)
    }
}
