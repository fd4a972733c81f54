//! Likelihood of the differences between repetitions under a noise model.
//!
//! Channels have independent noise, so products of whitened columns are sums over channels. A search changes one number
//! at a time, so the contributions of the other channels are stored. If the size of a shared direction changes, the
//! stored products are only scaled.

use super::gram::gram;
use super::known::Recent;
use super::noise::{ChannelFilter, ChannelNoise, Noise, NoiseClock};
use super::repeats::Repeats;
use super::shared::Likelihood;
use nalgebra::{DMatrix, DVector};
use std::sync::Arc;

/// Number of noises of a channel whose products are kept: our choice; a gradient needs four, a line search some more.
const KEPT: usize = 13;

/// Contribution of one channel of one condition.
struct LikelihoodPart {
    log_determinant: f64,
    /// Products of the shared directions and the differences, whitened.
    products: DMatrix<f64>,
}

/// Differences of repetitions, for repeated evaluation of their likelihood.
pub struct Landscape<'a> {
    repeats: &'a [Repeats],
    steps: Vec<Vec<f64>>,
    /// For each channel the contributions of all conditions, stored by the channel's noise.
    channels: Vec<Recent<ChannelNoise, Vec<LikelihoodPart>>>,
}

impl<'a> Landscape<'a> {
    pub fn new(repeats: &'a [Repeats], clock: NoiseClock) -> Self {
        let steps = repeats.iter().map(|r| clock.steps(&r.progress)).collect();
        let channels = repeats.first().map_or(0, |r| r.sizes.len());
        Self { repeats, steps, channels: vec![Recent::up_to(KEPT); channels] }
    }

    /// −2 log likelihood.
    pub fn deviance(&self, noise: &Noise) -> f64 {
        if self.repeats.is_empty() {
            return 0.0;
        }
        let parts: Vec<_> = noise.channels.iter().enumerate().map(|(c, own)| self.parts(c, own)).collect();
        let mut total = 0.0;
        for (k, repeat) in self.repeats.iter().enumerate() {
            let mut products = parts[0][k].products.clone();
            parts[1..].iter().for_each(|p| products += &p[k].products);
            let own: f64 = parts.iter().map(|p| p[k].log_determinant).sum();
            let sd: Vec<f64> = repeat.shared.iter().map(|(family, _)| noise.shared[*family]).collect();
            let likelihood = Likelihood::new(&products, &sd);
            for d in sd.len()..products.nrows() {
                let along = DVector::from_fn(sd.len(), |i, _| sd[i] * products[(i, d)]);
                total += own + likelihood.log_determinant + likelihood.square(products[(d, d)], &along);
            }
        }
        total
    }

    /// Contributions of channel `c` under its noise.
    fn parts(&self, c: usize, noise: &ChannelNoise) -> Arc<Vec<LikelihoodPart>> {
        let of = |(repeat, steps): (&Repeats, &Vec<f64>)| LikelihoodPart::new(repeat, c, noise, steps);
        self.channels[c].of(noise, || self.repeats.iter().zip(&self.steps).map(of).collect())
    }
}

impl LikelihoodPart {
    fn new(repeat: &Repeats, c: usize, noise: &ChannelNoise, steps: &[f64]) -> Self {
        let filter = ChannelFilter::new(noise, &repeat.sizes[c], steps, &[]);
        let all = repeat.shared.iter().map(|(_, direction)| direction).chain(&repeat.differences);
        let white: Vec<Vec<f64>> = all
            .map(|channels| {
                let mut own = channels[c].clone();
                filter.whiten(&mut own);
                own
            })
            .collect();
        let products = gram(&white);
        Self { log_determinant: filter.log_determinant, products }
    }
}
