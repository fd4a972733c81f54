//! Resets and restores that make tasks and episodes before they run: thousands of them take seconds, so they are made
//! some at a time.

use super::batch::Batch;
use super::operation::{Operation, ResetTasks};
use super::snapshot::{Snapshot, broken};
use crate::env::episode::Episode;
use crate::env::{AnyTask, ResetOptions};
use crate::error::{Error, Result};
use crate::sim::{MemoryCount, resident};
use std::collections::HashMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// An [`Operation`] whose tasks and episodes are not all made yet.
pub struct Preparing {
    plan: PreparationPlan,
    /// The next environment.
    next: usize,
    /// Memory of the tasks so far.
    count: MemoryCount,
}

enum PreparationPlan {
    Reset(ResetPlan),
    Restore(RestorePlan),
}

struct ResetPlan {
    chosen: Option<Vec<bool>>,
    seeds: Option<Vec<u64>>,
    options: ResetOptions,
    tasks: ResetTasks,
    /// Index of the new task by the id of the old one: environments that share a task also share the changed task.
    known: HashMap<usize, u32>,
}

struct RestorePlan {
    snapshot: Snapshot,
    sources: Option<Vec<u32>>,
    /// By the index of the options in the snapshot.
    tasks: HashMap<u32, Arc<dyn AnyTask>>,
    /// By the index in the snapshot.
    resumed: HashMap<usize, Arc<Episode>>,
    episodes: Vec<Arc<Episode>>,
}

impl Batch {
    /// Checks a reset, except for its options. If given, `chosen` and `seeds` must have one entry for each environment.
    /// `options` change the present options of each chosen environment, and must suit all of them.
    pub fn prepare_reset(
        &self,
        chosen: Option<Vec<bool>>,
        seeds: Option<Vec<u64>>,
        options: ResetOptions,
    ) -> Result<Preparing> {
        let count = |field: &str, n: usize| match n == self.envs() {
            true => Ok(()),
            false => Err(Error::invalid(field, format!("{n} entries for {} environments", self.envs()))),
        };
        chosen.as_ref().map_or(Ok(()), |c| count("mask", c.len()))?;
        seeds.as_ref().map_or(Ok(()), |s| count("seeds", s.len()))?;
        let given = options.keywords().iter().filter(|(_, value)| !value.is_null());
        let changed = given.map(|(name, _)| name.clone()).collect();
        let tasks = ResetTasks { all: Vec::new(), of: Vec::new(), changed };
        let plan = ResetPlan { chosen, seeds, options, tasks, known: HashMap::new() };
        Ok(Preparing { plan: PreparationPlan::Reset(plan), next: 0, count: MemoryCount::default() })
    }

    /// A restore: environment i goes on as environment `sources[i]` of `snapshot`. Without `sources`, environment i
    /// goes on as environment i modulo n of a snapshot of n environments, so a snapshot of one environment is copied to
    /// all.
    pub fn prepare_restore(&self, snapshot: Snapshot, sources: Option<Vec<u32>>) -> Result<Preparing> {
        if snapshot.task != self.spec().id {
            return Err(broken(format!("it is of {}, not of {}", snapshot.task, self.spec().id)));
        }
        if sources.as_ref().is_some_and(|s| s.len() != self.envs()) || snapshot.envs() == 0 {
            let got = sources.map_or(0, |s| s.len());
            return Err(Error::invalid("sources", format!("{got} entries for {} environments", self.envs())));
        }
        let (tasks, resumed) = (HashMap::new(), HashMap::new());
        let plan = RestorePlan { snapshot, sources, tasks, resumed, episodes: Vec::new() };
        Ok(Preparing { plan: PreparationPlan::Restore(plan), next: 0, count: MemoryCount::default() })
    }
}

impl Preparing {
    /// Makes at least one more task or episode, and further ones until `time` has passed. Returns the operation when all
    /// are made.
    ///
    /// # Errors
    /// The request is refused.
    pub fn go_on(mut self, batch: &Batch, time: Duration) -> Result<Prepared> {
        let begun = Instant::now();
        if matches!(&self.plan, PreparationPlan::Reset(plan) if plan.options == ResetOptions::default()) {
            self.next = batch.envs();
        }
        while self.next < batch.envs() {
            match &mut self.plan {
                PreparationPlan::Reset(plan) => plan.make(self.next, batch, &mut self.count)?,
                PreparationPlan::Restore(plan) => plan.make(self.next, batch, &mut self.count)?,
            }
            self.next += 1;
            if self.next < batch.envs() && begun.elapsed() >= time {
                return Ok(Prepared::Later(self));
            }
        }
        Ok(Prepared::Now(match self.plan {
            PreparationPlan::Reset(ResetPlan { chosen, seeds, tasks, .. }) => {
                let tasks = (!tasks.of.is_empty()).then_some(tasks);
                Operation::Reset { chosen, seeds, tasks }
            }
            PreparationPlan::Restore(plan) => Operation::Restore { episodes: plan.episodes },
        }))
    }

    /// Makes all that is missing.
    pub fn finish(self, batch: &Batch) -> Result<Operation> {
        match self.go_on(batch, Duration::MAX)? {
            Prepared::Now(operation) => Ok(operation),
            Prepared::Later(_) => Err(Error::Internal("a request could not be prepared".into())),
        }
    }
}

/// What [`Preparing::go_on`] returns.
pub enum Prepared {
    Now(Operation),
    Later(Preparing),
}

impl ResetPlan {
    /// The task of environment `env`, changed by the options.
    fn make(&mut self, env: usize, batch: &Batch, count: &mut MemoryCount) -> Result<()> {
        if self.chosen.as_ref().is_some_and(|chosen| !chosen[env]) {
            self.tasks.of.push(None);
            return Ok(());
        }
        let old = batch.task_of(env);
        if !self.known.contains_key(&old.id()) {
            let task = old.changed(&self.options)?;
            batch.charge(added(count, old, &task))?;
            self.known.insert(old.id(), self.tasks.all.len() as u32);
            self.tasks.all.push(task);
        }
        self.tasks.of.push(self.known.get(&old.id()).copied());
        Ok(())
    }
}

/// Memory that `task` takes besides `old` and all that was counted before [bytes].
fn added(count: &mut MemoryCount, old: &Arc<dyn AnyTask>, task: &Arc<dyn AnyTask>) -> usize {
    old.count_memory(count);
    let before = count.bytes();
    task.count_memory(count);
    resident(count.bytes() - before)
}

impl RestorePlan {
    /// Checks that environment `env` of the batch can go on as its environment of the snapshot.
    fn make(&mut self, env: usize, batch: &Batch, count: &mut MemoryCount) -> Result<()> {
        let all = self.snapshot.episodes();
        let source = self.sources.as_ref().map_or(env % all.len(), |s| s[env] as usize);
        if let Some(known) = self.resumed.get(&source) {
            self.episodes.push(known.clone());
            return Ok(());
        }
        let range = || Error::invalid(format!("sources[{env}]"), format!("{source} is outside [0, {})", all.len()));
        let (index, episode) = all.get(source).ok_or_else(range)?;
        let task = match self.tasks.get(index) {
            Some(task) => task.clone(),
            None => {
                let task = batch.task_with(self.snapshot.options_of(*index)?)?;
                if task.id() != batch.task().id() {
                    batch.charge(added(count, batch.task(), &task))?;
                }
                self.tasks.insert(*index, task.clone());
                task
            }
        };
        let episode = episode.episode()?;
        let new = Arc::new(Episode::resume(&episode, &task)?);
        self.resumed.insert(source, new.clone());
        self.episodes.push(new);
        Ok(())
    }
}
