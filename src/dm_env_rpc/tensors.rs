//! Rows of a task as tensors: one action, and the observation with reward and discount.
//!
//! | | uid | name | shape |
//! |---|---|---|---|
//! | action | 1 | action | f32 [action columns], with bounds |
//! | observation | 1 | observation | f32 [observation columns], with bounds |
//! | observation | 2 | reward | f32 [] |
//! | observation | 3 | discount | f32 [], 0 where the episode terminated, else 1 |
//!
//! `reward` and `discount` are the names that DeepMind's adaptor looks for. With one tensor for each column, a step
//! would be some forty named scalars, which every agent would have to join again.

use super::proto::tensor::{FloatArray, Payload};
use super::proto::tensor_spec::{Value, value};
use super::proto::{ActionObservationSpecs, DataType, EnvironmentStateType, Tensor, TensorSpec};
use crate::env::{Column, Spec};
use crate::error::{Error, Result};
use crate::pool::Batch;
use std::collections::HashMap;

const ACTION: u64 = 1;
const OBSERVATION: u64 = 1;
const REWARD: u64 = 2;
const DISCOUNT: u64 = 3;

/// The results of a world's only environment.
#[derive(Clone, Debug)]
pub struct WorldView {
    observation: Vec<f32>,
    reward: f32,
    pub state: EnvironmentStateType,
}

impl WorldView {
    /// The first observation of the present episode.
    pub fn first(batch: &Batch) -> Self {
        let observation = batch.shards().iter().flat_map(|s| &s.rows.observations).copied().collect();
        Self { observation, reward: 0.0, state: EnvironmentStateType::Running }
    }

    /// The rows of the last step; if it ended the episode, the last observation of that episode.
    pub fn after_step(batch: &Batch) -> Self {
        let first = Self::first(batch);
        let Some(shard) = batch.shards().first() else { return first };
        let rows = &shard.rows;
        let state = match (rows.terminated[0], rows.truncated[0]) {
            (0, 0) => EnvironmentStateType::Running,
            (0, _) => EnvironmentStateType::Interrupted,
            _ => EnvironmentStateType::Terminated,
        };
        let ended = !rows.ended.is_empty();
        let observation = if ended { rows.final_observations.clone() } else { first.observation };
        Self { observation, reward: rows.rewards[0], state }
    }

    /// The same observation, without a reward, as the end of an episode that was ended from outside.
    pub fn interrupted(&self) -> Self {
        Self { observation: self.observation.clone(), reward: 0.0, state: EnvironmentStateType::Interrupted }
    }

    /// The requested tensors.
    pub fn tensors(&self, requested: &[u64]) -> HashMap<u64, Tensor> {
        let terminated = self.state == EnvironmentStateType::Terminated;
        let tensor = |uid: &u64| match *uid {
            REWARD => (REWARD, scalar(self.reward)),
            DISCOUNT => (DISCOUNT, scalar(if terminated { 0.0 } else { 1.0 })),
            uid => (uid, tensor(self.observation.clone(), vec![self.observation.len() as i32])),
        };
        requested.iter().map(tensor).collect()
    }
}

fn tensor(array: Vec<f32>, shape: Vec<i32>) -> Tensor {
    Tensor { payload: Some(Payload::Floats(FloatArray { array })), shape }
}

fn scalar(x: f32) -> Tensor {
    tensor(vec![x], vec![])
}

/// Largest number of uids in one step: our choice, several times the number of observations.
const MOST_REQUESTED: usize = 16;

/// Refuses uids of observations that do not exist.
pub fn check_requested(requested: &[u64]) -> Result<()> {
    if requested.len() > MOST_REQUESTED {
        let reason = format!("{} uids are more than {MOST_REQUESTED}", requested.len());
        return Err(Error::invalid("requested_observations", reason));
    }
    match requested.iter().find(|uid| ![OBSERVATION, REWARD, DISCOUNT].contains(uid)) {
        None => Ok(()),
        Some(uid) => {
            let known = "1 is observation, 2 reward, 3 discount";
            Err(Error::invalid("requested_observations", format!("there is no uid {uid}; {known}")))
        }
    }
}

/// Checks the only action and returns its row; each number is within its column's bounds. A single number applies to
/// all columns.
pub fn action(spec: &Spec, mut tensors: HashMap<u64, Tensor>) -> Result<Vec<f32>> {
    let found = tensors.remove(&ACTION);
    if let Some(uid) = tensors.keys().min() {
        return Err(Error::invalid(format!("actions[{uid}]"), "there is no such uid; 1 is action"));
    }
    let field = format!("actions[{ACTION}]");
    let Some(Tensor { payload, shape }) = found else {
        return Err(Error::invalid(field, "missing: a step needs the tensor action"));
    };
    let Some(Payload::Floats(FloatArray { mut array })) = payload else {
        return Err(Error::invalid(field, format!("{}, expected floats", payload.as_ref().map_or("nothing", kind))));
    };
    let wide = spec.action.len();
    let fits = match shape.as_slice() {
        [] => array.len() == 1,
        [size] => (*size < 0 || usize::try_from(*size) == Ok(wide)) && [1, wide].contains(&array.len()),
        _ => false,
    };
    if !fits {
        let n = array.len();
        return Err(Error::invalid(field, format!("shape {shape:?} with {n} numbers, expected [{wide}]")));
    }
    if array.len() == 1 {
        array = vec![array[0]; wide];
    }
    for (k, (value, column)) in array.iter().zip(&spec.action).enumerate() {
        column.check(*value, || format!("{field}[{k}]"))?;
    }
    Ok(array)
}

fn kind(payload: &Payload) -> &'static str {
    match payload {
        Payload::Floats(_) => "floats",
        Payload::Doubles(_) => "doubles",
        Payload::Int8s(_) => "int8s",
        Payload::Int32s(_) => "int32s",
        Payload::Int64s(_) => "int64s",
        Payload::Uint8s(_) => "uint8s",
        Payload::Uint32s(_) => "uint32s",
        Payload::Uint64s(_) => "uint64s",
        Payload::Bools(_) => "bools",
        Payload::Strings(_) => "strings",
        Payload::Protos(_) => "protos",
    }
}

/// The tables of a task.
pub fn specs(spec: &Spec) -> ActionObservationSpecs {
    let bounds = |array: Vec<f32>| Some(Value { payload: Some(value::Payload::Floats(FloatArray { array })) });
    let row = |name: &str, columns: &[Column]| TensorSpec {
        min: bounds(columns.iter().map(|c| c.low as f32).collect()),
        max: bounds(columns.iter().map(|c| c.high as f32).collect()),
        shape: vec![columns.len() as i32],
        ..number(name)
    };
    let discount = TensorSpec { min: bounds(vec![0.0]), max: bounds(vec![1.0]), ..number("discount") };
    ActionObservationSpecs {
        actions: [(ACTION, row("action", &spec.action))].into(),
        observations: [
            (OBSERVATION, row("observation", &spec.observation)),
            (REWARD, number("reward")),
            (DISCOUNT, discount),
        ]
        .into(),
    }
}

fn number(name: &str) -> TensorSpec {
    TensorSpec { name: name.into(), dtype: DataType::Float.into(), ..Default::default() }
}
