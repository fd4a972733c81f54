//! Reads force logs of plates and legs (intrusion CSV) into trials.

use super::broken::{self, Fault, TrialReadings};
use super::check::finding::{Finding, Severity};
use super::check::logged::LoggedTrial;
use super::experiment::{Experiment, Intruder};
use super::motion::{Heading, heading, moving, progress};
use super::observations::{Channel, MeasuredLog, Names, Observations, Size, Unit, columns};
use super::series::low_middle_high;
use super::track::{ArmPose, Track};
use crate::error::Result;
use crate::progress::Progress;
use crate::table::{HeaderColumn, Quantity, Row};
use std::path::Path;

/// A force log; the setting of a trial is its track.
pub type ForceLog = MeasuredLog<Track>;

// A column is not required if its cells may be blank: columns of plates in a file of legs, and the reverse.
columns! {
    TRIAL = "trial" Text true;
    CONDITION = "condition" Text true;
    REP = "rep" Text true;
    KIND = "kind" Text true;
    SHAPE = "shape" Text true;
    MEDIUM = "medium" Text false;
    HIP_Z = "hip_z" Length false;
    BETA = "plate_beta" Angle false;
    GAMMA = "plate_gamma" Angle false;
    PASS = "pass" Number false;
    PASS_DX = "pass_dx" Length false;
    X_BED = "x_bed" Length false;
    T = "t" Time true;
    THETA = "theta" Angle false;
    OMEGA = "omega" AngularSpeed false;
    X = "x" Length false;
    Z = "z" Length false;
    VX = "vx" Speed false;
    VZ = "vz" Speed false;
    FX = "Fx" Force true;
    FZ = "Fz" Force true;
    TY = "Ty" Torque false;
}

/// A trial whose rows are still being read.
struct Growing {
    id: String,
    condition: usize,
    track: Track,
    /// Intrusion angle [rad] of each row that gives one.
    gammas: Vec<Option<f64>>,
    /// Fx, Fz and Ty of each row; not all logs have Ty.
    loads: Vec<[Option<f64>; 3]>,
    logged: LoggedTrial,
    /// The first time in the file; the trial's own times begin at 0.
    start: f64,
}

/// Reads the log; `experiment` names shapes, medium and units.
pub fn read(path: &Path, experiment: &Experiment, progress: &dyn Progress) -> Result<ForceLog> {
    read_rows(path, experiment, progress).map(|read| read.log)
}

/// A log with what only checks need.
pub struct ForceLogFile {
    pub log: ForceLog,
    /// The trials as they were logged.
    pub trials: Vec<LoggedTrial>,
    /// Faults of the sensor, whose rows are left out.
    pub broken: Vec<Finding>,
}

/// The log, and its trials as they were logged, for checks.
pub fn read_rows(path: &Path, experiment: &Experiment, progress: &dyn Progress) -> Result<ForceLogFile> {
    let (mut conditions, mut ids) = (Names::default(), Names::default());
    let mut trials: Vec<Growing> = Vec::new();
    let mut medium = None;
    let mut seen = [false; 3];
    let summary = experiment.read(path, COLUMNS, progress, |row| {
        check_medium(row, experiment, &mut medium)?;
        for (seen, column) in seen.iter_mut().zip([PASS, PASS_DX, X_BED]) {
            *seen |= row.text(column).is_some();
        }
        let condition = conditions.place(row.needed_text(CONDITION)?);
        row.needed_text(REP)?;
        let id = row.needed_text(TRIAL)?;
        let place = ids.place(id);
        let track = track_header(row, experiment)?;
        if place == trials.len() {
            trials.push(Growing::new(row, condition, track)?);
        } else {
            check_same(row, &trials[place], &track, condition)?;
        }
        let trial = &mut trials[place];
        let pose = pose(row, &trial.track.intruder, trial.start)?;
        if trial.track.poses.last().is_some_and(|last| pose.t <= last.t) {
            return Err(row.error(T, format!("time does not increase within trial {}", trial.id)));
        }
        trial.track.poses.push(pose);
        log_row(&mut trial.logged, row, pose.t);
        trial.gammas.push(row.within(GAMMA, MOST)?);
        let forces = [row.needed_within(FX, MOST)?, row.needed_within(FZ, MOST)?];
        trial.loads.push([Some(forces[0]), Some(forces[1]), row.within(TY, MOST)?]);
        Ok(())
    })?;
    let mut missing: Vec<_> =
        [PASS, PASS_DX, X_BED].iter().zip(seen).filter(|s| !s.1).map(|s| COLUMNS[*s.0].name).collect();
    let torque = trials.iter().flat_map(|t| &t.loads).all(|load| load[2].is_some());
    if !torque {
        missing.push("Ty");
    }
    trials.iter_mut().for_each(mirror);
    let rests = without_rests(&mut trials);
    let logged: Vec<LoggedTrial> = trials.iter_mut().map(|trial| std::mem::take(&mut trial.logged)).collect();
    let channels = if torque { &CHANNELS[..] } else { &CHANNELS[..2] };
    let (faults, whole) = without_faults(&mut trials, channels.len());
    let found = |fault: &Fault| {
        let rows = fault.at.map(|i| logged[fault.trial].lines[i]);
        Finding::new(Severity::Warn, &channels[fault.channel].name, &*fault.what, fault.remedy).at(rows)
    };
    let kept = |&trial: &usize| {
        let names: Vec<&str> = channels.iter().map(|c| &*c.name).collect();
        let what = format!("trial {} has faults in most of its rows, so all of them are used", logged[trial].id);
        Finding::new(Severity::Warn, &names.join(", "), what, "leave the trial out").at(logged[trial].rows())
    };
    let broken = faults.iter().map(found).chain(whole.iter().map(kept)).collect();
    let mut log = assemble(trials, conditions.list, channels, missing, summary.sha256);
    log.notes.extend(rests.into_iter().chain(summary.notes));
    Ok(ForceLogFile { log, trials: logged, broken })
}

impl Growing {
    /// The trial that begins with this row.
    fn new(row: &Row, condition: usize, track: Track) -> Result<Self> {
        let id = row.needed_text(TRIAL)?;
        let logged = LoggedTrial {
            id: id.into(),
            intruder: Some(track.intruder),
            hip_z: row.within(HIP_Z, MOST)?,
            beta: row.within(BETA, MOST)?,
            ..LoggedTrial::default()
        };
        let (gammas, loads, start) = (Vec::new(), Vec::new(), row.needed_time(T)?);
        Ok(Self { id: id.into(), condition, track, gammas, loads, logged, start })
    }
}

/// Adds a row to a trial as it is in the file. A cell without a number becomes NaN, since the model may not need it.
fn log_row(logged: &mut LoggedTrial, row: &Row, t: f64) {
    let number = |column: usize| row.within(column, MOST).ok().flatten().unwrap_or(f64::NAN);
    logged.lines.push(row.line);
    logged.t.push(t);
    logged.gamma.push(number(GAMMA));
    logged.theta.push(number(THETA));
    logged.omega.push(number(OMEGA));
    for (k, columns) in [[X, VX], [Z, VZ]].into_iter().enumerate() {
        logged.place[k].push(number(columns[0]));
        logged.velocity[k].push(number(columns[1]));
    }
}

/// Above 1 MN, or 1e6 of anything, a value is broken or in the wrong unit, and squares would overflow: our choice.
const MOST: f64 = 1e6;

fn check_medium(row: &Row, experiment: &Experiment, first: &mut Option<String>) -> Result<()> {
    let Some(name) = row.text(MEDIUM) else { return Ok(()) };
    let expected = first.get_or_insert_with(|| {
        if experiment.file.sand.is_some() { name.to_string() } else { experiment.medium.name.clone() }
    });
    if name != expected {
        return Err(row.error(MEDIUM, format!("medium {name:?} is unknown; the experiment's is {expected:?}")));
    }
    Ok(())
}

/// The track of a trial with this row, without poses yet.
fn track_header(row: &Row, experiment: &Experiment) -> Result<Track> {
    let shape = row.needed_text(SHAPE)?;
    let Some(intruder) = experiment.file.shapes.get(shape) else {
        let known: Vec<_> = experiment.file.shapes.keys().map(String::as_str).collect();
        let known = match known.is_empty() {
            true => "the experiment describes no shape; give a table [shape.NAME]".into(),
            false => format!("known: {}", known.join(", ")),
        };
        return Err(row.error(SHAPE, format!("shape {shape:?} is unknown; {known}")));
    };
    let kind = row.needed_text(KIND)?;
    let (hip_height, beta) = match (kind, intruder) {
        ("leg", Intruder::Leg { .. }) => (row.needed_within(HIP_Z, MOST)?, 0.0),
        ("plate", Intruder::Plate { .. }) => (0.0, row.needed_within(BETA, MOST)?),
        ("leg" | "plate", _) => return Err(row.error(KIND, format!("{kind} is not the type of shape {shape}"))),
        _ => return Err(row.error(KIND, format!("{kind:?} is unknown; known: leg, plate"))),
    };
    let pass = row.within(PASS, MOST)?.unwrap_or(1.0);
    if !(1.0..=1e6).contains(&pass) || pass.fract() != 0.0 {
        return Err(row.error(PASS, format!("{pass} is no pass number (1 fresh bed, 2 re-used, …)")));
    }
    Ok(Track {
        shape: shape.into(),
        intruder: *intruder,
        hip_height,
        beta,
        pass: pass as u32,
        pass_dx: row.within(PASS_DX, MOST)?.unwrap_or(0.0),
        x_bed: row.within(X_BED, MOST)?.unwrap_or(0.0),
        poses: Vec::new(),
        compared: Vec::new(),
    })
}

/// Sets a plate's β in our frame. Attack and intrusion angles are stated for motion toward +x (v ∥ (cos γ, −sin γ)). If
/// the logged velocity is toward −x, the mirror image of this, the plate is also mirrored. The first direction in which
/// the plate certainly moves decides, because at rest the logged velocity is noise.
fn mirror(trial: &mut Growing) {
    let poses = &trial.track.poses;
    let outward = poses.iter().zip(&trial.gammas).take(heading(&trial.track).until + 1);
    let (along, speeds) = outward.fold((0.0, 0.0), |(along, speeds), (pose, gamma)| {
        let [vx, vz] = pose.velocity;
        (along + vx * gamma.map_or(0.0, f64::cos), speeds + vx.hypot(vz))
    });
    // A π/2 with few digits has a cosine of up to 1e-5, and vx is then noise, some hundredth of the speed.
    if along < -1e-7 * speeds {
        trial.track.beta = -trial.track.beta;
    }
}

/// Refuses a row that contradicts the earlier rows of its trial.
fn check_same(row: &Row, trial: &Growing, now: &Track, condition: usize) -> Result<()> {
    let was = &trial.track;
    let same = [
        (CONDITION, trial.condition == condition),
        (SHAPE, was.shape == now.shape),
        (HIP_Z, was.hip_height == now.hip_height),
        (BETA, was.beta == now.beta),
        (PASS, was.pass == now.pass),
        (PASS_DX, was.pass_dx == now.pass_dx),
        (X_BED, was.x_bed == now.x_bed),
    ];
    match same.iter().find(|(_, same)| !same) {
        Some((column, _)) => Err(row.error(*column, format!("differs from the first row of trial {}", trial.id))),
        None => Ok(()),
    }
}

/// The pose in a row, with the time since `start`: clocks may count from 1970.
fn pose(row: &Row, intruder: &Intruder, start: f64) -> Result<ArmPose> {
    let t = row.needed_time(T)? - start;
    Ok(match intruder {
        Intruder::Leg { .. } => ArmPose {
            t,
            theta: row.needed_within(THETA, MOST)?,
            omega: row.needed_within(OMEGA, MOST)?,
            ..ArmPose::default()
        },
        Intruder::Plate { .. } => ArmPose {
            t,
            center: [row.needed_within(X, MOST)?, row.needed_within(Z, MOST)?],
            velocity: [row.needed_within(VX, MOST)?, row.needed_within(VZ, MOST)?],
            ..ArmPose::default()
        },
    })
}

/// Leaves rows out in which the intruder rests, and says so.
fn without_rests(trials: &mut [Growing]) -> Option<String> {
    trials.iter_mut().for_each(|trial| trial.track.compared = moving(&trial.track));
    let rows: usize = trials.iter().map(|t| t.loads.len()).sum();
    let resting = rows - trials.iter().map(|t| t.track.compared.len()).sum::<usize>();
    let why = "there the intruder rests, and resistive force theory does not predict the force at rest";
    (resting > 0).then(|| format!("{resting} of {rows} rows are left out: {why}"))
}

/// The channels of a log; not all logs have the last one.
const CHANNELS: [Channel; 3] =
    [Channel::new("Fx", "N", true), Channel::new("Fz", "N", true), Channel::new("Ty", "N·m", false)];

/// Leaves rows out in which the sensor or the logger is at fault. Places of faults are samples of the trials. Also returns the trials that
/// have faults in most of their rows, and keep them all.
fn without_faults(trials: &mut [Growing], channels: usize) -> (Vec<Fault>, Vec<usize>) {
    let of = |trial: &Growing| {
        let series = |c: usize| trial.track.compared.iter().filter_map(|&i| trial.loads[i][c]).collect();
        TrialReadings {
            id: trial.id.clone(),
            condition: trial.condition,
            channels: (0..channels).map(series).collect(),
        }
    };
    let readings: Vec<TrialReadings> = trials.iter().map(of).collect();
    let mut faults = broken::faults(&readings);
    for fault in &mut faults {
        fault.at = fault.at.map(|i| trials[fault.trial].track.compared[i]);
    }
    let mut whole = Vec::new();
    for (place, sound) in broken::sound(&readings, &faults).into_iter().enumerate() {
        let own = &mut trials[place].track.compared;
        match sound {
            Some(sound) => *own = sound.into_iter().map(|i| own[i]).collect(),
            None => whole.push(place),
        }
    }
    (faults, whole)
}

fn assemble(
    trials: Vec<Growing>,
    conditions: Vec<String>,
    channels: &[Channel],
    missing: Vec<&'static str>,
    sha256: String,
) -> ForceLog {
    let (mut values, mut units, mut settings, mut setting_of) =
        (Vec::new(), Vec::new(), Vec::<Track>::new(), Vec::new());
    let mut headings: Vec<Option<Heading>> = vec![None; conditions.len()];
    for trial in trials {
        let start = values.len();
        // Repetitions are matched along the direction of motion; a trial that never moves has none.
        let own = heading(&trial.track);
        let common = headings[trial.condition].get_or_insert(own);
        if !common.moves() {
            *common = own;
        }
        let (kept, progress) = (&trial.track.compared, progress(&trial.track, common));
        for channel in 0..channels.len() {
            values.extend(kept.iter().filter_map(|&i| trial.loads[i][channel]));
        }
        let known = settings.iter().position(|t| *t == trial.track);
        units.push(Unit {
            id: trial.id,
            condition: trial.condition,
            start,
            samples: kept.len(),
            progress: kept.iter().map(|&i| progress[i]).collect(),
        });
        setting_of.push(known.unwrap_or(settings.len()));
        if known.is_none() {
            settings.push(trial.track);
        }
    }
    let observations = Observations { size: Size::Force, values, channels: channels.to_vec(), units, conditions };
    ForceLog { observations, settings, setting_of, missing, notes: Vec::new(), sha256 }
}

/// A log of planned trials, each with a description: one condition for each, and zeros for forces.
pub fn planned(trials: Vec<(Track, String)>, channels: usize) -> ForceLog {
    let (tracks, names): (Vec<Track>, Vec<String>) = trials.into_iter().unzip();
    let trials = tracks.into_iter().enumerate().map(|(i, track)| {
        let (id, loads) = (i.to_string(), vec![[Some(0.0); 3]; track.poses.len()]);
        let (gammas, logged, start) = (Vec::new(), LoggedTrial::default(), 0.0);
        Growing { id, condition: i, track, gammas, loads, logged, start }
    });
    let mut trials: Vec<Growing> = trials.collect();
    without_rests(&mut trials);
    assemble(trials, names, &CHANNELS[..channels.min(CHANNELS.len())], Vec::new(), String::new())
}

/// Number of samples in a planned trial: our choice, as many as a log needs (docs/diagnosis.md, "What it needs").
const PLANNED_SAMPLES: usize = 60;

/// Trials that the apparatus of `tracks` could make and that are not in the data: each intruder at its slowest, a middle and its fastest
/// speed, at two depths, on used ground and on fresh ground, on fresh ground also 10 cm to either side; plates at several angles.
pub fn possible(tracks: &[Track]) -> Vec<(Track, String)> {
    let mut shapes: Vec<&Track> = Vec::new();
    for track in tracks {
        if !shapes.iter().any(|s| s.shape == track.shape) {
            shapes.push(track);
        }
    }
    let mut out = Vec::new();
    for base in shapes {
        let own = tracks.iter().filter(|t| t.shape == base.shape).map(Track::rate);
        for rate in low_middle_high(own) {
            for deep in [true, false] {
                for (pass, x_bed) in [(1, 0.0), (2, 0.0), (1, 0.1), (1, -0.1)] {
                    let angles: &[(f64, f64)] = match base.intruder {
                        Intruder::Leg { .. } => &[(0.0, 0.0)],
                        Intruder::Plate { .. } => {
                            &[(0.0, 90.0), (90.0, 0.0), (45.0, 45.0), (-45.0, 45.0), (60.0, 30.0)]
                        }
                    };
                    out.extend(angles.iter().map(|&(beta, gamma)| base.planned(rate, deep, pass, x_bed, beta, gamma)));
                }
            }
        }
    }
    out.retain(|(planned, _)| !tracks.iter().any(|made| planned.resembles(made)));
    out
}

impl Track {
    /// Fastest angular speed of a leg [rad/s] or speed of a plate [m/s].
    pub(super) fn rate(&self) -> f64 {
        self.poses.iter().map(|pose| self.speed(pose)).fold(0.0, f64::max)
    }

    /// This track's intruder in another trial, and a description of that trial; angles in degrees.
    fn planned(&self, rate: f64, deep: bool, pass: u32, x_bed: f64, beta: f64, gamma: f64) -> (Track, String) {
        let mut track = Track { pass, pass_dx: 0.0, x_bed, ..self.clone() };
        let at = |i: usize| (i as f64 + 0.5) / PLANNED_SAMPLES as f64;
        let motion = match self.intruder {
            Intruder::Leg { chord, .. } => {
                track.hip_height = if deep { 0.25 * chord } else { 0.6 * chord };
                let pose = |i| {
                    let theta = -1.75 + 3.5 * at(i);
                    ArmPose { t: (theta + 1.75) / rate.max(1e-6), theta, omega: rate, ..ArmPose::default() }
                };
                track.poses = (0..PLANNED_SAMPLES).map(pose).collect();
                format!("hip {:.1} cm above the sand, {rate:.2} rad/s", 100.0 * track.hip_height)
            }
            Intruder::Plate { length, .. } => {
                track.beta = beta.to_radians();
                let (sin, cos) = gamma.to_radians().sin_cos();
                let from = if gamma == 0.0 { if deep { length } else { 0.5 * length } } else { 0.0 };
                let reach = if deep { 1.3 * length } else { 0.5 * length };
                let pose = |i| {
                    let path = reach * at(i);
                    let (center, velocity) = ([path * cos, -from - path * sin], [rate * cos, -rate * sin]);
                    ArmPose { t: path / rate.max(1e-9), center, velocity, ..ArmPose::default() }
                };
                track.poses = (0..PLANNED_SAMPLES).map(pose).collect();
                format!("β {beta:.0}°, γ {gamma:.0}°, {:.1} cm deep, {rate:.3} m/s", 100.0 * (from + reach * sin))
            }
        };
        let ground = if pass > 1 { "second pass in place" } else { "fresh bed" };
        let words = format!("{}: {motion}, {ground}, x_bed {:.0} cm", self.shape, 100.0 * x_bed);
        (track, words)
    }
}
