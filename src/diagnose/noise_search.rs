//! Learns the parameters of the noise from the repetitions in the data: those for which the differences between
//! repetitions are most likely.

use super::errors::Errors;
use super::likelihood::Landscape;
use super::minimise::minimise;
use super::noise::{ChannelNoise, Clock, Noise, Source, normal};
use super::repeats::Repeats;
use super::shared::Shared;
use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;

/// Quantile of χ² with one degree of freedom at 95 % (NIST/SEMATECH e-Handbook of Statistical Methods, 1.3.6.7.4).
const AT_95_PERCENT: f64 = 3.841;

impl Source<'_> {
    /// A first estimate from the size of the differences; the search starts here.
    fn guess(&self, repeats: &[Repeats], clock: Clock) -> Noise {
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
        Noise { clock, channels, shared: self.shared.iter().map(|s| s.guess).collect() }
    }

    /// Learns the noise from the repetitions; `start` is an earlier estimate from similar data. After a stop it
    /// returns the estimate reached so far.
    pub fn noise(&self, start: Option<&Noise>, stopped: &(dyn Fn() -> bool + Sync)) -> Noise {
        let repeats = self.repeats();
        if let Some(start) = start {
            return self.search(&repeats, start.clock, Some(start), stopped).0;
        }
        let of = |clock: &Clock| self.search(&repeats, *clock, None, stopped);
        // A unit with a single number has no correlation.
        let clocks = [Clock::Sample, Clock::Path];
        let clocks = if self.observations.units.iter().any(|u| u.samples > 1) { &clocks[..] } else { &clocks[..1] };
        let found = crate::parallel::map(clocks, of).into_iter().min_by(|a, b| a.1.total_cmp(&b.1));
        found.map_or_else(|| self.guess(&repeats, Clock::Sample), |f| f.0)
    }

    /// Names of the shared directions that the repetitions support: an optional direction is left out if the likelihood
    /// without it is not significantly lower (at 95 %). Directions without support cannot be estimated and would widen
    /// the gates.
    pub fn asked_for(&self, noise: &Noise) -> Vec<&'static str> {
        let repeats = self.repeats();
        let landscape = Landscape::new(&repeats, noise.clock);
        let least = landscape.deviance(noise);
        let needed = |(k, shared): &(usize, &Shared)| {
            let mut without = noise.clone();
            without.shared[*k] = 1e-6 * shared.guess;
            !shared.optional || landscape.deviance(&without) - least > AT_95_PERCENT
        };
        self.shared.iter().enumerate().filter(needed).map(|(_, s)| s.name).collect()
    }

    /// The likeliest noise for a given clock, and its −2 log likelihood.
    fn search(
        &self,
        repeats: &[Repeats],
        clock: Clock,
        start: Option<&Noise>,
        stopped: &(dyn Fn() -> bool + Sync),
    ) -> (Noise, f64) {
        let center = self.guess(repeats, clock).pack();
        let deviance = self.deviance(repeats, clock, &center, stopped);
        let (from, rounds) = start.map_or((center.clone(), 60), |s| (s.pack(), 12));
        let found = minimise(&deviance, from, rounds);
        let value = deviance(&found);
        (Noise::unpack(&found, self.observations.channels.len(), clock), value)
    }

    /// −2 log likelihood of packed noise, plus a prior of three e-folds about the guess, which matters only if the data
    /// contain no information.
    fn deviance<'b>(
        &'b self,
        repeats: &'b [Repeats],
        clock: Clock,
        center: &'b [f64],
        stopped: &'b (dyn Fn() -> bool + Sync),
    ) -> impl Fn(&[f64]) -> f64 + 'b {
        let landscape = Landscape::new(repeats, clock);
        move |p: &[f64]| {
            if stopped() {
                return f64::INFINITY;
            }
            let prior: f64 = p.iter().zip(center).map(|(a, b)| ((a - b) / 3.0).powi(2)).sum();
            prior + landscape.deviance(&Noise::unpack(p, self.observations.channels.len(), clock))
        }
    }

    /// Random noises that are compatible with the repetitions: draws from the normal approximation of the likelihood
    /// about `noise`. Noise is learnt from the differences between repetitions, and causes from their means; the two
    /// are independent, so a noise can be drawn without the data.
    pub fn draws(&self, noise: &Noise, count: usize, stopped: &(dyn Fn() -> bool + Sync)) -> Vec<Noise> {
        let repeats = self.repeats();
        let center = self.guess(&repeats, noise.clock).pack();
        let deviance = self.deviance(&repeats, noise.clock, &center, stopped);
        let at = noise.pack();
        let step = 0.05;
        let places: Vec<(usize, usize)> = (0..at.len()).flat_map(|i| (0..=i).map(move |j| (i, j))).collect();
        let second = crate::parallel::map(&places, |&(i, j)| {
            let moved = |a: f64, b: f64| {
                let mut p = at.clone();
                p[i] += a * step;
                p[j] += b * step;
                deviance(&p)
            };
            (moved(1.0, 1.0) - moved(1.0, -1.0) - moved(-1.0, 1.0) + moved(-1.0, -1.0)) / (4.0 * step * step)
        });
        let mut curvature = DMatrix::zeros(at.len(), at.len());
        for (&(i, j), value) in places.iter().zip(second) {
            let value = if value.is_finite() { value } else { 0.0 };
            (curvature[(i, j)], curvature[(j, i)]) = (value, value);
        }
        let eigen = curvature.symmetric_eigen();
        // A deviance is −2 ln likelihood, so the covariance is twice the inverse of its curvature. Where the
        // curvature is small, that of the prior, 2/9, takes its place.
        let root: Vec<f64> = eigen.eigenvalues.iter().map(|c| (2.0 / c.max(2.0 / 9.0)).sqrt()).collect();
        let least = deviance(&at);
        let draw = |seed: &usize| {
            let mut rng = Xoshiro256PlusPlus::seed_from_u64(0xd7a3 ^ *seed as u64);
            let share = DVector::from_iterator(root.len(), root.iter().map(|_| normal(&mut rng)));
            let expected = share.norm_squared();
            let moved = &eigen.eigenvectors * share.component_mul(&DVector::from_column_slice(&root));
            let place = |part: f64| at.iter().zip(moved.iter()).map(|(a, m)| a + part * m).collect::<Vec<f64>>();
            // The likelihood is not quite normal: a draw that is far less likely than expected moves toward the
            // maximum.
            let parts =
                (0..6).map(|k| 0.5f64.powi(k)).find(|part| deviance(&place(*part)) - least <= 1.5 * expected + 5.0);
            Noise::unpack(&place(parts.unwrap_or(0.0)), self.observations.channels.len(), noise.clock)
        };
        crate::parallel::map(&(0..count).collect::<Vec<_>>(), draw)
    }

    /// Scatter of repetitions over the channels that count in the error: no model can predict it. Conditions
    /// without repetitions do not contribute.
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

impl Noise {
    /// Search space of the likelihood: ln grain, ln sensor, logit φ of each channel, then the shared ones' ln.
    fn pack(&self) -> Vec<f64> {
        let channel = |c: &ChannelNoise| [c.grain.ln(), c.sensor.ln(), (c.phi / (1.0 - c.phi)).ln()];
        self.channels.iter().flat_map(channel).chain(self.shared.iter().map(|s| s.ln())).collect()
    }

    fn unpack(p: &[f64], channels: usize, clock: Clock) -> Self {
        let logistic = |x: f64| (1.0 / (1.0 + (-x).exp())).clamp(1e-6, 1.0 - 1e-6);
        let channel = |c: &[f64]| ChannelNoise { grain: c[0].exp(), sensor: c[1].exp(), phi: logistic(c[2]) };
        let (own, shared) = p.split_at(3 * channels);
        Self { clock, channels: own.chunks(3).map(channel).collect(), shared: shared.iter().map(|s| s.exp()).collect() }
    }
}
