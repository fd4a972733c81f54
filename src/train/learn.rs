//! Computes gradients from a rollout: minibatches in random order, each divided into chunks for threads.

use super::loss::{ActionNoise, LossSlopes, LossSums, LossWeights, Samples, slopes};
use super::network::{NetworkPass, Networks};
use rand::seq::SliceRandom as _;
use rand_xoshiro::Xoshiro256PlusPlus;

/// Number of samples that a thread takes at a time, the same for any number of threads: enough for fast matrix
/// products, and few enough to stay in a processor's own cache.
pub const CHUNK: usize = 128;

/// The transitions, one row for each step of an environment.
#[derive(Clone, Debug, Default)]
pub struct RolloutBuffer {
    pub observations: Vec<f32>,
    pub actions: Vec<f32>,
    pub log_probabilities: Vec<f32>,
    pub values: Vec<f32>,
    pub rewards: Vec<f32>,
    pub advantages: Vec<f32>,
    pub returns: Vec<f32>,
}

impl RolloutBuffer {
    pub fn new(rows: usize, observation: usize, action: usize) -> Self {
        let row = || vec![0.0; rows];
        Self {
            observations: vec![0.0; rows * observation],
            actions: vec![0.0; rows * action],
            log_probabilities: row(),
            values: row(),
            rewards: row(),
            advantages: row(),
            returns: row(),
        }
    }

    pub fn clear(&mut self) {
        self.all().into_iter().for_each(Vec::clear);
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.rewards.len()
    }

    /// Adds the rows of `other`, except those with the indices `skipped`, which ascend.
    pub fn append(&mut self, other: &mut Self, skipped: &[usize]) {
        let rows = other.rows();
        for (all, more) in self.all().into_iter().zip(other.all()) {
            let (width, mut first) = (more.len() / rows, 0);
            for end in skipped.iter().copied().chain([rows]) {
                all.extend_from_slice(&more[first * width..end * width]);
                first = end + 1;
            }
        }
    }

    fn all(&mut self) -> [&mut Vec<f32>; 7] {
        let Self { observations, actions, log_probabilities, values, rewards, advantages, returns } = self;
        [observations, actions, log_probabilities, values, rewards, advantages, returns]
    }

    /// Share of the returns' variance that the values explain.
    pub fn explained_variance(&self) -> f64 {
        let n = self.returns.len() as f64;
        let variance = |x: &mut dyn Iterator<Item = f64>| {
            let (sum, squares) = x.fold((0.0, 0.0), |(s, q), x| (s + x, q + x * x));
            squares / n - sum / n * (sum / n)
        };
        let returns = variance(&mut self.returns.iter().map(|r| f64::from(*r)));
        let missed = self.returns.iter().zip(&self.values).map(|(r, v)| f64::from(r - v));
        let missed = variance(&mut { missed });
        if returns > 0.0 { 1.0 - missed / returns } else { f64::NAN }
    }
}

/// The samples of a minibatch, and the normalization of their advantages.
#[derive(Clone, Debug, Default)]
pub struct Minibatches {
    /// Rows of the rollout in this epoch's order.
    order: Vec<u32>,
    /// Place of the present minibatch in `order`.
    first: usize,
    count: usize,
    /// Mean and 1 / standard deviation of its advantages.
    mean: f32,
    scale: f32,
}

impl Minibatches {
    pub fn shuffle(&mut self, rows: usize, random: &mut Xoshiro256PlusPlus) {
        // Starts from the same order each time, so that the result is a function of the random numbers.
        self.order.clear();
        self.order.extend(0..rows as u32);
        self.order.shuffle(random);
    }

    /// Selects the minibatch that begins at `first`. Advantages are normalized by their mean and standard
    /// deviation.
    pub fn take(&mut self, rollout: &RolloutBuffer, first: usize, size: usize, normalize: bool) -> usize {
        (self.first, self.count) = (first, size.min(self.order.len() - first));
        (self.mean, self.scale) = (0.0, 1.0);
        if normalize && self.count > 1 {
            let all =
                || self.order[first..first + self.count].iter().map(|i| f64::from(rollout.advantages[*i as usize]));
            let n = self.count as f64;
            let mean = all().sum::<f64>() / n;
            let variance = all().map(|a| (a - mean) * (a - mean)).sum::<f64>() / (n - 1.0);
            (self.mean, self.scale) = (mean as f32, (1.0 / (variance.sqrt() + 1e-8)) as f32);
        }
        self.count
    }

    /// Number of chunks in the present minibatch.
    pub fn chunks(&self) -> usize {
        self.count.div_ceil(CHUNK)
    }
}

/// Work space and results of a chunk.
pub struct Chunk {
    pass: NetworkPass,
    spread: ActionNoise,
    batch: RolloutBuffer,
    means: Vec<f32>,
    values: Vec<f32>,
    log_std: Vec<f32>,
    pub gradient: Vec<f32>,
    pub sums: LossSums,
}

impl Chunk {
    pub fn new(networks: &Networks) -> Self {
        let shape = &networks.shape;
        Self {
            pass: networks.pass(CHUNK),
            spread: ActionNoise::default(),
            batch: RolloutBuffer::new(CHUNK, shape.observation, shape.action),
            means: vec![0.0; CHUNK * shape.action],
            values: vec![0.0; CHUNK],
            log_std: vec![0.0; shape.action],
            gradient: vec![0.0; shape.parameters],
            sums: LossSums::default(),
        }
    }

    /// Computes, for chunk `index` of the present minibatch, the gradient of the loss without the entropy, and the sums
    /// for reports.
    pub fn learn(
        &mut self,
        networks: &Networks,
        parameters: &[f32],
        rollout: &RolloutBuffer,
        minibatches: &Minibatches,
        index: usize,
        weights: &LossWeights,
    ) {
        let (first, end) = (index * CHUNK, minibatches.count.min((index + 1) * CHUNK));
        let rows = &minibatches.order[minibatches.first + first..minibatches.first + end];
        let shape = &networks.shape;
        let (wide, width, count) = (shape.observation, shape.action, rows.len());
        let batch = &mut self.batch;
        for (k, row) in rows.iter().enumerate() {
            let i = *row as usize;
            batch.actions[k * width..(k + 1) * width].copy_from_slice(&rollout.actions[i * width..(i + 1) * width]);
            batch.log_probabilities[k] = rollout.log_probabilities[i];
            batch.values[k] = rollout.values[i];
            batch.returns[k] = rollout.returns[i];
            batch.advantages[k] = (rollout.advantages[i] - minibatches.mean) * minibatches.scale;
        }
        networks.forward(parameters, &mut self.pass, count, |out| {
            for (out, row) in out.chunks_exact_mut(wide).zip(rows) {
                out.copy_from_slice(&rollout.observations[*row as usize * wide..][..wide]);
            }
        });
        let samples = Samples {
            actions: &batch.actions,
            log_probabilities: &batch.log_probabilities,
            advantages: &batch.advantages,
            returns: &batch.returns[..count],
            values: &batch.values,
        };
        self.spread.set(&parameters[shape.log_std.clone()]);
        self.log_std.fill(0.0);
        let out = LossSlopes { means: &mut self.means, values: &mut self.values, log_std: &mut self.log_std };
        self.sums = slopes(weights, &samples, &self.pass.means, &self.pass.values, &self.spread, out);
        self.gradient.fill(0.0);
        self.gradient[shape.log_std.clone()].copy_from_slice(&self.log_std);
        networks.backward(parameters, &mut self.pass, &self.means, &self.values, &mut self.gradient);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn skipped_rows_are_left_out() {
        let mut part = RolloutBuffer::new(5, 2, 1);
        part.observations = (0..10).map(|k| k as f32).collect();
        part.rewards = (0..5).map(|k| k as f32).collect();
        let mut all = RolloutBuffer::default();
        all.append(&mut part, &[0, 2, 4]);
        all.append(&mut part, &[]);
        all.append(&mut part, &[0, 1, 2, 3, 4]);
        assert_eq!(all.rewards, [1.0, 3.0, 0.0, 1.0, 2.0, 3.0, 4.0]);
        assert_eq!(all.observations[..6], [2.0, 3.0, 6.0, 7.0, 0.0, 1.0]);
        assert_eq!((all.rows(), all.actions.len()), (7, 7));
    }
}
