//! A robot's own log: diagnoses the sand from measurements of the joints and the IMU during walks.
//!
//! [`read`] makes a [`log`] of the file. [`windows`] selects the parts of each run that are compared. [`replay`] simulates them
//! with the logged joint angles. [`sensors`] and [`servo`] compute what the log's sensors would have read. [`model`] combines
//! these parts to a forward model. The strides of a run are its repetitions. Effects that belong to one run (strength of the
//! bed, offsets of the sensors) are errors that all strides of this run share.

mod consistency;
mod description;
mod forecast;
#[cfg(test)]
mod generate;
pub mod log;
mod measuring;
mod model;
mod plan;
mod replay;
mod sensors;
mod servo;
mod simulate;
#[cfg(test)]
mod tests;
mod windows;

use super::check;
use super::check::finding::{Finding, settled};
use super::experiment::Experiment;
use super::observations::Observations;
use crate::error::Result;
use crate::progress::{Latch, Progress};
use crate::table::{self, ReadOptions, Summary};
use log::{Gather, JointColumns, Run};
use model::TrajectoryModel;
use replay::ReplayRobot;
use std::path::Path;

/// Reads the runs of a log, with what a look at them has found; refuses the log if units or signs are wrong.
pub fn read(
    data: &Path,
    experiment: &Experiment,
    progress: &dyn Progress,
) -> Result<(Vec<Run>, Summary, Vec<Finding>)> {
    let file = &experiment.file;
    let joints = ReplayRobot::of(experiment)?.joint_names();
    let names = JointColumns::new(&joints, file)?;
    let columns = names.columns();
    let [renamed, units] = [&file.columns, &file.units].map(|table| names.for_each_joint(table));
    let asked = ReadOptions { renamed, units, progress, ..ReadOptions::new(&columns) };
    let mut gather = Gather::new(&names, file);
    let summary = table::read(data, &asked, |row| gather.take(row))?;
    let runs = gather.finish(data)?;
    consistency::check(data, &runs, &joints, file.imu.quat)?;
    let findings = settled(data, check::robot::check(&runs, &joints))?;
    Ok((runs, summary, findings))
}

/// A log that was read: the measured numbers, the checksum of their file, notes on how they were prepared, what a look at them has
/// found, and the model that predicts them.
pub struct MeasuredTrajectory<'a> {
    pub observations: Observations,
    pub sha256: String,
    pub notes: Vec<String>,
    pub findings: Vec<Finding>,
    pub model: TrajectoryModel<'a>,
}

pub fn measured<'a>(data: &Path, experiment: &Experiment, latch: &'a Latch<'a>) -> Result<MeasuredTrajectory<'a>> {
    let (runs, summary, findings) = read(data, experiment, latch)?;
    let (model, observations) = TrajectoryModel::new(runs, experiment, latch)?;
    consistency::against_replay(data, &model.layout, &observations.values, &model.plain())?;
    let follows = model.follows().map_or("is free".into(), |time| format!("follows the gyro within {time:.2} s"));
    let note = format!(
        "the logged joint angles are replayed, and the base {follows}, in {} windows with {} strides in all; {}",
        model.windows.len(),
        observations.units.len(),
        model.torque_channels(&observations.channels),
    );
    let notes = [vec![note], summary.notes].concat();
    Ok(MeasuredTrajectory { observations, sha256: summary.sha256, notes, findings, model })
}
