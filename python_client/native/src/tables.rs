//! Tables of tasks and studies, as tuples that Python converts to its own types.

use crate::arrays::{doubles, names};
use crate::errors::raise;
use crate::values::python;
use pyo3::prelude::*;
use pyo3::types::PyList;
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

/// Columns, each with name, unit and numbers or names; and warnings.
pub fn table<'py>(py: Python<'py>, table: &proto::Table) -> PyResult<Bound<'py, PyAny>> {
    let mut columns = Vec::new();
    for series in &table.columns {
        let values = if series.names.is_empty() { doubles(py, &series.numbers)? } else { names(py, &series.names)? };
        columns.push((&series.name, &series.unit, values));
    }
    Ok((PyList::new(py, columns)?, table.warnings.clone()).into_pyobject(py)?.into_any())
}
