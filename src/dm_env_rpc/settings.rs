//! Settings of worlds and resets: tensors by name, converted from and to keywords of `gymnasium.make`.
//!
//! A scalar is a number, text or truth value, and a tensor of one dimension is a list. Clients flatten nested settings
//! with dots: `weights.tracking` is the field `tracking` of the option `weights`.

use super::proto::Tensor;
use super::proto::tensor::Payload;
use crate::env::ResetOptions;
use crate::env::registry::{TASK_IDS, reset_names};
use crate::error::{Error, Result};
use crate::values;
use serde_json::{Map, Value};
use std::collections::HashMap;

/// Settings as in a message.
pub type TensorSettings = HashMap<String, Tensor>;

/// Largest length of a list in a setting: our choice. The longest option has at most one name for each sensor.
const LONGEST: usize = 64;

/// The arguments of a new world.
#[derive(Debug)]
pub struct NewWorld {
    pub task: String,
    /// Keywords of the task.
    pub options: Value,
    /// None: a random seed.
    pub seed: Option<u64>,
}

/// The changes of a reset.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ResetChanges {
    pub options: ResetOptions,
    /// None: the stream of random numbers continues.
    pub seed: Option<u64>,
}

/// Settings of CreateWorld: `task`, `seed` and the task's options.
pub fn plan(settings: TensorSettings) -> Result<NewWorld> {
    let mut keywords = keywords(settings)?;
    let seed = seed(&mut keywords)?;
    let task = match keywords.remove("task") {
        Some(Value::String(task)) => task,
        Some(other) => return Err(Error::invalid("settings.task", format!("{other} is not text"))),
        None => return Err(Error::invalid("settings.task", format!("missing; known: {}", TASK_IDS.join(", ")))),
    };
    Ok(NewWorld { task, options: Value::Object(keywords), seed })
}

/// Settings of Reset and ResetWorld: `seed` and the options that a reset can change.
pub fn changes(settings: TensorSettings) -> Result<ResetChanges> {
    let mut keywords = keywords(settings)?;
    let seed = seed(&mut keywords)?;
    let names = reset_names();
    let unknown = keywords.keys().find(|name| !names.contains(&name.as_str()));
    if let Some(name) = unknown {
        let known = [vec!["seed"], names].concat();
        return Err(Error::unknown("setting of a reset", name, &known));
    }
    Ok(ResetChanges { options: ResetOptions::new(Value::Object(keywords))?, seed })
}

/// Settings of JoinWorld: there are none.
pub fn none(settings: &TensorSettings) -> Result<()> {
    match settings.keys().min() {
        Some(name) => Err(Error::invalid(format!("settings.{name}"), "join_world takes no settings")),
        None => Ok(()),
    }
}

fn seed(keywords: &mut Map<String, Value>) -> Result<Option<u64>> {
    let Some(value) = keywords.remove("seed") else { return Ok(None) };
    let refused = || Error::invalid("settings.seed", format!("{value} is no whole number in [0, 2^64)"));
    value.as_u64().map(Some).ok_or_else(refused)
}

fn keywords(settings: TensorSettings) -> Result<Map<String, Value>> {
    let mut settings: Vec<_> = settings.into_iter().collect();
    settings.sort_by(|a, b| a.0.cmp(&b.0)); // sorted, so that the error does not depend on a hash
    let mut keywords = Map::new();
    for (name, tensor) in settings {
        let value = value(&format!("settings.{name}"), tensor)?;
        let Some((group, field)) = name.split_once('.') else {
            keywords.insert(name, value);
            continue;
        };
        match keywords.entry(group).or_insert_with(|| Value::Object(Map::new())) {
            Value::Object(fields) => fields.insert(field.into(), value),
            _ => return Err(Error::invalid(format!("settings.{name}"), format!("{group:?} is given as a whole too"))),
        };
    }
    Ok(keywords)
}

fn value(path: &str, tensor: Tensor) -> Result<Value> {
    let mut items = items(path, tensor.payload)?;
    let wrong = |n: usize| {
        let shape = &tensor.shape;
        Error::invalid(
            path,
            format!("shape {shape:?} with {n} elements is neither a scalar nor a list of at most {LONGEST}"),
        )
    };
    match (tensor.shape.as_slice(), items.len()) {
        ([], 1) => Ok(items.remove(0)),
        ([size], n) if n <= LONGEST && (*size < 0 || usize::try_from(*size) == Ok(n)) => Ok(Value::Array(items)),
        // One element fills the shape.
        ([size], 1) if usize::try_from(*size).is_ok_and(|s| s <= LONGEST) => {
            Ok(Value::Array(vec![items.remove(0); *size as usize]))
        }
        (_, n) => Err(wrong(n)),
    }
}

fn items(path: &str, payload: Option<Payload>) -> Result<Vec<Value>> {
    let real = |x: f64| values::number(path, x).map(Value::Number);
    Ok(match payload {
        Some(Payload::Floats(p)) => p.array.into_iter().map(|x| real(x.into())).collect::<Result<_>>()?,
        Some(Payload::Doubles(p)) => p.array.into_iter().map(real).collect::<Result<_>>()?,
        Some(Payload::Int8s(p)) => p.array.into_iter().map(|x| (x as i8).into()).collect(),
        Some(Payload::Int32s(p)) => p.array.into_iter().map(Value::from).collect(),
        Some(Payload::Int64s(p)) => p.array.into_iter().map(Value::from).collect(),
        Some(Payload::Uint8s(p)) => p.array.into_iter().map(Value::from).collect(),
        Some(Payload::Uint32s(p)) => p.array.into_iter().map(Value::from).collect(),
        Some(Payload::Uint64s(p)) => p.array.into_iter().map(Value::from).collect(),
        Some(Payload::Bools(p)) => p.array.into_iter().map(Value::from).collect(),
        Some(Payload::Strings(p)) => p.array.into_iter().map(Value::from).collect(),
        Some(Payload::Protos(_)) => return Err(Error::invalid(path, "messages are no settings")),
        None => return Err(Error::invalid(path, "the tensor is empty")),
    })
}

#[cfg(test)]
mod tests {
    use super::super::proto::tensor;
    use super::*;
    use serde_json::json;

    fn text(s: &str) -> Tensor {
        Tensor { payload: Some(Payload::Strings(tensor::StringArray { array: vec![s.into()] })), shape: vec![] }
    }

    fn doubles(array: &[f64], shape: &[i32]) -> Tensor {
        let payload = Some(Payload::Doubles(tensor::DoubleArray { array: array.into() }));
        Tensor { payload, shape: shape.into() }
    }

    fn settings(fields: &[(&str, Tensor)]) -> TensorSettings {
        fields.iter().map(|(name, t)| ((*name).into(), t.clone())).collect()
    }

    #[test]
    fn tensors_become_keywords() {
        let plan = plan(settings(&[
            ("task", text("t")),
            ("seed", doubles(&[3.0], &[])),
            ("command", doubles(&[0.2], &[2])),
            ("weights.power", doubles(&[0.5], &[])),
            ("weights.lateral", doubles(&[2.0], &[])),
        ]));
        let plan = plan.unwrap();
        assert_eq!((plan.task.as_str(), plan.seed), ("t", Some(3)));
        assert_eq!(plan.options, json!({"command": [0.2, 0.2], "weights": {"power": 0.5, "lateral": 2}}));
    }

    #[test]
    fn wrong_settings_are_named() {
        let error = |fields: &[(&str, Tensor)]| changes(settings(fields)).unwrap_err().to_string();
        assert_eq!(error(&[("seed", doubles(&[0.5], &[]))]), "settings.seed: 0.5 is no whole number in [0, 2^64)");
        assert_eq!(error(&[("payload", doubles(&[f64::NAN], &[]))]), "settings.payload: NaN is not finite");
        assert!(error(&[("payload", doubles(&[1.0, 2.0], &[]))]).starts_with("settings.payload: shape [] with 2"));
        assert!(error(&[("payload", doubles(&[1.0], &[i32::MAX]))]).starts_with("settings.payload: shape"));
        assert!(error(&[("payload", Tensor::default())]).starts_with("settings.payload: the tensor is empty"));
        assert!(error(&[("dt", doubles(&[1e-4], &[]))]).starts_with("setting of a reset \"dt\" is unknown; "));
        let twice = error(&[("rocks", doubles(&[1.0], &[])), ("rocks.count", doubles(&[1.0], &[]))]);
        assert_eq!(twice, "settings.rocks.count: \"rocks\" is given as a whole too");
        assert!(plan(settings(&[])).unwrap_err().to_string().starts_with("settings.task: missing; known: sandgait/"));
        assert!(none(&settings(&[("x", text("y"))])).unwrap_err().to_string().starts_with("settings.x:"));
    }
}
