//! What drives environments when their speed is measured: the same steps in this process and through the service.

mod remote;

pub use remote::{Remote, Rollouts};

use crate::env::ResetOptions;
use crate::env::registry::Blueprint;
use crate::pool::{Batch, Pool};
use crate::{Error, Result};

/// Something that makes batched steps.
pub trait Stepper {
    /// Control steps that one call of [`Stepper::step`] makes.
    fn steps(&self) -> usize {
        1
    }

    /// So many control steps; `actions` is f32 [steps, envs, action].
    fn step(&mut self, actions: &[f32]) -> Result<()>;
}

/// The pool, called directly.
pub struct Direct {
    pool: Pool,
    /// Only empty while the pool has it.
    batch: Option<Batch>,
}

impl Direct {
    /// `envs` environments reset with seeds 0, 1, …; `threads` as in [`Pool::new`].
    pub fn new(blueprint: &Blueprint, envs: usize, threads: usize) -> Result<Self> {
        let pool = Pool::new(threads);
        let mut batch = Batch::new(blueprint, envs)?;
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
}

/// 16 batches of uniform random actions, f32 [envs, width] each, always the same: drawn once and used in turn, so that
/// drawing is not part of what is measured.
pub fn random_actions(envs: usize, width: usize) -> Vec<Vec<f32>> {
    let mut generator = 1u64;
    // A linear congruential generator with Knuth's constants (MMIX).
    let mut draw = || {
        generator = generator.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (generator >> 40) as f32 / (1 << 23) as f32 - 1.0
    };
    (0..16).map(|_| (0..envs * width).map(|_| draw()).collect()).collect()
}
