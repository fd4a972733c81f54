//! Runs environments for measurements of speed: the same steps in this process and through the service.

use sandgait_base::{Error, Result};
use sandgait_client as client;
use sandgait_env as env;
use sandgait_policy as policy;
use sandgait_pool as pool;
use sandgait_service as service;

mod remote;

pub use remote::{RolloutStepper, ServerStepper};

use crate::env::ResetOptions;
use crate::env::registry::Blueprint;
use crate::policy::Network;
use crate::pool::{Batch, Pool};
use std::time::{Duration, Instant};

/// Source of a measurement's actions.
pub enum Actions {
    /// Batches, f32 [envs, action] each, which are made before the clock starts and used in turn.
    Made(Vec<Vec<f32>>),
    /// A policy that looks at each step's observations; its own time is not counted.
    Policy(Network),
}

/// Something that makes batched steps.
pub trait Stepper {
    /// Control steps that one call of [`Stepper::step`] makes.
    fn steps(&self) -> usize {
        1
    }

    /// Makes the control steps of one call; `actions` is f32 [steps, envs, action].
    fn step(&mut self, actions: &[f32]) -> Result<()>;

    /// Fills `actions`, f32 [envs, action], by `policy`.
    fn choose(&self, _policy: &Network, _actions: &mut [f32]) -> Result<()> {
        Err(Error::invalid("--actions", "a policy is measured in process only: leave --through out"))
    }
}

/// The pool, called directly.
pub struct Direct {
    pool: Pool,
    /// The environments; None only while the pool works on them.
    batch: Option<Batch>,
}

impl Direct {
    /// `envs` environments reset with seeds 0, 1, …; `threads` as in [`Pool::new`].
    pub fn new(blueprint: &Blueprint, envs: usize, threads: usize) -> Result<Self> {
        let pool = Pool::new(threads);
        let batch = Batch::new(blueprint, envs)?;
        let reset = batch.reset(None, Some((0..envs as u64).collect()), ResetOptions::default())?;
        let batch = Some(pool.wait(batch, reset)?);
        Ok(Self { pool, batch })
    }
}

impl Stepper for Direct {
    fn step(&mut self, actions: &[f32]) -> Result<()> {
        let batch = self.batch.take().ok_or_else(|| Error::OutOfOrder("the batch was lost".into()))?;
        let operation = batch.step(actions.to_vec())?;
        self.batch = Some(self.pool.wait(batch, operation)?);
        Ok(())
    }

    fn choose(&self, policy: &Network, actions: &mut [f32]) -> Result<()> {
        let shards = self.batch.iter().flat_map(Batch::shards);
        let mut rest = actions;
        for shard in shards {
            let (rows, later) = rest.split_at_mut(shard.envs() * shard.actions());
            policy.act(&shard.rows.observations, rows)?;
            rest = later;
        }
        Ok(())
    }
}

/// Environment steps per second in each of `repeats` intervals of duration `length`, in ascending order.
pub fn measure(
    stepper: &mut dyn Stepper,
    actions: &Actions,
    size: [usize; 2],
    repeats: usize,
    length: Duration,
) -> Result<Vec<f64>> {
    let [envs, width] = size;
    let at_once = stepper.steps();
    let mut chosen = vec![0.0; envs * width];
    let mut repeat = |length: Duration| -> Result<f64> {
        let (mut spent, mut calls) = (Duration::ZERO, 0);
        while spent < length {
            let batch = match actions {
                Actions::Made(batches) => &batches[calls % batches.len()],
                Actions::Policy(policy) => {
                    stepper.choose(policy, &mut chosen)?;
                    &chosen
                }
            };
            let clock = Instant::now();
            stepper.step(batch)?;
            spent += clock.elapsed();
            calls += 1;
        }
        Ok((calls * at_once * envs) as f64 / spent.as_secs_f64())
    };
    repeat(length)?; // warm-up: robots leave their start positions, caches fill
    let mut rates = (0..repeats).map(|_| repeat(length)).collect::<Result<Vec<_>>>()?;
    rates.sort_by(f64::total_cmp);
    Ok(rates)
}

/// 16 batches of uniform random actions, f32 [envs, width] each, the same in every run. They are drawn once and
/// used in turn, so that drawing is not part of the measurement.
pub fn random_actions(envs: usize, width: usize) -> Vec<Vec<f32>> {
    let mut generator = 1u64;
    // A linear congruential generator with Knuth's constants (MMIX).
    let mut draw = || {
        generator = generator.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (generator >> 40) as f32 / (1 << 23) as f32 - 1.0
    };
    (0..16).map(|_| (0..envs * width).map(|_| draw()).collect()).collect()
}
