//! One environment's episode, and the rows that it fills.

use super::sensors::{ActionDelay, Privileged, SensorInput, SensorMemory};
use super::task::{AnyTask, TaskState};
use crate::sand::memory::Moved;
use crate::sim::{Model, State};
use std::sync::Arc;

/// Everything that the rest of an episode, and all later episodes, depend on.
#[derive(Clone)]
pub struct Episode {
    /// The task with this environment's options and model.
    pub(super) task: Arc<dyn AnyTask>,
    pub(super) seed: u64,
    pub(super) number: u64,
    pub(super) steps: u32,
    pub(super) task_state: TaskState,
    /// The present state. Sand that was moved is stored in the engine; only in a copy of the episode is it in this state.
    pub(super) state: State,
    pub(super) last_action: Vec<f32>,
    /// What the episode's sensors remember.
    pub(super) sensed: SensorMemory,
    pub(super) delay: ActionDelay,
}

/// Data of an episode that ended, which the start of the next episode would overwrite.
pub(super) struct Ended {
    pub task_state: TaskState,
    pub steps: u32,
    pub action: Vec<f32>,
}

/// One environment of a shard.
pub(super) struct Environment {
    pub episode: Episode,
    /// Was there a reset or a restore?
    pub begun: bool,
    /// True if a reset may have changed the task's options since the engine got them.
    pub stale: bool,
    /// The state before the last step; if that step ended an episode, the final state of that episode.
    pub before: State,
    /// The sand's force on each leg in the last time step, if a sensor needs it and the engine keeps it.
    pub normal_forces: Vec<f64>,
    /// The ground's force on each foot of a robot from a file in the last time step.
    pub foot_loads: Vec<f64>,
    /// The episode before this one, if the last step ended it.
    pub ended: Option<Ended>,
}

/// The event before the observed state.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Before {
    /// A reset.
    Begin,
    /// The end of the previous episode, whose last values are in the info row.
    End,
    Step,
    Restore,
}

impl Episode {
    /// The task with the environment's options.
    pub fn task(&self) -> &Arc<dyn AnyTask> {
        &self.task
    }

    /// The model that simulates the episode.
    pub(super) fn model(&self) -> &Arc<Model> {
        self.task_state.model.as_ref().unwrap_or(self.task.model())
    }
}

impl Environment {
    /// An environment without a state.
    pub fn new(task: Arc<dyn AnyTask>) -> Self {
        let still = State::at_rest(0.0, &vec![0.0; task.model().joints()]);
        let episode = Episode {
            seed: 0,
            number: 0,
            steps: 0,
            task_state: TaskState::default(),
            state: still.clone(),
            last_action: vec![0.0; task.spec().action.len()],
            sensed: SensorMemory::default(),
            delay: ActionDelay::default(),
            task,
        };
        Self {
            episode,
            begun: false,
            stale: false,
            before: still,
            normal_forces: Vec::new(),
            foot_loads: Vec::new(),
            ended: None,
        }
    }

    /// Fills an observation row, and the sensors' part of an info row. `before`: the event before the present state;
    /// `sand`: the sand that was moved.
    pub fn observe(&mut self, before: Before, period: f64, sand: Option<&Moved>, row: &mut [f32], info: &mut [f32]) {
        let Episode { task, seed, number, steps, task_state, state, last_action, sensed, .. } = &mut self.episode;
        let Some(sensors) = task.sensing() else {
            task.observe(task_state, state, last_action, row);
            for (value, column) in row.iter_mut().zip(&task.spec().observation) {
                *value = value.clamp(column.low as f32, column.high as f32);
            }
            return;
        };
        let exact = |row: &mut [f32]| task.observe(task_state, state, last_action, row);
        let input = SensorInput {
            model: task_state.model.as_ref().unwrap_or(task.model()),
            footing: task_state.ground.as_ref().map_or(&[], |ground| &ground.footing),
            normal_forces: if before == Before::Step { &self.normal_forces } else { &[] },
            sand,
            states: [if before == Before::Step { &self.before } else { state }, state],
            at: [*seed, *number, u64::from(*steps)],
            period,
        };
        match before {
            Before::Step => sensors.sense(sensed, &input, exact, row, Privileged::Present(info)),
            Before::Begin | Before::End => {
                *sensed = SensorMemory::default();
                let privileged = if before == Before::End { Privileged::Next(info) } else { Privileged::Present(info) };
                sensors.sense(sensed, &input, exact, row, privileged);
            }
            Before::Restore => sensors.repeat(sensed, &input, exact, row, info),
        }
    }
}
