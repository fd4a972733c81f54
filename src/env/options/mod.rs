//! Options of a task: the keywords of `gymnasium.make`, some of which `reset(options=…)` can change.
//!
//! A task declares its options with [`options!`](crate::options!), one line each:
//!
//! ```ignore
//! options! {
//!     /// Options of HexapodTerrain.
//!     pub struct TerrainOptions {
//!         ..gait: GaitOptions = GaitOptions::default();
//!         difficulty: f64 = 1.0, [0.0, 1.0], reset, "share of the ranges in randomize, from 0 (nothing varies) to 1";
//!     }
//! }
//! ```
//!
//! `..name` includes the options of another struct, `[low, high]` are bounds (none where the type has its own), and
//! `reset` marks what a reset may change. Keywords, their help, their checks and the task's page follow from these
//! lines.

mod declare;
mod robot;
mod value;

pub use crate::sim::MemoryCount;
pub use robot::RobotName;
pub use value::{Bounded, NumberPair, OptionValue, changed};

use crate::error::{Error, Result};
use crate::sensors::Hardware;
use serde_json::{Map, Value, json};

/// One option of a task, or one key of an option that is a dictionary.
#[derive(Clone, Debug, PartialEq)]
pub struct OptionRow {
    pub name: &'static str,
    pub help: &'static str,
    /// May a reset change this option?
    pub at_reset: bool,
    /// Least and greatest value of its numbers, if they do not depend on other options.
    pub bounds: Option<[f64; 2]>,
    /// Is it a range [low, high]? A number then stands for the range of that number alone.
    pub is_range: bool,
    /// For a dictionary: its keys.
    pub keys: Vec<OptionRow>,
}

/// A struct of options; [`options!`](crate::options!) implements it.
pub trait Options: Clone + Default + PartialEq + std::fmt::Debug + Send + Sync + 'static {
    /// All options in the order of the declaration; the options of included structs come first.
    fn rows() -> Vec<OptionRow>;

    fn get(&self, name: &str) -> Option<Value>;

    /// Sets option `name`; in a dictionary, only the keys in `value` change. Returns false if there is no such option.
    fn set(&mut self, name: &str, value: &Value) -> Result<bool>;

    /// Adds the memory of the options' texts and lists.
    fn count_memory(&self, count: &mut MemoryCount);

    /// Refuses values out of bounds. In errors, `prefix` precedes each name.
    fn check_all(&self, prefix: &str) -> Result<()>;
}

/// The options of a task, together with the options that every task has.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TaskOptions<O> {
    pub task: O,
    pub hardware: Hardware,
}

/// An option that some tasks declare themselves. In every task it has the key [`DRAWN`].
const DRAWS: &str = "domain_rand";
const DRAWN: &str = "hardware";

impl<O: Options> TaskOptions<O> {
    /// Sets option [`DRAWS`]; with null, nothing is drawn.
    fn set_draws(&mut self, value: &Value) -> Result<bool> {
        let mut of_task = value.clone();
        let own = match &mut of_task {
            Value::Object(keys) => keys.remove(DRAWN),
            Value::Null => Some("".into()),
            _ => None,
        };
        match self.task.get(DRAWS) {
            Some(_) => drop(self.task.set(DRAWS, &of_task)?),
            // The task has no other keys in this option. This call refuses unknown keys and names them.
            None if !value.is_null() => drop(self.hardware.set(DRAWS, &of_task)?),
            None => (),
        }
        own.map_or(Ok(true), |own| self.hardware.set(DRAWS, &json!({ DRAWN: own })))
    }
}

impl<O: Options> Options for TaskOptions<O> {
    fn rows() -> Vec<OptionRow> {
        let (mut rows, mut own) = (O::rows(), Hardware::rows());
        if let Some(draws) = rows.iter_mut().find(|row| row.name == DRAWS) {
            own.iter().filter(|row| row.name == DRAWS).for_each(|row| draws.keys.extend(row.keys.clone()));
            own.retain(|row| row.name != DRAWS);
        }
        rows.extend(own);
        rows
    }

    fn get(&self, name: &str) -> Option<Value> {
        let mut value = self.task.get(name);
        if let (DRAWS, Some(Value::Object(keys))) = (name, &mut value) {
            keys.insert(DRAWN.into(), self.hardware.domain_rand.hardware.clone().into());
        }
        value.or_else(|| self.hardware.get(name))
    }

    fn set(&mut self, name: &str, value: &Value) -> Result<bool> {
        if name == DRAWS {
            return self.set_draws(value);
        }
        Ok(self.task.set(name, value)? || self.hardware.set(name, value)?)
    }

    fn count_memory(&self, count: &mut MemoryCount) {
        self.task.count_memory(count);
        Options::count_memory(&self.hardware, count);
    }

    fn check_all(&self, prefix: &str) -> Result<()> {
        self.task.check_all(prefix)?;
        self.hardware.check_all(prefix)
    }
}

/// The changes of an environment's options by a reset; they hold until another reset. Dictionaries change key by
/// key.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ResetOptions(Map<String, Value>);

impl ResetOptions {
    /// Keywords from a JSON object; null changes nothing. The task that gets them checks names and values, so that a
    /// keyword with null means the same as for a new environment.
    pub fn new(keywords: Value) -> Result<Self> {
        object(keywords).map(Self)
    }

    pub fn keywords(&self) -> &Map<String, Value> {
        &self.0
    }
}

/// Keywords as a JSON object; null if there are none.
pub fn object(keywords: Value) -> Result<Map<String, Value>> {
    match keywords {
        Value::Object(keywords) => Ok(keywords),
        Value::Null => Ok(Map::new()),
        _ => Err(Error::invalid("options", "not an object of keywords")),
    }
}
