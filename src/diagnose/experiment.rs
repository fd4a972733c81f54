//! EXPERIMENT.toml: facts that the data file does not contain.

use super::nuisance::{PriorEntry, Priors};
use super::trajectory::keys::{self, Imu, Keys, MotorKeys, RunTable};
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

impl BodyDescription {
    pub fn shape(&self) -> Result<BodyShape> {
        BodyShape::named(&self.body)
    }
}

#[derive(Deserialize)]
#[serde(untagged)]
enum CoefficientsSource {
    Named(String),
    Table(Coefficients),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SandTable {
    name: Option<String>,
    coefficients: Option<CoefficientsSource>,
    zeta: Option<f64>,
    bulk_density: Option<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    kind: DataKind,
    medium: Option<String>,
    sand: Option<SandTable>,
    bulk_density: Option<f64>,
    coefficient_sd: Option<f64>,
    robot: Option<String>,
    #[serde(default)]
    shape: BTreeMap<String, Intruder>,
    law: Option<String>,
    #[serde(default)]
    body: BTreeMap<String, BodyDescription>,
    #[serde(default)]
    nuisances: BTreeMap<String, PriorEntry>,
    #[serde(default)]
    units: BTreeMap<String, String>,
    #[serde(default)]
    columns: BTreeMap<String, String>,
    #[serde(default)]
    imu: Imu,
    #[serde(default)]
    motor: MotorKeys,
    slope_deg: Option<f64>,
    stride_frequency: Option<f64>,
    leg: Option<String>,
    touches: Option<Vec<String>>,
    window: Option<f64>,
    hardware: Option<String>,
    #[serde(rename = "topics")]
    _topics: Option<IgnoredAny>,
    #[serde(default)]
    run: Vec<RunTable>,
}

/// EXPERIMENT.toml, checked.
#[derive(Clone, Debug)]
pub struct Experiment {
    pub kind: DataKind,
    /// Medium with the experiment's bulk density.
    pub medium: Medium,
    /// Is the medium from the user's own `[sand]` table? Then the rows of the data may use any name for it, but only one.
    pub own_sand: bool,
    /// Relative prior standard deviation of each stress coefficient.
    pub coefficient_sd: f64,
    pub robot: Option<String>,
    pub shapes: BTreeMap<String, Intruder>,
    /// Force law that gives the stress tables of bodies in steady motion.
    pub law: Law,
    pub bodies: BTreeMap<String, BodyDescription>,
    pub nuisances: Priors,
    /// Column → unit, for columns that are not in SI.
    pub units: BTreeMap<String, String>,
    /// Our name of a column → the data's name.
    pub columns: BTreeMap<String, String>,
    /// The table of a robot's log.
    pub trajectory: Keys,
    pub given: GivenModel,
}

/// Results of earlier diagnoses. The plain model of a robot's log already contains them.
#[derive(Clone, Debug, Default)]
pub struct GivenModel {
    /// The mechanisms in the `sand.toml` that the experiment names as its medium.
    pub mechanisms: Mechanisms,
    pub hardware: HardwareDescription,
}

/// Relative prior sd of the coefficients if the experiment gives none: our choice, more than the 2 to 5 % that the
/// tests and studies put into their coefficients, and less than the 20 to 40 % of different batches (docs/physics.md).
const COEFFICIENT_SD: f64 = 0.08;

impl Experiment {
    /// Reads the file, and the files that it names.
    pub fn load(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(|e| Error::file(path, e))?;
        let read = |name: &str| std::fs::read_to_string(name).map_err(|e| Error::file(Path::new(name), e));
        Self::parse(&text, &read).map_err(|e| Error::file(path, e))
    }

    /// Reads the text of an experiment file that contains the texts of other files instead of their names: a server reads no files that a
    /// client names.
    pub fn from_toml(text: &str) -> Result<Self> {
        Self::parse(text, &|name| Err(Error::invalid(name, "a server reads no files; send the content of this one")))
    }

    /// Calls `take` with each row of the data, with the experiment's columns and units.
    pub fn read(
        &self,
        data: &Path,
        columns: &[HeaderColumn],
        progress: &dyn Progress,
        take: impl FnMut(&Row) -> Result<()>,
    ) -> Result<Summary> {
        let (renamed, units) = (self.columns.clone(), self.units.clone());
        table::read(data, &ReadOptions { columns, renamed, units, most_rows: Some(MOST_ROWS), progress }, take)
    }

    fn parse(text: &str, read_file: &dyn Fn(&str) -> Result<String>) -> Result<Self> {
        let read = |name: &str| if name.contains('\n') { Ok(name.to_string()) } else { read_file(name) };
        let file: File = toml::from_str(text).map_err(|e| {
            let line = e.span().map(|s| text[..s.start.min(text.len())].lines().count().max(1));
            Error::invalid(
                "experiment",
                format!("{}{}", line.map(|l| format!("line {l}: ")).unwrap_or_default(), e.message()),
            )
        })?;
        let given: toml::Table = toml::from_str(text).unwrap_or_default();
        let key = keys::NAMES.iter().find(|key| given.contains_key(**key));
        if let Some(key) = key.filter(|_| file.kind != DataKind::Trajectory) {
            return Err(Error::invalid(*key, "only kind = \"trajectory\" has this key"));
        }
        let own_sand = file.sand.is_some();
        let mut given = GivenModel::default();
        if let Some(name) = &file.hardware {
            given.hardware = HardwareDescription::from_toml(&read(name)?)?;
        }
        let found = file.medium.as_deref().filter(|name| name.ends_with(".toml") || name.contains('\n'));
        let mut medium = match found {
            Some(name) => {
                let sand = found_sand(&read(name)?, file.kind, own_sand)?;
                given.mechanisms = sand.mechanisms;
                sand.medium()
            }
            None => medium(file.medium.as_deref(), file.sand)?,
        };
        if let Some(density) = file.bulk_density {
            medium.bulk_density = density;
        }
        // Less than air or more than gold is a wrong unit: our choice.
        check_range("bulk_density", medium.bulk_density, 1.0..=20_000.0)?;
        let coefficient_sd = file.coefficient_sd.unwrap_or(COEFFICIENT_SD);
        check_range("coefficient_sd", coefficient_sd, 0.0..=1.0)?;
        for (name, shape) in &file.shape {
            check_shape(name, shape)?;
        }
        for (name, body) in &file.body {
            body.shape().map_err(|e| Error::invalid(format!("body.{name}"), e.to_string()))?;
            // The same range as that of --mu-s in `sandgait intrude`.
            check_range(&format!("body.{name}.friction"), body.friction, 0.1..=10.0)?;
        }
        Ok(Self {
            law: file.law.as_deref().map_or(Ok(Law::Agarwal2023), Law::named)?,
            bodies: file.body,
            kind: file.kind,
            medium,
            own_sand,
            coefficient_sd,
            robot: file.robot,
            shapes: file.shape,
            nuisances: Priors::from_table(&file.nuisances)?,
            units: file.units,
            columns: file.columns,
            trajectory: Keys {
                imu: file.imu,
                torque_constant: file.motor.torque_constant,
                slope_deg: file.slope_deg.unwrap_or(0.0),
                stride_frequency: file.stride_frequency,
                leg: file.leg,
                touches: file.touches,
                window: file.window.unwrap_or(keys::WINDOW),
                runs: file.run,
            }
            .checked()?,
            given,
        })
    }
}

/// Reads the sand that an earlier diagnosis has found, which becomes the medium of a robot's log.
fn found_sand(text: &str, kind: DataKind, own_sand: bool) -> Result<SandDescription> {
    let sand = SandDescription::from_toml(text)?;
    match (kind, own_sand, sand.law) {
        (DataKind::Trajectory, false, Law::Li2013) => Ok(sand),
        (DataKind::Trajectory, true, _) => Err(Error::invalid("medium", "a sand.toml and a [sand] table are given")),
        (DataKind::Trajectory, ..) => Err(Error::invalid("medium", "a robot's log is replayed with law li2013 only")),
        _ => Err(Error::invalid("medium", "only kind = \"trajectory\" takes a sand.toml as its medium")),
    }
}

fn medium(name: Option<&str>, sand: Option<SandTable>) -> Result<Medium> {
    let Some(sand) = sand else {
        let name = name.ok_or_else(|| Error::invalid("medium", "neither a medium name nor a [sand] table is given"))?;
        return Medium::named(name);
    };
    let mut medium = match (sand.coefficients, sand.zeta) {
        (Some(CoefficientsSource::Table(coefficients)), None) => Medium {
            name: "own".into(),
            coefficients,
            bulk_density: 1500.0, // dry sand, as for `Medium::generic`
            source: "experiment".into(),
            terms: Vec::new(),
        },
        (Some(CoefficientsSource::Named(set)), None) if set != "generic" => Medium::named(&set)?,
        (Some(CoefficientsSource::Named(set)), Some(zeta)) if set == "generic" => Medium::generic(zeta)?,
        (None, Some(zeta)) => Medium::generic(zeta)?,
        (None, None) => match name {
            Some(name) => Medium::named(name)?,
            None => {
                return Err(Error::invalid("sand", "needs coefficients (a medium's name or nine numbers) or zeta"));
            }
        },
        _ => {
            return Err(Error::invalid(
                "sand",
                "zeta belongs to coefficients = \"generic\": give both, or another set without zeta",
            ));
        }
    };
    // 1e8 N/m³ are 100 N/cm³, as for `Medium::generic`: our choice, which catches wrong units.
    for c in medium.coefficients.to_array() {
        check_range("sand.coefficients", c, -1e8..=1e8)?;
    }
    if let Some(density) = sand.bulk_density {
        medium.bulk_density = density;
    }
    if let Some(name) = sand.name.or(name.map(Into::into)) {
        medium.name = name;
    }
    Ok(medium)
}

fn check_shape(name: &str, shape: &Intruder) -> Result<()> {
    let field = |part: &str| format!("shape.{name}.{part}");
    // The ranges are those of `LegShape`: smaller or larger shapes have a wrong unit.
    let (length, width, thickness) = match *shape {
        Intruder::Leg { chord, width, xi_deg, thickness } => {
            check_range(&field("xi_deg"), xi_deg, -89.9..=89.9)?;
            (check_range(&field("chord"), chord, 1e-3..=10.0)?, width, thickness)
        }
        Intruder::Plate { length, width, thickness } => {
            (check_range(&field("length"), length, 1e-3..=10.0)?, width, thickness)
        }
    };
    check_range(&field("width"), width, 1e-4..=10.0)?;
    check_range(&field("thickness"), thickness.unwrap_or(0.0), 0.0..=length)?;
    Ok(())
}
