//! A robot's own log: what its joints and its IMU say of the sand under it.
//!
//! file → [`log`] (by [`read`]) → [`windows`] → [`replay`] of the logged joints → [`sensors`], [`servo`] → [`model`], a forward model
//! as any other. Strides are the repetitions of their run; what a run has of its own (bed, zeros of sensors) is an error that all of
//! its strides share.

mod bag;
mod cdr;
mod columnar;
mod compact;
mod forecast;
#[cfg(test)]
mod generate;
pub mod keys;
pub mod log;
mod measuring;
pub mod model;
mod packed;
mod pages;
mod plan;
pub mod read;
#[cfg(test)]
mod readers;
pub mod replay;
pub mod sensors;
pub mod servo;
mod simulate;
pub mod slips;
#[cfg(test)]
mod tests;
pub mod windows;

pub use model::TrajectoryModel;
pub use read::read;

use super::Measured;
use super::experiment::Experiment;
use crate::error::Result;
use crate::progress::Latch;
use std::path::Path;

/// What was measured, and the model of it.
pub fn measured<'a>(
    data: &Path,
    experiment: &Experiment,
    latch: &'a Latch<'a>,
) -> Result<(Measured, TrajectoryModel<'a>)> {
    let log = read(data, experiment)?;
    let sha256 = log.sha256.clone();
    let (model, observations) = TrajectoryModel::new(log, experiment, latch)?;
    slips::against_replay(data, model.layout(), &observations.values, &model.plain())?;
    let notes = vec![format!(
        "joints are replayed as logged, in {} windows of {} strides; {}",
        model.windows().len(),
        observations.units.len(),
        model::channel_names(&observations.channels, &model.joint_names()),
    )];
    let interest = experiment.nuisances.interest.clone();
    Ok((Measured { observations, coefficient_sd: experiment.coefficient_sd, interest, sha256, notes }, model))
}
