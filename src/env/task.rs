//! What a task is, and which there are.

use super::gait::HexapodGait;
use super::legs::HexapodLegs;
use super::options::{ResetOptions, TaskOptions};
use super::random::Random;
use super::rocks::{HexapodRocks, RockOptions};
use super::spec::Spec;
use crate::error::{Error, Result};
use crate::sim::engine::{Command, EngineKind};
use crate::sim::{Model, State};
use serde_json::Value;
use std::sync::Arc;

/// What an episode is about: drawn or chosen when it begins, constant until it ends.
#[derive(Clone, Debug, PartialEq)]
pub struct Goal {
    /// Commanded forward speed [m/s].
    pub speed: f64,
    /// Commanded yaw speed [rad/s].
    pub turn: f64,
    /// The setup's model with this episode's obstacles, for tasks that draw them.
    pub model: Option<Arc<Model>>,
}

/// What one environment may have been told by a reset: its own options and the model they make.
#[derive(Clone)]
pub struct Setup {
    pub options: TaskOptions,
    pub model: Arc<Model>,
}

impl Setup {
    pub fn new(options: TaskOptions) -> Result<Self> {
        let model = Arc::new(options.model()?);
        Ok(Self { options, model })
    }

    /// This setup with a reset's changes.
    pub fn changed(&self, reset: &ResetOptions) -> Result<Self> {
        Self::new(self.options.changed(reset))
    }
}

/// One control step as a task judges it.
pub struct Transition<'a> {
    pub goal: &'a Goal,
    pub before: &'a State,
    pub after: &'a State,
    /// This step's action, in [-1, 1].
    pub action: &'a [f32],
    pub previous_action: &'a [f32],
    /// Duration [s].
    pub period: f64,
    /// The state went beyond what can be computed; `after` is the last sound one.
    pub diverged: bool,
}

/// A task: pure functions from states to rows, the same for every environment of a session.
pub trait Task: Send + Sync {
    fn spec(&self) -> &Spec;

    /// First state and goal of an episode.
    fn begin(&self, setup: &Setup, random: &mut Random) -> (State, Goal);

    /// What the servos do under `action`.
    fn command(&self, action: &[f32], state: &State, command: &mut Command);

    /// Fills an observation row.
    fn observe(&self, goal: &Goal, state: &State, last_action: &[f32], row: &mut [f32]);

    /// Fills an info row (weighted reward terms first) and says whether the episode terminated.
    fn judge(&self, transition: &Transition, info: &mut [f32]) -> bool;
}

/// A task with its options: everything a session is made from.
#[derive(Clone)]
pub struct Blueprint {
    pub task: Arc<dyn Task>,
    pub engine: EngineKind,
    pub setup: Setup,
}

/// States, options and bookkeeping of an episode [bytes], and its share of the messages in flight; measured.
const EPISODE_BYTES: usize = 2_000;

/// Ids of all tasks.
pub const TASK_IDS: [&str; 3] = [HexapodGait::ID, HexapodLegs::ID, HexapodRocks::ID];

impl Blueprint {
    /// Task `id` with the keywords in `options` (a JSON object; null for defaults).
    pub fn new(id: &str, options: Value) -> Result<Self> {
        let defaults = match id {
            HexapodGait::ID => TaskOptions::default(),
            HexapodLegs::ID => TaskOptions { robot: "xplorer18".into(), leg: "flat".into(), ..Default::default() },
            HexapodRocks::ID => {
                TaskOptions { engine: EngineKind::Rapier, rocks: Some(RockOptions::default()), ..Default::default() }
            }
            _ => return Err(Error::unknown("task", id, &TASK_IDS)),
        };
        let options = defaults.with(options)?;
        if id != HexapodRocks::ID && options.rocks.is_some() {
            return Err(Error::invalid("rocks", format!("{id} has none; {} does", HexapodRocks::ID)));
        }
        let engine = options.engine;
        let setup = Setup::new(options)?;
        let task: Arc<dyn Task> = match id {
            HexapodLegs::ID => Arc::new(HexapodLegs::new(&setup)?),
            HexapodRocks::ID => Arc::new(HexapodRocks::new(&setup)?),
            _ => Arc::new(HexapodGait::new(&setup)?),
        };
        let period = 1.0 / task.spec().control_rate;
        let (dt, steps) = (setup.options.dt, period / setup.options.dt);
        if (steps - steps.round()).abs() > 1e-6 * steps {
            return Err(Error::invalid("dt", format!("{dt} does not divide the control period {period} s")));
        }
        Ok(Self { task, engine, setup })
    }

    /// Memory that one environment takes [bytes], roughly: rows twice (final observations), its episode, its robot.
    pub fn bytes_per_env(&self) -> usize {
        let spec = self.task.spec();
        let rows = 4 * (2 * spec.observation.len() + spec.info.len() + spec.action.len());
        rows + EPISODE_BYTES + self.engine.robot_bytes()
    }
}
