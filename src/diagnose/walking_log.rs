//! Reads runs of a walking robot (walking CSV), with one row for each run.

use super::columns::columns;
use super::experiment::Experiment;
use super::observations::{Channel, MeasuredLog, Names, Observations, Size};
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

/// Number of measured columns.
const MEASURED: usize = 5;
/// Measured columns in the order of the channels.
static CHANNELS: [(usize, Channel); MEASURED] = [
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

struct WalkRun {
    id: String,
    condition: usize,
    setup: usize,
    measured: [Option<f64>; MEASURED],
}

/// Reads the runs; `experiment` names robot, medium and units.
pub fn read(path: &Path, experiment: &Experiment, progress: &dyn Progress) -> Result<WalkingLog> {
    let (mut conditions, mut ids) = (Names::default(), Names::default());
    let (mut runs, mut setups): (Vec<WalkRun>, Vec<WalkSetup>) = (Vec::new(), Vec::new());
    let optional = [X_BED, SLOPE, PAYLOAD];
    let mut seen = [false; 3];
    let summary = experiment.read(path, COLUMNS, progress, |row| {
        for (seen, column) in seen.iter_mut().zip(optional) {
            *seen |= row.text(column).is_some();
        }
        let id = row.needed_text(RUN)?;
        if ids.place(id) != runs.len() {
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
        let mut measured = [None; MEASURED];
        // Larger numbers are broken or in the wrong unit: our choice, as in force logs.
        for (value, (column, _)) in measured.iter_mut().zip(&CHANNELS) {
            *value = row.within(*column, 1e6)?;
        }
        row.needed(SPEED)?;
        runs.push(WalkRun { id: id.into(), condition, setup: place, measured });
        Ok(())
    })?;
    let missing = optional.iter().zip(seen).filter(|s| !s.1).map(|s| COLUMNS[*s.0].name).collect();
    let setting_of = runs.iter().map(|r| r.setup).collect();
    let (observations, notes) = (observations(runs, conditions.list), Vec::new());
    Ok(WalkingLog { observations, settings: setups, setting_of, missing, notes, sha256: summary.sha256 })
}

/// The setup in a row. The ranges are those of a simulated walk; longer measurements take too long (our choice).
fn setup(row: &Row, experiment: &Experiment) -> Result<WalkSetup> {
    let robot = row.text(ROBOT).or(experiment.robot.as_deref());
    let robot = robot.ok_or_else(|| row.error(ROBOT, "is blank, and the experiment names none"))?;
    if experiment.robot.as_deref() != Some(robot) && !Robot::names().contains(&robot) {
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
        return Err(row.error(LEG, format!("leg {name:?} is unknown; known: {}", LegShape::NAMES.join(", "))));
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

fn observations(runs: Vec<WalkRun>, conditions: Vec<String>) -> Observations {
    let complete = |c: &usize| runs.iter().all(|r| r.measured[*c].is_some());
    let kept: Vec<usize> = (0..CHANNELS.len()).filter(complete).collect();
    let values = runs.iter().flat_map(|run| kept.iter().filter_map(|&c| run.measured[c])).collect();
    let channels = kept.iter().map(|&c| CHANNELS[c].1.clone()).collect();
    Observations::of_rows(Size::Channel, channels, runs.iter().map(|r| (r.id.clone(), r.condition)), values, conditions)
}

/// Planned runs: one unit for each setup, and zeros for measurements.
pub fn planned(setups: Vec<WalkSetup>, channels: Vec<Channel>) -> WalkingLog {
    let names: Vec<String> = (0..setups.len()).map(|i| i.to_string()).collect();
    let (rows, values) = (names.iter().cloned().zip(0..), vec![0.0; channels.len() * setups.len()]);
    let observations = Observations::of_rows(Size::Channel, channels, rows, values, names.clone());
    let (setting_of, notes) = ((0..setups.len()).collect(), Vec::new());
    WalkingLog { observations, settings: setups, setting_of, missing: Vec::new(), notes, sha256: String::new() }
}

/// Runs that a laboratory with these `setups` could make: its legs, and legs L and revL, at the lowest, a middle and
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
                out.push((WalkSetup { robot, leg, frequency, slope_deg, payload, x_bed, strides: STRIDES }, words));
            }
        }
    }
    out
}
