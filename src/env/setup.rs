//! A task with an environment's options and model.

use super::ground::Change;
use super::legged::draws::MOST_COMMAND;
use super::options::{OptionRow, Options, ResetOptions, TaskOptions};
use super::random::Random;
use super::sensors::{self, HardwareFiles, SensorModel};
use super::spec::Spec;
use super::task::{AnyTask, Setup, Task, TaskState, Transition};
use crate::error::{Error, Result, check_range};
use crate::sim::engine::Command;
use crate::sim::{MemoryCount, Model, State, resident};
use serde_json::Value;
use std::sync::Arc;

/// Refuses a keyword that is not an option of the task with this id.
pub(super) type CheckKeyword = fn(&str, &[OptionRow], &str) -> Result<()>;

/// Memory of an environment with two states, its episode's numbers and a copy of them [bytes]; counted by
/// `tests/prices.rs`.
const ENVIRONMENT: usize = 3_000;

/// [`AnyTask`] of one type of task.
pub(super) struct TaskSetup<T: Task> {
    check_keyword: CheckKeyword,
    task: Arc<T>,
    options: TaskOptions<T::Options>,
    model: Arc<Model>,
    /// The task's spec, with the columns of sensors.
    spec: Arc<Spec>,
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
        Ok(Self { check_keyword, task, options, model, spec: Arc::new(spec), hardware, sensing })
    }

    /// Shares the columns of `other` if they are the same: thousands of environments may have options of their own.
    fn share_columns(&mut self, other: &Self) {
        if self.spec == other.spec {
            self.spec = other.spec.clone();
        }
        if let (Some(own), Some(other)) = (&mut self.sensing, &other.sensing) {
            own.share_columns(other);
        }
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

    fn action_delay(&self) -> [f64; 2] {
        self.hardware.action_delay(self.options.hardware.action_delay)
    }

    fn most_obstacles(&self) -> usize {
        T::most_obstacles(&self.options.task)
    }

    fn count_memory(&self, count: &mut MemoryCount) {
        // The task has its own columns twice: in its spec, and with the functions that compute them.
        count.add(size_of::<Self>() + size_of::<T>() + 2 * self.task.spec().memory_bytes());
        count.add(self.hardware.memory_bytes());
        self.model.count_memory(count);
        self.options.count_memory(count);
        count.add_shared(&self.spec, Spec::memory_bytes);
        if let Some(sensing) = &self.sensing {
            sensing.count_memory(count);
        }
    }

    fn bytes_per_env(&self) -> usize {
        let (spec, model, setup) = (&self.spec, &self.model, self.setup());
        let rows = 4 * (3 * spec.observation.len() + spec.info.len() + spec.action.len());
        let sensed = self.sensing.as_ref().map_or(0, SensorModel::episode_bytes);
        let drawn = match T::drawn_bytes(&setup) {
            0 if self.hardware.is_random() => model.episode_bytes(),
            bytes => bytes,
        };
        let robot = model.engine_bytes(T::engine(&self.options.task), self.most_obstacles());
        let episodes = ENVIRONMENT + 2 * (sensed + T::list_bytes(&setup) + drawn);
        resident(rows + episodes + robot) + 2 * model.sand_bytes()
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
        let mut changed = Self::new(options, self.check_keyword)?;
        changed.share_columns(self);
        T::check_change(&self.model, &changed.model)?;
        Ok(Arc::new(changed))
    }
}
