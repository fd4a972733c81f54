//! What a reset may change of an environment's options.

use super::{Randomize, RockOptions, StrokeOptions, TaskOptions};
use crate::error::{Error, Result};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use std::marker::PhantomData;

/// Some keys of a dictionary of options; the others stay as they are.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Partial<T> {
    keys: Map<String, Value>,
    #[serde(skip)]
    of: PhantomData<T>,
}

impl<T: Serialize + DeserializeOwned> Partial<T> {
    /// Every key of `whole`.
    pub fn all(whole: &T) -> Self {
        // Plain data: serialising it cannot fail, and an empty dictionary would change nothing.
        let keys = serde_json::to_value(whole).ok().and_then(|all| all.as_object().cloned());
        Self { keys: keys.unwrap_or_default(), of: PhantomData }
    }

    /// `whole` with these keys; `name` is the dictionary's, for errors.
    fn merged(&self, name: &str, whole: &T) -> Result<T> {
        let mut keys = Self::all(whole).keys;
        keys.extend(self.keys.clone());
        serde_json::from_value(Value::Object(keys)).map_err(|e| Error::invalid(name, e.to_string()))
    }
}

/// What a reset may change of an environment's options; it holds until a reset changes it again.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ResetOptions {
    pub leg: Option<String>,
    pub medium: Option<String>,
    pub slope_deg: Option<f64>,
    pub payload: Option<f64>,
    pub command: Option<[f64; 2]>,
    pub turn: Option<[f64; 2]>,
    pub rocks: Option<Partial<RockOptions>>,
    pub randomize: Option<Partial<Randomize>>,
    pub difficulty: Option<f64>,
    pub stroke: Option<Partial<StrokeOptions>>,
}

impl ResetOptions {
    /// Names of the keywords, for tables.
    pub const NAMES: [&'static str; 10] =
        ["leg", "medium", "slope_deg", "payload", "command", "turn", "rocks", "randomize", "difficulty", "stroke"];

    /// Names of those that are given.
    pub fn given(&self) -> Vec<String> {
        let all = serde_json::to_value(self).unwrap_or_default(); // plain data: serialising it cannot fail
        let given = all.as_object().into_iter().flatten().filter(|(_, value)| !value.is_null());
        given.map(|(name, _)| name.clone()).collect()
    }

    /// Everything of `options` that a reset may change.
    pub fn all_of(options: &TaskOptions) -> Self {
        let TaskOptions {
            leg, medium, slope_deg, payload, command, turn, rocks, randomize, difficulty, stroke, ..
        } = options.clone();
        Self {
            leg: Some(leg),
            medium: Some(medium),
            slope_deg: Some(slope_deg),
            payload: Some(payload),
            command: Some(command),
            turn: Some(turn),
            rocks: rocks.as_ref().map(Partial::all),
            randomize: randomize.as_ref().map(Partial::all),
            difficulty,
            stroke: stroke.as_ref().map(Partial::all),
        }
    }
}

/// `old` with the keys that `given` has; a dictionary that the task does not have stays away.
fn merged<T: Serialize + DeserializeOwned + Copy>(
    name: &str,
    old: Option<T>,
    given: &Option<Partial<T>>,
) -> Result<Option<T>> {
    match (old, given) {
        (Some(old), Some(given)) => given.merged(name, &old).map(Some),
        _ => Ok(old),
    }
}

impl TaskOptions {
    /// These options with a reset's changes. Dictionaries change key by key.
    pub fn changed(&self, reset: &ResetOptions) -> Result<Self> {
        let mut new = self.clone();
        new.leg = reset.leg.clone().unwrap_or(new.leg);
        new.medium = reset.medium.clone().unwrap_or(new.medium);
        new.slope_deg = reset.slope_deg.unwrap_or(new.slope_deg);
        new.payload = reset.payload.unwrap_or(new.payload);
        new.command = reset.command.unwrap_or(new.command);
        new.turn = reset.turn.unwrap_or(new.turn);
        new.rocks = merged("rocks", new.rocks, &reset.rocks)?;
        new.randomize = merged("randomize", new.randomize, &reset.randomize)?;
        new.difficulty = reset.difficulty.or(new.difficulty);
        new.stroke = merged("stroke", new.stroke, &reset.stroke)?;
        Ok(new)
    }
}
