//! The definition of a task by its author ([`Task`]), and the form in which environments hold it ([`AnyTask`]).

use super::ground::{Change, UsedGround};
use super::legged::draws::MOST_COMMAND;
use super::legged::episode::LeggedEpisode;
use super::options::{OptionRow, Options, ResetOptions, TaskOptions};
use super::random::Random;
use super::sensors::{self, HardwareFiles, SensorModel};
use super::spec::Spec;
use crate::error::{Error, Result, check_range};
use crate::sim::engine::{Command, EngineKind};
use crate::sim::{Model, State};
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

    /// Memory of an episode's state, options and bookkeeping [bytes], and its share of the messages in flight;
    /// measured.
    const EPISODE_BYTES: usize = 2_000;
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

    /// Does each episode have motors of its own?
    fn draws_motors(&self) -> bool;

    /// Range of the delay of actions [s].
    fn action_delay(&self) -> [f64; 2];

    fn most_obstacles(&self) -> usize;
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

/// Refuses a keyword that is not an option of the task with this id.
pub(super) type CheckKeyword = fn(&str, &[OptionRow], &str) -> Result<()>;

/// [`AnyTask`] of one type of task.
pub(super) struct TaskSetup<T: Task> {
    check_keyword: CheckKeyword,
    task: Arc<T>,
    options: TaskOptions<T::Options>,
    model: Arc<Model>,
    /// The task's spec, with the columns of sensors.
    spec: Spec,
    hardware: HardwareFiles,
    sensing: Option<SensorModel>,
}

impl<T: Task> TaskSetup<T> {
    /// `options` are checked here.
    pub fn new(options: TaskOptions<T::Options>, check_keyword: CheckKeyword) -> Result<Self> {
        options.check_all("")?;
        let hardware = HardwareFiles::new(&options.hardware)?;
        let motors = sensors::motors(options.hardware.actuator, &hardware.values());
        let model = T::model(&options.task)?.with_motors(&motors.into())?;
        Self::with(options, hardware, Arc::new(model), check_keyword)
    }

    fn with(
        options: TaskOptions<T::Options>,
        hardware: HardwareFiles,
        model: Arc<Model>,
        check_keyword: CheckKeyword,
    ) -> Result<Self> {
        let task = Arc::new(T::new(&Setup { options: &options.task, model: &model })?);
        let mut spec = task.spec().clone();
        let sensing = SensorModel::new(&options.hardware, &hardware, &model, &mut spec)?;
        Ok(Self { check_keyword, task, options, model, spec, hardware, sensing })
    }

    fn setup(&self) -> Setup<'_, T::Options> {
        Setup { options: &self.options.task, model: &self.model }
    }

    /// The task's own part of an info row.
    fn own<'a>(&self, info: &'a [f32]) -> &'a [f32] {
        &info[..self.task.spec().info.len()]
    }
}

impl<T: Task> AnyTask for TaskSetup<T> {
    fn spec(&self) -> &Spec {
        &self.spec
    }

    fn model(&self) -> &Arc<Model> {
        &self.model
    }

    fn begin(&self, last: Option<&TaskState>, random: &mut Random) -> (State, TaskState) {
        match last {
            Some(last) => self.task.begin_after(&self.setup(), last, random),
            None => self.task.begin(&self.setup(), random),
        }
    }

    fn command(&self, action: &[f32], state: &State, command: &mut Command) {
        self.task.command(action, state, command);
    }

    fn after_step(&self, task_state: &mut TaskState, state: &State, info: &[f32]) -> Change {
        self.task.after_step(&self.setup(), task_state, state, self.own(info))
    }

    fn observe(&self, task_state: &TaskState, state: &State, last_action: &[f32], row: &mut [f32]) {
        self.task.observe(task_state, state, last_action, row);
    }

    fn evaluate(&self, transition: &Transition, info: &mut [f32]) -> bool {
        self.task.evaluate(&self.setup(), transition, &mut info[..self.task.spec().info.len()])
    }

    fn sensing(&self) -> Option<&SensorModel> {
        self.sensing.as_ref()
    }

    fn draw_motors(&self, task_state: &mut TaskState, seed: u64, number: u64) {
        if !self.hardware.is_random() {
            return;
        }
        let motors = sensors::motors(self.options.hardware.actuator, &self.hardware.of_episode(seed, number));
        let model = task_state.model.as_ref().unwrap_or(&self.model);
        // The ends of the intervals were checked, so this cannot fail for the values between them.
        if let Ok(model) = Model::clone(model).with_motors(&motors.into()) {
            task_state.model = Some(Arc::new(model));
        }
    }

    fn draws_motors(&self) -> bool {
        self.hardware.is_random()
    }

    fn action_delay(&self) -> [f64; 2] {
        self.hardware.action_delay(self.options.hardware.action_delay)
    }

    fn most_obstacles(&self) -> usize {
        T::most_obstacles(&self.options.task)
    }

    fn resume(&self, task_state: &mut TaskState) -> std::result::Result<(), String> {
        match T::resume(&self.setup(), task_state) {
            // If the task itself draws no model, the model in the state is the session's model with drawn motors;
            // `draw_motors` makes it again.
            Err(_) if self.hardware.is_random() && task_state.model.take().is_some() => {
                T::resume(&self.setup(), task_state)
            }
            result => result,
        }
    }

    fn command_ranges(&self) -> Option<[[f64; 2]; 3]> {
        self.task.command_ranges(&self.setup())
    }

    fn check_command(&self, name: &str, command: [f64; 3]) -> Result<()> {
        if self.command_ranges().is_none() {
            return Err(Error::invalid(name, format!("{} has no commands", T::ID)));
        }
        for value in command {
            check_range(name, value, -MOST_COMMAND..=MOST_COMMAND)?;
        }
        match command[1] == 0.0 || T::SIDEWAYS {
            true => Ok(()),
            false => {
                Err(Error::invalid(name, format!("{} has no command to the left; the second number must be 0", T::ID)))
            }
        }
    }

    fn set_command(&self, task_state: &mut TaskState, command: [f64; 3]) {
        self.task.set_command(task_state, command);
    }

    fn rows(&self) -> Vec<OptionRow> {
        TaskOptions::<T::Options>::rows()
    }

    fn option(&self, name: &str) -> Value {
        self.options.get(name).unwrap_or_default()
    }

    fn changed(&self, reset: &ResetOptions) -> Result<Arc<dyn AnyTask>> {
        let rows = TaskOptions::<T::Options>::rows();
        let mut options = self.options.clone();
        for (name, value) in reset.keywords() {
            (self.check_keyword)(T::ID, &rows, name)?;
            if !rows.iter().any(|row| row.name == name && row.at_reset) {
                let can: Vec<_> = rows.iter().filter(|row| row.at_reset).map(|row| row.name).collect();
                return Err(Error::invalid(name, format!("no reset changes it; resets change: {}", can.join(", "))));
            }
            options.set(name, value)?;
        }
        let changed = Self::new(options, self.check_keyword)?;
        T::check_change(&self.model, &changed.model)?;
        Ok(Arc::new(changed))
    }
}
