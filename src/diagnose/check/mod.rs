//! Looks at the data before any fit: units, signs, zeros and clocks that contradict each other, broken channels, and what
//! the design of the experiment can tell apart at all.
//!
//! A finding is refused only if it is certain: the file contradicts itself, or a factor would be one that no sand has.
//! All else is a warning or a note in the report. [`motion`] compares the logged motion with itself, [`forces`] compares
//! measured with predicted forces, [`channels`] looks for broken channels, [`robot`] looks at a robot's own log, and
//! [`design`] computes which causes the motions separate.

pub mod channels;
pub mod design;
pub mod finding;
pub mod force_log;
pub mod forces;
pub mod legs;
pub mod logged;
pub mod means;
pub mod motion;
pub mod ratio;
pub mod robot;
pub mod section;
#[cfg(test)]
mod tests;

use design::ExperimentDesign;
use finding::Finding;
use serde::Serialize;

/// The result of the stage.
#[derive(Clone, Debug, Default, Serialize, PartialEq)]
pub struct Check {
    pub findings: Vec<Finding>,
    pub design: ExperimentDesign,
}
