//! The rows of a force log as they were logged, for checks. The model of the data keeps only what it needs.

use crate::experiment::Intruder;

/// One trial.
#[derive(Clone, Debug, Default)]
pub struct LoggedTrial {
    pub id: String,
    pub intruder: Option<Intruder>,
    /// Height of a leg's hip and attack angle of a plate, as stated.
    pub hip_z: Option<f64>,
    pub beta: Option<f64>,
    /// Row of the file of each sample.
    pub lines: Vec<u64>,
    /// Time, stated intrusion angle of a plate, angle, angular speed, position and velocity of each sample; NaN where a cell is blank.
    pub t: Vec<f64>,
    pub gamma: Vec<f64>,
    pub theta: Vec<f64>,
    pub omega: Vec<f64>,
    pub place: [Vec<f64>; 2],
    pub velocity: [Vec<f64>; 2],
}

impl LoggedTrial {
    /// First and last row of the trial.
    pub fn rows(&self) -> [u64; 2] {
        [self.lines.first(), self.lines.last()].map(|line| line.copied().unwrap_or(0))
    }

    /// The longest side of the intruder [m].
    pub fn size(&self) -> f64 {
        match self.intruder {
            Some(Intruder::Leg { chord, .. }) => chord,
            Some(Intruder::Plate { length, width, .. }) => length.max(width),
            None => f64::NAN,
        }
    }

    pub fn is_leg(&self) -> bool {
        matches!(self.intruder, Some(Intruder::Leg { .. }))
    }
}
