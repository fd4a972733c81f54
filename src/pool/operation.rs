//! The operations on a batch, and how a thread carries them out on one shard.

use crate::env::episode::Episode;
use crate::env::shard::Rows;
use crate::env::{AnyTask, Shard};
use crate::policy::Network;
use std::sync::Arc;
use std::time::Duration;

/// A function that gets the rows of each shard that has made its step, and the number of its first environment. The thread
/// that made the step calls it, while the rows are in its processor's cache.
pub type Gather = Arc<dyn Fn(usize, &Rows) + Send + Sync>;

/// A checked request. Only [`super::Batch`] makes operations, so a pool gets no malformed operations.
pub enum Operation {
    Reset { chosen: Option<Vec<bool>>, seeds: Option<Vec<u64>>, tasks: Option<ResetTasks> },
    Step { actions: Vec<f32>, held: Option<Vec<bool>>, gather: Option<Gather> },
    Restore { episodes: Vec<Arc<Episode>> },
    Command(Vec<[f64; 3]>),
    Roll(Roll),
}

/// After this time of work on a shard a worker looks whether other sessions wait, and whether anybody still waits for
/// this operation: our choice. A shard's step with the default time step takes a tenth of it, so it is in one part.
const PART: Duration = Duration::from_millis(5);

/// New tasks, with changed options, of the environments that a reset chooses.
pub struct ResetTasks {
    /// Each different task once.
    pub(super) all: Vec<Arc<dyn AnyTask>>,
    /// Index of each environment's task; None for environments that are not chosen.
    pub(super) of: Vec<Option<u32>>,
    /// Names of the options that the reset changes.
    pub(super) changed: Vec<String>,
}

impl ResetTasks {
    pub(super) fn get(&self, env: usize) -> Option<&Arc<dyn AnyTask>> {
        self.all.get(self.of[env]? as usize)
    }
}

/// A part of a rollout.
#[derive(Clone)]
pub struct Roll {
    pub(super) plan: ActionSource,
    /// Number of steps of the whole rollout.
    pub(super) total: usize,
    /// The steps of this part.
    pub(super) steps: std::ops::Range<usize>,
    /// Keep the rows of every step.
    pub(super) record: bool,
    /// Largest number of steps of a part.
    pub(super) longest: usize,
}

/// Source of a rollout's actions.
#[derive(Clone)]
pub(super) enum ActionSource {
    /// f32 [steps, envs, action] of the whole rollout.
    Actions(Arc<Vec<f32>>),
    Network(Arc<Network>),
}

impl Roll {
    /// The next part of this rollout with at most `count` steps; None after the last step.
    pub fn next(&self, count: usize) -> Option<Self> {
        let total = self.total();
        let steps = self.steps.end..total.min(self.steps.end + count.min(self.longest));
        (!steps.is_empty()).then(|| Self { steps, ..self.clone() })
    }

    /// Number of steps of the whole rollout.
    pub fn total(&self) -> usize {
        self.total
    }

    /// Does a policy choose the actions?
    pub fn chooses(&self) -> bool {
        matches!(self.plan, ActionSource::Network(_))
    }

    /// Steps done after this part.
    pub fn made(&self) -> usize {
        self.steps.end
    }
}

impl Operation {
    /// The same step, whose rows `gather` gets. Other operations do not change.
    pub fn gathered(self, gather: Option<Gather>) -> Self {
        match self {
            Self::Step { actions, held, .. } => Self::Step { actions, held, gather },
            other => other,
        }
    }

    /// What the user gave that takes memory, for refusals: the options of a reset.
    pub fn field(&self) -> String {
        match self {
            Self::Reset { tasks: Some(tasks), .. } if !tasks.changed.is_empty() => tasks.changed.join(", "),
            other => other.name().to_owned(),
        }
    }

    /// Its name in logs and metrics.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Reset { .. } => "reset",
            Self::Step { .. } => "step",
            Self::Restore { .. } => "restore",
            Self::Command(_) => "set_command",
            Self::Roll(_) => "rollout",
        }
    }

    /// How many of `envs` environments the operation advances; 0 if it is not a step.
    pub fn steps(&self, envs: usize) -> usize {
        match self {
            Self::Step { held, .. } => envs - held.iter().flatten().filter(|held| **held).count(),
            _ => 0,
        }
    }

    /// Number of kinds of operations, and the index of this one's kind.
    pub(super) const KINDS: usize = 5;
    pub(super) fn kind(&self) -> usize {
        match self {
            Self::Reset { .. } => 0,
            Self::Step { .. } => 1,
            Self::Restore { .. } => 2,
            Self::Command(_) => 3,
            Self::Roll(_) => 4,
        }
    }

    /// Computes for about [`PART`] on one shard whose first environment is number `start` of the batch; returns whether
    /// the operation is done there. `done`: number of control steps of a rollout that were made on this shard.
    pub(super) fn run(&self, shard: &mut Shard, start: usize, done: &mut usize) -> bool {
        let (envs, width) = (shard.envs(), shard.actions());
        match self {
            Self::Step { actions, held, gather } => {
                let actions = &actions[start * width..][..envs * width];
                let done = shard.step_part(actions, |i| held.as_ref().is_some_and(|held| held[start + i]), PART);
                if let Some(gather) = gather.as_ref().filter(|_| done) {
                    gather(start, &shard.rows);
                }
                return done;
            }
            Self::Reset { chosen, seeds, tasks } => {
                let chosen = |i: usize| chosen.as_ref().is_none_or(|c| c[start + i]);
                let seeds = seeds.as_ref().map(|s| &s[start..start + envs]);
                shard.reset(chosen, seeds, |i| tasks.as_ref().and_then(|tasks| tasks.get(start + i)));
            }
            Self::Restore { episodes } => {
                shard.rows.clear();
                // A rollout ends with a restore, after its rows have been read.
                shard.begin_rollout();
                for i in 0..envs {
                    shard.restore(i, &episodes[start + i]);
                }
            }
            Self::Command(commands) => {
                shard.rows.clear();
                (0..envs).for_each(|i| shard.set_command(i, commands[start + i]));
            }
            Self::Roll(roll) => {
                *done += usize::from(roll.run(shard, start, *done));
                return *done >= roll.steps.len();
            }
        }
        true
    }
}

impl Roll {
    /// Goes on with step `part` of this part of a rollout on one shard whose first environment is number `start` of the
    /// batch; returns whether the step is done.
    fn run(&self, shard: &mut Shard, start: usize, part: usize) -> bool {
        let step = self.steps.start + part;
        if !shard.is_in_step() {
            if step == 0 {
                shard.begin_rollout();
            }
            if part == 0 {
                shard.rollout.steps.clear();
            }
        }
        let (first, count) = (start * shard.actions(), shard.envs() * shard.actions());
        match &self.plan {
            ActionSource::Actions(actions) => {
                let row = actions.len() / self.total;
                shard.roll_part(&actions[step * row + first..][..count], self.record, PART)
            }
            ActionSource::Network(network) if shard.rollout.failed.is_none() => {
                let mut actions = vec![0.0; count];
                match network.act(&shard.rows.observations, &mut actions) {
                    Ok(()) => shard.roll_part(&actions, self.record, PART),
                    Err(error) => {
                        shard.rollout.failed = Some(error);
                        true
                    }
                }
            }
            ActionSource::Network(_) => true,
        }
    }
}
