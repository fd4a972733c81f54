//! Random numbers of an episode: a function of the environment's seed and the episode's number only.

use rand::{Rng as _, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

/// Draws in a fixed order; equal seeds and episodes give equal draws on every machine.
pub struct Random(Xoshiro256PlusPlus);

impl Random {
    /// The stream of episode `episode` of the environment with seed `seed`.
    pub fn new(seed: u64, episode: u64) -> Self {
        let mut bytes = [0; 32];
        bytes[..8].copy_from_slice(&seed.to_le_bytes());
        bytes[8..16].copy_from_slice(&episode.to_le_bytes());
        bytes[16] = 1; // xoshiro's state must not be all zero
        let mut generator = Xoshiro256PlusPlus::from_seed(bytes);
        generator.long_jump(); // mixes the bits of the seed: neighbouring seeds give unrelated streams
        Self(generator)
    }

    /// Uniform in [low, high); `low` if the interval is empty.
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.random::<f64>()
    }
}
