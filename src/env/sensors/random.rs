//! The sensors' random numbers.

use rand::SeedableRng as _;
use rand_xoshiro::Xoshiro256PlusPlus;

/// An arbitrary number that makes the sensors' random numbers independent of the episode's other random numbers.
const STREAM: u64 = 0x5e15_0125;
/// The random numbers of one step of an episode. The numbers are mixed by the finalizer of splitmix64 (Steele, Lea & Flood,
/// OOPSLA 2014), so neighbouring ones give unrelated streams.
pub(super) fn stream(seed: u64, number: u64, step: u64) -> Xoshiro256PlusPlus {
    let mixed = [seed, number, step].into_iter().fold(STREAM, |sum, x| {
        let mut z = (sum ^ x).wrapping_add(0x9e37_79b9_7f4a_7c15);
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    });
    Xoshiro256PlusPlus::seed_from_u64(mixed)
}
