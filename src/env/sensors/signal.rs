//! One measured value, and what its sensor does to it.

use super::{Imperfections, Part};
use nalgebra::Rotation3;
use rand::Rng as _;
use rand_distr::StandardNormal;
use rand_xoshiro::Xoshiro256PlusPlus;

/// A value of a sensor, its columns in a row of exact values, and what a control step does to it.
#[derive(Clone, Debug, PartialEq)]
pub struct Signal {
    /// The column; of an angle, the column of its sine.
    pub column: usize,
    /// The column of an angle's cosine.
    pub cosine: Option<usize>,
    /// Whole control steps of the delay.
    pub late: usize,
    /// The rest of the delay, as a share of a control step: the sensor samples so long before the step ends.
    early: f64,
    /// Places of column and cosine in the row that the policy gets; empty if it does not get them.
    pub places: Vec<(usize, usize)>,
    /// Probability that a sample is lost.
    pub dropout: f64,
    /// Does the sensor change the value, besides delaying it?
    alters: bool,
    gain: f64,
    offset: f64,
    /// Standard deviations: of the constant error, of its change in a step, of a sample's noise.
    bias: f64,
    walk: f64,
    noise: f64,
    /// Share of its distance to a new sample by which the low-pass filter moves; None: no filter.
    follows: Option<f64>,
    quantization: f64,
}

/// A rest of a delay below this share of a control step is rounding: our choice, which moves no value by more than a millionth of its
/// change in a step.
const ROUNDING: f64 = 1e-6;

/// The sensors of an episode.
#[derive(Debug, PartialEq)]
pub struct Senses {
    pub signals: Vec<Signal>,
    /// Rotation from the base's frame to that of the inertial measurement unit; None: they are the same.
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
    /// `period`: that of the control [s].
    pub fn new(column: usize, part: Part, imperfections: Imperfections, period: f64) -> Option<Self> {
        // Sine and cosine are one signal, which begins with its sine.
        if part == Part::Cosine {
            return None;
        }
        let delay = imperfections.delay / period;
        let whole = (delay + ROUNDING).floor();
        // A delay of whole steps copies bits.
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

    /// The value of `column`, late by whole steps, among sampled rows of `width` numbers, the newest first.
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

    /// `from`, moved to `to` by this share of the distance; an angle along the shorter way.
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
