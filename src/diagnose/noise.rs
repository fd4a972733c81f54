//! The model of the noise in the data. Its parameters are learnt from the data's own repetitions, see
//! [`super::noise_search`].
//!
//! The noise has three parts: a part that all numbers of a trial share ([`super::shared`]: from the strength of its bed
//! or the phase of the hips), the noise of grains, which is an AR(1) noise in proportion to a size S, and white sensor
//! noise:
//!
//! y_c(i) = m_c(i) + Σ_k g_k u_kc(i) + s_c(i) a(i) + b_c e(i), a(i) = φ a(i−1) + √(1−φ²) w(i), s_c(i) = grain_c
//! S(i).
//!
//! S is |F| in force logs (grains push on all channels alike) and the channel's own mean in walking runs. φ is the
//! correlation over a step of a [`NoiseClock`]. The noise of grains is correlated along the path, and the noise of
//! filters and amplifiers in time; which clock is used follows from the repetitions. The parameters maximise the
//! likelihood of the differences between repetitions, which do not depend on the model of the sand.

use super::observations::{Observations, Size, Unit};
use super::series::interpolate;
use super::shared::Uncertainty;
use crate::number::{Doubles, Kernel, Real};

/// Number of channels that are whitened together: our choice, two registers of AVX2.
pub const LANES: usize = 8;

/// Noise of one channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChannelNoise {
    /// Standard deviation of the grain noise divided by the size S [1; m for torques].
    pub grain: f64,
    /// Standard deviation of the sensor noise [unit of the channel].
    pub sensor: f64,
    /// Correlation of the grain noise from one step of the clock to the next, 0…1.
    pub phi: f64,
}

/// The coordinate along which the grain noise is correlated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoiseClock {
    /// The correlation is from sample to sample.
    Sample,
    /// The correlation is along the path. A step is a sixtieth of the path: our choice, on which φ depends, but not the noise.
    Path,
}

impl NoiseClock {
    /// Number of steps from each sample to the one before; none for the first.
    pub fn steps(self, progress: &[f64]) -> Vec<f64> {
        let way = progress.last().zip(progress.first()).map_or(0.0, |(last, first)| last - first);
        let step = |i: usize| match self {
            NoiseClock::Sample => 1.0,
            NoiseClock::Path => (60.0 * (progress[i] - progress[i - 1]) / way.max(1e-12)).max(1e-3),
        };
        (0..progress.len()).map(|i| if i == 0 { 0.0 } else { step(i) }).collect()
    }
}

/// Noise of a data set.
#[derive(Clone, Debug, PartialEq)]
pub struct Noise {
    pub clock: NoiseClock,
    pub channels: Vec<ChannelNoise>,
    /// Standard deviation along each of [`super::shared::SharedNoise`]'s directions.
    pub shared: Vec<f64>,
}

/// The size S for each sample of each unit and channel: the mean over repetitions, smoothed over five samples.
pub type Sizes = Vec<Vec<Vec<f64>>>;

/// The sizes of the measured values.
pub fn sizes(observations: &Observations) -> Sizes {
    sizes_of(observations, &observations.values)
}

/// The sizes of `values`, for instance those of a model's prediction. If a model is near the data, the sizes of its
/// prediction are better than measured sizes: with these, samples that noise has made small would get too much weight,
/// and every fit would be too low.
pub fn sizes_of(observations: &Observations, values: &[f64]) -> Sizes {
    let (groups, channels) = (observations.repetitions(), observations.channels.len());
    let of = |unit: &Unit| {
        let group = &groups[unit.condition];
        let mean = |c: usize, at: f64| {
            let of = |v: &usize| {
                let other = &observations.units[*v];
                interpolate(&other.progress, &values[other.block(c)], at)
            };
            group.iter().map(of).sum::<f64>() / group.len() as f64
        };
        match observations.size {
            Size::Force => {
                let force = unit.progress.iter().map(|&at| mean(0, at).hypot(mean(1, at)));
                vec![smoothed(&force.collect::<Vec<_>>()); channels]
            }
            Size::Channel => {
                let own = |c: usize| unit.progress.iter().map(|&at| mean(c, at).abs()).collect::<Vec<_>>();
                (0..channels).map(|c| smoothed(&own(c))).collect()
            }
        }
    };
    observations.units.iter().map(of).collect()
}

fn smoothed(size: &[f64]) -> Vec<f64> {
    let window = |i: usize| &size[i.saturating_sub(2)..(i + 3).min(size.len())];
    (0..size.len()).map(|i| window(i).iter().sum::<f64>() / window(i).len() as f64).collect()
}

/// Whitens one channel of one unit: the innovations of the Kalman filter of grain + sensor noise, unit variance each.
#[derive(Clone, Debug)]
pub struct ChannelFilter {
    /// For each sample: correlation with the sample before, standard deviation of the grain noise, Kalman gain, and
    /// 1/standard deviation of the innovation.
    steps: Vec<[f64; 4]>,
    pub log_determinant: f64,
}

impl ChannelFilter {
    /// `clock` has the steps between samples ([`NoiseClock::steps`]), and `own` the additional variance of each sample;
    /// it may be empty.
    pub fn new(noise: &ChannelNoise, magnitude: &[f64], clock: &[f64], own: &[f64]) -> Self {
        let (mut variance, mut log_determinant, mut product) = (1.0, 0.0, 1.0);
        let steps: Vec<_> = magnitude
            .iter()
            .zip(clock)
            .enumerate()
            .map(|(i, (size, step))| {
                let phi = if *step == 1.0 { noise.phi } else { noise.phi.powf(*step) };
                variance = phi * phi * variance + 1.0 - phi * phi;
                let s = noise.grain * size;
                let total = s * s * variance + noise.sensor * noise.sensor + own.get(i).copied().unwrap_or(0.0);
                let gain = variance * s / total;
                // Takes one logarithm for a product of many factors, before the product overflows.
                product *= total;
                if !(1e-150..1e150).contains(&product) {
                    log_determinant += f64::ln(product);
                    product = 1.0;
                }
                variance *= 1.0 - gain * s;
                [phi, s, gain, 1.0 / total.sqrt()]
            })
            .collect();
        Self { steps, log_determinant: log_determinant + f64::ln(product) }
    }

    /// Replaces `values` by their whitened innovations.
    pub fn whiten(&self, values: &mut [f64]) {
        let mut state = 0.0;
        for (value, [phi, s, gain, inverse]) in values.iter_mut().zip(&self.steps) {
            state *= phi;
            let innovation = *value - s * state;
            state += gain * innovation;
            *value = innovation * inverse;
        }
    }

    /// The same for [`LANES`] channels at once, sample by sample: each number of a filter waits for the one before, so many channels
    /// take hardly longer than one.
    pub fn whiten_together(&self, values: &mut [[f64; LANES]]) {
        Doubles::dispatch(WhitenTogether { steps: &self.steps, values });
    }
}

struct WhitenTogether<'a> {
    steps: &'a [[f64; 4]],
    values: &'a mut [[f64; LANES]],
}

impl Kernel for WhitenTogether<'_> {
    #[inline(always)]
    fn run(self) {
        let mut state = [0.0; LANES];
        for (values, [phi, s, gain, inverse]) in self.values.iter_mut().zip(self.steps) {
            for (value, state) in values.iter_mut().zip(&mut state) {
                *state *= phi;
                let innovation = *value - s * *state;
                *state += gain * innovation;
                *value = innovation * inverse;
            }
        }
    }
}

/// The data from which noise is learnt.
pub struct NoiseData<'a> {
    pub observations: &'a Observations,
    pub prediction: &'a [f64],
    pub sizes: &'a Sizes,
    pub uncertainty: &'a Uncertainty,
    /// Conditions that are not used.
    pub left_out: &'a [usize],
}

impl Noise {
    /// Standard deviation of one repetition about the model at every number of the stack.
    pub fn standard_deviation(&self, source: &NoiseData) -> Vec<f64> {
        let mut square = vec![0.0; source.prediction.len()];
        for (unit, sizes) in source.observations.units.iter().zip(source.sizes) {
            for (c, noise) in self.channels.iter().enumerate() {
                for (k, size) in unit.block(c).zip(&sizes[c]) {
                    square[k] = (noise.grain * size).powi(2) + noise.sensor.powi(2);
                }
            }
            let span = source.observations.span(unit);
            for (shared, sd) in source.uncertainty.shared.iter().zip(&self.shared) {
                for vector in shared.vectors(span.clone()) {
                    square[span.clone()].iter_mut().zip(vector).for_each(|(s, u)| *s += (sd * u).powi(2));
                }
            }
        }
        for stack in &source.uncertainty.common {
            square.iter_mut().zip(stack).for_each(|(s, e)| *s += e * e);
        }
        square.iter_mut().zip(&source.uncertainty.own).for_each(|(s, e)| *s += e * e);
        square.into_iter().map(f64::sqrt).collect()
    }
}
