//! The noise of the data, learnt from their own repetitions and nothing else.
//!
//! Three parts, after the prototype of the contract's section 4: what the whole trial has in common ([`super::shared`]: a
//! gain of that bed, the phase of the hips), an AR(1) noise in proportion to a size S, and white sensor noise:
//!
//! y_c(i) = m_c(i) + Σ_k g_k u_kc(i) + s_c(i) a(i) + b_c e(i), a(i) = φ_c a(i−1) + √(1−φ_c²) w(i), s_c(i) = grain_c S(i).
//!
//! S is |F| in force logs (grains push on all channels alike) and the channel's own mean in walking runs. The parts' sizes
//! maximise the likelihood of the differences between repetitions, which no wrong model can bias.

use super::errors::Errors;
use super::minimise::minimise;
use super::observations::{Observations, Size, interpolate};
use super::shared::{Along, Likelihood, Shared};
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};

/// Noise of one channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChannelNoise {
    /// Standard deviation of the grain noise per size [1; m for torques].
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
    /// Standard deviation along each of [`Shared`]'s directions.
    pub shared: Vec<f64>,
}

/// Repetitions that scatter by less than this share of what they measure are copies, or simulations without noise: our choice,
/// the rounding of a log with six digits.
const COPIES: f64 = 1e-6;

/// What the proportional noise of each unit and channel is proportional to, sample by sample: the mean over repetitions,
/// smoothed over five samples.
pub type Sizes = Vec<Vec<Vec<f64>>>;

/// See [`Sizes`].
pub fn sizes(observations: &Observations) -> Sizes {
    let groups = observations.repetitions();
    let mut out = vec![Vec::new(); observations.units.len()];
    for group in &groups {
        for &u in group {
            let unit = &observations.units[u];
            let mean = |c: usize, at: f64| {
                let of = |v: &usize| {
                    let other = &observations.units[*v];
                    interpolate(&other.progress, &observations.values[other.block(c)], at)
                };
                group.iter().map(of).sum::<f64>() / group.len() as f64
            };
            let channels = observations.channels.len();
            out[u] = match observations.size {
                Size::Force => {
                    let force = unit.progress.iter().map(|&at| mean(0, at).hypot(mean(1, at)));
                    vec![smoothed(&force.collect::<Vec<_>>()); channels]
                }
                Size::Channel => {
                    let own = |c: usize| unit.progress.iter().map(|&at| mean(c, at).abs()).collect::<Vec<_>>();
                    (0..channels).map(|c| smoothed(&own(c))).collect()
                }
            };
        }
    }
    out
}

fn smoothed(size: &[f64]) -> Vec<f64> {
    let window = |i: usize| &size[i.saturating_sub(2)..(i + 3).min(size.len())];
    (0..size.len()).map(|i| window(i).iter().sum::<f64>() / window(i).len() as f64).collect()
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
    /// Channel by channel.
    sizes: Vec<Vec<f64>>,
    /// Directions of what a repetition has in common: which of [`Shared`], and the direction channel by channel.
    shared: Vec<(usize, Vec<Vec<f64>>)>,
    /// Orthonormal differences of the residuals, each channel by channel.
    differences: Vec<Vec<Vec<f64>>>,
}

/// All that noise is learnt from.
pub struct Source<'a> {
    pub observations: &'a Observations,
    pub prediction: &'a [f64],
    pub sizes: &'a Sizes,
    pub shared: &'a [Shared],
    /// What [`super::forward::ForwardModel::model_error`] says at `prediction`. Repetitions differ by none of it.
    pub model_error: &'a [Vec<f64>],
}

impl Source<'_> {
    fn repeats(&self) -> Vec<Repeats> {
        self.observations.repetitions().iter().filter(|g| g.len() > 1).map(|g| self.repeats_of(g)).collect()
    }

    fn repeats_of(&self, group: &[usize]) -> Repeats {
        let observations = self.observations;
        let first = &observations.units[group[0]];
        let ends = |u: &usize| {
            let progress = &observations.units[*u].progress;
            (progress[0], progress[progress.len() - 1])
        };
        let low = group.iter().map(|u| ends(u).0).fold(f64::MIN, f64::max);
        let high = group.iter().map(|u| ends(u).1).fold(f64::MAX, f64::min);
        let slack = 1e-9 + 1e-6 * (high - low).abs(); // rounding of the log
        let common = |i: &usize| (low - slack..=high + slack).contains(&first.progress[*i]);
        let touching = |i: &usize| group.iter().any(|&u| self.reads_at(u, first.progress[*i]));
        let kept: Vec<usize> = (0..first.samples).filter(common).filter(touching).collect();
        let aligned = |u: usize, c: usize, what: &dyn Fn(usize) -> f64| -> Vec<f64> {
            let unit = &observations.units[u];
            let values: Vec<f64> = unit.block(c).map(what).collect();
            kept.iter().map(|&i| interpolate(&unit.progress, &values, first.progress[i])).collect()
        };
        let channels = 0..observations.channels.len();
        let residual = |k: usize| observations.values[k] - self.prediction[k];
        let each: Vec<Vec<Vec<f64>>> =
            group.iter().map(|&u| channels.clone().map(|c| aligned(u, c, &residual)).collect()).collect();
        let mean = channels.clone().flat_map(|c| {
            let all: Vec<_> = group.iter().map(|&u| aligned(u, c, &|k| observations.values[k])).collect();
            (0..kept.len()).map(move |i| all.iter().map(|a| a[i]).sum::<f64>() / all.len() as f64)
        });
        let mean: Vec<f64> = mean.collect();
        let differences = (1..group.len()).map(|k| {
            let norm = ((k * (k + 1)) as f64).sqrt();
            let difference =
                |c: usize, i: usize| (each[..k].iter().map(|e| e[c][i]).sum::<f64>() - k as f64 * each[k][c][i]) / norm;
            channels.clone().map(|c| (0..kept.len()).map(|i| difference(c, i)).collect()).collect()
        });
        Repeats {
            sizes: channels.clone().map(|c| kept.iter().map(|&i| self.sizes[group[0]][c][i]).collect()).collect(),
            shared: self.directions(group[0], &kept, &mean),
            differences: differences.collect(),
        }
    }

    /// Does unit `u` read anything at `progress`? An exact zero in every channel is a simulated intruder in the air: no
    /// sensor read it, and a noise that explained its silence would be none at all.
    fn reads_at(&self, u: usize, progress: f64) -> bool {
        let unit = &self.observations.units[u];
        let reads = |c| interpolate(&unit.progress, &self.observations.values[unit.block(c)], progress) != 0.0;
        (0..self.observations.channels.len()).any(reads)
    }

    /// Directions in the `kept` samples of unit `u`, whose mean over repetitions is `mean`.
    fn directions(&self, u: usize, kept: &[usize], mean: &[f64]) -> Vec<(usize, Vec<Vec<f64>>)> {
        let unit = &self.observations.units[u];
        let mut all = Vec::new();
        for (family, shared) in self.shared.iter().enumerate() {
            match &shared.along {
                Along::Signal => all.push((family, mean.chunks(kept.len().max(1)).map(<[f64]>::to_vec).collect())),
                Along::Stacks(stacks) => all.extend(stacks.iter().map(|stack| {
                    let own = |c: usize| kept.iter().map(|&i| stack[unit.block(c).start + i]).collect();
                    (family, (0..self.observations.channels.len()).map(own).collect())
                })),
            }
        }
        all
    }

    /// A first guess from the size of the differences; the search starts here.
    fn guess(&self, repeats: &[Repeats]) -> Noise {
        let channel = |c: usize| {
            let (mut square, mut size, mut count) = (0.0, 0.0, 0.0);
            for r in repeats {
                for d in &r.differences {
                    square += d[c].iter().map(|v| v * v).sum::<f64>();
                    size += r.sizes[c].iter().map(|m| m * m).sum::<f64>();
                    count += d[c].len() as f64;
                }
            }
            // A log without any scatter still has its last digit: 1e-9 keeps the likelihood finite.
            let sd = (square / f64::max(count, 1.0)).sqrt().max(1e-9);
            let grain = 0.7 * sd / (size / f64::max(count, 1.0)).sqrt().max(1e-9);
            // One number a unit has no correlation along it.
            let phi = if self.observations.units.iter().any(|u| u.samples > 1) { 0.6 } else { 0.0 };
            ChannelNoise { grain, sensor: 0.3 * sd, phi }
        };
        let channels = (0..self.observations.channels.len()).map(channel).collect();
        Noise { channels, shared: self.shared.iter().map(|s| s.guess).collect() }
    }

    /// Learns the noise from the repetitions; `start` is an earlier estimate of nearly the same data. Once `stopped` it is
    /// whatever has been found.
    pub fn noise(&self, start: Option<&Noise>, stopped: &dyn Fn() -> bool) -> Noise {
        let repeats = self.repeats();
        let center = self.guess(&repeats).pack();
        let channels = self.observations.channels.len();
        // A prior of three e-folds about the guess: it matters only where the data say nothing.
        let deviance = |p: &[f64]| {
            if stopped() {
                return f64::INFINITY;
            }
            let prior: f64 = p.iter().zip(&center).map(|(a, b)| ((a - b) / 3.0).powi(2)).sum();
            prior + Noise::unpack(p, channels).deviance(&repeats)
        };
        let (from, rounds) = start.map_or((center.clone(), 60), |s| (s.pack(), 12));
        Noise::unpack(&minimise(deviance, from, rounds), channels)
    }

    /// Scatter of repetitions over the channels that count in the error: what no model can predict. Conditions made once have
    /// none to show.
    pub fn floor(&self) -> Errors {
        let of = |group: &Vec<usize>| {
            let (mut square, mut count) = (0.0, 0.0);
            for difference in self.repeats_of(group).differences {
                for (values, _) in difference.iter().zip(&self.observations.channels).filter(|d| d.1.in_rmse) {
                    square += values.iter().map(|v| v * v).sum::<f64>();
                    count += values.len() as f64;
                }
            }
            (square, count)
        };
        let (square, count) = self.observations.repetitions().iter().map(of).unzip();
        Errors { square, count }
    }
}

/// Do the repetitions scatter, so that they are a noise floor? Copies do not.
pub fn scatters(observations: &Observations, floor: &Errors) -> bool {
    let counted = observations.channels.iter().enumerate().filter(|c| c.1.in_rmse);
    let blocks = counted.flat_map(|(c, _)| observations.units.iter().map(move |u| u.block(c)));
    let (square, count) = blocks.flatten().fold((0.0, 0.0), |(s, n), k| (s + observations.values[k].powi(2), n + 1.0));
    floor.rmse() > COPIES * (square / f64::max(count, 1.0)).sqrt()
}

impl Noise {
    /// Search space of the likelihood: ln grain, ln sensor, atanh φ of each channel, then the shared ones' ln.
    fn pack(&self) -> Vec<f64> {
        let channel = |c: &ChannelNoise| [c.grain.ln(), c.sensor.ln(), c.phi.atanh()];
        self.channels.iter().flat_map(channel).chain(self.shared.iter().map(|s| s.ln())).collect()
    }

    fn unpack(p: &[f64], channels: usize) -> Self {
        let channel = |c: &[f64]| ChannelNoise { grain: c[0].exp(), sensor: c[1].exp(), phi: c[2].tanh() };
        let (own, shared) = p.split_at(3 * channels);
        Self { channels: own.chunks(3).map(channel).collect(), shared: shared.iter().map(|s| s.exp()).collect() }
    }

    /// Adds a draw of this noise to `values`, and of the model's error, alike for all repetitions of a condition.
    pub fn add(&self, source: &Source, values: &mut [f64], rng: &mut impl Rng) {
        for stack in source.model_error {
            let shares: Vec<f64> = source.observations.conditions.iter().map(|_| normal(rng)).collect();
            for unit in &source.observations.units {
                let share = shares[unit.condition];
                source.observations.span(unit).for_each(|k| values[k] += share * stack[k]);
            }
        }
        for (unit, sizes) in source.observations.units.iter().zip(source.sizes) {
            let span = source.observations.span(unit);
            let signal = values[span.clone()].to_vec();
            for (shared, sd) in source.shared.iter().zip(&self.shared) {
                for vector in shared.vectors(span.clone(), &signal) {
                    let share = sd * normal(rng);
                    values[span.clone()].iter_mut().zip(vector).for_each(|(v, u)| *v += share * u);
                }
            }
            for (c, noise) in self.channels.iter().enumerate() {
                let fresh = (1.0 - noise.phi * noise.phi).sqrt();
                let mut grain = normal(rng);
                for (value, size) in values[unit.block(c)].iter_mut().zip(&sizes[c]) {
                    *value += noise.grain * size * grain + noise.sensor * normal(rng);
                    grain = noise.phi * grain + fresh * normal(rng);
                }
            }
        }
    }

    /// Standard deviation of one repetition about the model at every number of the stack.
    pub fn standard_deviation(&self, source: &Source) -> Vec<f64> {
        let mut square = vec![0.0; source.prediction.len()];
        for (unit, sizes) in source.observations.units.iter().zip(source.sizes) {
            for (c, noise) in self.channels.iter().enumerate() {
                for (k, size) in unit.block(c).zip(&sizes[c]) {
                    square[k] = (noise.grain * size).powi(2) + noise.sensor.powi(2);
                }
            }
            let span = source.observations.span(unit);
            for (shared, sd) in source.shared.iter().zip(&self.shared) {
                for vector in shared.vectors(span.clone(), &source.prediction[span.clone()]) {
                    square[span.clone()].iter_mut().zip(vector).for_each(|(s, u)| *s += (sd * u).powi(2));
                }
            }
        }
        for stack in source.model_error {
            square.iter_mut().zip(stack).for_each(|(s, e)| *s += e * e);
        }
        square.into_iter().map(f64::sqrt).collect()
    }

    /// −2 log likelihood of the differences between repetitions.
    fn deviance(&self, repeats: &[Repeats]) -> f64 {
        let mut total = 0.0;
        for repeat in repeats {
            let filters: Vec<_> =
                self.channels.iter().zip(&repeat.sizes).map(|(n, s)| ChannelFilter::new(n, s)).collect();
            let whitened = |channels: &[Vec<f64>], factor: f64| {
                let mut white: Vec<f64> = Vec::with_capacity(channels.iter().map(Vec::len).sum());
                for (filter, values) in filters.iter().zip(channels) {
                    let start = white.len();
                    white.extend(values.iter().map(|v| factor * v));
                    filter.whiten(&mut white[start..]);
                }
                white
            };
            let columns = repeat.shared.iter().map(|(family, d)| whitened(d, self.shared[*family]));
            let shared = Likelihood::new(columns.collect());
            let own: f64 = filters.iter().map(|f| f.log_determinant).sum();
            for difference in &repeat.differences {
                total += own + shared.log_determinant + shared.square(&whitened(difference, 1.0));
            }
        }
        total
    }
}

fn normal(rng: &mut impl Rng) -> f64 {
    StandardNormal.sample(rng)
}
