//! Sizes of errors, and the fraction by which one is smaller than another.

use rand::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

/// Errors over the channels that count in the error, condition by condition.
#[derive(Clone, Debug)]
pub struct Errors {
    /// Sum of squares [unit of the channels, squared] and number of values.
    pub square: Vec<f64>,
    pub count: Vec<f64>,
}

impl Errors {
    /// Root mean square over all conditions.
    pub fn rmse(&self) -> f64 {
        (self.square.iter().sum::<f64>() / self.count.iter().sum::<f64>().max(1.0)).sqrt()
    }

    /// The errors in `conditions`.
    pub fn among(&self, conditions: &[usize]) -> Self {
        let of = |values: &[f64]| conditions.iter().map(|&k| values[k]).collect();
        Self { square: of(&self.square), count: of(&self.count) }
    }

    /// These errors after a reduction: in each condition the mean square falls by the difference of the mean squares of
    /// `before` and `after`.
    pub fn less(&self, before: &Self, after: &Self) -> Self {
        let part = |k: usize| {
            let mean = |e: &Self| e.square[k] / e.count[k].max(1.0);
            (self.square[k] - self.count[k] * (mean(before) - mean(after)).max(0.0)).max(0.0)
        };
        Self { square: (0..self.square.len()).map(part).collect(), count: self.count.clone() }
    }

    /// 95 % interval of the fraction by which `other` is smaller: bootstrap over conditions, 2000 draws.
    pub fn reduction_interval(&self, other: &Errors) -> [f64; 2] {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(3);
        let n = self.square.len();
        let mut draws: Vec<f64> = (0..2000)
            .map(|_| {
                let (mut own, mut others, mut counts) = (0.0, 0.0, [0.0; 2]);
                for _ in 0..n {
                    let k = rng.random_range(0..n);
                    own += self.square[k];
                    others += other.square[k];
                    counts = [counts[0] + self.count[k], counts[1] + other.count[k]];
                }
                let share = counts[0] / f64::max(counts[1], 1.0);
                if own > 0.0 { 1.0 - (others / own * share).sqrt() } else { 0.0 }
            })
            .collect();
        draws.sort_by(f64::total_cmp);
        [draws[49], draws[1949]]
    }
}
