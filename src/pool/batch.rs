//! All environments of one session, cut into shards.
//!
//! A request is checked completely before it changes anything. The refusal is a message in the stream, so the session goes on.

use super::operation::{ActionSource, Operation, Roll};
use crate::env::registry::Blueprint;
use crate::env::{AnyTask, EnvView, ResetOptions, Shard, Spec};
use crate::error::{Error, Result, check_range};
use crate::policy::Network;
use crate::sim::{MemoryCount, resident};
use std::collections::HashMap;
use std::sync::Arc;
use std::time::Duration;

/// A function that is called with the memory [bytes] that a request needs, before the request takes it. An error
/// refuses the request.
pub type Account = Arc<dyn Fn(usize) -> Result<()> + Send + Sync>;

/// Checks the number of environments of a batch: it is from 1 to `most`.
///
/// # Errors
/// The number is outside this range. Too many environments give [`Error::Exhausted`], because the caller may ask
/// another server.
pub fn check_envs(envs: usize, most: usize) -> Result<usize> {
    let range = format!("{envs} is outside [1, {most}]");
    match envs {
        0 => Err(Error::invalid("num_envs", range)),
        _ if envs > most => Err(Error::Exhausted(format!("num_envs: {range}"))),
        _ => Ok(envs),
    }
}

/// The environments of one session. `Pool::run` takes a batch and gives it back.
pub struct Batch {
    pub(super) shards: Vec<Shard>,
    task: Arc<dyn AnyTask>,
    envs: usize,
    account: Option<Account>,
    pub(super) stop: Option<Stop>,
    stopped: bool,
    /// Least time of an operation of each kind with the present options: other programs can only lengthen it.
    spent: [Option<Duration>; Operation::KINDS],
    begun: Vec<bool>,
}

/// A function that says whether nobody waits for an operation any more.
pub type Stop = Arc<dyn Fn() -> bool + Send + Sync>;

/// An operation that takes at least this for each environment can be undone: our choice, a hundred times what the copy
/// of an episode takes. A step of engine `lanes` or `tree` takes a tenth of this.
const DEAR: Duration = Duration::from_micros(100);

/// Memory [bytes] of the rows of one part of a rollout, unless one step needs more: our choice, the rows of some 2,700
/// steps of one environment of HexapodGait.
const PART: usize = 1 << 19;

impl Batch {
    /// `envs` environments of `blueprint`, which need a first reset.
    pub(super) fn of(blueprint: &Blueprint, shards: Vec<Shard>) -> Self {
        let envs = shards.iter().map(Shard::envs).sum();
        Self {
            shards,
            task: blueprint.task.clone(),
            envs,
            account: None,
            stop: None,
            stopped: false,
            spent: Default::default(),
            begun: vec![false; envs],
        }
    }

    pub fn envs(&self) -> usize {
        self.envs
    }

    /// Does every environment still need its first reset?
    pub fn is_untouched(&self) -> bool {
        !self.begun.contains(&true)
    }

    pub fn spec(&self) -> &Spec {
        self.task.spec()
    }

    /// From now on `account` must allow the memory of models and snapshots; with None, this memory is not limited.
    pub fn set_account(&mut self, account: Option<Account>) {
        self.account = account;
    }

    pub(super) fn charge(&self, bytes: usize) -> Result<()> {
        self.account.as_ref().map_or(Ok(()), |account| account(bytes))
    }

    /// From now on an operation ends, and is undone, when `stop` returns true.
    pub fn set_stop(&mut self, stop: Option<Stop>) {
        self.stop = stop;
    }

    /// Was the last operation undone, because nobody waited for it any more?
    pub fn was_stopped(&self) -> bool {
        self.stopped
    }

    /// Memory of the environments, estimated [bytes].
    pub fn bytes(&self) -> usize {
        self.bytes_with(|_| None)
    }

    /// Memory of the environments while `operation` replaces tasks of theirs [bytes]; None if it replaces none.
    pub fn bytes_during(&self, operation: &Operation) -> Option<usize> {
        match operation {
            Operation::Reset { tasks: Some(tasks), .. } => Some(self.bytes_with(|env| tasks.get(env))),
            Operation::Restore { episodes } => Some(self.bytes_with(|env| Some(episodes[env].task()))),
            _ => None,
        }
    }

    /// Memory of the environments with their present tasks and the tasks `next`, if there are any [bytes].
    fn bytes_with<'a>(&'a self, next: impl Fn(usize) -> Option<&'a Arc<dyn AnyTask>>) -> usize {
        let (mut count, mut known) = (MemoryCount::default(), HashMap::new());
        let mut size = |task: &Arc<dyn AnyTask>| {
            *known.entry(task.id()).or_insert_with(|| {
                task.count_memory(&mut count);
                task.bytes_per_env()
            })
        };
        size(&self.task);
        let largest = |env| size(self.task_of(env)).max(next(env).map_or(0, &mut size));
        let own: usize = (0..self.envs).map(largest).sum();
        own + resident(count.bytes())
    }

    /// The task of an environment with its present options.
    pub(super) fn task_of(&self, env: usize) -> &Arc<dyn AnyTask> {
        // All shards but the last are full.
        let full = self.shards[0].envs();
        self.shards[env / full].task(env % full)
    }

    /// The shards in order of the environments. Their `rows` hold the results of the last operation.
    pub fn shards(&self) -> &[Shard] {
        &self.shards
    }

    /// See [`Batch::prepare_reset`].
    pub fn reset(
        &self,
        chosen: Option<Vec<bool>>,
        seeds: Option<Vec<u64>>,
        options: ResetOptions,
    ) -> Result<Operation> {
        self.prepare_reset(chosen, seeds, options)?.finish(self)
    }

    /// Notes which environments begin with `operation`.
    pub(super) fn begin(&mut self, operation: &Operation) {
        match operation {
            Operation::Reset { chosen: Some(chosen), .. } => {
                self.begun.iter_mut().zip(chosen).for_each(|(begun, chosen)| *begun |= chosen);
            }
            Operation::Reset { .. } | Operation::Restore { .. } => self.begun.fill(true),
            _ => (),
        }
    }

    /// Ends an operation: `stopped` undoes it. `spent`: the time that workers have worked on it.
    pub(super) fn end(&mut self, kind: usize, stopped: bool, spent: Duration) {
        self.stopped = stopped;
        if stopped {
            self.shards.iter_mut().for_each(Shard::undo);
            let begun = self.shards.iter().flat_map(|shard| (0..shard.envs()).map(|i| shard.is_begun(i)));
            self.begun = begun.collect();
        } else {
            self.shards.iter_mut().for_each(Shard::settle);
            let least = self.spent[kind].map_or(spent, |least| least.min(spent));
            self.spent[kind] = Some(least);
        }
    }

    /// Is the operation so dear that copies of all environments cost little in comparison, so that it can be undone? An
    /// operation whose cost is not known yet counts as dear.
    pub(super) fn keeps(&mut self, operation: &Operation) -> bool {
        let kept = matches!(operation, Operation::Reset { .. } | Operation::Step { .. } | Operation::Restore { .. });
        let is_dear = |spent: Duration| spent >= DEAR * self.envs as u32;
        let keeps = self.stop.is_some() && kept && self.spent[operation.kind()].is_none_or(is_dear);
        if matches!(operation, Operation::Reset { tasks: Some(_), .. } | Operation::Restore { .. }) {
            self.spent = Default::default();
        }
        keeps
    }

    /// Checks a step: `actions` is f32 [envs, action], each number within its column's bounds.
    pub fn step(&self, actions: Vec<f32>) -> Result<Operation> {
        self.check_begun("step")?;
        let width = self.spec().action.len();
        if actions.len() != self.envs * width {
            return Err(self.wrong_rows("actions", actions.len(), self.spec().action.len()));
        }
        self.check_actions(&actions, |row| format!("actions[{row}]"))?;
        Ok(Operation::Step { actions, held: None, gather: None })
    }

    /// The error that `field` has `got` numbers, and not `width` numbers for each environment.
    pub fn wrong_rows(&self, field: &str, got: usize, width: usize) -> Error {
        let n = self.envs;
        Error::invalid(field, format!("{got} numbers, expected {} = [{n}, {width}]", n * width))
    }

    /// The same as [`Batch::step`], but environments for which `held` is true keep their state.
    pub fn step_but(&self, actions: Vec<f32>, held: Vec<bool>) -> Result<Operation> {
        if held.len() != self.envs {
            return Err(Error::invalid("held", format!("{} entries for {} environments", held.len(), self.envs)));
        }
        match self.step(actions)? {
            Operation::Step { actions, gather, .. } => Ok(Operation::Step { actions, held: Some(held), gather }),
            other => Ok(other),
        }
    }

    /// Checks new commands, f32 [envs, 3]: velocity forward and to the left [m/s], yaw rate [rad/s]. They apply for the
    /// rest of the present episodes.
    pub fn set_command(&self, commands: &[f32]) -> Result<Operation> {
        self.check_begun("set_command")?;
        if commands.len() != 3 * self.envs {
            return Err(self.wrong_rows("commands", commands.len(), 3));
        }
        let commands: Vec<[f64; 3]> = commands.as_chunks().0.iter().map(|c: &[f32; 3]| c.map(f64::from)).collect();
        for (i, command) in commands.iter().enumerate() {
            self.task.check_command(&format!("commands[{i}]"), *command)?;
        }
        Ok(Operation::Command(commands))
    }

    /// The operation that restores every environment's present state.
    pub fn keep(&self) -> Result<Operation> {
        self.check_begun("rollout")?;
        let all = self.shards.iter().flat_map(|shard| (0..shard.envs()).map(|i| Arc::new(shard.keep(i))));
        Ok(Operation::Restore { episodes: all.collect() })
    }

    /// Checks a rollout of `actions`, f32 [steps, envs, action]. The returned value has no steps yet; [`Roll::next`]
    /// gives its parts.
    pub fn roll(&self, actions: Vec<f32>, record: bool) -> Result<Roll> {
        self.check_begun("rollout")?;
        let width = self.spec().action.len();
        let row = self.envs * width;
        if actions.is_empty() || !actions.len().is_multiple_of(row) {
            let (got, n) = (actions.len(), self.envs);
            return Err(Error::invalid(
                "actions",
                format!("{got} numbers, expected a multiple of {row} = [{n}, {width}]"),
            ));
        }
        self.check_actions(&actions, |k| format!("actions[{}][{}]", k / self.envs, k % self.envs))?;
        let (total, longest) = (actions.len() / row, self.longest_part(record));
        Ok(Roll { total, plan: ActionSource::Actions(Arc::new(actions)), steps: 0..0, record, longest })
    }

    /// Checks a rollout of `total` steps with the actions of the network in `onnx`. The end of an episode ends its
    /// rollout, so a rollout has at most as many steps as an episode.
    pub fn roll_network(&self, onnx: &[u8], total: u32, record: bool) -> Result<Roll> {
        self.check_begun("rollout")?;
        let spec = self.spec();
        check_range("steps", f64::from(total), 1.0..=f64::from(spec.max_episode_steps))?;
        let network = Arc::new(Network::new(onnx, spec)?);
        let (total, longest) = (total as usize, self.longest_part(record));
        Ok(Roll { total, plan: ActionSource::Network(network), steps: 0..0, record, longest })
    }

    /// Memory of the recorded rows of one step [bytes].
    fn recorded_bytes(&self) -> usize {
        4 * (self.spec().observation.len() + 1 + self.spec().action.len()) * self.envs
    }

    /// Largest memory of the rows of one part of a rollout that records them [bytes].
    pub fn part_bytes(&self) -> usize {
        self.recorded_bytes().max(PART)
    }

    /// Largest number of steps of one part of a rollout.
    fn longest_part(&self, record: bool) -> usize {
        if record { self.part_bytes() / self.recorded_bytes() } else { usize::MAX }
    }

    /// Environment `index` for viewers; see [`Shard::look`].
    pub fn look(&self, index: usize, ended: bool) -> Result<EnvView<'_>> {
        let outside = || Error::invalid("index", format!("{index} is outside [0, {})", self.envs));
        if !*self.begun.get(index).ok_or_else(outside)? {
            return Err(Error::OutOfOrder(format!("render before reset: environment {index} has not been reset yet")));
        }
        let mut first = 0;
        for shard in &self.shards {
            if index < first + shard.envs() {
                return Ok(shard.look(index - first, ended));
            }
            first += shard.envs();
        }
        Err(outside())
    }

    /// Are all environments at the start of an episode, before its first step?
    pub fn is_fresh(&self) -> bool {
        self.begun.iter().all(|b| *b) && self.shards.iter().all(Shard::is_fresh)
    }

    pub(super) fn task(&self) -> &Arc<dyn AnyTask> {
        &self.task
    }

    pub(super) fn check_begun(&self, what: &str) -> Result<()> {
        match self.begun.iter().position(|b| !b) {
            Some(i) => Err(Error::OutOfOrder(format!("{what} before reset: environment {i} has not been reset yet"))),
            None => Ok(()),
        }
    }

    /// Checks that every number is within its column's bounds; `name` names a row of actions.
    fn check_actions(&self, actions: &[f32], name: impl Fn(usize) -> String) -> Result<()> {
        let columns = &self.spec().action;
        for (row, values) in actions.chunks_exact(columns.len()).enumerate() {
            for (k, (value, c)) in values.iter().zip(columns).enumerate() {
                c.check(*value, || format!("{}[{k}]", name(row)))?;
            }
        }
        Ok(())
    }
}
