//! `sandgait.train`: what the command `sandgait train` does.

use crate::errors::raise;
use crate::remote::{self, Address};
use crate::values::keywords;
use crate::wait;
use pyo3::prelude::*;
use pyo3::types::PyMapping;
use sandgait::cli::{TrainingArgs, learn};
use sandgait::env::registry::Blueprint;
use sandgait::train::Mirror;
use serde_json::json;
use std::path::PathBuf;

#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct SessionRequest<'py> {
    task: String,
    hyperparameters: Option<PathBuf>,
    settings: Bound<'py, PyMapping>,
    options: Bound<'py, PyMapping>,
    seed: u64,
    seconds: Option<f64>,
    timesteps: Option<u64>,
    out: Option<PathBuf>,
    resume: bool,
    start_from: Option<PathBuf>,
    checkpoint_every: u64,
    threads: usize,
    place: Option<Address>,
}

/// Folder, steps, seconds, the learning curve as (steps, seconds, return), the score as JSON, and all results as
/// text.
type Learnt = (PathBuf, u64, f64, Vec<(u64, f64, f64)>, String, String);

/// Trains a gait. `told` is called with the finished share and the stage. Ctrl-C and an exception of `told` end the
/// training, which leaves a checkpoint first.
#[pyfunction]
#[pyo3(signature = (asked, told))]
pub fn train(py: Python<'_>, asked: SessionRequest<'_>, told: Option<&Bound<'_, PyAny>>) -> PyResult<Learnt> {
    let changes = match keywords(&asked.settings)? {
        serde_json::Value::Object(changes) => changes.into_iter().collect(),
        _ => Vec::new(),
    };
    let training = TrainingArgs {
        task: asked.task,
        hyperparameters: asked.hyperparameters,
        seed: asked.seed,
        seconds: asked.seconds,
        timesteps: asked.timesteps,
        out: asked.out,
        resume: asked.resume,
        start_from: asked.start_from,
        checkpoint_every: asked.checkpoint_every,
        threads: asked.threads,
    };
    let (options, place) = (keywords(&asked.options)?, asked.place.map(remote::place));
    wait::to_the_end(py, told, move |progress| {
        let request = training.request(changes, options, place)?;
        let (outcome, text) = learn(&request, progress)?;
        let curve = outcome.curve.iter().map(|p| (p.steps, p.seconds, p.mean_return)).collect();
        let (steps, seconds) = (outcome.learnt.steps, outcome.learnt.seconds);
        Ok((request.out, steps, seconds, curve, json!(outcome.score).to_string(), text))
    })
}

/// The mirrors of a task's observations and of its actions, left to right: for each column the column with its mirrored
/// value, and the sign.
#[pyfunction]
pub fn mirror(task: &str, options: &Bound<'_, PyMapping>) -> PyResult<[(Vec<usize>, Vec<f32>); 2]> {
    let mirrors = Blueprint::new(task, keywords(options)?).and_then(|blueprint| Mirror::both(&blueprint));
    Ok(mirrors.map_err(|error| raise(&error))?.map(|mirror| (mirror.order, mirror.signs)))
}
