//! What a task is.

use super::ground::{Change, Ground};
use super::legged::LeggedEpisode;
use super::options::keywords::Keywords;
use super::options::{ResetOptions, TaskOptions};
use super::random::Random;
use super::spec::Spec;
use crate::error::Result;
use crate::sim::engine::Command;
use crate::sim::{Model, State};
use std::sync::Arc;

/// What an episode is about: drawn or chosen when it begins, and changed by [`Task::walked`] alone.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Goal {
    /// Commanded forward speed [m/s].
    pub speed: f64,
    /// Commanded yaw speed [rad/s].
    pub turn: f64,
    /// The setup's model with what this episode drew, for tasks that draw some of it.
    pub model: Option<Arc<Model>>,
    /// Ground that changes along the way and remembers, for the task that has it.
    pub ground: Option<Ground>,
    /// What an episode of LeggedVelocity drew and remembers.
    pub legged: Option<LeggedEpisode>,
}

/// What one environment may have been told by a reset: its own options and the model they make.
#[derive(Clone)]
pub struct Setup {
    keywords: &'static Keywords,
    pub options: TaskOptions,
    pub model: Arc<Model>,
}

impl Setup {
    /// `keywords`: what the task takes.
    pub fn new(keywords: &'static Keywords, options: TaskOptions) -> Result<Self> {
        let model = Arc::new(options.model()?);
        Ok(Self { keywords, options, model })
    }

    pub fn keywords(&self) -> &'static Keywords {
        self.keywords
    }

    /// The same number for all copies of a setup, another for every other setup that is alive: its model is made with it.
    pub fn id(&self) -> usize {
        Arc::as_ptr(&self.model).addr()
    }

    /// The same task with all of `options`.
    pub fn with(&self, options: TaskOptions) -> Result<Self> {
        Self::new(self.keywords, options)
    }

    /// This setup with a reset's changes.
    pub fn changed(&self, reset: &ResetOptions) -> Result<Self> {
        reset.given().iter().try_for_each(|name| self.keywords.check(name))?;
        self.with(self.options.changed(reset)?)
    }
}

/// One control step as a task judges it.
pub struct Transition<'a> {
    pub options: &'a TaskOptions,
    /// What the episode is simulated with.
    pub model: &'a Model,
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

    /// Takes note of where a step has led, after it was judged; says what the engine must be told.
    fn walked(&self, _setup: &Setup, _goal: &mut Goal, _state: &State) -> Change {
        Change::Nothing
    }

    /// Fills an observation row.
    fn observe(&self, goal: &Goal, state: &State, last_action: &[f32], row: &mut [f32]);

    /// Fills an info row (weighted reward terms first) and says whether the episode terminated.
    fn judge(&self, transition: &Transition, info: &mut [f32]) -> bool;
}
