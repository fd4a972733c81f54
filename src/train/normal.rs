//! Running means and variances, and normalization by them, as in stable-baselines3's `VecNormalize`.

/// Added to a variance before its root is taken; the value of `VecNormalize`.
pub const EPSILON: f64 = 1e-8;
/// Normalized numbers are clipped to ± this; the value of `VecNormalize`.
pub const CLIP: f32 = 10.0;

/// Mean and variance of all rows so far, number by number.
#[derive(Clone, Debug, PartialEq)]
pub struct RunningStatistics {
    pub mean: Vec<f64>,
    pub variance: Vec<f64>,
    pub count: f64,
}

impl RunningStatistics {
    /// Statistics without rows. The initial count is 1e-4 as in `VecNormalize`, so that the first rows dominate.
    pub fn new(width: usize) -> Self {
        Self { mean: vec![0.0; width], variance: vec![1.0; width], count: 1e-4 }
    }

    /// Adds rows with these moments (Chan, Golub & LeVeque 1983).
    pub fn update(&mut self, rows: &BatchMoments) {
        if rows.count == 0.0 {
            return;
        }
        let total = self.count + rows.count;
        for (k, (mean, variance)) in self.mean.iter_mut().zip(&mut self.variance).enumerate() {
            let delta = rows.mean[k] - *mean;
            let squares = *variance * self.count + rows.squares[k] + delta * delta * self.count * rows.count / total;
            *mean += delta * rows.count / total;
            *variance = squares / total;
        }
        self.count = total;
    }
}

/// Mean of some rows, and their sums of squared deviations from it.
#[derive(Clone, Debug, PartialEq)]
pub struct BatchMoments {
    pub count: f64,
    pub mean: Vec<f64>,
    pub squares: Vec<f64>,
}

impl BatchMoments {
    pub fn new(width: usize) -> Self {
        Self { count: 0.0, mean: vec![0.0; width], squares: vec![0.0; width] }
    }

    /// Computes the moments of `rows`.
    pub fn set<T: Copy + Into<f64>>(&mut self, rows: &[T]) {
        let width = self.mean.len();
        self.count = (rows.len() / width) as f64;
        self.mean.fill(0.0);
        self.squares.fill(0.0);
        if rows.is_empty() {
            return;
        }
        for row in rows.chunks_exact(width) {
            self.mean.iter_mut().zip(row).for_each(|(sum, x)| *sum += (*x).into());
        }
        self.mean.iter_mut().for_each(|sum| *sum /= self.count);
        for row in rows.chunks_exact(width) {
            for ((sum, mean), x) in self.squares.iter_mut().zip(&self.mean).zip(row) {
                let d = (*x).into() - mean;
                *sum += d * d;
            }
        }
    }

    /// Adds the rows of `other` to these moments.
    pub fn join(&mut self, other: &Self) {
        if other.count == 0.0 {
            return;
        }
        let total = self.count + other.count;
        for k in 0..self.mean.len() {
            let delta = other.mean[k] - self.mean[k];
            self.mean[k] += delta * other.count / total;
            self.squares[k] += other.squares[k] + delta * delta * self.count * other.count / total;
        }
        self.count = total;
    }
}

/// Statistics for the normalization of observations and rewards.
#[derive(Clone, Debug, PartialEq)]
pub struct Normalizer {
    pub observations: RunningStatistics,
    /// Statistics of the discounted sums of rewards.
    pub returns: RunningStatistics,
}

impl Normalizer {
    pub fn new(width: usize) -> Self {
        Self { observations: RunningStatistics::new(width), returns: RunningStatistics::new(1) }
    }

    pub fn scales(&self) -> NormalizerScales {
        let both = self.observations.mean.iter().zip(&self.observations.variance);
        NormalizerScales {
            rows: both.map(|(mean, variance)| [*mean, 1.0 / (variance + EPSILON).sqrt()]).collect(),
            reward: 1.0 / (self.returns.variance[0] + EPSILON).sqrt(),
        }
    }
}

/// The factors of [`Normalizer`] at one time.
#[derive(Clone, Debug, PartialEq)]
pub struct NormalizerScales {
    /// Mean and 1/σ of each number of an observation.
    pub rows: Vec<[f64; 2]>,
    /// 1/σ of the returns.
    pub reward: f64,
}

impl NormalizerScales {
    /// Fills `out` with normalized `rows`.
    pub fn observations(&self, rows: &[f32], out: &mut [f32]) {
        let width = self.rows.len();
        for (row, out) in rows.chunks_exact(width).zip(out.chunks_exact_mut(width)) {
            for ((x, [mean, scale]), out) in row.iter().zip(&self.rows).zip(out) {
                *out = (((f64::from(*x) - mean) * scale) as f32).clamp(-CLIP, CLIP);
            }
        }
    }

    pub fn rewards(&self, rewards: &mut [f32]) {
        for reward in rewards {
            *reward = ((f64::from(*reward) * self.reward) as f32).clamp(-CLIP, CLIP);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Mean and variance are the same whether rows are added in pieces or at once.
    #[test]
    fn pieces_add_up() {
        let rows: Vec<f32> = (0..600).map(|k| (k as f32 * 0.37).sin() + (k % 3) as f32).collect();
        let mut running = RunningStatistics::new(3);
        for batch in rows.chunks(150) {
            let mut all = BatchMoments::new(3);
            for piece in batch.chunks(60) {
                let mut moments = BatchMoments::new(3);
                moments.set(piece);
                all.join(&moments);
            }
            running.update(&all);
        }
        for k in 0..3 {
            let column: Vec<f64> = rows.iter().skip(k).step_by(3).map(|x| f64::from(*x)).collect();
            let mean = column.iter().sum::<f64>() / 200.0;
            let variance = column.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / 200.0;
            // The initial statistics count as 1e-4 rows.
            assert!((running.mean[k] - mean).abs() < 1e-5 && (running.variance[k] - variance).abs() < 1e-5);
        }
    }
}
