//! Keywords: Python's values as JSON, the same as in messages.

use crate::errors::{invalid, raise};
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict, PyFloat, PyInt, PyList, PyMapping, PyString, PyTuple};
use sandgait::service::number;
use serde_json::{Map, Value};

/// Deepest nesting, as protobuf has it.
const DEEPEST: usize = 100;

/// Converts keywords; numpy's numbers and arrays, tuples, lists and dicts are allowed.
pub fn keywords(given: &Bound<'_, PyMapping>) -> PyResult<Value> {
    let mut all = Map::new();
    for pair in given.items()?.iter() {
        let (name, value): (String, Bound<'_, PyAny>) = pair.extract()?;
        let path = format!("options.{name}");
        let made = plain(&path, &value, 1)?;
        let made = made.ok_or_else(|| {
            let shown = value.repr().map_or_else(|_| "the value".to_owned(), |shown| shown.to_string());
            invalid(&name, format!("{shown} is not a number, text, truth value, list or dict"))
        })?;
        all.insert(name, made);
    }
    Ok(Value::Object(all))
}

/// None: the value cannot be sent.
fn plain(path: &str, value: &Bound<'_, PyAny>, depth: usize) -> PyResult<Option<Value>> {
    if depth > DEEPEST {
        return Err(invalid(path, "nested too deeply"));
    }
    if value.is_none() {
        return Ok(Some(Value::Null));
    }
    if let Ok(truth) = value.cast::<PyBool>() {
        return Ok(Some(Value::Bool(truth.is_true())));
    }
    if let Ok(text) = value.cast::<PyString>() {
        return Ok(Some(Value::String(text.to_str()?.to_owned())));
    }
    if value.is_instance_of::<PyFloat>() || value.is_instance_of::<PyInt>() {
        let Ok(x) = value.extract::<f64>() else { return Ok(None) };
        return number(path, x).map(|n| Some(Value::Number(n))).map_err(|e| raise(&e));
    }
    if value.is_instance_of::<PyList>() || value.is_instance_of::<PyTuple>() {
        let mut items = Vec::new();
        for (i, item) in value.try_iter()?.enumerate() {
            let Some(item) = plain(&format!("{path}[{i}]"), &item?, depth + 1)? else { return Ok(None) };
            items.push(item);
        }
        return Ok(Some(Value::Array(items)));
    }
    if let Ok(mapping) = value.cast::<PyMapping>() {
        let mut fields = Map::new();
        for pair in mapping.items()?.iter() {
            let Ok((key, value)) = pair.extract::<(String, Bound<'_, PyAny>)>() else { return Ok(None) };
            let Some(made) = plain(&format!("{path}.{key}"), &value, depth + 1)? else { return Ok(None) };
            fields.insert(key, made);
        }
        return Ok(Some(Value::Object(fields)));
    }
    match value.getattr_opt("tolist")? {
        Some(list) => plain(path, &list.call0()?, depth + 1),
        None => Ok(None),
    }
}

/// A value of a message as a Python object; integral numbers are ints.
pub fn python<'py>(py: Python<'py>, value: &prost_types::Value) -> PyResult<Bound<'py, PyAny>> {
    use prost_types::value::Kind;
    Ok(match &value.kind {
        None | Some(Kind::NullValue(_)) => py.None().into_bound(py),
        Some(Kind::BoolValue(truth)) => PyBool::new(py, *truth).to_owned().into_any(),
        Some(Kind::NumberValue(x)) if x.fract() == 0.0 && x.abs() < 2f64.powi(53) => {
            (*x as i64).into_pyobject(py)?.into_any()
        }
        Some(Kind::NumberValue(x)) => PyFloat::new(py, *x).into_any(),
        Some(Kind::StringValue(text)) => PyString::new(py, text).into_any(),
        Some(Kind::ListValue(list)) => {
            let items: PyResult<Vec<_>> = list.values.iter().map(|v| python(py, v)).collect();
            PyList::new(py, items?)?.into_any()
        }
        Some(Kind::StructValue(fields)) => {
            let dict = PyDict::new(py);
            for (key, value) in &fields.fields {
                dict.set_item(key, python(py, value)?)?;
            }
            dict.into_any()
        }
    })
}
