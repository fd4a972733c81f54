//! The checks of a force log.

use super::channels::Channels;
use super::finding::{Finding, settled};
use super::logged::LoggedTrial;
use super::{forces, legs, motion};
use crate::error::Result;
use crate::force_log::ForceLog;
use crate::force_model::ForceLogModel;
use crate::forward::ForwardModel;
use std::path::Path;

/// All findings, the worst first. The motion is checked first, because forces are predicted along it.
/// `broken` is what was found as the file was read.
pub fn check(
    path: &Path,
    trials: &[LoggedTrial],
    log: &ForceLog,
    model: &ForceLogModel,
    broken: Vec<Finding>,
) -> Result<Vec<Finding>> {
    let mut found = motion::check(trials);
    found.extend(legs::check(trials));
    let mut found = settled(path, found)?;
    let predicted = model.predict(&model.plain_sand());
    found.extend(forces::check(trials, &log.observations, &predicted));
    let kept: Vec<&[usize]> = log.setting_of.iter().map(|&track| &log.settings[track].compared[..]).collect();
    let channels = Channels { trials, observations: &log.observations, predicted: &predicted, kept: &kept };
    found.extend(channels.check());
    found.extend(broken);
    settled(path, found)
}
