//! The command `sandgait diagnose`.

use super::diagnose;
use super::experiment::Experiment;
use super::report::Diagnosis;
use crate::error::Result;
use crate::progress::Silent;
use std::path::PathBuf;

/// Find where a simulation disagrees with measured data, and why.
#[derive(Clone, Debug, clap::Args)]
pub struct Arguments {
    /// Measured data as CSV; `python -m sandgait.logs` converts Parquet, LeRobot data sets, MCAP and ROS bags
    pub data: PathBuf,
    /// Facts that the data file does not contain: medium, shapes, units (TOML)
    #[arg(long)]
    pub experiment: PathBuf,
    /// Directory for report.json, report.html, sand.toml and hardware.toml
    #[arg(long)]
    pub out: PathBuf,
}

/// Diagnoses and writes the report; bad input is an error and writes nothing.
pub fn run(arguments: &Arguments) -> Result<Diagnosis> {
    let experiment = Experiment::load(&arguments.experiment)?;
    let diagnosis = diagnose(&arguments.data, &experiment, &Silent)?;
    diagnosis.write(&arguments.out)?;
    Ok(diagnosis)
}
