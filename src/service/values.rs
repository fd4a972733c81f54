//! Turns protobuf's JSON-like values into serde's, and back.

use crate::error::{Error, Result};
use prost_types::value::Kind;
use serde_json::{Map, Number, Value};

/// Largest integer up to which all integers are exact in protobuf's f64: 2⁵³.
const EXACT: f64 = 9_007_199_254_740_992.0;

/// Keywords of a request; `None` and an empty struct both mean no keywords.
pub fn to_json(options: Option<prost_types::Struct>) -> Result<Value> {
    options.map_or_else(|| Ok(Value::Object(Map::new())), |s| object("options", s))
}

fn object(path: &str, s: prost_types::Struct) -> Result<Value> {
    let field = |(key, value)| {
        let value = json(&format!("{path}.{key}"), value)?;
        Ok((key, value))
    };
    s.fields.into_iter().map(field).collect::<Result<_>>().map(Value::Object)
}

/// `path` names the value in errors. Depth is bounded: the protobuf decoder refuses more than 100 levels.
fn json(path: &str, value: prost_types::Value) -> Result<Value> {
    Ok(match value.kind {
        None | Some(Kind::NullValue(_)) => Value::Null,
        Some(Kind::BoolValue(b)) => Value::Bool(b),
        Some(Kind::StringValue(s)) => Value::String(s),
        Some(Kind::NumberValue(x)) => Value::Number(number(path, x)?),
        Some(Kind::StructValue(s)) => object(path, s)?,
        Some(Kind::ListValue(list)) => {
            let items = list.values.into_iter().enumerate().map(|(i, v)| json(&format!("{path}[{i}]"), v));
            Value::Array(items.collect::<Result<_>>()?)
        }
    })
}

/// Integral numbers become integers, so that options of integer type accept them.
pub fn number(path: &str, x: f64) -> Result<Number> {
    if x.fract() == 0.0 && x.abs() <= EXACT {
        return Ok((x as i64).into());
    }
    Number::from_f64(x).ok_or_else(|| Error::invalid(path, format!("{x} is not finite")))
}

/// The inverse: JSON as a protobuf value.
pub fn from_json(value: &Value) -> prost_types::Value {
    let kind = match value {
        Value::Null => Kind::NullValue(0),
        Value::Bool(b) => Kind::BoolValue(*b),
        // Integers beyond 2^53 round; no option has one. Arbitrary precision is off, so every number has an f64.
        Value::Number(n) => Kind::NumberValue(n.as_f64().unwrap_or(f64::NAN)),
        Value::String(s) => Kind::StringValue(s.clone()),
        Value::Array(items) => {
            Kind::ListValue(prost_types::ListValue { values: items.iter().map(from_json).collect() })
        }
        Value::Object(fields) => Kind::StructValue(prost_types::Struct {
            fields: fields.iter().map(|(key, value)| (key.clone(), from_json(value))).collect(),
        }),
    };
    prost_types::Value { kind: Some(kind) }
}
