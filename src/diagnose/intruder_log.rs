//! Reads steady states of a body in sand (intruder CSV), with one row for each steady state under a known load.

use super::experiment::{BodyDescription, Experiment};
use super::observations::{Channel, MeasuredLog, Names, Observations, Size, columns};
use crate::error::{Error, Result};
use crate::progress::Progress;
use crate::sand::intruder::{DepthOrLoad, Trial};
use crate::table::{HeaderColumn, Quantity, Row};
use std::path::Path;

/// The setting of one row.
#[derive(Clone, Debug, PartialEq)]
pub struct SteadyRow {
    /// A table `[body.NAME]` of the experiment.
    pub body: String,
    /// The motion under the measured load.
    pub trial: Trial,
    /// Standard deviation in time of each channel; 0 if the data do not have it.
    pub unsteadiness: [f64; 3],
}

impl SteadyRow {
    /// [N]
    pub fn load(&self) -> f64 {
        if let DepthOrLoad::Load(load) = self.trial.given { load } else { 0.0 }
    }
}

/// Steady states of a body; each is a unit.
pub type IntruderLog = MeasuredLog<SteadyRow>;

columns! {
    TRIAL = "trial" Text true;
    CONDITION = "condition" Text true;
    REP = "rep" Text true;
    BODY = "body" Text true;
    VX = "vx" Speed false;
    VY = "vy" Speed false;
    VZ = "vz" Speed false;
    WX = "wx" AngularSpeed false;
    WY = "wy" AngularSpeed false;
    WZ = "wz" AngularSpeed false;
    LOAD = "load" Force true;
    DEPTH = "depth" Length true;
    FX = "Fx" Force true;
    FY = "Fy" Force true;
    DEPTH_SD = "depth_sd" Length false;
    FX_SD = "Fx_sd" Force false;
    FY_SD = "Fy_sd" Force false;
}

/// The predicted channels at the measured load: two forces, which count in the error, and the sinkage, which does not.
pub const CHANNELS: [Channel; 3] =
    [Channel::new("Fx", "N", true), Channel::new("Fy", "N", true), Channel::new("depth", "m", false)];

/// Largest number of rows: our choice, 15 times that of the wheels' data; each row is simulated some ten thousand
/// times.
const MOST_ROWS: usize = 2_000;

/// Larger numbers are broken or in the wrong unit: our choice.
const MOST: f64 = 1e6;

/// Reads the rows; `experiment` describes bodies and units.
pub fn read(path: &Path, experiment: &Experiment, progress: &dyn Progress) -> Result<IntruderLog> {
    let (mut conditions, mut ids) = (Names::default(), Names::default());
    let (mut rows, mut values, mut settings) = (Vec::new(), Vec::new(), Vec::new());
    let summary = experiment.read(path, COLUMNS, progress, |row| {
        let id = row.needed_text(TRIAL)?;
        if ids.place(id) != settings.len() {
            return Err(row.error(TRIAL, format!("{id} is in the file twice")));
        }
        if settings.len() == MOST_ROWS {
            return Err(row.error(TRIAL, format!("more than {MOST_ROWS} rows: split the data")));
        }
        row.needed_text(REP)?;
        let condition = conditions.place(row.needed_text(CONDITION)?);
        let unsteadiness = [sd(row, FX_SD)?, sd(row, FY_SD)?, sd(row, DEPTH_SD)?];
        rows.push((id.to_string(), condition));
        for column in [FX, FY, DEPTH] {
            values.push(row.needed_within(column, MOST)?);
        }
        settings.push(SteadyRow { body: body(row, experiment)?, trial: trial(row, path)?, unsteadiness });
        Ok(())
    })?;
    let observations =
        Observations::of_rows(Size::Force, CHANNELS.to_vec(), &[0.0], rows.into_iter(), values, conditions.list);
    let (setting_of, missing) = ((0..settings.len()).collect(), Vec::new());
    let notes = [notes(experiment), summary.notes].concat();
    Ok(IntruderLog { observations, settings, setting_of, missing, notes, sha256: summary.sha256 })
}

fn sd(row: &Row, column: usize) -> Result<f64> {
    let value = row.within(column, MOST)?.unwrap_or(0.0);
    if value < 0.0 { Err(row.error(column, format!("{value} is negative"))) } else { Ok(value) }
}

fn body(row: &Row, experiment: &Experiment) -> Result<String> {
    let name = row.needed_text(BODY)?;
    if experiment.file.bodies.contains_key(name) {
        return Ok(name.into());
    }
    let known: Vec<&str> = experiment.file.bodies.keys().map(String::as_str).collect();
    Err(row.error(BODY, Error::unknown("body", name, &known)))
}

fn trial(row: &Row, path: &Path) -> Result<Trial> {
    let mut motion = [0.0; 6];
    for (value, column) in motion.iter_mut().zip([VX, VY, VZ, WX, WY, WZ]) {
        *value = row.within(column, MOST)?.unwrap_or(0.0);
    }
    let [vx, vy, vz, wx, wy, wz] = motion;
    let load = row.needed_within(LOAD, MOST)?;
    let trial = Trial { velocity: [vx, vy, vz], spin: [wx, wy, wz], given: DepthOrLoad::Load(load) };
    trial.validated().map_err(|e| Error::file(path, format!("row {}: {e}", row.line)))
}

/// Notes for the report on the sand's file.
fn notes(experiment: &Experiment) -> Vec<String> {
    let said = |(name, body): (&String, &BodyDescription)| {
        format!("{name}: {}, surface friction μ_s {} (sandgait intrude --mu-s)", body.body, body.friction)
    };
    experiment.file.bodies.iter().map(said).collect()
}
