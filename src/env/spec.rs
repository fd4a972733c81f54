//! Tables of the meaning of every number in a row.

use super::sensors::{Part, Sensor};
use crate::error::{Error, Result, short};

/// Control steps in a second [Hz], in every task: our choice, as in legged_gym (`decimation` 4, `dt` 5 ms).
pub const CONTROL_RATE: f64 = 50.0;

/// One number of an observation, action or info row.
#[derive(Clone, Debug, PartialEq)]
pub struct Column {
    pub name: String,
    /// SI unit; "1" if dimensionless.
    pub unit: &'static str,
    pub low: f64,
    pub high: f64,
    /// The sensor that measures this number, and the function of the measured value that this column has; None: no sensor measures it.
    pub sensor: Option<(Sensor, Part)>,
}

impl Column {
    pub fn new(name: impl Into<String>, unit: &'static str, low: f64, high: f64) -> Self {
        Self { name: name.into(), unit, low, high, sensor: None }
    }

    /// Memory of a list of columns with their names [bytes].
    pub fn list_bytes(columns: &[Self]) -> usize {
        size_of_val(columns) + columns.iter().map(|column| column.name.len()).sum::<usize>()
    }

    /// Refuses a value beyond the bounds, or NaN; `field` names it.
    pub fn check(&self, value: f32, field: impl FnOnce() -> String) -> Result<()> {
        if (self.low..=self.high).contains(&f64::from(value)) {
            return Ok(());
        }
        let [low, high] = [self.low, self.high].map(short);
        let value = if value.abs() < 1e15 { value.to_string() } else { format!("{value:e}") };
        let reason = format!("{value} ({}) is outside [{low}, {high}]", self.name);
        Err(Error::invalid(field(), reason))
    }

    /// A column without bounds.
    pub fn free(name: impl Into<String>, unit: &'static str) -> Self {
        Self::new(name, unit, f64::NEG_INFINITY, f64::INFINITY)
    }

    /// The columns of a reward's terms in an info row.
    pub fn rewards(terms: &[RewardTerm]) -> Vec<Self> {
        terms.iter().map(|term| Self::free(format!("reward_{}", term.name), "1")).collect()
    }

    /// One column for each axis.
    pub fn xyz(name: &str, unit: &'static str, bound: f64) -> Vec<Self> {
        ["x", "y", "z"].iter().map(|axis| Self::new(format!("{name} {axis}"), unit, -bound, bound)).collect()
    }

    /// One column for each joint.
    pub fn each(joints: &[String], name: &str, unit: &'static str, bound: f64) -> Vec<Self> {
        joints.iter().map(|joint| Self::new(format!("{name}, {joint}"), unit, -bound, bound)).collect()
    }
}

/// One term of the reward.
#[derive(Clone, Debug, PartialEq)]
pub struct RewardTerm {
    pub name: &'static str,
    /// Description of the term without its weight.
    pub law: &'static str,
    /// Factor of the term in the reward.
    pub weight: f64,
}

/// All facts about a task's rows that do not change while it runs.
#[derive(Clone, Debug, PartialEq)]
pub struct Spec {
    /// For example `sandgait/HexapodGait-v1`.
    pub id: &'static str,
    pub summary: String,
    /// Text of the task's page, in Markdown: what an episode is, how it ends, and what its figures are useful for.
    pub about: &'static str,
    pub observation: Vec<Column>,
    pub action: Vec<Column>,
    /// Reward terms, weighted, then other figures of the step.
    pub info: Vec<Column>,
    /// The terms of the reward, in the order of the first info columns; the reward is the sum of these columns.
    pub reward: Vec<RewardTerm>,
    pub max_episode_steps: u32,
    /// Control steps in a second of simulated time [Hz].
    pub control_rate: f64,
}

impl Spec {
    /// Memory of the tables with their texts [bytes].
    pub fn memory_bytes(&self) -> usize {
        let tables = [&self.observation, &self.action, &self.info].map(|table| Column::list_bytes(table));
        size_of::<Self>() + self.summary.len() + tables.iter().sum::<usize>() + size_of_val(&self.reward[..])
    }
}
