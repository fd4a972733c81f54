//! Measures by which designs are compared, and their intervals.

use crate::error::{Error, Result};
use crate::evaluate::episode::EpisodeSums;

/// A measure of a gait.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GaitMeasure {
    Return,
    Speed,
    CostOfTransport,
}

impl GaitMeasure {
    pub const ALL: [Self; 3] = [Self::Return, Self::Speed, Self::CostOfTransport];

    pub fn named(name: &str) -> Result<Self> {
        let known = Self::ALL.map(Self::name);
        Self::ALL.into_iter().find(|m| m.name() == name).ok_or_else(|| Error::unknown("measure", name, &known))
    }

    pub fn name(self) -> &'static str {
        match self {
            Self::Return => "return",
            Self::Speed => "speed",
            Self::CostOfTransport => "cost-of-transport",
        }
    }

    pub fn label(self) -> &'static str {
        match self {
            Self::Return => "return of an episode",
            Self::Speed => "forward speed [m/s]",
            Self::CostOfTransport => "cost of transport",
        }
    }

    /// Its value over all episodes of a policy.
    pub fn of(self, episodes: &[EpisodeSums]) -> f64 {
        let sum = |term: fn(&EpisodeSums) -> f64| episodes.iter().map(term).sum::<f64>();
        match self {
            Self::Return => sum(|e| e.total_reward) / episodes.len() as f64,
            Self::Speed => sum(|e| e.distance) / sum(|e| e.time),
            Self::CostOfTransport => {
                let way = sum(|e| e.weight * e.distance);
                if way > 0.0 { sum(|e| e.work) / way } else { f64::INFINITY }
            }
        }
    }

    /// The value as a cost: smaller is better, and NaN is worst.
    pub fn cost(self, value: f64) -> f64 {
        let cost = if self == Self::CostOfTransport { value } else { -value };
        if cost.is_nan() { f64::INFINITY } else { cost }
    }
}

/// Mean over trainings, and its 95 % interval by Student's t; there is no interval for a single training.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrainingMean {
    pub mean: f64,
    pub half: f64,
}

impl TrainingMean {
    pub fn of(values: &[f64]) -> Self {
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let variance = values.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / (n - 1.0);
        let half = if values.len() > 1 { student(values.len() - 1) * (variance / n).sqrt() } else { f64::NAN };
        Self { mean, half }
    }
}

/// 97.5 % point of Student's t distribution (Fisher & Yates, Statistical Tables, table III). Beyond the table we use
/// the value of its last row, which makes the interval slightly too wide.
fn student(freedom: usize) -> f64 {
    const POINTS: [f64; 10] = [12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228];
    POINTS[freedom.clamp(1, POINTS.len()) - 1]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_interval_is_student_s() {
        let three = TrainingMean::of(&[1.0, 2.0, 3.0]);
        assert!((three.mean - 2.0).abs() < 1e-12 && (three.half - 4.303 / 3.0_f64.sqrt()).abs() < 1e-9);
        assert!(TrainingMean::of(&[1.0]).half.is_nan());
    }
}
