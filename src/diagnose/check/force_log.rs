//! The checks of a force log.

use super::channels::Channels;
use super::finding::{Finding, settled};
use super::logged::LoggedTrial;
use super::{forces, legs, motion};
use crate::error::Result;
use crate::force_log::ForceLog;
use crate::force_model::ForceLogModel;
use crate::forward::ForwardModel;
use crate::motion::moving;
use std::path::Path;

/// All findings, the worst first. The motion is checked first, because forces are predicted along it.
pub fn check(path: &Path, trials: &[LoggedTrial], log: &ForceLog, model: &ForceLogModel) -> Result<Vec<Finding>> {
    let mut found = motion::check(trials);
    found.extend(legs::check(trials));
    let mut found = settled(path, found)?;
    let predicted = model.predict(&model.plain_sand());
    found.extend(forces::check(trials, &log.observations, &predicted));
    let kept: Vec<Vec<usize>> = log.setting_of.iter().map(|&track| moving(&log.settings[track])).collect();
    let channels = Channels { trials, observations: &log.observations, predicted: &predicted, kept: &kept };
    found.extend(channels.check());
    settled(path, found)
}
