//! Reads a log from CSV.

use super::consistency;
use super::log::{Gather, JointColumns, Log};
use super::replay::ReplayRobot;
use crate::error::Result;
use crate::experiment::Experiment;
use crate::progress::Progress;
use crate::table::{self, ReadOptions};
use std::path::Path;

/// Reads a log and refuses it if units or signs are wrong.
pub fn read(data: &Path, experiment: &Experiment, progress: &dyn Progress) -> Result<Log> {
    let keys = &experiment.trajectory;
    let body = ReplayRobot::load(experiment.robot.as_deref().unwrap_or("xplorer"), keys.touches.as_deref())?;
    let joints = body.joint_names();
    let names = JointColumns::new(&joints, keys)?;
    let columns = names.columns();
    let [renamed, units] = [&experiment.columns, &experiment.units].map(|table| names.for_each_joint(table));
    let asked = ReadOptions { renamed, units, progress, ..ReadOptions::new(&columns) };
    let mut gather = Gather::new(&names, keys);
    let summary = table::read(data, &asked, |row| gather.take(row))?;
    let log = gather.finish(data, summary.sha256)?;
    consistency::check(data, &log, &joints, keys.imu.quat)?;
    Ok(log)
}
