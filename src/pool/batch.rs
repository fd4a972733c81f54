//! All environments of one session, cut into shards.

use crate::env::task::{Blueprint, Setup};
use crate::env::{ResetOptions, Shard, Spec, Task};
use crate::error::{Error, Result};
use std::sync::Arc;

/// The environments of one session. `Pool::run` takes it and gives it back.
pub struct Batch {
    pub(super) shards: Vec<Shard>,
    task: Arc<dyn Task>,
    setup: Setup,
    envs: usize,
    begun: Vec<bool>,
}

/// A checked request; only [`Batch`] makes one, so a pool never sees a malformed one.
pub enum Operation {
    Reset { chosen: Option<Vec<bool>>, seeds: Option<Vec<u64>>, setup: Option<Box<Setup>> },
    Step { actions: Vec<f32> },
}

impl Batch {
    /// `envs` environments that wait for their first reset.
    pub fn new(blueprint: &Blueprint, envs: usize) -> Result<Self> {
        if envs == 0 {
            return Err(Error::invalid("num_envs", "0 is outside [1, 4294967295]"));
        }
        let size = blueprint.engine.shard_size();
        let shards = (0..envs).step_by(size).map(|start| Shard::new(blueprint, size.min(envs - start)));
        Ok(Self {
            shards: shards.collect::<Result<_>>()?,
            task: blueprint.task.clone(),
            setup: blueprint.setup.clone(),
            envs,
            begun: vec![false; envs],
        })
    }

    pub fn envs(&self) -> usize {
        self.envs
    }

    pub fn spec(&self) -> &Spec {
        self.task.spec()
    }

    /// In order of the environments; `rows` of each hold what the last operation gave.
    pub fn shards(&self) -> &[Shard] {
        &self.shards
    }

    /// Checks a reset: `chosen` and `seeds` have one entry an environment if given, and the options suit the
    /// session's task.
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
        let setup =
            if options == ResetOptions::default() { None } else { Some(Box::new(self.setup.changed(&options)?)) };
        for (i, begun) in self.begun.iter_mut().enumerate() {
            *begun |= chosen.as_ref().is_none_or(|c| c[i]);
        }
        Ok(Operation::Reset { chosen, seeds, setup })
    }

    /// Checks a step: `actions` is f32 [envs, action], each number within its column's bounds.
    pub fn step(&self, actions: Vec<f32>) -> Result<Operation> {
        if let Some(i) = self.begun.iter().position(|b| !b) {
            return Err(Error::OutOfOrder(format!("step before reset: environment {i} has not been reset yet")));
        }
        let columns = &self.spec().action;
        if actions.len() != self.envs * columns.len() {
            let (got, n, m) = (actions.len(), self.envs, columns.len());
            return Err(Error::invalid("actions", format!("{got} numbers, expected {} = [{n}, {m}]", n * m)));
        }
        for (row, values) in actions.chunks_exact(columns.len()).enumerate() {
            for (k, (value, c)) in values.iter().zip(columns).enumerate() {
                // NaN fails this test too.
                if !(c.low..=c.high).contains(&f64::from(*value)) {
                    let reason = format!("{value} ({}) is outside [{}, {}]", c.name, c.low, c.high);
                    return Err(Error::invalid(format!("actions[{row}][{k}]"), reason));
                }
            }
        }
        Ok(Operation::Step { actions })
    }
}

impl Operation {
    /// Carries this out on one shard whose first environment is number `start` of the batch.
    pub(super) fn run(&self, shard: &mut Shard, start: usize) {
        let envs = shard.envs();
        match self {
            Self::Step { actions } => {
                let width = shard.actions();
                shard.step(&actions[start * width..][..envs * width]);
            }
            Self::Reset { chosen, seeds, setup } => {
                let chosen = |i: usize| chosen.as_ref().is_none_or(|c| c[start + i]);
                let seeds = seeds.as_ref().map(|s| &s[start..start + envs]);
                shard.reset(chosen, seeds, setup.as_deref());
            }
        }
    }
}
