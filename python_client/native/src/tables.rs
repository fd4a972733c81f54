//! Tables of tasks, as tuples that Python converts to its own types.

use crate::errors::raise;
use crate::values::python;
use pyo3::prelude::*;
use sandgait::env::registry::{Blueprint, TASK_IDS};
use sandgait::service::proto;
use serde_json::Value;

/// Version of the package, and all tasks with their default options.
#[pyfunction]
pub fn describe(py: Python<'_>) -> PyResult<(&'static str, Vec<Bound<'_, PyAny>>)> {
    let task = |id: &&str| {
        let blueprint = Blueprint::new(id, Value::Null).map_err(|e| raise(&e))?;
        task(py, &sandgait::service::task(&blueprint))
    };
    Ok((env!("CARGO_PKG_VERSION"), TASK_IDS.iter().map(task).collect::<PyResult<_>>()?))
}

/// The fields of `sandgait.Task`, in order; columns and options as tuples too.
pub fn task<'py>(py: Python<'py>, task: &proto::Task) -> PyResult<Bound<'py, PyAny>> {
    type Column<'a> = (&'a str, &'a str, f64, f64);
    fn columns(all: &[proto::Column]) -> Vec<Column<'_>> {
        all.iter().map(|c| (c.name.as_str(), c.unit.as_str(), c.low, c.high)).collect()
    }
    let mut options = Vec::new();
    for option in &task.options {
        let value = option.default_value.clone().unwrap_or_default();
        options.push((&option.name, &option.summary, python(py, &value)?, option.at_reset));
    }
    let tables = (columns(&task.observation), columns(&task.action), columns(&task.info));
    let (observation, action, info) = tables;
    let numbers = (task.reward_terms, task.max_episode_steps, task.control_rate);
    let (terms, steps, rate) = numbers;
    let all = (&task.id, &task.summary, observation, action, info, terms, steps, rate, options);
    Ok(all.into_pyobject(py)?.into_any())
}
