//! Trainings of robots from files.

use sandgait::train::{TrainingRequest, entry};
use serde_json::Value;
use std::path::Path;

/// A training in LeggedVelocity with one thread and these changes of the built-in settings, which writes to `out`.
pub fn request(options: Value, out: &Path, changes: Vec<(String, Value)>) -> TrainingRequest {
    let task = "sandgait/LeggedVelocity-v1";
    TrainingRequest {
        task: task.into(),
        options,
        external: None,
        settings: entry::settings(None, task, changes).unwrap(),
        seed: 3,
        threads: 1,
        out: out.to_owned(),
        resume: false,
        start_from: None,
        checkpoint_every: 1_000_000,
        connect: None,
    }
}
