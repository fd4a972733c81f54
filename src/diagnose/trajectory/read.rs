//! Reads a log from its file.

use super::log::{Gather, Log, Names};
use super::replay::Body;
use crate::error::Result;
use crate::experiment::Experiment;
use crate::table::{self, Asked};
use std::path::Path;

/// Reads a log, whatever kind of file it is.
pub fn read(data: &Path, experiment: &Experiment) -> Result<Log> {
    let keys = &experiment.trajectory;
    let body = Body::load(experiment.robot.as_deref().unwrap_or("xplorer"), keys.touches.as_deref())?;
    let names = Names::new(&body.joint_names(), keys)?;
    let columns = names.columns();
    let (renamed, units) = (experiment.columns.clone(), experiment.units.clone());
    let asked = Asked { columns: &columns, renamed, units, most_rows: None };
    let mut gather = Gather::new(&names, keys);
    let summary = table::read(data, &asked, |row| gather.take(row))?;
    gather.finish(data, summary.sha256)
}
