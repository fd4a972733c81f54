//! EXPERIMENT.toml: facts that the data file does not contain.

use super::nuisance::Priors;
use crate::error::{Error, Result, check_range};
use crate::progress::Progress;
use crate::sand::intruder::BodyShape;
use crate::sand::mechanism::Mechanisms;
use crate::sand::{Coefficients, Law, Medium, SandDescription};
use crate::sim::hardware::HardwareDescription;
use crate::table::{self, HeaderColumn, ReadOptions, Row, Summary};
use serde::Deserialize;
use serde::de::IgnoredAny;
use std::collections::BTreeMap;
use std::path::Path;

/// Largest number of rows of a log: our choice, because the diagnosis of such a log uses some 0.6 GiB (2026-11-24), and
/// more samples in a trial add hardly any information.
pub const MOST_ROWS: usize = 40_000;

/// Largest number of runs in a log, and of runs that an experiment file lists: our choice.
pub const MOST_RUNS: usize = 1000;

/// Keys that only `kind = "trajectory"` has.
const TRAJECTORY_KEYS: [&str; 9] =
    ["imu", "motor", "slope_deg", "stride_frequency", "leg", "touches", "window", "run", "hardware"];

/// The kind of data.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DataKind {
    /// Force logs of plates and legs moved through the sand.
    Intrusion,
    /// Runs of a walking robot.
    Walking,
    /// A robot's own log: joints and IMU.
    Trajectory,
    /// Steady states of a body under its load.
    Intruder,
}

/// An intruder as the user describes it; lengths in m.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(tag = "type", rename_all = "lowercase", deny_unknown_fields)]
pub enum Intruder {
    /// Rotating two-piece leg: `chord` hip to tip, `xi_deg` knee angle.
    Leg { chord: f64, width: f64, xi_deg: f64, thickness: Option<f64> },
    /// Flat plate: `length` in the plane of motion, `width` across.
    Plate { length: f64, width: f64, thickness: Option<f64> },
}

impl Intruder {
    /// Its extent in the plane of motion (a leg's chord) and across [m].
    pub fn sides(&self) -> [f64; 2] {
        match *self {
            Self::Leg { chord, width, .. } => [chord, width],
            Self::Plate { length, width, .. } => [length, width],
        }
    }
}

/// A table `[body.NAME]`: a body in steady motion.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BodyDescription {
    /// A body as in `sandgait intrude --body`.
    pub body: String,
    /// Friction coefficient μ_s of its surface.
    #[serde(default = "usual_friction")]
    pub friction: f64,
}

/// A friction coefficient between those of polished steel and of rough plates in dry sand (Potyondy 1961: 0.54 to 0.76
/// of the sand's friction angle).
fn usual_friction() -> f64 {
    0.45
}

#[derive(Clone, Debug, Deserialize)]
#[serde(untagged)]
enum CoefficientsSource {
    Named(String),
    Table(Coefficients),
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SandTable {
    name: Option<String>,
    coefficients: Option<CoefficientsSource>,
    zeta: Option<f64>,
    bulk_density: Option<f64>,
}

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

/// Length of the windows if the file gives none [s]: our choice, about a stride.
fn usual_window() -> f64 {
    0.5
}

/// EXPERIMENT.toml as it is written. Only robots' own logs have the keys from `imu` on.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExperimentFile {
    pub kind: DataKind,
    medium: Option<String>,
    /// The user's own sand. With it the rows of the data may use any name for the medium, but only one.
    pub(super) sand: Option<SandTable>,
    bulk_density: Option<f64>,
    /// Relative prior standard deviation of each stress coefficient.
    #[serde(default = "usual_coefficient_sd")]
    pub coefficient_sd: f64,
    pub robot: Option<String>,
    #[serde(default, rename = "shape")]
    pub shapes: BTreeMap<String, Intruder>,
    law: Option<String>,
    #[serde(default, rename = "body")]
    pub bodies: BTreeMap<String, BodyDescription>,
    /// Kind → prior standard deviation; 0 excludes the nuisance. `interest` is of older files and has no effect.
    #[serde(default)]
    nuisances: BTreeMap<String, toml::Value>,
    /// The same for errors of stated geometry.
    #[serde(default)]
    uncertainty: BTreeMap<String, f64>,
    /// Column → unit, for columns that are not in SI.
    #[serde(default)]
    pub units: BTreeMap<String, String>,
    /// Our name of a column → the data's name.
    #[serde(default)]
    pub columns: BTreeMap<String, String>,
    #[serde(default)]
    pub imu: Imu,
    #[serde(default)]
    pub motor: MotorKeys,
    /// Slope of the surface [°], if the log has no column for it.
    #[serde(default)]
    pub slope_deg: f64,
    /// Stride frequency [Hz], if the log has no column for it.
    pub stride_frequency: Option<f64>,
    /// Leg shape, if the log has no column for it.
    pub leg: Option<String>,
    /// Bodies or shapes that touch the sand, for a robot from a URDF or MJCF file.
    pub touches: Option<Vec<String>>,
    /// Length of the windows [s] if the log has no strides, because no joint makes full turns and no stride frequency is given.
    #[serde(default = "usual_window")]
    pub window: f64,
    hardware: Option<String>,
    /// This key and the next have no effect on a CSV file; they are for recordings that `sandgait.logs` (Python) reads.
    #[serde(rename = "topics")]
    _topics: Option<IgnoredAny>,
    #[serde(rename = "arm")]
    _arm: Option<IgnoredAny>,
    #[serde(default, rename = "run")]
    pub runs: Vec<RunTable>,
}

/// EXPERIMENT.toml, checked.
#[derive(Clone, Debug)]
pub struct Experiment {
    pub file: ExperimentFile,
    /// Medium with the experiment's bulk density.
    pub medium: Medium,
    /// Force law that gives the stress tables of bodies in steady motion.
    pub law: Law,
    pub nuisances: Priors,
    pub given: GivenModel,
}

/// Results of earlier diagnoses. The plain model of a robot's log already contains them.
#[derive(Clone, Debug, Default)]
pub struct GivenModel {
    /// The mechanisms in the `sand.toml` that the experiment names as its medium.
    pub mechanisms: Mechanisms,
    pub hardware: HardwareDescription,
}

/// Relative prior sd of the coefficients if the experiment gives none: our choice, well below the 0.2 to 0.4 by which
/// batches of sand differ (Li, Zhang & Goldman 2013).
fn usual_coefficient_sd() -> f64 {
    0.08
}

impl Experiment {
    /// Reads the file, and the files that it names.
    pub fn load(path: &Path) -> Result<Self> {
        let text = sandgait_base::files::read_text(path)?;
        let read = |name: &str| sandgait_base::files::read_text(Path::new(name));
        Self::with_files(&text, &read).map_err(|e| Error::file(path, e))
    }

    /// Reads the text of an experiment file that contains the texts of other files instead of their names: a server reads no files that a
    /// client names.
    pub fn from_toml(text: &str) -> Result<Self> {
        Self::with_files(text, &|name| {
            Err(Error::invalid(name, "a server reads no files; send the content of this one"))
        })
    }

    /// Calls `take` with each row of the data, with the experiment's columns and units.
    pub fn read(
        &self,
        data: &Path,
        columns: &[HeaderColumn],
        progress: &dyn Progress,
        take: impl FnMut(&Row) -> Result<()>,
    ) -> Result<Summary> {
        let (renamed, units) = (self.file.columns.clone(), self.file.units.clone());
        table::read(data, &ReadOptions { columns, renamed, units, most_rows: Some(MOST_ROWS), progress }, take)
    }

    /// The same; `read_file` gives the texts of the files that the experiment names.
    pub fn with_files(text: &str, read_file: &dyn Fn(&str) -> Result<String>) -> Result<Self> {
        let read = |name: &str| if name.contains('\n') { Ok(name.to_string()) } else { read_file(name) };
        let mut file: ExperimentFile = toml::from_str(text).map_err(|e| {
            let line = e.span().map(|s| text[..s.start.min(text.len())].lines().count().max(1));
            Error::invalid(
                "experiment",
                format!("{}{}", line.map(|l| format!("line {l}: ")).unwrap_or_default(), e.message()),
            )
        })?;
        let given: toml::Table = toml::from_str(text).unwrap_or_default();
        let key = TRAJECTORY_KEYS.iter().find(|key| given.contains_key(**key));
        if let Some(key) = key.filter(|_| file.kind != DataKind::Trajectory) {
            return Err(Error::invalid(*key, "only kind = \"trajectory\" has this key"));
        }
        let mut given = GivenModel::default();
        if let Some(name) = &file.hardware {
            given.hardware = HardwareDescription::from_toml(&read(name)?)?;
        }
        let found = file.medium.as_deref().filter(|name| name.ends_with(".toml") || name.contains('\n'));
        let mut medium = match found {
            Some(name) => {
                let sand = found_sand(&read(name)?, &file)?;
                given.mechanisms = sand.mechanisms;
                sand.medium()
            }
            None => medium(file.medium.as_deref(), file.sand.as_ref())?,
        };
        if let Some(density) = file.bulk_density {
            medium.bulk_density = density;
        }
        // Less than air or more than gold is a wrong unit: our choice.
        check_range("bulk_density", medium.bulk_density, 1.0..=20_000.0)?;
        check_range("coefficient_sd", file.coefficient_sd, 0.0..=1.0)?;
        for (name, shape) in &file.shapes {
            check_shape(name, shape)?;
        }
        for (name, body) in &file.bodies {
            BodyShape::named(&body.body).map_err(|e| Error::invalid(format!("body.{name}"), e.to_string()))?;
            // The same range as that of --mu-s in `sandgait intrude`.
            check_range(&format!("body.{name}.friction"), body.friction, 0.1..=10.0)?;
        }
        let law = file.law.as_deref().map_or(Ok(Law::Agarwal2023), Law::named)?;
        let nuisances = file.priors()?;
        file.check_trajectory()?;
        Ok(Self { file, medium, law, nuisances, given })
    }
}

impl ExperimentFile {
    fn priors(&self) -> Result<Priors> {
        let mut stated = BTreeMap::new();
        for (name, entry) in self.nuisances.iter().filter(|(name, _)| *name != "interest") {
            let sd = entry.as_float().or_else(|| entry.as_integer().map(|whole| whole as f64));
            let wrong = || Error::invalid("nuisances", format!("{name} has the wrong type"));
            stated.insert(name.clone(), sd.ok_or_else(wrong)?);
        }
        Priors::from_tables(&stated, &self.uncertainty)
    }

    /// Has the file the key `interest`, which has no effect any more?
    pub fn states_interest(&self) -> bool {
        self.nuisances.contains_key("interest")
    }

    /// Checks the keys of a robot's log, gives runs without a name their number, and normalises the quaternion.
    fn check_trajectory(&mut self) -> Result<()> {
        // A sensor more than 10 m from the base, or a torque constant above 1000 N·m/A, has a wrong unit: our choices.
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
        self.motor.torque_constant.map_or(Ok(0.0), |k| check_range("motor.torque_constant", k, 1e-6..=1e3))?;
        check_range("slope_deg", self.slope_deg, -35.0..=35.0)?;
        check_range("stride_frequency", self.stride_frequency.unwrap_or(0.0), -20.0..=20.0)?;
        check_range("window", self.window, 0.05..=60.0).map(drop)
    }
}

/// Reads the sand that an earlier diagnosis has found, which becomes the medium of a robot's log.
fn found_sand(text: &str, file: &ExperimentFile) -> Result<SandDescription> {
    let sand = SandDescription::from_toml(text)?;
    match (file.kind, file.sand.is_some(), sand.law) {
        (DataKind::Trajectory, false, Law::Li2013) => Ok(sand),
        (DataKind::Trajectory, true, _) => Err(Error::invalid("medium", "a sand.toml and a [sand] table are given")),
        (DataKind::Trajectory, ..) => Err(Error::invalid("medium", "a robot's log is replayed with law li2013 only")),
        _ => Err(Error::invalid("medium", "only kind = \"trajectory\" takes a sand.toml as its medium")),
    }
}

fn medium(name: Option<&str>, sand: Option<&SandTable>) -> Result<Medium> {
    let Some(sand) = sand else {
        let name = name.ok_or_else(|| Error::invalid("medium", "neither a medium name nor a [sand] table is given"))?;
        return Medium::named(name);
    };
    let mut medium = match (&sand.coefficients, sand.zeta) {
        (Some(CoefficientsSource::Table(coefficients)), None) => Medium {
            name: "own".into(),
            coefficients: *coefficients,
            bulk_density: 1500.0,
            source: "experiment".into(),
            terms: Vec::new(),
        },
        (Some(CoefficientsSource::Named(set)), None) if set != "generic" => Medium::named(set)?,
        (Some(CoefficientsSource::Named(set)), Some(zeta)) if set == "generic" => Medium::generic(zeta)?,
        (None, Some(zeta)) => Medium::generic(zeta)?,
        (None, None) => {
            let wrong = "needs coefficients (a medium's name or nine numbers) or zeta";
            Medium::named(name.ok_or_else(|| Error::invalid("sand", wrong))?)?
        }
        _ => {
            let wrong = "zeta belongs to coefficients = \"generic\": give both, or another set without zeta";
            return Err(Error::invalid("sand", wrong));
        }
    };
    // 1e8 N/m³ are 100 N/cm³, as for `Medium::generic`: our choice, which catches wrong units.
    for c in medium.coefficients.to_array() {
        check_range("sand.coefficients", c, -1e8..=1e8)?;
    }
    if let Some(density) = sand.bulk_density {
        medium.bulk_density = density;
    }
    if let Some(name) = sand.name.as_deref().or(name) {
        medium.name = name.into();
    }
    Ok(medium)
}

fn check_shape(name: &str, shape: &Intruder) -> Result<()> {
    let field = |part: &str| format!("shape.{name}.{part}");
    // 1 mm to 10 m as for LegShape::segments: smaller or larger ones have a wrong unit.
    let (Intruder::Leg { width, thickness, .. } | Intruder::Plate { width, thickness, .. }) = *shape;
    let length = match *shape {
        Intruder::Leg { chord, xi_deg, .. } => {
            check_range(&field("xi_deg"), xi_deg, -89.9..=89.9)?;
            check_range(&field("chord"), chord, 1e-3..=10.0)?
        }
        Intruder::Plate { length, .. } => check_range(&field("length"), length, 1e-3..=10.0)?,
    };
    check_range(&field("width"), width, 1e-4..=10.0)?;
    check_range(&field("thickness"), thickness.unwrap_or(0.0), 0.0..=length)?;
    Ok(())
}
