//! The operations on a batch, and how a thread carries them out on one shard.

use crate::env::episode::Episode;
use crate::env::{AnyTask, Shard};
use crate::policy::Network;
use std::sync::Arc;

/// A checked request. Only [`super::Batch`] makes operations, so a pool gets no malformed operations.
pub enum Operation {
    Reset { chosen: Option<Vec<bool>>, seeds: Option<Vec<u64>>, tasks: Option<ResetTasks> },
    Step { actions: Vec<f32>, held: Option<Vec<bool>> },
    Restore { episodes: Vec<Arc<Episode>> },
    Command(Vec<[f64; 3]>),
    Roll(Roll),
}

/// New tasks, with changed options, of the environments that a reset chooses.
pub struct ResetTasks {
    /// Each different task once.
    pub(super) all: Vec<Arc<dyn AnyTask>>,
    /// Index of each environment's task; None for environments that are not chosen.
    pub(super) of: Vec<Option<u32>>,
}

impl ResetTasks {
    fn get(&self, env: usize) -> Option<&Arc<dyn AnyTask>> {
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

    /// Number of parts. After each part a worker checks whether other sessions wait. In a rollout one control step is
    /// one part; every other operation is one part.
    pub(super) fn parts(&self) -> usize {
        match self {
            Self::Roll(roll) => roll.steps.len(),
            _ => 1,
        }
    }

    /// Computes part `part` on one shard whose first environment is number `start` of the batch.
    pub(super) fn run(&self, shard: &mut Shard, start: usize, part: usize) {
        let (envs, width) = (shard.envs(), shard.actions());
        match self {
            Self::Step { actions, held } => {
                let actions = &actions[start * width..][..envs * width];
                match held {
                    Some(held) => shard.step_but(actions, |i| held[start + i]),
                    None => shard.step(actions),
                }
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
            Self::Roll(roll) => roll.run(shard, start, part),
        }
    }
}

impl Roll {
    /// Makes step `part` of this part of a rollout on one shard whose first environment is number `start` of the
    /// batch.
    fn run(&self, shard: &mut Shard, start: usize, part: usize) {
        let step = self.steps.start + part;
        if step == 0 {
            shard.begin_rollout();
        }
        if part == 0 {
            shard.rollout.steps.clear();
        }
        let (first, count) = (start * shard.actions(), shard.envs() * shard.actions());
        match &self.plan {
            ActionSource::Actions(actions) => {
                let row = actions.len() / self.total;
                shard.roll(&actions[step * row + first..][..count], self.record);
            }
            ActionSource::Network(network) if shard.rollout.failed.is_none() => {
                let mut actions = vec![0.0; count];
                match network.act(&shard.rows.observations, &mut actions) {
                    Ok(()) => shard.roll(&actions, self.record),
                    Err(error) => shard.rollout.failed = Some(error),
                }
            }
            ActionSource::Network(_) => (),
        }
    }
}
