//! The evaluated gait: an uploaded network, or one of the gaits without a network.

use crate::env::random::Random;
use crate::env::registry::{Blueprint, TASK_IDS, tasks_with};
use crate::env::{Shard, Spec};
use crate::error::{Error, Result, check_range};
use crate::policy::Network;
use serde_json::{Value, json};
use std::sync::Arc;

/// Stride frequency at action 1 of a hip that is driven by its speed [Hz].
const TOP_RATE: f64 = crate::env::reference::TOP_SPEED / std::f64::consts::TAU;

/// A gait as the user names it, before it is checked for a task.
#[derive(Clone, Debug, PartialEq)]
pub enum PolicySource {
    /// An ONNX file: its name for people, and its bytes.
    Network { name: String, bytes: Vec<u8> },
    /// All hips at one rate [Hz]; without a rate, a search finds the best rate.
    Tripod(Option<f64>),
    /// One action of a task with `control="clock"`, held throughout.
    Clock(Vec<f64>),
    /// Action 0 throughout: hips that do not turn.
    Standing,
    /// Uniform in the action space, drawn anew in every step.
    Random,
}

const KNOWN: [&str; 5] =
    ["FOLDER or FILE.onnx", "tripod[:HZ]", "clock:FILE.json or clock:NUMBERS", "standing", "random"];

impl PolicySource {
    /// Parses the name of a gait. `read` reads files; it gives an error if files are not allowed.
    pub fn parse(text: &str, read: impl Fn(&str) -> Result<Vec<u8>>) -> Result<Self> {
        let (kind, rest) = text.split_once(':').map_or((text, None), |(kind, rest)| (kind, Some(rest)));
        match (kind, rest) {
            ("standing", None) => Ok(Self::Standing),
            ("random", None) => Ok(Self::Random),
            ("tripod", None) => Ok(Self::Tripod(None)),
            ("tripod", Some(rate)) => {
                let rate =
                    rate.parse().map_err(|_| Error::invalid("tripod", format!("{rate:?} is not a number of Hz")))?;
                check_range("tripod", rate, -TOP_RATE..=TOP_RATE).map(|rate| Self::Tripod(Some(rate)))
            }
            ("clock", Some(file)) if file.ends_with(".json") => {
                let content = read(file)?;
                let numbers = serde_json::from_slice(&content);
                let wrong = |e| Error::invalid(file, format!("not a list of numbers: {e}"));
                numbers.map(Self::Clock).map_err(wrong)
            }
            ("clock", Some(numbers)) => {
                let number =
                    |n: &str| n.trim().parse().map_err(|_| Error::invalid("clock", format!("{n:?} is no number")));
                numbers.split(',').map(number).collect::<Result<_>>().map(Self::Clock)
            }
            _ if text.ends_with(".onnx") => Ok(Self::Network { name: text.into(), bytes: read(text)? }),
            _ => Err(Error::unknown("policy", text, &KNOWN)),
        }
    }

    /// The control mode that this gait needs, if any.
    fn control(&self) -> Option<&'static str> {
        match self {
            Self::Tripod(_) | Self::Standing => Some("hip_speed"),
            Self::Clock(_) => Some("clock"),
            Self::Network { .. } | Self::Random => None,
        }
    }

    /// The gait in words, for messages.
    fn kind(&self) -> &'static str {
        match self {
            Self::Tripod(_) => "a tripod",
            Self::Standing => "standing",
            Self::Clock(_) => "a clock",
            Self::Network { .. } | Self::Random => "a policy",
        }
    }

    /// Refuses a gait that is made for some tasks, and not for `task`.
    fn check_task(&self, task: &str) -> Result<()> {
        let suited = tasks_with("control");
        // An unknown task is refused later, by its name.
        if self.control().is_none() || suited.contains(&task) || !TASK_IDS.contains(&task) {
            return Ok(());
        }
        let reason = format!("{} is a gait of other tasks than {task}; known: {}", self.kind(), suited.join(", "));
        Err(Error::invalid("policy", reason))
    }

    /// `options` of `task` with the control mode that this gait needs.
    pub fn with_control(&self, task: &str, mut options: Value) -> Result<Value> {
        self.check_task(task)?;
        let Some(needed) = self.control() else { return Ok(options) };
        if options.is_null() {
            options = json!({});
        }
        let Value::Object(keywords) = &mut options else {
            return Err(Error::invalid("options", "not an object of keywords"));
        };
        match keywords.insert("control".into(), needed.into()) {
            Some(given) if given != needed => {
                Err(Error::invalid("control", format!("this gait needs {needed:?}, not {given}")))
            }
            _ => Ok(options),
        }
    }

    /// The gait for `blueprint`'s task; None for a tripod whose rate is still to be searched.
    pub fn gait(&self, blueprint: &Blueprint) -> Result<Option<Gait>> {
        let spec = blueprint.task.spec();
        let width = spec.action.len();
        Ok(Some(match self {
            Self::Network { bytes, .. } => Gait::Network(Arc::new(Network::new(bytes, spec)?)),
            Self::Tripod(None) => return Ok(None),
            Self::Tripod(Some(rate)) => Gait::tripod(*rate, spec),
            Self::Standing => Gait::Held(vec![0.0; width]),
            Self::Random => Gait::Random,
            Self::Clock(action) => Gait::Held(held(action, spec)?),
        }))
    }
}

/// The action of a clock, after it was checked.
fn held(action: &[f64], spec: &Spec) -> Result<Vec<f32>> {
    let columns = &spec.action;
    if action.len() != columns.len() {
        let reason = format!("{} numbers, an action of this task has {}", action.len(), columns.len());
        return Err(Error::invalid("clock", reason));
    }
    let row: Vec<f32> = action.iter().map(|a| *a as f32).collect();
    for (k, (value, column)) in row.iter().zip(columns).enumerate() {
        column.check(*value, || format!("clock[{k}]"))?;
    }
    Ok(row)
}

/// Chooses the actions of a task.
#[derive(Clone)]
pub enum Gait {
    Network(Arc<Network>),
    /// f32 [action], the same in every step.
    Held(Vec<f32>),
    Random,
}

impl Gait {
    /// All hips at `rate` [Hz].
    pub fn tripod(rate: f64, spec: &Spec) -> Self {
        Self::Held(vec![(rate / TOP_RATE) as f32; spec.action.len()])
    }

    /// An instance for the environments of a shard with these seeds.
    pub fn player(&self, seeds: &[u64]) -> Player<'_> {
        // Episodes are numbered from 0, so no episode uses this stream of random numbers.
        let random = |seed: &u64| Random::new(*seed, u64::MAX);
        Player { gait: self, random: seeds.iter().map(random).collect() }
    }
}

/// A gait that chooses actions for one shard.
pub struct Player<'a> {
    gait: &'a Gait,
    random: Vec<Random>,
}

impl Player<'_> {
    /// Fills `actions`, f32 [envs, action].
    pub fn act(&mut self, shard: &Shard, actions: &mut [f32]) -> Result<()> {
        let width = shard.actions();
        match self.gait {
            Gait::Network(network) => return network.act(&shard.rows.observations, actions),
            Gait::Held(row) => actions.chunks_exact_mut(width).for_each(|a| a.copy_from_slice(row)),
            Gait::Random => {
                for (row, random) in actions.chunks_exact_mut(width).zip(&mut self.random) {
                    row.fill_with(|| random.uniform(-1.0, 1.0) as f32);
                }
            }
        }
        Ok(())
    }
}
