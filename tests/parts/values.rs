//! Protobuf's JSON-like values.

use prost_types::value::Kind;
use sandgait::Result;
use sandgait::service::values::{from_json, to_json};
use serde_json::{Value, json};

fn there_and_back(value: Value) -> Result<Value> {
    let Some(Kind::StructValue(s)) = from_json(&value).kind else { unreachable!("an object was given") };
    to_json(Some(s))
}

#[test]
fn objects_survive_the_wire() {
    let value = json!({"leg": "C", "max_episode_steps": 500, "slope_deg": 2.5, "command": [0.1, 0.4], "n": null});
    assert_eq!(there_and_back(value.clone()).unwrap(), value);
    assert_eq!(to_json(None).unwrap(), json!({}));
}

#[test]
fn numbers_that_json_lacks_are_named() {
    let bad = prost_types::Value { kind: Some(Kind::NumberValue(f64::NAN)) };
    let fields = [("dt".to_owned(), bad)].into_iter().collect();
    let error = to_json(Some(prost_types::Struct { fields })).unwrap_err().to_string();
    assert_eq!(error, "options.dt: NaN is not finite");
}
