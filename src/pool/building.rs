//! Environments under construction. Thousands of them take seconds, so they can be made some at a time.

use super::batch::{Batch, check_envs};
use crate::env::Shard;
use crate::env::registry::Blueprint;
use crate::error::Result;
use std::time::{Duration, Instant};

/// A [`Batch`] of which some shards are complete.
pub struct Building {
    blueprint: Blueprint,
    envs: usize,
    shards: Vec<Shard>,
}

impl Batch {
    /// `envs` environments that need a first reset.
    pub fn new(blueprint: &Blueprint, envs: usize) -> Result<Self> {
        Building::new(blueprint, envs)?.finish()
    }
}

impl Building {
    /// `envs` environments, none of which is made yet.
    pub fn new(blueprint: &Blueprint, envs: usize) -> Result<Self> {
        check_envs(envs, usize::MAX)?;
        Ok(Self { blueprint: blueprint.clone(), envs, shards: Vec::new() })
    }

    /// Makes at least one more shard, and further shards until `time` has passed.
    pub fn go_on(&mut self, time: Duration) -> Result<()> {
        let begun = Instant::now();
        while self.missing() > 0 {
            let envs = self.missing().min(self.blueprint.engine.shard_size());
            self.shards.push(Shard::new(&self.blueprint, envs)?);
            if begun.elapsed() >= time {
                break;
            }
        }
        Ok(())
    }

    /// Number of environments that are still to be made. All shards but the last are full.
    pub fn missing(&self) -> usize {
        self.envs.saturating_sub(self.shards.len() * self.blueprint.engine.shard_size())
    }

    /// The complete batch; makes the missing shards now.
    pub fn finish(mut self) -> Result<Batch> {
        self.go_on(Duration::MAX)?;
        Ok(Batch::of(&self.blueprint, self.shards))
    }
}
