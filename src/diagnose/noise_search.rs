//! Learns the parameters of the noise from the repetitions in the data: the parameters with which the differences
//! between repetitions are most likely.

use super::errors::SquaredErrors;
use super::likelihood::Landscape;
use super::minimise::minimise;
use super::noise::{ChannelNoise, Noise, NoiseClock, NoiseData};
use super::repeats::Repeats;
use super::series::root_mean_square;
use super::shared::SharedNoise;

/// Quantile of χ² with one degree of freedom at 95 % (NIST/SEMATECH e-Handbook of Statistical Methods, 1.3.6.7.4).
const AT_95_PERCENT: f64 = 3.841;

/// Repetitions that scatter by less than this share of the measured value are copies, or simulations without noise:
/// our choice, the rounding of a log with six digits.
const COPIES: f64 = 1e-6;
/// Noise of a channel that was not measured, in units of the root mean square of all measured values: our choice, so much that
/// its numbers have no weight.
const UNMEASURED: f64 = 100.0;

impl NoiseData<'_> {
    /// A first estimate from the size of the differences; the search starts here. How it divides them between grains
    /// and sensor is our choice, which the search corrects.
    fn guess(&self, repeats: &[Repeats], clock: NoiseClock) -> Noise {
        let channel = |c: usize| {
            let (mut square, mut size, mut count) = (0.0, 0.0, 0.0);
            for r in repeats {
                for d in &r.differences {
                    square += d[c].iter().map(|v| v * v).sum::<f64>();
                    size += r.sizes[c].iter().map(|m| m * m).sum::<f64>();
                    count += d[c].len() as f64;
                }
            }
            // For a log without scatter, 1e-9 keeps the likelihood finite.
            let sd = (square / f64::max(count, 1.0)).sqrt().max(1e-9);
            let grain = 0.7 * sd / (size / f64::max(count, 1.0)).sqrt().max(1e-9);
            let phi = 0.6;
            ChannelNoise { grain, sensor: 0.3 * sd, phi }
        };
        let channels = (0..self.observations.channels.len()).map(channel).collect();
        Noise { clock, channels, shared: self.uncertainty.shared.iter().map(|s| s.guess).collect() }
    }

    /// Learns the noise from the repetitions; `start` is an earlier estimate from similar data. If the work is stopped,
    /// it returns the estimate reached so far.
    pub fn noise(&self, start: Option<&Noise>, stopped: &(dyn Fn() -> bool + Sync)) -> Noise {
        let repeats = self.repeats();
        if let Some(start) = start {
            return self.search(&repeats, start.clock, Some(start), stopped).0;
        }
        let of = |clock: &NoiseClock| self.search(&repeats, *clock, None, stopped);
        // If all units have a single number, there is no correlation, and one clock suffices.
        let clocks = [NoiseClock::Sample, NoiseClock::Path];
        let clocks = if self.observations.units.iter().any(|u| u.samples > 1) { &clocks[..] } else { &clocks[..1] };
        let found = crate::parallel::map(clocks, of).into_iter().min_by(|a, b| a.1.total_cmp(&b.1));
        found.map_or_else(|| self.guess(&repeats, NoiseClock::Sample), |f| f.0)
    }

    /// Names of the shared directions that the repetitions support: an optional direction is left out if the likelihood
    /// without it is not significantly lower (at 95 %). The size of a direction without support cannot be estimated,
    /// and the direction would only increase the uncertainty.
    pub fn supported(&self, noise: &Noise) -> Vec<&'static str> {
        let repeats = self.repeats();
        let landscape = Landscape::new(&repeats, noise.clock);
        let least = landscape.deviance(noise);
        let needed = |(k, shared): &(usize, &SharedNoise)| {
            let mut without = noise.clone();
            without.shared[*k] = 1e-6 * shared.guess; // practically 0
            !shared.optional || landscape.deviance(&without) - least > AT_95_PERCENT
        };
        self.uncertainty.shared.iter().enumerate().filter(needed).map(|(_, s)| s.name).collect()
    }

    /// The likeliest noise for a given clock, and its −2 log likelihood. The numbers of rounds are our choice: fewer if
    /// the search starts near the end.
    fn search(
        &self,
        repeats: &[Repeats],
        clock: NoiseClock,
        start: Option<&Noise>,
        stopped: &(dyn Fn() -> bool + Sync),
    ) -> (Noise, f64) {
        let center = self.guess(repeats, clock).pack();
        let (landscape, channels) = (Landscape::new(repeats, clock), self.observations.channels.len());
        let least = self.least();
        let of = |p: &[f64]| {
            let mut noise = Noise::unpack(p, channels, clock);
            noise.channels.iter_mut().zip(&least).for_each(|(own, least)| own.sensor = own.sensor.max(*least));
            noise
        };
        // −2 log likelihood of packed noise, plus a prior about the guess with a standard deviation of three e-folds, which
        // matters only if the data contain no information.
        let deviance = |p: &[f64]| {
            if stopped() {
                return f64::INFINITY;
            }
            let prior: f64 = p.iter().zip(&center).map(|(a, b)| ((a - b) / 3.0).powi(2)).sum();
            prior + landscape.deviance(&of(p))
        };
        let (from, rounds) = start.map_or((center.clone(), 60), |s| (s.pack(), 12));
        let found = minimise(deviance, from, rounds);
        (of(&found), deviance(&found))
    }

    /// The least noise of the sensor of each channel. One that is 0 throughout was not measured, and must not count; without this its
    /// noise would be 0, and it would decide alone.
    fn least(&self) -> Vec<f64> {
        let counted = self.observations.counted(self.observations.units.iter());
        let all = root_mean_square(counted.map(|k| self.observations.values[k]));
        let of = |c: usize| if self.observations.is_empty(c) { UNMEASURED * all } else { 0.0 };
        (0..self.observations.channels.len()).map(of).collect()
    }

    /// Do the repetitions differ, so that they give a noise floor? Copies do not differ.
    pub fn scatters(&self) -> bool {
        let counted = self.observations.counted(self.observations.units.iter());
        self.floor().rmse() > COPIES * root_mean_square(counted.map(|k| self.observations.values[k]))
    }

    /// Scatter of repetitions over the channels that count in the error: no model can predict it. Conditions
    /// without repetitions do not contribute.
    pub fn floor(&self) -> SquaredErrors {
        let of = |group: &Vec<usize>| {
            let [mut square, mut count] = [0.0; 2];
            for difference in self.repeats_of(group).differences {
                for (values, _) in difference.iter().zip(&self.observations.channels).filter(|d| d.1.in_rmse) {
                    square += values.iter().map(|v| v * v).sum::<f64>();
                    count += values.len() as f64;
                }
            }
            [square, count]
        };
        SquaredErrors(self.observations.repetitions().iter().map(of).collect())
    }
}

impl Noise {
    /// Coordinates of the search: ln grain, ln sensor and logit φ of each channel, then the logarithm of each shared standard deviation.
    fn pack(&self) -> Vec<f64> {
        let channel = |c: &ChannelNoise| [c.grain.ln(), c.sensor.ln(), (c.phi / (1.0 - c.phi)).ln()];
        self.channels.iter().flat_map(channel).chain(self.shared.iter().map(|s| s.ln())).collect()
    }

    fn unpack(p: &[f64], channels: usize, clock: NoiseClock) -> Self {
        let logistic = |x: f64| (1.0 / (1.0 + (-x).exp())).clamp(1e-6, 1.0 - 1e-6);
        let channel = |c: &[f64]| ChannelNoise { grain: c[0].exp(), sensor: c[1].exp(), phi: logistic(c[2]) };
        let (own, shared) = p.split_at(3 * channels);
        Self { clock, channels: own.chunks(3).map(channel).collect(), shared: shared.iter().map(|s| s.exp()).collect() }
    }
}
