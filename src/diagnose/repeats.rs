//! Matches the repetitions of a condition; only noise can cause their differences.

use super::noise::NoiseData;
use super::observations::{Observations, Unit};
use super::shared::SharedNoise;

/// Repetitions of one condition, matched by progress.
pub struct Repeats {
    /// Size of each matched sample, channel by channel.
    pub sizes: Vec<Vec<f64>>,
    /// Progress of the matched samples.
    pub progress: Vec<f64>,
    /// Directions of the noise that all numbers of a repetition share: the index in [`super::shared::Uncertainty::shared`], and the
    /// direction channel by channel.
    pub shared: Vec<(usize, Vec<Vec<f64>>)>,
    /// Orthonormal differences of the residuals, each channel by channel.
    pub differences: Vec<Vec<Vec<f64>>>,
}

impl NoiseData<'_> {
    /// The repetitions of every condition that has repetitions and is not left out.
    pub fn repeats(&self) -> Vec<Repeats> {
        let groups = self.observations.repetitions();
        let counts = |(condition, group): &(usize, &Vec<usize>)| group.len() > 1 && !self.left_out.contains(condition);
        groups.iter().enumerate().filter(counts).map(|(_, g)| self.repeats_of(g)).collect()
    }

    /// The repetitions of one condition, from its units.
    pub fn repeats_of(&self, group: &[usize]) -> Repeats {
        let observations = self.observations;
        let matched = matched(observations, group);
        let (first, kept): (_, Vec<usize>) = (group[0], matched.iter().map(|m| m[0]).collect());
        let channels = 0..observations.channels.len();
        let residual = |k: usize| observations.values[k] - self.prediction[k];
        let smooth: Vec<_> = channels.clone().map(|c| Smooth::new(observations, group, c, &residual)).collect();
        let own = |place: usize, c: usize| -> Vec<f64> {
            let unit = &observations.units[group[place]];
            let at = |m: &Vec<usize>| {
                let i = m[place];
                residual(unit.block(c).start + i) - smooth[c].at(unit.progress[i])
            };
            matched.iter().map(at).collect()
        };
        let each: Vec<Vec<Vec<f64>>> =
            (0..group.len()).map(|place| channels.clone().map(|c| own(place, c)).collect()).collect();
        let differences = (1..group.len()).map(|k| {
            let norm = ((k * (k + 1)) as f64).sqrt();
            let difference =
                |c: usize, i: usize| (each[..k].iter().map(|e| e[c][i]).sum::<f64>() - k as f64 * each[k][c][i]) / norm;
            channels.clone().map(|c| (0..kept.len()).map(|i| difference(c, i)).collect()).collect()
        });
        Repeats {
            sizes: channels.clone().map(|c| kept.iter().map(|&i| self.sizes[first][c][i]).collect()).collect(),
            progress: kept.iter().map(|&i| observations.units[first].progress[i]).collect(),
            shared: self.directions(first, &kept),
            differences: differences.collect(),
        }
    }

    /// Directions in the `kept` samples of unit `u`.
    fn directions(&self, u: usize, kept: &[usize]) -> Vec<(usize, Vec<Vec<f64>>)> {
        let unit = &self.observations.units[u];
        let of = |(family, shared): (usize, &'_ SharedNoise)| {
            let own = |stack: &Vec<f64>| {
                let channel = |c: usize| kept.iter().map(|&i| stack[unit.block(c).start + i]).collect();
                (family, (0..self.observations.channels.len()).map(channel).collect())
            };
            shared.stacks.iter().map(own).collect::<Vec<_>>()
        };
        self.uncertainty.shared.iter().enumerate().flat_map(of).collect()
    }
}

/// Matches the samples of the repetitions along the path. Each row of the result has one sample of each repetition;
/// samples are in order, and none is used twice. A sample of the repetition with the fewest samples is matched with the
/// nearest sample of each other repetition. Samples are not interpolated, because an interpolated value has less noise
/// than a sample. Rows in which every channel of every repetition is exactly zero are left out, because they come from
/// simulated intruders in the air, and would give a noise of zero.
fn matched(observations: &Observations, group: &[usize]) -> Vec<Vec<usize>> {
    let units: Vec<&Unit> = group.iter().map(|&u| &observations.units[u]).collect();
    let Some(leader) = (0..units.len()).min_by_key(|&k| units[k].samples) else { return Vec::new() };
    let ways = units.iter().map(|u| &u.progress);
    let low = ways.clone().map(|p| p[0]).fold(f64::MIN, f64::max);
    let high = ways.map(|p| p[p.len() - 1]).fold(f64::MAX, f64::min);
    let reach = (high - low).abs() / units[leader].samples.max(1) as f64;
    let mut next = vec![0; units.len()];
    let mut rows = Vec::new();
    for (i, &at) in units[leader].progress.iter().enumerate() {
        let nearest = |k: usize| {
            let progress = &units[k].progress;
            let right = progress.partition_point(|&p| p < at).max(next[k]);
            let left = right.saturating_sub(1).max(next[k]);
            let away = |j: usize| progress.get(j).map_or(f64::INFINITY, |p| (p - at).abs());
            let best = if away(left) <= away(right) { left } else { right };
            // A match is at most the mean distance between samples away, or 1e-9 more, for the rounding of the log.
            (away(best) <= reach + 1e-9).then_some(best)
        };
        let row: Option<Vec<usize>> =
            (0..units.len()).map(|k| if k == leader { Some(i) } else { nearest(k) }).collect();
        if let Some(row) = row {
            next.iter_mut().zip(&row).for_each(|(next, j)| *next = j + 1);
            rows.push(row);
        }
    }
    let reads = |(unit, i): (&&Unit, &usize)| {
        (0..observations.channels.len()).any(|c| observations.values[unit.block(c).start + i] != 0.0)
    };
    rows.retain(|row| units.iter().zip(row).any(reads));
    rows
}

/// The misfit that all repetitions of a condition share, in one channel: the running mean of their residuals along the
/// path. It is subtracted from each residual at the sample's own position, because matched samples are at slightly
/// different positions and would otherwise differ by this misfit.
struct Smooth {
    progress: Vec<f64>,
    /// Cumulative sums of the residuals.
    sums: Vec<f64>,
    half_width: f64,
}

impl Smooth {
    /// Half-width of the running mean, in mean spacings of the samples of the shortest repetition: our choice, so that
    /// the mean has about five samples of each repetition.
    const REACH: f64 = 2.0;

    fn new(observations: &Observations, group: &[usize], channel: usize, residual: &dyn Fn(usize) -> f64) -> Self {
        let units = group.iter().map(|&u| &observations.units[u]);
        let mut all: Vec<(f64, f64)> =
            units.clone().flat_map(|u| u.progress.iter().copied().zip(u.block(channel).map(residual))).collect();
        all.sort_by(|a, b| a.0.total_cmp(&b.0));
        let way = all.last().zip(all.first()).map_or(0.0, |(last, first)| last.0 - first.0);
        let fewest = units.map(|u| u.samples).min().unwrap_or(1).max(1);
        let mut sums = vec![0.0];
        sums.extend(all.iter().scan(0.0, |sum, (_, r)| {
            *sum += r;
            Some(*sum)
        }));
        Self { progress: all.iter().map(|a| a.0).collect(), sums, half_width: Self::REACH * way / fewest as f64 }
    }

    /// Mean about a position.
    fn at(&self, place: f64) -> f64 {
        let from = self.progress.partition_point(|&p| p < place - self.half_width);
        let until = self.progress.partition_point(|&p| p <= place + self.half_width);
        (self.sums[until] - self.sums[from]) / (until - from).max(1) as f64
    }
}
