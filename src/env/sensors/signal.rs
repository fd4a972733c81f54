//! One measured value, and what its sensor does to it.

use super::{Imperfections, Part};
use nalgebra::Rotation3;
use rand::Rng as _;
use rand_distr::StandardNormal;
use rand_xoshiro::Xoshiro256PlusPlus;

/// A value of a sensor, its columns in a row of exact values, and what a control step does to it.
#[derive(Clone, Debug, PartialEq)]
pub struct Signal {
    /// The column of the value; for an angle that is shown as sine and cosine, the column of the sine.
    pub column: usize,
    /// The column of an angle's cosine.
    pub cosine: Option<usize>,
    /// Whole control steps of the delay.
    pub late: usize,
    /// The rest of the delay, as a share of a control step: the sensor samples this much before the step ends.
    early: f64,
    /// For `column` and `cosine`: (place in the policy's row, column). Empty if the policy does not get them.
    pub places: Vec<(usize, usize)>,
    /// Probability that a sample is lost.
    pub dropout: f64,
    /// Does the sensor change the value, besides delaying it?
    alters: bool,
    gain: f64,
    offset: f64,
    /// Standard deviation of the constant error; the next fields: of its change in a step, and of a sample's noise.
    bias: f64,
    walk: f64,
    noise: f64,
    /// The low-pass filter's output moves toward a new sample by this share of the distance; None: no filter.
    follows: Option<f64>,
    quantization: f64,
}

/// If the rest of a delay is below this share of a control step, it counts as rounding and is 0: our choice, which changes a value by
/// at most a millionth of its change in a step.
const ROUNDING: f64 = 1e-6;

/// The sensors of an episode.
#[derive(Debug, PartialEq)]
pub struct Senses {
    pub signals: Vec<Signal>,
    /// Rotation from the base's frame to the frame of the inertial measurement unit; None: the frames are equal.
    pub turn: Option<Rotation3<f64>>,
}

/// What a signal remembers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Past {
    /// Constant error and its random walk so far.
    pub bias: f32,
    /// Output of the low-pass filter.
    pub filtered: f32,
    /// The exact value at the end of the control step before.
    pub exact: f32,
}

impl Signal {
    /// `period`: duration of a control step [s].
    pub fn new(column: usize, part: Part, imperfections: Imperfections, period: f64) -> Option<Self> {
        // Sine and cosine are one signal, which begins with its sine.
        if part == Part::Cosine {
            return None;
        }
        let delay = imperfections.delay / period;
        let whole = (delay + ROUNDING).floor();
        // A delay of whole steps copies values exactly.
        let rest = delay - whole;
        let Imperfections { gain, offset, noise_density, bias, random_walk, low_pass, quantization, dropout, .. } =
            imperfections;
        Some(Self {
            column,
            cosine: None,
            late: whole as usize,
            early: if rest > ROUNDING { rest } else { 0.0 },
            places: Vec::new(),
            dropout,
            alters: [gain, offset, noise_density, bias, random_walk, low_pass, quantization] != [0.0; 7],
            gain,
            offset,
            bias,
            walk: random_walk * period.sqrt(),
            // Standard deviation of one sample of white noise with this density: density / √period (Kalibr's IMU noise
            // model).
            noise: noise_density / period.sqrt(),
            follows: (low_pass > 0.0).then(|| -(-period / low_pass).exp_m1()),
            quantization,
        })
    }

    pub fn columns(&self) -> impl Iterator<Item = usize> {
        [Some(self.column), self.cosine].into_iter().flatten()
    }

    /// The value of `column`, delayed by the whole steps. `sampled` holds rows of `width` numbers, the newest first.
    pub fn delayed(&self, sampled: &[f32], width: usize, column: usize) -> f32 {
        sampled[self.late * width + column]
    }

    /// The measured value in a row.
    pub fn value(&self, row: &[f32]) -> f64 {
        let value = f64::from(row[self.column]);
        self.cosine.map_or(value, |cosine| value.atan2(f64::from(row[cosine])))
    }

    pub fn set(&self, row: &mut [f32], value: f64) {
        match self.cosine {
            None => row[self.column] = value as f32,
            Some(cosine) => (row[self.column], row[cosine]) = (value.sin() as f32, value.cos() as f32),
        }
    }

    /// The first sample of an episode.
    pub fn begin(&self, random: &mut Xoshiro256PlusPlus, row: &mut [f32]) -> Past {
        let mut past = Past { exact: self.value(row) as f32, ..Past::default() };
        if self.alters {
            past.bias = (self.bias * random.sample::<f64, _>(StandardNormal)) as f32;
            let noisy = self.noisy(self.value(row), &past, random);
            past.filtered = noisy as f32;
            self.set(row, self.quantized(noisy));
        }
        past
    }

    /// A later sample; `row` has the exact values.
    pub fn sample(&self, random: &mut Xoshiro256PlusPlus, past: &mut Past, row: &mut [f32]) {
        let mut value = self.value(row);
        if self.early > 0.0 {
            let exact = std::mem::replace(&mut past.exact, value as f32);
            value = self.between(value, exact.into(), self.early);
        } else if !self.alters {
            return;
        }
        if self.walk > 0.0 {
            past.bias += (self.walk * random.sample::<f64, _>(StandardNormal)) as f32;
        }
        value = self.noisy(value, past, random);
        if let Some(share) = self.follows {
            value = self.between(past.filtered.into(), value, share);
            past.filtered = value as f32;
        }
        self.set(row, self.quantized(value));
    }

    /// `from`, moved toward `to` by this share of the distance; an angle moves the shorter way round.
    fn between(&self, from: f64, to: f64, share: f64) -> f64 {
        from + share * if self.cosine.is_some() { wrapped(to - from) } else { to - from }
    }

    fn noisy(&self, value: f64, past: &Past, random: &mut Xoshiro256PlusPlus) -> f64 {
        let noise = if self.noise > 0.0 { self.noise * random.sample::<f64, _>(StandardNormal) } else { 0.0 };
        value + value * self.gain + self.offset + f64::from(past.bias) + noise
    }

    fn quantized(&self, value: f64) -> f64 {
        let step = self.quantization;
        if step > 0.0 { (value / step).round() * step } else { value }
    }
}

/// An angle within ± π.
pub fn wrapped(angle: f64) -> f64 {
    angle.sin().atan2(angle.cos())
}
