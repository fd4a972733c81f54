//! Reads a log from its file: CSV, MCAP or Parquet, as its first bytes say.

use super::log::{Gather, Log, Names};
use super::replay::Body;
use super::{bag, columnar, slips};
use crate::error::{Error, Result};
use crate::experiment::Experiment;
use crate::table::{self, Asked};
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Reads a log and refuses slips of units and signs.
pub fn read(data: &Path, experiment: &Experiment) -> Result<Log> {
    let keys = &experiment.trajectory;
    let body = Body::load(experiment.robot.as_deref().unwrap_or("xplorer"), keys.touches.as_deref())?;
    let joints = body.joint_names();
    let names = Names::new(&joints, keys)?;
    let columns = names.columns();
    let (renamed, units) = (experiment.columns.clone(), experiment.units.clone());
    let asked = Asked { columns: &columns, renamed, units, most_rows: None };
    let mut gather = Gather::new(&names, keys);
    let first = first_bytes(data)?;
    let mcap = first.starts_with(mcap::MAGIC);
    if !mcap && let Some(key) = keys.of_mcap() {
        return Err(Error::invalid(key, "only MCAP files take it; other logs have columns"));
    }
    let sha256 = if mcap {
        let sha256 = table::sha256(data)?;
        let bag = bag::read(data, &keys.topics, &keys.cuts)?;
        table::rows(data, &bag.header(), &asked, bag.rows(), |row| gather.take(row))?;
        sha256
    } else if first.starts_with(columnar::MAGIC) {
        let sha256 = table::sha256(data)?;
        columnar::read(data, &asked, |row| gather.take(row))?;
        sha256
    } else if first.contains(&0) {
        return Err(Error::file(data, "neither CSV nor Parquet nor MCAP; `ros2 bag convert` makes MCAP of other bags"));
    } else {
        table::read(data, &asked, |row| gather.take(row))?.sha256
    };
    let log = gather.finish(data, sha256)?;
    slips::check(data, &log, &joints, keys.imu_quat)?;
    Ok(log)
}

/// At most 64 bytes: the marks of MCAP, Parquet and SQLite (the bags of ROS 2, whose mark ends with a zero) are shorter.
fn first_bytes(path: &Path) -> Result<Vec<u8>> {
    let file = File::open(path).map_err(|e| Error::file(path, e))?;
    let mut first = Vec::new();
    file.take(64).read_to_end(&mut first).map_err(|e| Error::file(path, e))?;
    Ok(first)
}
