//! Reads a log from its file.

use super::log::{Gather, Log, Names};
use super::replay::Body;
use super::slips;
use crate::error::{Error, Result};
use crate::experiment::Experiment;
use crate::table::{self, Asked};
use std::path::Path;

/// Endings of binary logs, which are not read.
const BINARY: [&str; 5] = ["mcap", "parquet", "bag", "db3", "mat"];

/// Reads a log and refuses slips of units and signs.
pub fn read(data: &Path, experiment: &Experiment) -> Result<Log> {
    let ending = data.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase).unwrap_or_default();
    if BINARY.contains(&ending.as_str()) {
        return Err(Error::file(data, "logs are read as CSV, one row a sample: export it (pandas: to_csv)"));
    }
    let keys = &experiment.trajectory;
    let body = Body::load(experiment.robot.as_deref().unwrap_or("xplorer"), keys.touches.as_deref())?;
    let joints = body.joint_names();
    let names = Names::new(&joints, keys)?;
    let columns = names.columns();
    let (renamed, units) = (experiment.columns.clone(), experiment.units.clone());
    let asked = Asked { columns: &columns, renamed, units, most_rows: None };
    let mut gather = Gather::new(&names, keys);
    let summary = table::read(data, &asked, |row| gather.take(row))?;
    let log = gather.finish(data, summary.sha256)?;
    slips::check(data, &log, &joints, keys.imu_quat)?;
    Ok(log)
}
