//! Tests whether a residual contains anything but noise.
//!
//! Whitened noise is white, and the error of a wrong model is smooth. So the whitened residual of each trial and
//! channel is projected on the first few cosines along the trial, repetitions of a condition are averaged (which
//! reduces noise but not misfit), and the squares are summed. The mean square is 1 for noise alone.

use super::observations::Observations;
use std::f64::consts::PI;

/// Number of cosines along a trial: our choice; features shorter than an eighth of a trial count as noise.
const WAVES: usize = 8;

/// Difference of a whitened residual from noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lack {
    /// Mean square of the smooth part: 1 for noise alone.
    pub mean: f64,
    /// For each channel of each condition, the sum of squares minus their number, in its standard deviations for noise
    /// alone; the greatest of these. A mean over many conditions would not show the misfit of a single one.
    pub worst: f64,
    /// Sum of the squares minus their number, and that number.
    pub excess: f64,
    pub count: f64,
}

/// Lack of fit of a whitened residual.
pub fn statistic(observations: &Observations, white: &[f64]) -> Lack {
    let (mut square, mut count, mut worst) = (0.0, 0.0, f64::MIN);
    for group in observations.repetitions() {
        for channel in 0..observations.channels.len() {
            let mut sums = [0.0; WAVES];
            let mut waves = WAVES;
            for &u in &group {
                let unit = &observations.units[u];
                waves = waves.min(unit.samples);
                add_waves(&white[unit.block(channel)], &mut sums);
            }
            let own = sums[..waves].iter().map(|s| s * s / group.len() as f64).sum::<f64>();
            square += own;
            count += waves as f64;
            worst = worst.max((own - waves as f64) / (2.0 * waves as f64).sqrt());
        }
    }
    Lack { mean: square / f64::max(count, 1.0), worst, excess: square - count, count }
}

/// Adds the coefficients of `values` on orthonormal cosines (DCT-II).
fn add_waves(values: &[f64], sums: &mut [f64; WAVES]) {
    let n = values.len() as f64;
    for (k, sum) in sums.iter_mut().enumerate() {
        let norm = if k == 0 { (1.0 / n).sqrt() } else { (2.0 / n).sqrt() };
        // cos(πk(i+½)/n) by the Chebyshev recurrence in i
        let turn = 2.0 * (PI * k as f64 / n).cos();
        let (mut before, mut now) = ((PI * k as f64 * -0.5 / n).cos(), (PI * k as f64 * 0.5 / n).cos());
        let mut total = 0.0;
        for value in values {
            total += value * now;
            (before, now) = (now, turn * now - before);
        }
        *sum += norm * total;
    }
}
