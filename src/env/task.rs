//! The definition of a task by its author ([`Task`]), and the form in which environments hold it ([`AnyTask`]).

use super::ground::{Change, UsedGround};
use super::legged::episode::LeggedEpisode;
use super::options::{OptionRow, Options, ResetOptions};
use super::random::Random;
use super::sensors::SensorModel;
use super::spec::Spec;
use crate::error::Result;
use crate::sim::engine::{Command, EngineKind};
use crate::sim::{MemoryCount, Model, State};
use serde_json::{Map, Value};
use std::sync::Arc;

/// What a task knows of an episode besides the robot's state: commands, drawn model, ground, level of the curriculum.
/// It is drawn or chosen when the episode begins, and then changed by [`Task::after_step`] and [`Task::set_command`]
/// alone.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TaskState {
    /// Commanded forward speed [m/s].
    pub speed: f64,
    /// Commanded yaw speed [rad/s].
    pub turn: f64,
    /// The setup's model with this episode's drawn values, for tasks that draw some.
    pub model: Option<Arc<Model>>,
    /// Ground with patches and footprints, for HexapodTerrain.
    pub ground: Option<UsedGround>,
    /// The drawn and updated values of an episode of LeggedVelocity.
    pub legged: Option<LeggedEpisode>,
}

/// An environment's options, and the model built from them.
pub struct Setup<'a, O> {
    pub options: &'a O,
    pub model: &'a Arc<Model>,
}

impl<'a, O> Setup<'a, O> {
    /// The same setup with the options of another task on which this task is built.
    pub fn with<P>(&self, options: &'a P) -> Setup<'a, P> {
        Setup { options, model: self.model }
    }
}

/// One control step.
pub struct Transition<'a> {
    /// The model that simulates the episode.
    pub model: &'a Model,
    pub task_state: &'a TaskState,
    pub before: &'a State,
    pub after: &'a State,
    /// The ground's force on each foot of a robot from a file, along the surface's normal at the end of the step [N].
    pub foot_loads: &'a [f64],
    /// This step's action, in [-1, 1].
    pub action: &'a [f32],
    pub previous_action: &'a [f32],
    /// Duration [s].
    pub period: f64,
    /// The state became too large to compute; `after` is the last valid state.
    pub diverged: bool,
}

/// A task: pure functions from states to rows, the same for every environment of a session.
pub trait Task: Send + Sync + Sized + 'static {
    /// For example `sandgait/HexapodGait-v1`.
    const ID: &'static str;

    /// Does the task command velocities to the left?
    const SIDEWAYS: bool = false;

    type Options: Options;

    /// The engine that these options select.
    fn engine(options: &Self::Options) -> EngineKind;

    /// Checks that involve more than one option; then builds robot, sand and slope.
    fn model(options: &Self::Options) -> Result<Model>;

    fn new(setup: &Setup<Self::Options>) -> Result<Self>;

    fn spec(&self) -> &Spec;

    /// First state of the robot, and of the task, in an episode.
    fn begin(&self, setup: &Setup<Self::Options>, random: &mut Random) -> (State, TaskState);

    /// First states of robot and task in an episode that is not the environment's first; `last`: the state of the task
    /// at the end of the previous episode.
    fn begin_after(&self, setup: &Setup<Self::Options>, _last: &TaskState, random: &mut Random) -> (State, TaskState) {
        self.begin(setup, random)
    }

    /// The servos' command under `action`.
    fn command(&self, action: &[f32], state: &State, command: &mut Command);

    /// Updates the task's state after the step was evaluated; returns the changes for the engine. `info` is the step's row.
    fn after_step(
        &self,
        _setup: &Setup<Self::Options>,
        _goal: &mut TaskState,
        _state: &State,
        _info: &[f32],
    ) -> Change {
        Change::Nothing
    }

    /// The ranges [low, high] of commanded speeds forward, to the left [m/s] and yaw [rad/s]; None: the task has no commands.
    fn command_ranges(&self, _setup: &Setup<Self::Options>) -> Option<[[f64; 2]; 3]> {
        None
    }

    /// Replaces the command of the rest of the episode: forward, to the left [m/s], yaw [rad/s].
    fn set_command(&self, task_state: &mut TaskState, command: [f64; 3]) {
        [task_state.speed, _, task_state.turn] = command;
    }

    /// Fills an observation row.
    fn observe(&self, task_state: &TaskState, state: &State, last_action: &[f32], row: &mut [f32]);

    /// Fills an info row (weighted reward terms first) and says whether the episode terminated.
    fn evaluate(&self, setup: &Setup<Self::Options>, transition: &Transition, info: &mut [f32]) -> bool;

    /// Largest number of obstacles in an episode's model.
    fn most_obstacles(_options: &Self::Options) -> usize {
        0
    }

    /// Largest memory of the model that an episode draws [bytes]; 0: episodes draw none.
    fn drawn_bytes(_setup: &Setup<Self::Options>) -> usize {
        0
    }

    /// Largest memory of an episode's own lists [bytes], such as its commands.
    fn list_bytes(_setup: &Setup<Self::Options>) -> usize {
        0
    }

    /// Refuses a reset after which the model would not fit the environments' engine and rows.
    fn check_change(_old: &Model, _new: &Model) -> Result<()> {
        Ok(())
    }

    /// Checks the task's state in a snapshot, and rebuilds the parts that snapshots leave out. The error says which part is
    /// wrong.
    fn resume(_setup: &Setup<Self::Options>, task_state: &mut TaskState) -> std::result::Result<(), String> {
        match task_state {
            TaskState { model: None, ground: None, legged: None, .. } => Ok(()),
            _ => Err("its robot and sand".into()),
        }
    }
}

/// A task together with an environment's options and model: all data of an environment except its engine and state.
pub trait AnyTask: Send + Sync {
    fn spec(&self) -> &Spec;
    fn model(&self) -> &Arc<Model>;
    /// First states of robot and task in an episode. `last`: the state of the task at the end of the previous episode;
    /// None: this is the environment's first episode.
    fn begin(&self, last: Option<&TaskState>, random: &mut Random) -> (State, TaskState);
    fn command(&self, action: &[f32], state: &State, command: &mut Command);
    fn after_step(&self, task_state: &mut TaskState, state: &State, info: &[f32]) -> Change;
    /// Fills a row of the task's own exact values.
    fn observe(&self, task_state: &TaskState, state: &State, last_action: &[f32], row: &mut [f32]);
    fn evaluate(&self, transition: &Transition, info: &mut [f32]) -> bool;

    /// How observations follow from exact values; None: observations are the exact values.
    fn sensing(&self) -> Option<&SensorModel>;

    /// Draws the motors of an episode, if they are random.
    fn draw_motors(&self, task_state: &mut TaskState, seed: u64, number: u64);

    /// Range of the delay of actions [s].
    fn action_delay(&self) -> [f64; 2];

    fn most_obstacles(&self) -> usize;

    /// Adds the memory that environments with these options share: the model, the options with their texts, and the
    /// names of all columns. Parts that tasks with other options share count once.
    fn count_memory(&self, count: &mut MemoryCount);

    /// Largest resident memory of one environment [bytes], besides what it shares: its rows with the final observation
    /// and its part of an answer, its robot in the engine, its episode, and a second one: the copy with its sand that a
    /// rollout, a restore or a step makes, or the episode that has just ended.
    fn bytes_per_env(&self) -> usize;

    fn resume(&self, task_state: &mut TaskState) -> std::result::Result<(), String>;
    /// See [`Task::command_ranges`].
    fn command_ranges(&self) -> Option<[[f64; 2]; 3]>;
    /// Checks a command for [`Task::set_command`]; `name` names it.
    ///
    /// # Errors
    /// The task has no such commands, or a number is outside of the bounds that observations have.
    fn check_command(&self, name: &str, command: [f64; 3]) -> Result<()>;
    /// See [`Task::set_command`].
    fn set_command(&self, task_state: &mut TaskState, command: [f64; 3]);

    /// The declarations of all options.
    fn rows(&self) -> Vec<OptionRow>;

    /// The value of option `name`; null if there is none.
    fn option(&self, name: &str) -> Value;

    /// The same task after a reset's changes.
    fn changed(&self, reset: &ResetOptions) -> Result<Arc<dyn AnyTask>>;

    /// An id that copies of a setup share, and that differs from the ids of all other live setups, because each setup
    /// makes its own model.
    fn id(&self) -> usize {
        Arc::as_ptr(self.model()).addr()
    }

    /// Every option's value by name.
    fn options(&self) -> Map<String, Value> {
        self.rows().iter().map(|row| (row.name.to_owned(), self.option(row.name))).collect()
    }

    /// The changes with which a reset would set the options to `all`, as returned by [`AnyTask::options`]; None if no
    /// reset can.
    fn reset_to(&self, mut all: Map<String, Value>) -> Option<ResetOptions> {
        let rows = self.rows();
        if rows.len() != all.len() {
            return None;
        }
        for row in rows {
            let value = all.get(row.name)?;
            if *value == self.option(row.name) {
                all.remove(row.name);
            } else if !row.at_reset {
                return None;
            }
        }
        ResetOptions::new(Value::Object(all)).ok()
    }
}
