//! The list of tasks, and how an id and options become a session's environments.
//!
//! A task is one file and one row here: each option, reward term and figure is declared in one line of its file, from which
//! keywords, help, checks, resets and pages follow. A version of a task is a parameter of its type and a row of its own:
//! HexapodLegs-v1 is older than the joint limits, so it removes the ranges after the robot is built, and its results stay the
//! same to the bit.

use super::gait::HexapodGait;
use super::legged::LeggedVelocity;
use super::legs::HexapodLegs;
use super::options::{self, OptionRow, Options, ResetOptions, TaskOptions};
use super::rocks::HexapodRocks;
use super::sensors::Motors;
use super::setup::TaskSetup;
use super::stroke::LegStroke;
use super::task::{AnyTask, Task};
use super::terrain::HexapodTerrain;
use crate::error::{Error, Result};
use crate::sim::engine::EngineKind;
use crate::sim::{MemoryCount, resident};
use serde_json::Value;
use std::sync::Arc;

/// All tasks, one row each. A later version of a task comes after the earlier version. Everything else about a task is
/// in its own file.
const KINDS: [TaskKind; 7] = [
    TaskKind::of::<HexapodGait>(),
    TaskKind::of::<HexapodLegs<false>>(),
    TaskKind::of::<HexapodLegs<true>>(),
    TaskKind::of::<HexapodRocks>(),
    TaskKind::of::<HexapodTerrain>(),
    TaskKind::of::<LegStroke>(),
    TaskKind::of::<LeggedVelocity>(),
];

/// A task without its options.
struct TaskKind {
    id: &'static str,
    rows: fn() -> Vec<OptionRow>,
    make: fn(Value) -> Result<Blueprint>,
}

impl TaskKind {
    const fn of<T: Task>() -> Self {
        Self { id: T::ID, rows: TaskOptions::<T::Options>::rows, make: Blueprint::of::<T> }
    }
}

/// Ids of all tasks.
pub const TASK_IDS: [&str; KINDS.len()] = {
    let mut ids = [""; KINDS.len()];
    let mut i = 0;
    while i < ids.len() {
        ids[i] = KINDS[i].id;
        i += 1;
    }
    ids
};

/// The id of the task that a user calls `name`. A user may leave out `sandgait/`, and also the version, which then is the latest. Any
/// other name is returned unchanged.
pub fn task_id(name: &str) -> &str {
    let bare = |id: &'static str| id.trim_start_matches("sandgait/");
    let called = name.strip_prefix("sandgait/").unwrap_or(name);
    let means = |id: &&'static str| bare(id) == called || bare(id).split("-v").next() == Some(called);
    TASK_IDS.into_iter().rev().find(means).unwrap_or(name)
}

/// One keyword of a task, for tables.
pub struct Keyword {
    pub name: &'static str,
    pub help: &'static str,
    /// The help; for a dictionary, also the help of its keys.
    pub summary: String,
    /// The option's value in this session.
    pub value: Value,
    /// May a reset change this option?
    pub at_reset: bool,
    /// See [`OptionRow::bounds`].
    pub bounds: Option<[f64; 2]>,
    /// For a dictionary: its keys.
    pub keys: Vec<OptionRow>,
}

/// Names of all options that a reset of some task can change.
pub fn reset_names() -> Vec<&'static str> {
    let mut names = Vec::new();
    for row in KINDS.iter().flat_map(|kind| (kind.rows)()).filter(|row| row.at_reset) {
        if !names.contains(&row.name) {
            names.push(row.name);
        }
    }
    names
}

/// Ids of the tasks that have option `name`.
pub fn tasks_with(name: &str) -> Vec<&'static str> {
    let having = KINDS.iter().filter(|kind| (kind.rows)().iter().any(|row| row.name == name));
    having.map(|kind| kind.id).collect()
}

/// Refuses keyword `name` of task `id` if it is not in the task's `rows`; names the tasks that have it.
fn check_keyword(id: &str, rows: &[OptionRow], name: &str) -> Result<()> {
    if rows.iter().any(|row| row.name == name) {
        return Ok(());
    }
    let others = tasks_with(name);
    if others.is_empty() {
        let known: Vec<_> = rows.iter().map(|row| row.name).collect();
        return Err(Error::unknown("option", name, &known));
    }
    let have = if others.len() == 1 { "has" } else { "have" };
    Err(Error::invalid(name, format!("{id} has no such option; {} {have}", others.join(", "))))
}

/// The error for an unknown task `id`: an earlier version of a task, or an unknown name.
pub fn no_task(id: &str) -> Error {
    let version = |id: &str| id.rsplit_once("-v").and_then(|(name, v)| Some((name.to_owned(), v.parse::<u32>().ok()?)));
    let earlier = |new: &&&str| match (version(id), version(new)) {
        (Some((old, v)), Some((name, w))) => old == name && v < w,
        _ => false,
    };
    match TASK_IDS.iter().rev().find(earlier) {
        Some(new) => Error::Replaced { what: "task", name: id.into(), new: (*new).into() },
        None => Error::unknown("task", id, &TASK_IDS),
    }
}

/// A task with its options: it determines a session.
#[derive(Clone)]
pub struct Blueprint {
    pub task: Arc<dyn AnyTask>,
    pub engine: EngineKind,
}

impl Blueprint {
    /// Task `id` with the keywords in `options` (a JSON object; null for defaults).
    pub fn new(id: &str, options: Value) -> Result<Self> {
        let kind = KINDS.iter().find(|kind| kind.id == id).ok_or_else(|| no_task(id))?;
        (kind.make)(options)
    }

    /// Task `T` with these keywords; `T` need not be in the registry.
    pub fn of<T: Task>(keywords: Value) -> Result<Self> {
        let (rows, keywords) = (TaskOptions::<T::Options>::rows(), options::object(keywords)?);
        keywords.keys().try_for_each(|name| check_keyword(T::ID, &rows, name))?;
        let mut options = TaskOptions::<T::Options>::default();
        for (name, value) in &keywords {
            options.set(name, value)?;
        }
        let engine = T::engine(&options.task);
        if engine == EngineKind::Carriage && options.hardware.actuator != Motors::default() {
            return Err(Error::invalid(
                "actuator",
                format!("{} drives joints by their speeds and has no motors", T::ID),
            ));
        }
        if keywords.contains_key("engine") && !keywords.contains_key("dt") {
            options.set("dt", &engine.default_dt().into())?;
        }
        let task: Arc<dyn AnyTask> = Arc::new(TaskSetup::<T>::new(options, check_keyword)?);
        let (dt, period) = (task.model().scene.dt, 1.0 / task.spec().control_rate);
        let steps = period / dt;
        // Our choice of the tolerance: a time step may be rounded to seven digits.
        if (steps - steps.round()).abs() > 1e-6 * steps {
            return Err(Error::invalid("dt", format!("{dt} does not divide the control period {period} s")));
        }
        Ok(Self { task, engine })
    }

    /// See [`AnyTask::changed`].
    pub fn changed(&self, reset: &ResetOptions) -> Result<Self> {
        Ok(Self { task: self.task.changed(reset)?, ..*self })
    }

    /// Warnings about mechanisms of a sand.toml that have no effect on robots, with the reason.
    pub fn warnings(&self) -> Vec<String> {
        self.task.model().scene.mechanisms.unfelt_by_walkers()
    }

    /// The keywords of this task, with their values here.
    pub fn keywords(&self) -> Vec<Keyword> {
        let keyword = |row: OptionRow| {
            let OptionRow { name, help, at_reset, bounds, keys, .. } = row;
            let keys_help: Vec<_> = keys.iter().map(|key| format!("{}: {}", key.name, key.help)).collect();
            let summary = if keys.is_empty() { help.into() } else { format!("{help}. {}", keys_help.join("; ")) };
            Keyword { name, help, summary, value: self.task.option(name), at_reset, bounds, keys }
        };
        self.task.rows().into_iter().map(keyword).collect()
    }

    /// Estimated memory of `envs` environments with these options [bytes].
    pub fn bytes(&self, envs: usize) -> usize {
        resident(self.shared_bytes()) + envs * self.task.bytes_per_env()
    }

    /// See [`AnyTask::bytes_per_env`].
    pub fn bytes_per_env(&self) -> usize {
        self.task.bytes_per_env()
    }

    /// Memory that environments with these options share [bytes]; see [`AnyTask::count_memory`].
    pub fn shared_bytes(&self) -> usize {
        let mut count = MemoryCount::default();
        self.task.count_memory(&mut count);
        count.bytes()
    }
}
