//! A robot's own log: the diagnosis of the sand from what the joints and the IMU measured during walks.
//!
//! [`read`] reads the file into a [`log`]. [`windows`] selects the parts of each run that are compared. [`replay`] simulates them
//! with the logged joint angles. [`sensors`] and [`servo`] compute what the log's sensors would have read. [`model`] puts this
//! together as a forward model. The strides of a run are its repetitions. Effects that belong to one run (strength of the bed,
//! offsets of the sensors) are errors that all strides of this run share.

mod consistency;
mod forecast;
#[cfg(test)]
pub(super) mod generate;
pub(super) mod keys;
mod log;
mod logged;
mod measuring;
mod model;
mod plan;
mod read;
mod replay;
mod sensors;
mod servo;
mod simulate;
#[cfg(test)]
mod tests;
mod windows;

pub use model::TrajectoryModel;
pub use read::read;

use super::Measured;
use super::experiment::Experiment;
use crate::error::Result;
use crate::progress::Latch;
use std::path::Path;

/// The measured data, and the model that predicts them.
pub fn measured<'a>(
    data: &Path,
    experiment: &Experiment,
    latch: &'a Latch<'a>,
) -> Result<(Measured, TrajectoryModel<'a>)> {
    let log = read(data, experiment, latch)?;
    let sha256 = log.sha256.clone();
    let (model, observations) = TrajectoryModel::new(log, experiment, latch)?;
    consistency::against_replay(data, model.layout(), &observations.values, &model.plain())?;
    let notes = vec![format!(
        "the logged joint angles are replayed, in {} windows with {} strides in all; {}",
        model.windows().len(),
        observations.units.len(),
        model::channel_names(&observations.channels, &model.joint_names()),
    )];
    let interest = experiment.nuisances.interest.clone();
    Ok((Measured { observations, coefficient_sd: experiment.coefficient_sd, interest, sha256, notes }, model))
}
