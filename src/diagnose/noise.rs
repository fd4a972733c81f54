//! The noise of the data, learnt from their own repetitions and nothing else.
//!
//! Three parts, after the prototype of the contract's section 4: a gain of the whole trial (packing of that bed), an
//! AR(1) grain noise in proportion to the size of the force, and white sensor noise:
//!
//! y_c(i) = (1 + g) m_c(i) + s_c(i) a(i) + b_c e(i), a(i) = φ_c a(i−1) + √(1−φ_c²) w(i), s_c(i) = grain_c |F|(i).
//!
//! Their sizes maximise the likelihood of the differences between repetitions, which no wrong model can bias.

use super::observations::{Observations, interpolate};
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};

/// Noise of one channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChannelNoise {
    /// Standard deviation of the grain noise per |F| [1; m for torques].
    pub grain: f64,
    /// Standard deviation of the sensor noise [unit of the channel].
    pub sensor: f64,
    /// Correlation of the grain noise from one sample to the next.
    pub phi: f64,
}

/// Noise of a data set.
#[derive(Clone, Debug, PartialEq)]
pub struct Noise {
    pub channels: Vec<ChannelNoise>,
    /// Standard deviation of the trial gain.
    pub gain: f64,
}

/// Size of the force |F| [N] along every unit, the mean over repetitions smoothed over five samples.
pub fn magnitudes(observations: &Observations) -> Vec<Vec<f64>> {
    let groups = observations.repetitions();
    let mut out = vec![Vec::new(); observations.units.len()];
    for group in &groups {
        for &u in group {
            let unit = &observations.units[u];
            let mut mean = vec![[0.0; 2]; unit.samples];
            for &v in group {
                let other = &observations.units[v];
                for (c, _) in observations.channels.iter().enumerate().take(2) {
                    let values = &observations.values[other.block(c)];
                    for (i, at) in unit.progress.iter().enumerate() {
                        mean[i][c] += interpolate(&other.progress, values, *at) / group.len() as f64;
                    }
                }
            }
            let size: Vec<f64> = mean.iter().map(|f| f[0].hypot(f[1])).collect();
            out[u] = (0..size.len())
                .map(|i| {
                    let window = &size[i.saturating_sub(2)..(i + 3).min(size.len())];
                    window.iter().sum::<f64>() / window.len() as f64
                })
                .collect();
        }
    }
    out
}

/// Whitens one channel of one unit: the innovations of the Kalman filter of grain + sensor noise, unit variance each.
#[derive(Clone, Debug)]
pub struct ChannelFilter {
    phi: f64,
    /// (grain sd, Kalman gain, 1/innovation sd) of each sample.
    steps: Vec<(f64, f64, f64)>,
    pub log_determinant: f64,
}

impl ChannelFilter {
    pub fn new(noise: &ChannelNoise, magnitude: &[f64]) -> Self {
        let phi = noise.phi;
        let (mut variance, mut log_determinant, mut product) = (1.0, 0.0, 1.0);
        let steps: Vec<_> = magnitude
            .iter()
            .map(|size| {
                let s = noise.grain * size;
                let total = s * s * variance + noise.sensor * noise.sensor;
                let gain = variance * s / total;
                // One logarithm for many factors, before their product leaves the range of a number.
                product *= total;
                if !(1e-150..1e150).contains(&product) {
                    log_determinant += f64::ln(product);
                    product = 1.0;
                }
                variance = phi * phi * variance * (1.0 - gain * s) + 1.0 - phi * phi;
                (s, gain, 1.0 / total.sqrt())
            })
            .collect();
        Self { phi, steps, log_determinant: log_determinant + f64::ln(product) }
    }

    /// Replaces `values` by their whitened innovations.
    pub fn whiten(&self, values: &mut [f64]) {
        let mut state = 0.0;
        for (value, (s, gain, inverse)) in values.iter_mut().zip(&self.steps) {
            let innovation = *value - s * state;
            state = self.phi * (state + gain * innovation);
            *value = innovation * inverse;
        }
    }
}

/// Repetitions of one condition, matched by progress: what differs between them only noise can have made.
struct Repeats {
    magnitude: Vec<f64>,
    /// Measured mean of each channel, along which a gain acts.
    mean: Vec<Vec<f64>>,
    /// Orthonormal differences of the residuals, each channel by channel.
    differences: Vec<Vec<Vec<f64>>>,
}

fn repeats(observations: &Observations, prediction: &[f64], magnitudes: &[Vec<f64>]) -> Vec<Repeats> {
    let groups = observations.repetitions();
    groups.iter().filter(|g| g.len() > 1).map(|g| repeats_of(observations, prediction, magnitudes, g)).collect()
}

fn repeats_of(observations: &Observations, prediction: &[f64], magnitudes: &[Vec<f64>], group: &[usize]) -> Repeats {
    let first = &observations.units[group[0]];
    let ends = |u: &usize| {
        let progress = &observations.units[*u].progress;
        (progress[0], progress[progress.len() - 1])
    };
    let low = group.iter().map(|u| ends(u).0).fold(f64::MIN, f64::max);
    let high = group.iter().map(|u| ends(u).1).fold(f64::MAX, f64::min);
    let slack = 1e-9 + 1e-6 * (high - low).abs(); // rounding of the log
    let common = |i: &usize| (low - slack..=high + slack).contains(&first.progress[*i]);
    let kept: Vec<usize> = (0..first.samples).filter(common).collect();
    let aligned = |u: usize, c: usize, what: &dyn Fn(usize) -> f64| -> Vec<f64> {
        let unit = &observations.units[u];
        let values: Vec<f64> = unit.block(c).map(what).collect();
        kept.iter().map(|&i| interpolate(&unit.progress, &values, first.progress[i])).collect()
    };
    let channels = 0..observations.channels.len();
    let residual = |k: usize| observations.values[k] - prediction[k];
    let each: Vec<Vec<Vec<f64>>> =
        group.iter().map(|&u| channels.clone().map(|c| aligned(u, c, &residual)).collect()).collect();
    let mean = channels.clone().map(|c| {
        let all: Vec<_> = group.iter().map(|&u| aligned(u, c, &|k| observations.values[k])).collect();
        (0..kept.len()).map(|i| all.iter().map(|a| a[i]).sum::<f64>() / group.len() as f64).collect()
    });
    let differences = (1..group.len()).map(|k| {
        let norm = ((k * (k + 1)) as f64).sqrt();
        let difference =
            |c: usize, i: usize| (each[..k].iter().map(|e| e[c][i]).sum::<f64>() - k as f64 * each[k][c][i]) / norm;
        channels.clone().map(|c| (0..kept.len()).map(|i| difference(c, i)).collect()).collect()
    });
    Repeats {
        magnitude: kept.iter().map(|&i| magnitudes[group[0]][i]).collect(),
        mean: mean.collect(),
        differences: differences.collect(),
    }
}

impl Noise {
    /// Search space of the likelihood: ln grain, ln sensor, atanh φ of each channel, then ln gain.
    fn pack(&self) -> Vec<f64> {
        let channel = |c: &ChannelNoise| [c.grain.ln(), c.sensor.ln(), c.phi.atanh()];
        self.channels.iter().flat_map(channel).chain([self.gain.ln()]).collect()
    }

    fn unpack(p: &[f64]) -> Self {
        let channel = |c: &[f64]| ChannelNoise { grain: c[0].exp(), sensor: c[1].exp(), phi: c[2].tanh() };
        Self { channels: p[..p.len() - 1].chunks(3).map(channel).collect(), gain: p[p.len() - 1].exp() }
    }

    /// A first guess from the size of the differences; the search starts here.
    fn guess(repeats: &[Repeats], channels: usize) -> Self {
        let channel = |c: usize| {
            let (mut square, mut size, mut count) = (0.0, 0.0, 0.0);
            for r in repeats {
                for d in &r.differences {
                    square += d[c].iter().map(|v| v * v).sum::<f64>();
                    size += r.magnitude.iter().map(|m| m * m).sum::<f64>();
                    count += d[c].len() as f64;
                }
            }
            // A log without any scatter still has its last digit: 1e-9 keeps the likelihood finite.
            let sd = (square / f64::max(count, 1.0)).sqrt().max(1e-9);
            let grain = 0.7 * sd / (size / f64::max(count, 1.0)).sqrt().max(1e-9);
            ChannelNoise { grain, sensor: 0.3 * sd, phi: 0.6 }
        };
        Self { channels: (0..channels).map(channel).collect(), gain: 0.05 }
    }

    /// Learns the noise from the repetitions; `start` is an earlier estimate of nearly the same data.
    pub fn estimate(
        observations: &Observations,
        prediction: &[f64],
        magnitudes: &[Vec<f64>],
        start: Option<&Noise>,
    ) -> Self {
        let repeats = repeats(observations, prediction, magnitudes);
        let guess = Self::guess(&repeats, observations.channels.len());
        let center = guess.pack();
        // A prior of three e-folds about the guess: it matters only where the data say nothing.
        let deviance = |p: &[f64]| {
            let prior: f64 = p.iter().zip(&center).map(|(a, b)| ((a - b) / 3.0).powi(2)).sum();
            prior + Self::unpack(p).deviance(&repeats)
        };
        let (from, rounds) = start.map_or((center.clone(), 60), |s| (s.pack(), 12));
        Self::unpack(&minimise(deviance, from, rounds))
    }

    /// Adds a draw of this noise to `values`.
    pub fn add(&self, observations: &Observations, magnitudes: &[Vec<f64>], values: &mut [f64], rng: &mut impl Rng) {
        for (unit, magnitude) in observations.units.iter().zip(magnitudes) {
            let gain: f64 = 1.0 + self.gain * normal(rng);
            for (c, noise) in self.channels.iter().enumerate() {
                let fresh = (1.0 - noise.phi * noise.phi).sqrt();
                let mut grain = normal(rng);
                for (value, size) in values[unit.block(c)].iter_mut().zip(magnitude) {
                    *value = *value * gain + noise.grain * size * grain + noise.sensor * normal(rng);
                    grain = noise.phi * grain + fresh * normal(rng);
                }
            }
        }
    }

    /// Standard deviation of one repetition at every number of the stack.
    pub fn standard_deviation(
        &self,
        observations: &Observations,
        magnitudes: &[Vec<f64>],
        prediction: &[f64],
    ) -> Vec<f64> {
        let mut out = vec![0.0; prediction.len()];
        for (unit, magnitude) in observations.units.iter().zip(magnitudes) {
            for (c, noise) in self.channels.iter().enumerate() {
                for (k, size) in unit.block(c).zip(magnitude) {
                    out[k] = (self.gain * prediction[k]).hypot(noise.grain * size).hypot(noise.sensor);
                }
            }
        }
        out
    }

    /// −2 log likelihood of the differences between repetitions.
    fn deviance(&self, repeats: &[Repeats]) -> f64 {
        let variance = self.gain * self.gain;
        let mut total = 0.0;
        for repeat in repeats {
            let filters: Vec<_> = self.channels.iter().map(|c| ChannelFilter::new(c, &repeat.magnitude)).collect();
            let mut mean = repeat.mean.clone();
            filters.iter().zip(&mut mean).for_each(|(f, m)| f.whiten(m));
            let length: f64 = mean.iter().flatten().map(|m| m * m).sum();
            let shrink = variance / (1.0 + variance * length);
            for difference in &repeat.differences {
                let (mut square, mut along) = (0.0, 0.0);
                for ((filter, values), mean) in filters.iter().zip(difference).zip(&mean) {
                    let mut white = values.clone();
                    filter.whiten(&mut white);
                    total += filter.log_determinant;
                    square += white.iter().map(|w| w * w).sum::<f64>();
                    along += white.iter().zip(mean).map(|(w, m)| w * m).sum::<f64>();
                }
                total += (variance * length).ln_1p() + square - shrink * along * along;
            }
        }
        total
    }
}

fn normal(rng: &mut impl Rng) -> f64 {
    StandardNormal.sample(rng)
}

/// Standard deviation between repetitions over the channels that count in the error: what no model can predict.
pub fn noise_floor(observations: &Observations, prediction: &[f64], magnitudes: &[Vec<f64>]) -> f64 {
    let (mut square, mut count) = (0.0, 0.0);
    for difference in repeats(observations, prediction, magnitudes).iter().flat_map(|r| &r.differences) {
        for (values, _) in difference.iter().zip(&observations.channels).filter(|d| d.1.in_rmse) {
            square += values.iter().map(|v| v * v).sum::<f64>();
            count += values.len() as f64;
        }
    }
    (square / f64::max(count, 1.0)).sqrt()
}

/// Least value of `f` by BFGS with numerical gradients, from `x`, in at most `rounds` rounds.
fn minimise(f: impl Fn(&[f64]) -> f64, mut x: Vec<f64>, rounds: usize) -> Vec<f64> {
    let n = x.len();
    let gradient = |x: &[f64], value: f64| -> Vec<f64> {
        let slope = |k: usize| {
            let mut moved = x.to_vec();
            moved[k] += 1e-4;
            (f(&moved) - value) / 1e-4
        };
        (0..n).map(slope).collect()
    };
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let mut value = f(&x);
    let mut g = gradient(&x, value);
    let mut inverse: Vec<Vec<f64>> =
        (0..n).map(|i| (0..n).map(|j| if i == j { 1e-2 } else { 0.0 }).collect()).collect();
    for _ in 0..rounds {
        let mut step: Vec<f64> = inverse.iter().map(|row| -dot(row, &g)).collect();
        let longest = step.iter().fold(0.0, |a: f64, b| a.max(b.abs()));
        if longest > 1.0 {
            step.iter_mut().for_each(|s| *s /= longest);
        }
        let slope = dot(&step, &g);
        let mut share = 1.0;
        let moved = loop {
            let trial: Vec<f64> = x.iter().zip(&step).map(|(x, s)| x + share * s).collect();
            let now = f(&trial);
            if now < value + 1e-4 * share * slope {
                break Some((trial, now));
            }
            share *= 0.4;
            if share < 1e-3 {
                break None;
            }
        };
        let Some((next, now)) = moved else { break };
        let gained = value - now;
        let after = gradient(&next, now);
        let s: Vec<f64> = next.iter().zip(&x).map(|(a, b)| a - b).collect();
        let y: Vec<f64> = after.iter().zip(&g).map(|(a, b)| a - b).collect();
        update_inverse(&mut inverse, &s, &y);
        (x, value, g) = (next, now, after);
        if gained < 1e-2 {
            break;
        }
    }
    x
}

/// BFGS update of the inverse Hessian by a step `s` that changed the gradient by `y`.
fn update_inverse(inverse: &mut [Vec<f64>], s: &[f64], y: &[f64]) {
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let curvature = dot(s, y);
    if curvature <= 1e-12 {
        return;
    }
    let hy: Vec<f64> = inverse.iter().map(|row| dot(row, y)).collect();
    let factor = (1.0 + dot(y, &hy) / curvature) / curvature;
    for i in 0..s.len() {
        for j in 0..s.len() {
            inverse[i][j] += factor * s[i] * s[j] - (hy[i] * s[j] + s[i] * hy[j]) / curvature;
        }
    }
}
