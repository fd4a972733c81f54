//! Reads a log from a file. The first bytes of the file tell whether it is CSV, MCAP or Parquet.

use super::log::{Gather, Log, Names};
use super::replay::Body;
use super::{bag, columnar, consistency};
use crate::error::{Error, Result};
use crate::experiment::Experiment;
use crate::table::{self, Asked};
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Reads a log and refuses it if units or signs are wrong.
pub fn read(data: &Path, experiment: &Experiment) -> Result<Log> {
    let keys = &experiment.trajectory;
    let body = Body::load(experiment.robot.as_deref().unwrap_or("xplorer"), keys.touches.as_deref())?;
    let joints = body.joint_names();
    let names = Names::new(&joints, keys)?;
    let columns = names.columns();
    let (renamed, units) = (experiment.columns.clone(), experiment.units.clone());
    let asked = Asked { renamed, units, ..Asked::new(&columns) };
    let mut gather = Gather::new(&names, keys);
    let first = first_bytes(data)?;
    let mcap = first.starts_with(mcap::MAGIC);
    if !mcap && let Some(key) = keys.of_mcap() {
        return Err(Error::invalid(key, "only MCAP files take this key; other logs have columns for it"));
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
        return Err(Error::file(data, "neither CSV, Parquet nor MCAP; `ros2 bag convert` converts other bags to MCAP"));
    } else {
        table::read(data, &asked, |row| gather.take(row))?.sha256
    };
    let log = gather.finish(data, sha256)?;
    consistency::check(data, &log, &joints, keys.imu_quat)?;
    Ok(log)
}

/// The first 64 bytes, or the whole file if it is shorter. The marks of MCAP, Parquet and SQLite fit into them. SQLite is another
/// format of ROS 2 bags; its mark contains a zero byte, which no CSV file has.
fn first_bytes(path: &Path) -> Result<Vec<u8>> {
    let file = File::open(path).map_err(|e| Error::file(path, e))?;
    let mut first = Vec::new();
    file.take(64).read_to_end(&mut first).map_err(|e| Error::file(path, e))?;
    Ok(first)
}
