//! All environments of one session, cut into shards.

use super::operation::{ActionSource, Operation, ResetTasks, Roll};
use crate::env::registry::Blueprint;
use crate::env::{AnyTask, EnvView, ResetOptions, Shard, Spec};
use crate::error::{Error, Result, check_range};
use crate::policy::Network;
use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::sync::Arc;

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
    pub(super) begun: Vec<bool>,
}

/// Memory [bytes] of the rows of one part of a rollout, unless one step needs more: our choice, the rows of some 2,700
/// steps of one environment of HexapodGait.
const PART: usize = 1 << 19;

impl Batch {
    /// `envs` environments of `blueprint`, which need a first reset.
    pub(super) fn of(blueprint: &Blueprint, shards: Vec<Shard>) -> Self {
        let envs = shards.iter().map(Shard::envs).sum();
        Self { shards, task: blueprint.task.clone(), envs, account: None, begun: vec![false; envs] }
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

    /// Memory of the environments' models [bytes]. Resets and restores make models.
    pub fn model_bytes(&self) -> usize {
        let tasks = self.shards.iter().flat_map(|shard| (0..shard.envs()).map(|i| shard.task(i)));
        let models: HashMap<usize, &Arc<dyn AnyTask>> = tasks.map(|task| (task.id(), task)).collect();
        models.values().map(|task| task.model().memory_bytes()).sum()
    }

    /// The shards in order of the environments. Their `rows` hold the results of the last operation.
    pub fn shards(&self) -> &[Shard] {
        &self.shards
    }

    /// Checks a reset. If given, `chosen` and `seeds` must have one entry for each environment. `options` change the
    /// present options of each chosen environment, and must suit all of them.
    pub fn reset(
        &mut self,
        chosen: Option<Vec<bool>>,
        seeds: Option<Vec<u64>>,
        options: ResetOptions,
    ) -> Result<Operation> {
        let count = |field: &str, n: usize| match n == self.envs {
            true => Ok(()),
            false => Err(Error::invalid(field, format!("{n} entries for {} environments", self.envs))),
        };
        chosen.as_ref().map_or(Ok(()), |c| count("mask", c.len()))?;
        seeds.as_ref().map_or(Ok(()), |s| count("seeds", s.len()))?;
        let changes = options != ResetOptions::default();
        let tasks = changes.then(|| self.changed(chosen.as_deref(), &options)).transpose()?;
        for (i, begun) in self.begun.iter_mut().enumerate() {
            *begun |= chosen.as_ref().is_none_or(|c| c[i]);
        }
        Ok(Operation::Reset { chosen, seeds, tasks })
    }

    /// The tasks of the `chosen` environments, changed by `options`. Environments that share a task also share the
    /// changed task.
    fn changed(&self, chosen: Option<&[bool]>, options: &ResetOptions) -> Result<ResetTasks> {
        let mut tasks = ResetTasks { all: Vec::new(), of: Vec::with_capacity(self.envs) };
        let mut known: HashMap<usize, u32> = HashMap::new();
        let own = self.shards.iter().flat_map(|shard| (0..shard.envs()).map(|i| shard.task(i)));
        for (env, old) in own.enumerate() {
            if chosen.is_some_and(|chosen| !chosen[env]) {
                tasks.of.push(None);
                continue;
            }
            let index = match known.entry(old.id()) {
                Entry::Occupied(known) => *known.get(),
                Entry::Vacant(new) => {
                    let task = old.changed(options)?;
                    self.charge(task.model().memory_bytes())?;
                    tasks.all.push(task);
                    *new.insert(tasks.all.len() as u32 - 1)
                }
            };
            tasks.of.push(Some(index));
        }
        Ok(tasks)
    }

    /// Checks a step: `actions` is f32 [envs, action], each number within its column's bounds.
    pub fn step(&self, actions: Vec<f32>) -> Result<Operation> {
        self.check_begun("step")?;
        let width = self.spec().action.len();
        if actions.len() != self.envs * width {
            return Err(self.wrong_rows("actions", actions.len(), self.spec().action.len()));
        }
        self.check_actions(&actions, |row| format!("actions[{row}]"))?;
        Ok(Operation::Step { actions, held: None })
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
            Operation::Step { actions, .. } => Ok(Operation::Step { actions, held: Some(held) }),
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
