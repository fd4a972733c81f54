//! Differences of two models, condition by condition, and their standard errors.

use crate::student;

/// Half of the 95 % interval of a normal distribution in standard deviations. Quantiles of Student's t are divided by this.
pub const NORMAL: f64 = 1.96;

/// What one condition adds to a difference of two models: the difference, and the two estimates of its variance that
/// [`super::evidence`] explains.
#[derive(Clone, Copy, Debug, Default)]
pub struct SumPart {
    pub gain: f64,
    /// Variance if the errors are noise.
    pub noise: f64,
    /// Variance if the errors are the model's own, correlated within the condition.
    pub clusters: f64,
}

/// The sum of all parts and its standard error, widened by Student's t; `degrees` are those of the noise.
pub fn summed(parts: &[SumPart], degrees: f64) -> [f64; 2] {
    let (mut sum, count) = (SumPart::default(), parts.len() as f64);
    for part in parts {
        sum.gain += part.gain;
        sum.noise += part.noise;
        sum.clusters += part.clusters;
    }
    let mean = sum.gain / count.max(1.0);
    let others = (count - 1.0).max(1.0);
    let spread = parts.iter().map(|part| (part.gain - mean).powi(2)).sum::<f64>() * count / others;
    let of = |variance: f64, degrees: f64| variance.max(0.0).sqrt() * student::two_sided_95(degrees) / NORMAL;
    [sum.gain, of(sum.noise, degrees).max(of(sum.clusters.min(spread), others))]
}
