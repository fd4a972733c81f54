//! Looks for broken channels of a force sensor: a value that stands still, a late channel, a zero that was not taken. None of these is
//! certain, so all are warnings. Saturation and outliers are found as the log is read ([`crate::broken`]).

use super::finding::{Finding, Severity::Warn};
use super::forces::agrees;
use super::logged::LoggedTrial;
use crate::observations::{Observations, Unit};
use crate::series::{ends, interpolate, root_mean_square, runs_of};

/// The forces of a file: measured and predicted, with the index of the sample that each number belongs to.
pub struct Channels<'a> {
    pub trials: &'a [LoggedTrial],
    pub observations: &'a Observations,
    pub predicted: &'a [f64],
    /// Samples of each trial that are compared.
    pub kept: &'a [&'a [usize]],
}

impl Channels<'_> {
    pub fn check(&self) -> Vec<Finding> {
        let count = self.observations.channels.len();
        let of = |c| [self.empty(c), self.still(c), self.offset(c)];
        let broken = (0..count).flat_map(of);
        broken.chain([self.late()]).flatten().collect()
    }

    fn name(&self, channel: usize) -> &str {
        &self.observations.channels[channel].name
    }

    fn units(&self) -> impl Iterator<Item = (usize, &Unit)> {
        self.observations.units.iter().enumerate()
    }

    fn measured(&self, unit: &Unit, channel: usize) -> &[f64] {
        &self.observations.values[unit.block(channel)]
    }

    fn predicted(&self, unit: &Unit, channel: usize) -> &[f64] {
        &self.predicted[unit.block(channel)]
    }

    fn rms(&self, channel: usize) -> f64 {
        root_mean_square(self.units().flat_map(|(_, u)| self.measured(u, channel).iter().copied()))
    }

    /// Rows of the samples from `a` to `b` of a trial.
    fn rows(&self, trial: usize, a: usize, b: usize) -> [u64; 2] {
        [a, b].map(|i| self.trials[trial].lines[self.kept[trial][i]])
    }

    /// A channel that is always 0.
    fn empty(&self, channel: usize) -> Option<Finding> {
        let what = "is 0 in all rows, so it counts as not measured";
        self.observations
            .is_empty(channel)
            .then(|| Finding::new(Warn, self.name(channel), what, "log the sensor's readings"))
    }

    /// A value that stays the same to the last digit while the sand's force must change.
    fn still(&self, channel: usize) -> Option<Finding> {
        let edges = ends(self.units().flat_map(|(_, u)| self.measured(u, channel).iter().copied()));
        self.units().find_map(|(u, unit)| {
            let (own, said) = (self.measured(unit, channel), self.predicted(unit, channel));
            let same = (0..own.len()).map(|i| i > 0 && own[i] == own[i - 1]);
            let [a, b] = runs_of(same).max_by_key(|[a, b]| b - a)?;
            let [low, high] = ends(said[a.saturating_sub(1)..=b].iter().copied());
            // A quarter of a trial, and a change by half of the channel's rms: our choice.
            let frozen = b - a + 2 > (own.len() / 4).max(6) && high - low > 0.5 * self.rms(channel);
            // The largest value of the file is that of a saturated sensor.
            let saturated = edges.contains(&own[a]);
            (frozen && !saturated).then(|| {
                let what =
                    format!("stays at {} in trial {} while the intruder moves in the sand", own[a], self.trials[u].id);
                Finding::new(Warn, self.name(channel), what, "leave these rows out: the channel is frozen")
                    .at(self.rows(u, a.saturating_sub(1), b))
            })
        })
    }

    /// A mean reading above the surface.
    fn offset(&self, channel: usize) -> Option<Finding> {
        let mut before: Vec<(f64, usize, usize)> = Vec::new();
        for (u, unit) in self.units() {
            let free =
                self.predicted(unit, 0).iter().zip(self.predicted(unit, 1)).take_while(|(x, z)| x.hypot(**z) == 0.0);
            before.extend((0..free.count()).map(|i| (self.measured(unit, channel)[i], u, i)));
        }
        let mean = before.iter().map(|b| b.0).sum::<f64>() / before.len().max(1) as f64;
        let scatter = root_mean_square(before.iter().map(|b| b.0 - mean)) / (before.len().max(1) as f64).sqrt();
        let (_, trial, last) = *before.last()?;
        // A fifth of the rms, and three standard errors: our choice, twice the usual prior of an offset.
        (before.len() >= 5 && mean.abs() > 0.2 * self.rms(channel) && mean.abs() > 3.0 * scatter).then(|| {
            let what = format!("reads {mean:.3} on average before the intruder reaches the sand");
            let remedy = "take the sensor's zero there, or see the height of the surface";
            Finding::new(Warn, self.name(channel), what, remedy).at(self.rows(trial, 0, last))
        })
    }

    /// A delay of a channel against the motion, for which the measured forces agree better with the prediction.
    fn late(&self) -> Option<Finding> {
        let best: Vec<Option<f64>> = (0..2).map(|c| self.delay(c)).collect();
        let (name, delay) = match best[..] {
            [Some(x), Some(z)] if (x - z).abs() <= 0.5 * x.abs().max(z.abs()) => ("Fx, Fz", 0.5 * (x + z)),
            [Some(x), None] => ("Fx", x),
            [None, Some(z)] => ("Fz", z),
            [Some(x), Some(z)] if x.abs() > z.abs() => ("Fx", x),
            [Some(_), Some(z)] => ("Fz", z),
            _ => return None,
        };
        let (side, size) = (if delay > 0.0 { "late" } else { "early" }, 1e3 * delay.abs());
        let what = format!("fits the motion best if it is {size:.0} ms {side}");
        let remedy = format!("see the clocks of force and motion, or state [nuisances] delay = {:.3}", delay.abs());
        Some(Finding::new(Warn, name, what, remedy))
    }

    /// The delay at which measured and predicted changes agree best, if it removes a third of the misfit's variance (our choice).
    fn delay(&self, channel: usize) -> Option<f64> {
        let step = self.shortest_step();
        let misfit = |delay: f64| {
            let mut sums = [0.0; 4];
            for (u, unit) in self.units() {
                let t: Vec<f64> = self.kept[u].iter().map(|&i| self.trials[u].t[i]).collect();
                let said = self.predicted(unit, channel);
                let pairs = t.iter().map(|t0| interpolate(&t, said, t0 - delay)).zip(self.measured(unit, channel));
                let n = t.len().max(1) as f64;
                let pairs: Vec<(f64, f64)> = pairs.map(|(a, b)| (a, *b)).collect();
                let (ma, mb) = pairs.iter().fold((0.0, 0.0), |(a, b), p| (a + p.0 / n, b + p.1 / n));
                for (a, b) in &pairs {
                    sums[0] += (a - ma) * (a - ma);
                    sums[1] += (a - ma) * (b - mb);
                    sums[2] += (b - mb) * (b - mb);
                }
            }
            sums[2] - sums[1].max(0.0) * sums[1] / sums[0].max(f64::MIN_POSITIVE)
        };
        let all = |of: &dyn Fn(&Unit) -> Vec<f64>| self.units().flat_map(|(_, u)| of(u)).collect::<Vec<f64>>();
        let (own, said) = (all(&|u| self.measured(u, channel).to_vec()), all(&|u| self.predicted(u, channel).to_vec()));
        if !agrees(&said, &own) {
            return None;
        }
        let none = misfit(0.0);
        let steps = (1..=40).flat_map(|k| [-1.0, 1.0].map(|sign| sign * 0.25 * step * f64::from(k)));
        let (delay, least) = steps.map(|d| (d, misfit(d))).min_by(|a, b| a.1.total_cmp(&b.1))?;
        (least < 2.0 / 3.0 * none && delay.abs() > 0.3 * step).then_some(delay)
    }

    /// The median time between samples of the trial that is sampled fastest [s].
    fn shortest_step(&self) -> f64 {
        let usual = |trial: &LoggedTrial| {
            let mut steps: Vec<f64> = trial.t.windows(2).map(|w| w[1] - w[0]).collect();
            steps.sort_by(f64::total_cmp);
            steps.get(steps.len() / 2).copied().unwrap_or(f64::MAX)
        };
        self.trials.iter().map(usual).fold(f64::MAX, f64::min).min(1.0)
    }
}
