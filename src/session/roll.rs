//! Rollouts, a few steps at a time. In between the caller can stop waiting, and other sessions have their turns.

use super::MOST_MEMORY;
use crate::env::rollout::{Recorded, Rollout};
use crate::error::{Error, Result};
use crate::pool::{Batch, Operation, Pool, Roll};
use std::time::{Duration, Instant};

/// Time of one part of a rollout; between parts we check whether the caller still waits. Our choice: long compared with
/// the fixed cost of a part, and short for a caller that wants to stop. Other sessions do not wait for a part to end,
/// because the pool interleaves sessions.
const TURN: Duration = Duration::from_millis(30);

/// Largest ratio of the steps in a part to those in the part before, because the first part's single step may have been
/// unusually fast.
const GROWTH: usize = 4;

/// A rollout in progress: the operations of its parts, each of about [`TURN`].
pub struct Rolling {
    last: Roll,
    /// Number of steps of the next part.
    steps: usize,
    /// Number of steps before the present part.
    before: usize,
    begun: Instant,
}

impl Rolling {
    pub fn new(roll: &Roll) -> Self {
        Self { last: roll.clone(), steps: 1, before: 0, begun: Instant::now() }
    }

    /// The operation of the next part; None after the last one.
    pub fn next_part(&mut self) -> Option<Operation> {
        self.before = self.made();
        self.last = self.last.next(self.steps)?;
        self.begun = Instant::now();
        Some(Operation::Roll(self.last.clone()))
    }

    /// Number of steps up to the end of the present part.
    pub fn made(&self) -> usize {
        self.last.made()
    }

    /// Is the present part the last one?
    pub fn is_last(&self) -> bool {
        self.made() == self.last.total()
    }

    /// The error of the rollout's network, if it failed in the present part.
    pub fn check(batch: &Batch) -> Result<()> {
        batch.shards().iter().find_map(|s| s.rollout.failed.clone()).map_or(Ok(()), Err)
    }

    /// The present part is done; its time determines the length of the next one.
    pub fn went(&mut self) {
        self.steps = next_steps(self.made() - self.before, self.begun.elapsed());
    }
}

/// Steps of the next part, after a part that made `done` steps in `time`. `done` may be fewer steps than the operation
/// should make, because the memory of a part is limited.
fn next_steps(done: usize, time: Duration) -> usize {
    let fitting = done as f64 * TURN.as_secs_f64() / time.as_secs_f64().max(1e-6);
    (fitting as usize).clamp(1, GROWTH * done.max(1))
}

/// Results of a rollout; one row for each environment.
#[derive(Default)]
pub struct Rolled {
    pub returns: Vec<f64>,
    pub lengths: Vec<u32>,
    pub terminated: Vec<u8>,
    pub truncated: Vec<u8>,
    /// f32 [steps, envs, observation], empty unless recorded.
    pub observations: Vec<f32>,
    /// f32 [steps, envs], empty unless recorded.
    pub rewards: Vec<f32>,
    /// f32 [steps, envs, action], empty unless recorded: the network's choices.
    pub actions: Vec<f32>,
}

/// Makes all steps of `roll` and restores the environments with `back`. `stopped` ends it between two parts.
///
/// # Errors
/// Outer error: the environments are lost. Inner error: they have their former state.
pub fn run(
    pool: &Pool,
    mut batch: Batch,
    roll: &Roll,
    back: Operation,
    record: bool,
    stopped: impl Fn() -> bool,
) -> Result<(Batch, Result<Rolled>)> {
    let mut rolled = check_size(&batch, roll, record).map(|()| Rolled::default());
    let mut rolling = Rolling::new(roll);
    while let (Some(operation), Ok(rows)) = (rolling.next_part(), &mut rolled) {
        batch = pool.wait(batch, operation)?;
        if let Err(error) = Rolling::check(&batch) {
            rolled = Err(error);
        } else if stopped() {
            rolled = Err(Error::Cancelled("the rollout was stopped".into()));
        } else {
            rows.add(&batch, roll.chooses());
            rolling.went();
        }
    }
    if let Ok(rows) = &mut rolled {
        rows.end(&batch);
    }
    Ok((pool.wait(batch, back)?, rolled))
}

fn check_size(batch: &Batch, roll: &Roll, record: bool) -> Result<()> {
    let numbers = batch.spec().observation.len() + batch.spec().action.len() + 1;
    let bytes = (4 * numbers * batch.envs()).saturating_mul(if record { roll.total() } else { 0 });
    match bytes > MOST_MEMORY {
        true => Err(Error::Exhausted(format!("trajectories: they need {} MiB", bytes >> 20))),
        false => Ok(()),
    }
}

impl Rolled {
    /// Adds the steps of the part that was just computed, if they were recorded.
    fn add(&mut self, batch: &Batch, chosen: bool) {
        let shards = batch.shards();
        let steps = shards.first().map_or(0, |s| s.rollout.steps.len());
        for step in 0..steps {
            let column = |into: &mut Vec<f32>, of: fn(&Recorded) -> &[f32]| {
                shards.iter().for_each(|s| into.extend_from_slice(of(&s.rollout.steps[step])));
            };
            column(&mut self.observations, |r| &r.observations);
            column(&mut self.rewards, |r| &r.rewards);
            if chosen {
                column(&mut self.actions, |r| &r.actions);
            }
        }
    }

    /// Stores the results after the last step.
    fn end(&mut self, batch: &Batch) {
        let rollouts = || batch.shards().iter().map(|s| &s.rollout);
        let flags = |of: fn(&Rollout) -> &[u8]| rollouts().flat_map(of).copied().collect();
        self.returns = rollouts().flat_map(|r| &r.returns).copied().collect();
        self.lengths = rollouts().flat_map(|r| &r.lengths).copied().collect();
        self.terminated = flags(|r| &r.terminated);
        self.truncated = flags(|r| &r.truncated);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// If memory limits the parts to a few steps, the number of steps for the next part does not grow without end.
    #[test]
    fn short_parts_ask_for_a_few_steps() {
        let mut asked = 1;
        for _ in 0..100 {
            asked = next_steps(asked.min(3), Duration::ZERO);
            assert!((1..=12).contains(&asked), "{asked}");
        }
        assert_eq!(next_steps(100, Duration::from_millis(60)), 50);
        assert_eq!(next_steps(5, Duration::from_secs(9)), 1);
    }
}
