//! Reads runs of a walking robot (walking CSV), with one row for each run.

use super::experiment::Experiment;
use super::observations::{Channel, MeasuredLog, Names, Observations, Size, columns};
use super::series::low_middle_high;
use crate::error::{Error, Result};
use crate::progress::Progress;
use crate::sand::LegShape;
use crate::sim::Robot;
use crate::table::{HeaderColumn, Quantity, Row};
use std::path::Path;

/// The setup of a run; runs with the same setup share one `WalkSetup`.
#[derive(Clone, Debug, PartialEq)]
pub struct WalkSetup {
    pub robot: String,
    /// Name of a leg shape, see [`LegShape::named`].
    pub leg: String,
    /// [Hz]
    pub frequency: f64,
    pub slope_deg: f64,
    /// [kg]
    pub payload: f64,
    /// Position along the bed where the run starts [m].
    pub x_bed: f64,
    /// Number of strides in the measurement.
    pub strides: f64,
}

/// Runs of a robot.
pub type WalkingLog = MeasuredLog<WalkSetup>;

columns! {
    RUN = "run" Text true;
    CONDITION = "condition" Text true;
    REP = "rep" Text true;
    ROBOT = "robot" Text false;
    LEG = "leg" Text true;
    XI = "xi_deg" Degrees false;
    FREQUENCY = "stride_frequency" Frequency true;
    SLOPE = "slope_deg" Degrees false;
    PAYLOAD = "payload" Mass false;
    X_BED = "x_bed" Length false;
    DURATION = "duration" Time false;
    SPEED = "speed" Speed true;
    HEIGHT = "base_height" Length false;
    PITCH = "pitch_rms" Angle false;
    TORQUE = "hip_torque_rms" Torque false;
    SPEED_ERROR = "hip_speed_error_rms" AngularSpeed false;
}

/// Measured columns in the order of the channels; `field` is that of [`crate::sim::walk::WalkResult`].
static CHANNELS: [(usize, Channel); 5] = [
    (SPEED, Channel::new("speed", "m/s", true)),
    (HEIGHT, Channel::new("base_height", "m", false)),
    (PITCH, Channel::new("pitch_rms", "rad", false)),
    (TORQUE, Channel::new("hip_torque_rms", "N·m", false)),
    (SPEED_ERROR, Channel::new("hip_speed_error_rms", "rad/s", false)),
];

/// Number of strides in the protocol's measurement, for data that do not give it.
const STRIDES: f64 = 4.0;
/// Largest number of different setups: our choice. Each is simulated some five hundred times, and sixty runs take about
/// a minute.
const MOST_SETUPS: usize = 300;

/// Reads the runs; `experiment` names robot, medium and units.
pub fn read(path: &Path, experiment: &Experiment, progress: &dyn Progress) -> Result<WalkingLog> {
    let (mut conditions, mut ids) = (Names::default(), Names::default());
    let (mut rows, mut measured, mut setting_of) = (Vec::new(), Vec::new(), Vec::new());
    let mut setups: Vec<WalkSetup> = Vec::new();
    let optional = [X_BED, SLOPE, PAYLOAD];
    let mut seen = [false; 3];
    let summary = experiment.read(path, COLUMNS, progress, |row| {
        for (seen, column) in seen.iter_mut().zip(optional) {
            *seen |= row.text(column).is_some();
        }
        let id = row.needed_text(RUN)?;
        if ids.place(id) != rows.len() {
            return Err(row.error(RUN, format!("{id} is in the file twice")));
        }
        row.needed_text(REP)?;
        let condition = conditions.place(row.needed_text(CONDITION)?);
        let setup = setup(row, experiment)?;
        let known = setups.iter().position(|s| *s == setup);
        if known.is_none() && setups.len() == MOST_SETUPS {
            return Err(row.error(CONDITION, format!("more than {MOST_SETUPS} different setups: split the data")));
        }
        let place = known.unwrap_or(setups.len());
        if known.is_none() {
            setups.push(setup);
        }
        let mut own = [None; CHANNELS.len()];
        for (value, (column, _)) in own.iter_mut().zip(&CHANNELS) {
            *value = row.within(*column, 1e6)?;
        }
        row.needed(SPEED)?;
        rows.push((id.to_owned(), condition));
        measured.push(own);
        setting_of.push(place);
        Ok(())
    })?;
    let missing = optional.iter().zip(seen).filter(|s| !s.1).map(|s| COLUMNS[*s.0].name).collect();
    // Channels that every run has.
    let kept: Vec<usize> = (0..CHANNELS.len()).filter(|&c| measured.iter().all(|own| own[c].is_some())).collect();
    let values = measured.iter().flat_map(|own| kept.iter().filter_map(|&c| own[c])).collect();
    let (channels, rows) = (kept.iter().map(|&c| CHANNELS[c].1.clone()).collect(), rows.into_iter());
    let observations = Observations::of_rows(Size::Channel, channels, &[0.0], rows, values, conditions.list);
    let notes = summary.notes;
    Ok(WalkingLog { observations, settings: setups, setting_of, missing, notes, sha256: summary.sha256 })
}

/// The setup in a row. The ranges are those of a simulated walk; longer measurements take too long (our choice).
fn setup(row: &Row, experiment: &Experiment) -> Result<WalkSetup> {
    let robot = row.text(ROBOT).or(experiment.file.robot.as_deref());
    let robot = robot.ok_or_else(|| row.error(ROBOT, "is blank, and the experiment names none"))?;
    if experiment.file.robot.as_deref() != Some(robot) && !Robot::names().contains(&robot) {
        return Err(row.error(ROBOT, Error::unknown("robot", robot, &Robot::names())));
    }
    let frequency = row.needed_within(FREQUENCY, 20.0)?;
    if frequency.abs() < 0.02 {
        return Err(row.error(FREQUENCY, format!("{frequency} Hz is no walk: at least 0.02 Hz")));
    }
    let payload = row.within(PAYLOAD, 1e3)?.unwrap_or(0.0);
    if payload < 0.0 {
        return Err(row.error(PAYLOAD, format!("{payload} kg is negative")));
    }
    let duration = row.within(DURATION, 1e4)?.unwrap_or(STRIDES / frequency.abs());
    // A measurement covers whole strides, so a fraction of a stride is a rounding error of the duration in the log.
    let strides = (duration * frequency.abs()).round();
    if !(1.0..=100.0).contains(&strides) {
        return Err(row.error(DURATION, format!("{duration} s are {strides} strides; 1 to 100 can be simulated")));
    }
    Ok(WalkSetup {
        robot: robot.into(),
        leg: leg(row)?,
        frequency,
        slope_deg: row.within(SLOPE, 35.0)?.unwrap_or(0.0),
        payload,
        x_bed: row.within(X_BED, 1e3)?.unwrap_or(0.0),
        strides,
    })
}

/// The leg's shape: its name or, for a two-piece leg whose knee angle is given, this angle.
fn leg(row: &Row) -> Result<String> {
    let name = row.needed_text(LEG)?;
    if !LegShape::NAMES.contains(&name) {
        return Err(row.error(LEG, Error::unknown("leg", name, &LegShape::NAMES)));
    }
    let Some(xi) = row.within(XI, 89.9)? else { return Ok(name.into()) };
    let wrong = match name {
        "L" => xi <= 0.0,
        "revL" => xi == 0.0,
        "flat" => xi != 0.0,
        _ => return Ok(name.into()), // half circles have no knee angle
    };
    if wrong {
        return Err(row.error(XI, format!("{xi}° is not the knee angle of a leg {name}")));
    }
    // The leg names stand for an angle of 45°. The angle of a reversed leg may be given with or without its sign.
    let named = name == "flat" || (xi.abs() - 45.0).abs() < 1e-9;
    Ok(if named { name.into() } else { format!("xi={}", if name == "revL" { -xi.abs() } else { xi }) })
}

impl WalkSetup {
    /// Would another log call these two the same condition? Frequencies may differ by a tenth, slopes by 2°, payloads by 5 g, places by
    /// 5 cm: our choices.
    fn resembles(&self, other: &Self) -> bool {
        self.leg == other.leg
            && (self.frequency.abs() - other.frequency.abs()).abs() <= 0.1 * self.frequency.abs()
            && (self.slope_deg - other.slope_deg).abs() <= 2.0
            && (self.payload - other.payload).abs() <= 5e-3
            && (self.x_bed - other.x_bed).abs() <= 0.05
    }
}

/// Planned runs, each with a description: one condition for each, and zeros for measurements.
pub fn planned(runs: Vec<(WalkSetup, String)>, channels: Vec<Channel>) -> WalkingLog {
    let (setups, names): (Vec<WalkSetup>, Vec<String>) = runs.into_iter().unzip();
    let (rows, values) = (names.iter().cloned().zip(0..), vec![0.0; channels.len() * setups.len()]);
    let observations = Observations::of_rows(Size::Channel, channels, &[0.0], rows, values, names.clone());
    let (setting_of, notes) = ((0..setups.len()).collect(), Vec::new());
    WalkingLog { observations, settings: setups, setting_of, missing: Vec::new(), notes, sha256: String::new() }
}

/// Runs that a laboratory with these `setups` could make and that are not in the data: its legs, and legs L and revL, at the lowest, a middle and
/// the highest stride frequency in the log, on level sand, 10° up and down, with a payload of 50 g (a third of the mass
/// of `xplorer`), and 30 cm behind the usual start: our choice.
pub fn possible(setups: &[WalkSetup]) -> Vec<(WalkSetup, String)> {
    let Some(first) = setups.first() else { return Vec::new() };
    let frequencies = low_middle_high(setups.iter().map(|s| s.frequency.abs()));
    let mut legs: Vec<String> = setups.iter().map(|s| s.leg.clone()).collect();
    legs.extend(["L", "revL"].map(String::from));
    let shape = |leg: &String| LegShape::named(leg).ok();
    legs.sort();
    legs.dedup_by(|a, b| shape(a) == shape(b));
    let mut out = Vec::new();
    for leg in legs {
        for frequency in frequencies {
            for (slope_deg, payload, x_bed) in
                [(0.0, 0.0, 0.0), (10.0, 0.0, 0.0), (-10.0, 0.0, 0.0), (0.0, 0.05, 0.0), (0.0, 0.0, -0.3)]
            {
                let words = format!(
                    "leg {leg}, {frequency:.2} Hz, slope {slope_deg:.0}°, payload {:.0} g, start at x = {:.0} cm",
                    1e3 * payload,
                    1e2 * x_bed
                );
                let leg = leg.clone();
                let robot = first.robot.clone();
                let planned = WalkSetup { robot, leg, frequency, slope_deg, payload, x_bed, strides: STRIDES };
                if !setups.iter().any(|made| planned.resembles(made)) {
                    out.push((planned, words));
                }
            }
        }
    }
    out
}
