//! Scores with confidence intervals, from the sums over episodes.

use super::episode::EpisodeSums;
use rand::{Rng as _, SeedableRng as _};
use rand_xoshiro::Xoshiro256PlusPlus;
use serde::Serialize;

/// Number of resamples of the bootstrap. The ends of an interval are then exact to some 3 % of its width (Efron &
/// Tibshirani 1993, An Introduction to the Bootstrap, §13.3, ask for 1000).
const RESAMPLES: usize = 2000;
/// The same seed in every run, so that a figure can be repeated; the number is arbitrary.
const SEED: u64 = 1;

/// A score and its 95 % interval; NaN if it is undefined.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Estimate {
    pub mean: f64,
    pub low: f64,
    pub high: f64,
}

/// Scores of a policy on one medium and slope.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Figures {
    pub episodes: usize,
    /// Sum of rewards of an episode.
    pub total_reward: Estimate,
    /// Mean forward speed [m/s].
    pub speed: Estimate,
    /// |mean speed − commanded speed| [m/s].
    pub speed_error: Estimate,
    /// Sum of the work of all episodes, divided by the sum of weight times distance; undefined unless the latter is
    /// positive.
    pub cost_of_transport: Estimate,
    /// Slip of the gait: 1 − distance / distance without slip, over all episodes; undefined if the feet did not push
    /// backward.
    pub slip: Estimate,
    /// Share of the episodes that ended with the robot flipped or buried.
    pub falls: Estimate,
    /// Number of episodes whose simulation failed.
    pub diverged: usize,
}

impl Figures {
    pub fn of(episodes: &[EpisodeSums]) -> Self {
        Self {
            episodes: episodes.len(),
            total_reward: bootstrap(episodes, |e| [e.total_reward, 1.0], |[sum, n]| sum / n),
            speed: bootstrap(episodes, |e| [e.speed(), 1.0], |[sum, n]| sum / n),
            speed_error: bootstrap(episodes, |e| [e.speed_error(), 1.0], |[sum, n]| sum / n),
            cost_of_transport: bootstrap(episodes, |e| [e.work, e.weight * e.distance], ratio),
            slip: bootstrap(episodes, |e| [e.without_slip - e.carried, e.without_slip], ratio),
            falls: wilson(episodes.iter().filter(|e| e.fell).count(), episodes.len()),
            diverged: episodes.iter().filter(|e| e.diverged).count(),
        }
    }
}

/// NaN unless the denominator is positive.
fn ratio([above, below]: [f64; 2]) -> f64 {
    if below > 0.0 { above / below } else { f64::NAN }
}

/// A function of sums over episodes, with the percentile bootstrap's interval over episodes. If the resamples beyond
/// one end of the interval are undefined, this end is undefined, too.
fn bootstrap(episodes: &[EpisodeSums], term: fn(&EpisodeSums) -> [f64; 2], of: fn([f64; 2]) -> f64) -> Estimate {
    let terms: Vec<[f64; 2]> = episodes.iter().map(term).collect();
    let sum = |sum: [f64; 2], t: &[f64; 2]| [sum[0] + t[0], sum[1] + t[1]];
    let mean = of(terms.iter().fold([0.0; 2], sum));
    let mut random = Xoshiro256PlusPlus::seed_from_u64(SEED);
    let mut resampled =
        || of((0..terms.len()).fold([0.0; 2], |s, _| sum(s, &terms[random.random_range(0..terms.len())])));
    let mut values: Vec<f64> = (0..RESAMPLES).map(|_| resampled()).collect();
    // Undefined resamples are sorted above all others: their distance was not positive, so their cost has no bound.
    values.sort_by(|a, b| a.is_nan().cmp(&b.is_nan()).then(a.total_cmp(b)));
    let end = |share: f64| values[(share * (RESAMPLES - 1) as f64).round() as usize];
    if mean.is_nan() {
        Estimate { mean, low: mean, high: mean }
    } else {
        Estimate { mean, low: end(0.025), high: end(0.975) }
    }
}

/// 97.5 % point of the normal distribution.
const Z: f64 = 1.959_964;

/// A share with the score interval of Wilson, J. Am. Stat. Assoc. 22:209 (1927). It is valid for shares of 0 and 1,
/// where a bootstrap's interval has no width.
fn wilson(count: usize, of: usize) -> Estimate {
    let (n, z2) = (of as f64, Z * Z);
    let share = count as f64 / n;
    let center = (share + z2 / (2.0 * n)) / (1.0 + z2 / n);
    let half = Z / (1.0 + z2 / n) * (share * (1.0 - share) / n + z2 / (4.0 * n * n)).sqrt();
    Estimate { mean: share, low: (center - half).max(0.0), high: (center + half).min(1.0) }
}
