//! PPO's loss (Schulman et al. 2017, arXiv:1707.06347) over some samples, and its derivatives, term by term as in
//! stable-baselines3 2.9.

use std::ops::AddAssign;

/// ln √(2π)
const LN_SQRT_TAU: f32 = 0.918_938_5;

/// Parameters of the loss.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LossWeights {
    /// Clip range of the probability ratio to the old policy.
    pub clip: f32,
    /// Clip range of the value; None: not clipped.
    pub clip_value: Option<f32>,
    /// Weight of the value's squared error; the policy's part has weight 1.
    pub value: f32,
    /// Are the actions those of a teacher, which the means imitate? The policy's part is then half of the squared distance.
    pub imitates: bool,
    /// Number of samples in the whole minibatch, of which these may be a part.
    pub samples: usize,
}

/// Samples, one row each.
pub struct Samples<'a> {
    /// f32 [n, action]
    pub actions: &'a [f32],
    /// Logarithm of the actions' probability when they were chosen.
    pub log_probabilities: &'a [f32],
    /// Normalized.
    pub advantages: &'a [f32],
    /// Target of the value.
    pub returns: &'a [f32],
    /// Value when the action was chosen.
    pub values: &'a [f32],
}

/// Sums over samples, for reports.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LossSums {
    pub samples: f64,
    pub policy: f64,
    pub value: f64,
    pub clipped: f64,
    /// Estimate of the divergence of the new policy from the old one: (r − 1) − ln r, with the ratio r of their
    /// probabilities of the action (J. Schulman 2020).
    pub kl: f64,
}

impl AddAssign for LossSums {
    fn add_assign(&mut self, other: Self) {
        self.samples += other.samples;
        self.policy += other.policy;
        self.value += other.value;
        self.clipped += other.clipped;
        self.kl += other.kl;
    }
}

/// A normal distribution's standard deviations, in the forms that are needed.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ActionNoise {
    /// f32 [action]: 1 / standard deviation.
    inverse: Vec<f32>,
    /// Logarithm of the density at the mean.
    peak: f32,
}

impl ActionNoise {
    pub fn set(&mut self, log_std: &[f32]) {
        self.inverse.clear();
        self.inverse.extend(log_std.iter().map(|s| (-s).exp()));
        self.peak = -log_std.iter().map(|s| s + LN_SQRT_TAU).sum::<f32>();
    }

    /// Logarithm of the probability density of `action`.
    pub fn log_probability(&self, action: &[f32], mean: &[f32]) -> f32 {
        let scaled = action.iter().zip(mean).zip(&self.inverse).map(|((a, m), scale)| (a - m) * scale);
        self.peak - 0.5 * scaled.map(|z| z * z).sum::<f32>()
    }
}

/// Entropy of the distribution.
pub fn entropy(log_std: &[f32]) -> f32 {
    log_std.iter().map(|s| 0.5 + LN_SQRT_TAU + s).sum()
}

/// Outputs for the derivatives of the loss.
pub struct LossSlopes<'a> {
    /// f32 [n, action]
    pub means: &'a mut [f32],
    /// f32 [n]
    pub values: &'a mut [f32],
    /// f32 [action]; the derivatives are added to it.
    pub log_std: &'a mut [f32],
}

/// Derivatives of the mean loss by the networks' outputs `means` and `values`, and by the logarithms of the standard
/// deviations. The derivatives of the entropy are left out, because they do not depend on the samples.
pub fn slopes(
    weights: &LossWeights,
    samples: &Samples,
    means: &[f32],
    values: &[f32],
    spread: &ActionNoise,
    out: LossSlopes,
) -> LossSums {
    let (width, share) = (spread.inverse.len(), 1.0 / weights.samples as f32);
    let mut sums = LossSums { samples: samples.returns.len() as f64, ..LossSums::default() };
    for (i, goal) in samples.returns.iter().enumerate() {
        let row = i * width..(i + 1) * width;
        let (action, mean) = (&samples.actions[row.clone()], &means[row.clone()]);
        let moved = values[i] - samples.values[i];
        let (predicted, follows) = match weights.clip_value {
            Some(clip) => (samples.values[i] + moved.clamp(-clip, clip), moved.abs() <= clip),
            None => (values[i], true),
        };
        let missed = predicted - goal;
        out.values[i] = if follows { 2.0 * weights.value * missed * share } else { 0.0 };
        sums.value += f64::from(missed * missed);
        if weights.imitates {
            for ((slope, a), m) in out.means[row].iter_mut().zip(action).zip(mean) {
                *slope = (m - a) * share;
                sums.policy += 0.5 * f64::from((m - a) * (m - a));
            }
            continue;
        }
        let log_ratio = spread.log_probability(action, mean) - samples.log_probabilities[i];
        let (ratio, advantage) = (log_ratio.exp(), samples.advantages[i]);
        let held = ratio.clamp(1.0 - weights.clip, 1.0 + weights.clip);
        let (free, bound) = (advantage * ratio, advantage * held);
        let slope = if free <= bound || ratio == held { -advantage * ratio * share } else { 0.0 };
        let slopes = out.means[row].iter_mut().zip(out.log_std.iter_mut());
        for (((mean_slope, std_slope), (a, m)), scale) in slopes.zip(action.iter().zip(mean)).zip(&spread.inverse) {
            let z = (a - m) * scale;
            *mean_slope = slope * z * scale;
            *std_slope += slope * (z * z - 1.0);
        }
        sums.policy -= f64::from(if free.is_nan() { free } else { free.min(bound) });
        sums.clipped += f64::from(u8::from((ratio - 1.0).abs() > weights.clip));
        sums.kl += f64::from(ratio - 1.0 - log_ratio);
    }
    sums
}
