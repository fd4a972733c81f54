//! `sandgait.train`: what the command `sandgait train` does.

use crate::errors::raise;
use crate::external::{DirectProgress, ExternalEnvironments, Raised};
use crate::remote::{self, Address};
use crate::values::keywords;
use crate::wait;
use parking_lot::Mutex;
use pyo3::prelude::*;
use pyo3::types::PyMapping;
use sandgait::Result;
use sandgait::cli::{TrainingArgs, learn};
use sandgait::env::registry::Blueprint;
use sandgait::progress::Progress;
use sandgait::train::remote::{Pause, RemoteEnvironments};
use sandgait::train::{CurvePoint, ExternalSpaces, Mirror, TrainingPlan, TrainingRequest};
use sandgait::train::{describe, golden};
use serde_json::{Value, json};
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
    vector: Option<Vector<'py>>,
}

/// Another program's environments: what steps them, their number, and bounds of observations and actions.
#[derive(FromPyObject)]
struct Vector<'py>(Bound<'py, PyAny>, usize, Vec<[f64; 2]>, Vec<[f64; 2]>);

/// A point of the learning curve: steps, seconds, return, and each reward term by its name.
type Point = (u64, f64, f64, Vec<(String, f64)>);
/// Folder, steps, seconds, the learning curve, the score as JSON, and all results as text.
type Learnt = (PathBuf, u64, f64, Vec<Point>, String, String);

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
    if let Some(vector) = asked.vector {
        return external(py, training, changes, options, vector, told);
    }
    wait::to_the_end(py, told, move |progress| learnt(&training.request(changes, options, place)?, progress))
}

/// The same for another program's environments, which work in this thread.
fn external(
    py: Python<'_>,
    training: TrainingArgs,
    changes: Vec<(String, Value)>,
    options: Value,
    Vector(vector, envs, observation, action): Vector<'_>,
    told: Option<&Bound<'_, PyAny>>,
) -> PyResult<Learnt> {
    let raised = Raised::default();
    let progress = DirectProgress {
        told: told.map(|told| told.clone().unbind()),
        raised: raised.clone(),
        last: Mutex::new((0.0, String::new())),
    };
    let (vector, own) = (vector.unbind(), raised.clone());
    let connect = Box::new(move |_: &TrainingPlan, _: &Value, _: Pause<'_>| {
        let vector = Python::attach(|py| vector.clone_ref(py));
        let environments = ExternalEnvironments { vector, raised: own.clone(), envs, skipped: Vec::new() };
        Ok(Box::new(environments) as Box<dyn RemoteEnvironments>)
    });
    let outcome = py.detach(|| {
        let spaces = ExternalSpaces { observation, action };
        learnt(&training.external(changes, options, spaces, envs, connect)?, &progress)
    });
    match (raised.take(), outcome) {
        (None, outcome) => outcome.map_err(|error| raise(&error)),
        (Some(raised), outcome) => {
            if let Err(ended) = outcome {
                raised.value(py).call_method1("add_note", (ended.to_string(),))?;
            }
            Err(raised)
        }
    }
}

fn learnt(request: &TrainingRequest, progress: &dyn Progress) -> Result<Learnt> {
    let (outcome, text) = learn(request, progress)?;
    let point = |p: CurvePoint| (p.steps, p.seconds, p.mean_return, p.terms);
    let curve = outcome.curve.into_iter().map(point).collect();
    let (steps, seconds) = (outcome.learnt.steps, outcome.learnt.seconds);
    Ok((request.out.clone(), steps, seconds, curve, json!(outcome.score).to_string(), text))
}

/// The mirrors of a task's observations and of its actions, left to right: for each column the column with its mirrored
/// value, and the sign.
#[pyfunction]
pub fn mirror(task: &str, options: &Bound<'_, PyMapping>) -> PyResult<[(Vec<usize>, Vec<f32>); 2]> {
    let mirrors = Blueprint::new(task, keywords(options)?).and_then(|blueprint| Mirror::both(&blueprint));
    Ok(mirrors.map_err(|error| raise(&error))?.map(|mirror| (mirror.order, mirror.signs)))
}

/// `policy.json` and `golden.csv` of the policy `onnx` of a task with these options, as texts; no trace if the task's
/// actions are no joint targets.
#[pyfunction]
pub fn describe_policy(
    py: Python<'_>,
    task: &str,
    options: &Bound<'_, PyMapping>,
    onnx: Vec<u8>,
) -> PyResult<(String, Option<String>)> {
    let options = keywords(options)?;
    let described = py.detach(|| {
        let about = describe::of_task(&Blueprint::new(task, options.clone())?, &onnx);
        Ok((format!("{about:#}\n"), golden::golden(task, &options, &onnx)?))
    });
    described.map_err(|error| raise(&error))
}
