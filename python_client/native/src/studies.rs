//! Studies by their names, with the words of the command line.

use crate::arrays;
use crate::errors::raise;
use crate::remote::{self, Address};
use crate::values::keywords;
use crate::wait;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyMapping};
use sandgait::client::StudyCall;
use sandgait::study::{ColumnValues, Content, Inputs, StudyColumn, StudyResult, StudyTable, named};
use std::collections::HashMap;

/// What a study reads: the bytes of a file, or columns of a table with name, unit and f64.
#[derive(FromPyObject)]
pub enum Given {
    File(Vec<u8>),
    Table(Vec<(String, String, Vec<u8>)>),
}

impl From<Given> for Content {
    fn from(given: Given) -> Self {
        match given {
            Given::File(bytes) => Self::Bytes(bytes.into()),
            Given::Table(columns) => {
                let column = |(name, unit, bytes): (String, String, Vec<u8>)| {
                    let numbers = bytes.as_chunks().0.iter().map(|b| f64::from_le_bytes(*b));
                    StudyColumn::numbers(&name, &unit, numbers)
                };
                Self::Table(StudyTable::new("", columns.into_iter().map(column).collect()))
            }
        }
    }
}

/// The study `name` with its arguments as words, at `place` or in this process. `files`: what is in memory; other files that
/// the words name are read here. Returns summary, what the JSON form states beside the rows,
/// warnings, tables, files, and files that the arguments name. `told` is
/// called with the finished share and the stage; its exception stops the study.
#[pyfunction]
#[pyo3(signature = (place, name, words, files, told))]
pub fn study<'py>(
    py: Python<'py>,
    place: Option<Address>,
    name: &str,
    words: Vec<String>,
    files: HashMap<String, Given>,
    told: Option<&Bound<'_, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    // Options have the contents of their files already.
    let mut inputs = Inputs::local(|_| Ok(()));
    files.into_iter().for_each(|(name, given)| inputs.add(&name, given.into()));
    let prepared = named(name).and_then(|entry| {
        let study = entry.parse(&words)?;
        study.read(&mut inputs)?;
        Ok(study)
    });
    let study = prepared.map_err(|e| raise(&e))?;
    let (result, about) = match place {
        None => {
            let result = wait::study(py, told, move |progress| study.check(&inputs)?.finish(progress))?;
            let about = serde_json::Value::Object(result.about.clone()).to_string();
            (result, about)
        }
        Some(place) => {
            let call = StudyCall { name: name.to_owned(), words, files: inputs.into_contents() };
            remote::study(py, place, call, told)?
        }
    };
    let StudyResult { summary, mut warnings, failure, tables, files, named_files, .. } = result;
    warnings.extend(failure);
    let tables = tables.iter().map(|table| columns(py, table)).collect::<PyResult<Vec<_>>>()?;
    let [files, named] = [files, named_files]
        .map(|all| all.into_iter().map(|file| (file.name, PyBytes::new(py, &file.content))).collect::<Vec<_>>());
    Ok((summary, about, warnings, tables, files, named).into_pyobject(py)?.into_any())
}

/// Name and columns of a table, each with name, unit and numbers or names.
fn columns<'py>(py: Python<'py>, table: &StudyTable) -> PyResult<(String, Vec<PyColumn<'py>>)> {
    let column = |column: &StudyColumn| {
        let values = match &column.values {
            ColumnValues::Numbers(numbers) => arrays::doubles(py, numbers),
            ColumnValues::Names(names) => arrays::names(py, names)?,
        };
        Ok((column.name.clone(), column.unit.clone(), values))
    };
    Ok((table.name.clone(), table.columns.iter().map(column).collect::<PyResult<_>>()?))
}

type PyColumn<'py> = (String, String, Bound<'py, PyAny>);

/// Options of a task, each with its value as JSON.
#[pyfunction]
pub fn option_words(given: &Bound<'_, PyMapping>) -> PyResult<Vec<(String, String)>> {
    let options = keywords(given)?;
    let options = options.as_object().into_iter().flatten();
    Ok(options.map(|(name, value)| (name.clone(), value.to_string())).collect())
}
