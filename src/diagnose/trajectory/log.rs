//! A robot's own log in memory: runs with the samples of joints and IMU, gathered from the rows of a file.

use crate::error::{Error, Result};
use crate::experiment::{ExperimentFile, MOST_RUNS, RunTable};
use crate::observations::columns;
use crate::series::ends;
use crate::table::{HeaderColumn, Quantity, Row};
use std::collections::BTreeMap;
use std::f64::consts::TAU;
use std::path::Path;

/// Largest number of values in a log: our choice, 160 MB.
const MOST_NUMBERS: usize = 20_000_000;
/// Largest number of a robot's joints: our choice, enough for a hexapod with four joints a leg.
pub const MOST_JOINTS: usize = 24;
/// Fewest samples of a run: our choice; a tenth of a second at 200 Hz is less than a stride.
const FEWEST_SAMPLES: usize = 20;
/// Longest usual time between two samples [s]. The next constant is the longest gap as a multiple of the usual time. Our choices: a
/// slower log misses the forces within a stride, and during a longer gap the joints' motion is unknown.
const LONGEST_STEP: f64 = 0.05;
const LONGEST_GAP: f64 = 10.0;
/// Largest number that is accepted: our choice, far above every quantity of a robot in SI units.
const MOST: f64 = 1e6;

/// One run.
#[derive(Clone, Debug, Default)]
pub struct Run {
    pub name: String,
    pub condition: String,
    pub leg: Option<String>,
    pub slope_deg: f64,
    /// Commanded turns of the hips a second [Hz].
    pub frequency: Option<f64>,
    /// Time [s] since the run's first row, whose time in the file is `start`: clocks may count from 1970.
    pub t: Vec<f64>,
    pub start: f64,
    /// Row of the file of each sample.
    pub lines: Vec<u64>,
    /// Angles, joint by joint [rad].
    pub q: Vec<Vec<f64>>,
    /// Joint speeds [rad/s]; empty if the log has none.
    pub qd: Vec<Vec<f64>>,
    /// Joint torques [N·m].
    pub tau: Vec<Vec<f64>>,
    /// Angular velocity [rad/s] in the IMU's frame; the next field is the specific force [m/s²] in this frame.
    pub gyro: [Vec<f64>; 3],
    pub acc: [Vec<f64>; 3],
    /// Rotation from the IMU's frame to the level frame, w, x, y, z; empty if the log has none.
    pub attitude: [Vec<f64>; 4],
    /// Position of the base [m]; empty if the log has none.
    pub place: [Vec<f64>; 3],
}

// Columns that do not depend on the robot; the columns of joints follow them. Vectors are read from their first column on.
columns! {
    RUN = "run" Text false;
    CONDITION = "condition" Text false;
    _REP = "rep" Text false;
    LEG = "leg" Text false;
    SLOPE = "slope_deg" Degrees false;
    FREQUENCY = "stride_frequency" Frequency false;
    T = "t" Time true;
    GYRO = "gyro_x" AngularSpeed true;
    _GYRO_Y = "gyro_y" AngularSpeed true;
    _GYRO_Z = "gyro_z" AngularSpeed true;
    ACC = "acc_x" Acceleration true;
    _ACC_Y = "acc_y" Acceleration true;
    _ACC_Z = "acc_z" Acceleration true;
    QUAT = "quat_w" Number false;
    _QUAT_X = "quat_x" Number false;
    _QUAT_Y = "quat_y" Number false;
    _QUAT_Z = "quat_z" Number false;
    PLACE = "x" Length false;
    _Y = "y" Length false;
    _Z = "z" Length false;
    _VX = "vx" Speed false;
    _VY = "vy" Speed false;
    _VZ = "vz" Speed false;
}

/// Names of the joints' columns, three for each joint.
pub struct JointColumns<'a> {
    of_joints: Vec<String>,
    joints: &'a [String],
    currents: bool,
}

impl<'a> JointColumns<'a> {
    /// The columns of these joints. If the torque constant is given, the log has currents in place of torques.
    pub fn new(joints: &'a [String], file: &ExperimentFile) -> Result<Self> {
        if joints.is_empty() || joints.len() > MOST_JOINTS {
            let reason = format!("the robot has {} joints; a log is replayed with 1 to {MOST_JOINTS}", joints.len());
            return Err(Error::invalid("robot", reason));
        }
        let currents = file.motor.torque_constant.is_some();
        let torque = if currents { "i" } else { "tau" };
        let of_joints =
            ["q", "qd", torque].into_iter().flat_map(|kind| joints.iter().map(move |j| format!("{kind}:{j}")));
        Ok(Self { of_joints: of_joints.collect(), joints, currents })
    }

    /// The columns that a log must or may have.
    pub fn columns(&self) -> Vec<HeaderColumn<'_>> {
        let kinds = [
            (Quantity::Angle, true),
            (Quantity::AngularSpeed, false),
            (if self.currents { Quantity::Current } else { Quantity::Torque }, true),
        ];
        let own = self.of_joints.iter().enumerate().map(|(k, name)| {
            let (quantity, required) = kinds[k / self.joints.len()];
            HeaderColumn { name, quantity, required }
        });
        COLUMNS.iter().copied().chain(own).collect()
    }

    /// A table of columns, in which an entry such as `"q:*" = "state.*.pos"` stands for the same entry of every joint.
    pub fn for_each_joint(&self, table: &BTreeMap<String, String>) -> BTreeMap<String, String> {
        let mut all = BTreeMap::new();
        for (ours, theirs) in table {
            match ours.strip_suffix(":*") {
                Some(kind) => {
                    let own = self.joints.iter().map(|j| (format!("{kind}:{j}"), theirs.replace('*', j)));
                    all.extend(own.filter(|(name, _)| !table.contains_key(name)));
                }
                None => drop(all.insert(ours.clone(), theirs.clone())),
            }
        }
        all
    }
}

/// Gathers the rows of a file into runs.
pub struct Gather<'a> {
    names: &'a JointColumns<'a>,
    file: &'a ExperimentFile,
    runs: Vec<Run>,
    places: BTreeMap<String, usize>,
    numbers: usize,
    /// Whether the log has joint speeds, attitude and position; set by the first row.
    there: Option<[bool; 3]>,
}

impl<'a> Gather<'a> {
    pub fn new(names: &'a JointColumns<'a>, file: &'a ExperimentFile) -> Self {
        Self { names, file, runs: Vec::new(), places: BTreeMap::new(), numbers: 0, there: None }
    }

    pub fn take(&mut self, row: &Row) -> Result<()> {
        let joints = self.names.joints.len();
        let there = *self.there.get_or_insert_with(|| {
            let all = |from: usize, count: usize| (from..from + count).all(|c| row.text(c).is_some());
            [all(COLUMNS.len() + joints, joints), all(QUAT, 4), all(PLACE, 3)]
        });
        let constant = self.file.motor.torque_constant.unwrap_or(1.0);
        let number = |column: usize| row.within(column, MOST)?.ok_or_else(|| row.blank(column));
        let t = row.needed_time(T)?;
        let cut = self.file.runs.iter().find(|cut| cut.holds(t));
        if cut.is_none() && !self.file.runs.is_empty() {
            return Ok(()); // the experiment file lists runs, and the row belongs to none of them
        }
        let place = self.place(row, cut, there[0])?;
        let run = &mut self.runs[place];
        if run.t.is_empty() {
            run.start = t;
        }
        if run.t.last().is_some_and(|last| t - run.start <= *last) {
            return Err(row.error(T, format!("{t} s is not after the previous sample of the same run")));
        }
        run.t.push(t - run.start);
        run.lines.push(row.line);
        let base = COLUMNS.len();
        for j in 0..joints {
            run.q[j].push(number(base + j)?);
            if there[0] {
                run.qd[j].push(number(base + joints + j)?);
            }
            run.tau[j].push(constant * number(base + 2 * joints + j)?);
        }
        let three = |from: usize, to: &mut [Vec<f64>]| -> Result<()> {
            to.iter_mut().enumerate().try_for_each(|(k, v)| number(from + k).map(|n| v.push(n)))
        };
        three(GYRO, &mut run.gyro)?;
        three(ACC, &mut run.acc)?;
        if there[1] {
            three(QUAT, &mut run.attitude)?;
            let norm = run.attitude.iter().map(|v| v[v.len() - 1].powi(2)).sum::<f64>().sqrt();
            // Rounded quaternions have a norm within a percent of 1; we allow two.
            if (norm - 1.0).abs() > 0.02 {
                return Err(row.error(QUAT, format!("the quaternion has length {norm:.3}, not 1")));
            }
        }
        if there[2] {
            three(PLACE, &mut run.place)?;
        }
        self.numbers += 7 + 3 * joints + 4 * usize::from(there[1]) + 3 * usize::from(there[2]);
        match self.numbers > MOST_NUMBERS {
            true => {
                Err(row.error(T, format!("the log has more than {MOST_NUMBERS} numbers: keep only every n-th sample")))
            }
            false => Ok(()),
        }
    }

    /// Index of the run that a row belongs to: the run `cut` that the experiment file lists, or the run in the column `run`.
    /// `speeds`: does the log have joint speeds?
    fn place(&mut self, row: &Row, cut: Option<&RunTable>, speeds: bool) -> Result<usize> {
        if cut.is_some() && row.text(RUN).is_some() {
            return Err(row.error(RUN, "the log says which rows are a run, and the experiment file lists [[run]] too"));
        }
        let name = cut.and_then(|c| c.name.as_deref()).or(row.text(RUN)).unwrap_or("1");
        if let Some(place) = self.places.get(name) {
            return Ok(*place);
        }
        if self.runs.len() == MOST_RUNS {
            return Err(row.error(RUN, format!("more than {MOST_RUNS} runs")));
        }
        let joints = self.names.joints.len();
        let frequency = cut.and_then(|c| c.stride_frequency).or(row.number(FREQUENCY)?).or(self.file.stride_frequency);
        if frequency.is_some_and(|f| !(-20.0..=20.0).contains(&f)) {
            return Err(row.error(FREQUENCY, "is outside [-20, 20] Hz"));
        }
        let slope_deg = cut.and_then(|c| c.slope_deg).or(row.number(SLOPE)?).unwrap_or(self.file.slope_deg);
        if slope_deg.abs() > crate::sim::model::Scene::MAX_SLOPE_DEG {
            return Err(
                row.error(SLOPE, format!("{slope_deg} is outside ±{}", crate::sim::model::Scene::MAX_SLOPE_DEG))
            );
        }
        self.runs.push(Run {
            name: name.into(),
            condition: cut.and_then(|c| c.condition.as_deref()).or(row.text(CONDITION)).unwrap_or(name).into(),
            leg: cut.and_then(|c| c.leg.as_deref()).or(row.text(LEG)).or(self.file.leg.as_deref()).map(Into::into),
            slope_deg,
            frequency,
            q: vec![Vec::new(); joints],
            qd: vec![Vec::new(); if speeds { joints } else { 0 }],
            tau: vec![Vec::new(); joints],
            ..Run::default()
        });
        self.places.insert(name.into(), self.runs.len() - 1);
        Ok(self.runs.len() - 1)
    }

    /// The runs, checked one by one.
    pub fn finish(mut self, path: &Path) -> Result<Vec<Run>> {
        if self.runs.is_empty() {
            return Err(Error::file(
                path,
                "no row belongs to a run that the experiment file lists: `from` and `to` are values of t [s]",
            ));
        }
        self.runs.iter_mut().flat_map(|r| &mut r.q).for_each(|q| unwrap(q));
        for run in &self.runs {
            run.validate().map_err(|reason| Error::file(path, format!("run {}: {reason}", run.name)))?;
        }
        Ok(self.runs)
    }
}

/// Makes an angle continuous that is logged between −π and π.
fn unwrap(q: &mut [f64]) {
    let [low, high] = ends(q.iter().copied());
    if high - low > 1.05 * TAU {
        return; // beyond a turn, and 5 % more for noise (our choice), the angle is continuous already
    }
    let mut turns = 0.0;
    for i in 1..q.len() {
        let change = q[i] + turns - q[i - 1];
        // Corrects only jumps of nearly one turn (our choice): no joint moves by 0.8 of a turn between two samples.
        if (change.abs() / TAU - 1.0).abs() < 0.2 {
            turns -= TAU.copysign(change);
        }
        q[i] += turns;
    }
}

impl Run {
    /// Time between samples [s]: the median.
    pub fn step(&self) -> f64 {
        let mut steps: Vec<f64> = self.t.windows(2).map(|w| w[1] - w[0]).collect();
        steps.sort_by(f64::total_cmp);
        steps.get(steps.len() / 2).copied().unwrap_or(0.0)
    }

    /// Row of the file of a sample.
    pub fn line(&self, sample: usize) -> u64 {
        self.lines.get(sample).copied().unwrap_or(0)
    }

    fn validate(&self) -> std::result::Result<(), String> {
        if self.t.len() < FEWEST_SAMPLES {
            return Err(format!("it has {} samples; at least {FEWEST_SAMPLES} are needed", self.t.len()));
        }
        let step = self.step();
        if step > LONGEST_STEP {
            let hint = if step > 1.0 { "; is t in ms? state [units] t = \"ms\"" } else { "" };
            return Err(format!(
                "it has one sample every {step:.3} s; at least {} a second are needed{hint}",
                1.0 / LONGEST_STEP
            ));
        }
        match self.t.windows(2).find(|w| w[1] - w[0] > LONGEST_GAP * step) {
            Some(w) => {
                let [from, to] = [self.start + w[0], self.start + w[1]];
                Err(format!("nothing is logged from t = {from} to {to} s: split it into two runs"))
            }
            None => Ok(()),
        }
    }
}
