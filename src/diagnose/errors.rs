//! Sizes of errors, and the fraction by which one is smaller than another.

use super::observations::Observations;
use rand::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

/// Errors over the channels that count in the error, condition by condition.
#[derive(Clone, Debug)]
pub struct SquaredErrors {
    /// Sum of squares [unit of the channels, squared] and number of values.
    pub square: Vec<f64>,
    pub count: Vec<f64>,
}

impl SquaredErrors {
    /// Root mean square over all conditions.
    pub fn rmse(&self) -> f64 {
        (self.square.iter().sum::<f64>() / self.count.iter().sum::<f64>().max(1.0)).sqrt()
    }

    /// Errors of a prediction on the conditions `held`, over the channels that count. `prediction` gives each number of the stack.
    pub fn of(o: &Observations, prediction: impl Fn(usize) -> f64, held: &[usize]) -> Self {
        let of = |&condition: &usize| {
            let units = o.units.iter().filter(|u| u.condition == condition);
            let counted = o.channels.iter().enumerate().filter(|c| c.1.in_rmse).map(|c| c.0);
            let blocks = units.flat_map(|u| counted.clone().map(|c| u.block(c)));
            let add =
                |(square, count): (f64, f64), k: usize| (square + (o.values[k] - prediction(k)).powi(2), count + 1.0);
            blocks.flatten().fold((0.0, 0.0), add)
        };
        let (square, count) = held.iter().map(of).unzip();
        Self { square, count }
    }

    /// 95 % interval of the fraction by which `other` is smaller than these errors: bootstrap over conditions. 2000
    /// draws are our choice, because 50 of them are then beyond each end; a fixed seed makes reports repeatable.
    pub fn reduction_interval(&self, other: &SquaredErrors) -> [f64; 2] {
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
