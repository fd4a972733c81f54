//! Selects the parts of a log that are replayed. A window consists of a lead-in, which is simulated but not compared, and of the
//! strides after it, which are compared.
//!
//! The state at the start of a replay (depth of the feet, motion of the base) is not in the log. Sand dissipates energy, so the
//! simulation forgets its initial state during the lead-in.

use super::log::Run;
use std::f64::consts::TAU;

/// Parts of a stride; the mean over each part is compared. Our choice: it resolves the gait up to the eighth harmonic.
pub const BINS: usize = 16;
/// Turns of the hips before the first stride that is compared: our choice, so that short runs keep most strides.
const LEAD_IN: f64 = 0.75;
/// A run with at most this number of strides is one window: our choice, as many as are compared in a longer run.
const STRIDES: usize = 12;
/// Number of strides of such a short run that are compared, at most: our choice; more strides repeat the same information.
const COMPARED: usize = 4;
/// Number of windows in a longer run: our choice, which limits the computing time.
const WINDOWS_OF_RUN: usize = 3;
/// Largest number of windows in a log: our choice, which also limits the computing time.
const WINDOWS: usize = 96;
/// Strides in each window of a longer run: our choice, as many as are compared in a short run ([`COMPARED`]).
const STRIDES_OF_MANY: usize = 4;
/// A joint has begun to move if its angle differs from its first angle by this [rad]: our choice, above the noise of encoders.
const MOVES: f64 = 0.1;
/// A joint with more turns than this in a run makes full turns; other joints swing. Our choice: no joint swings so far.
const TURNS: f64 = 1.5;

/// Part of a run that is replayed.
#[derive(Clone, Debug, PartialEq)]
pub struct Window {
    pub run: usize,
    /// Where the replay starts [s].
    pub from: f64,
    /// Begin and end of each stride that is compared [s].
    pub strides: Vec<[f64; 2]>,
}

impl Window {
    pub fn end(&self) -> f64 {
        self.strides.last().map_or(self.from, |s| s[1])
    }
}

/// The windows of all runs. `length` [s] is the length of a stride if the joints swing and the stride frequency is not known.
pub fn windows(runs: &[Run], length: f64) -> Vec<Window> {
    let mut all: Vec<Window> = runs.iter().enumerate().flat_map(|(k, run)| of_run(k, run, length)).collect();
    if all.len() > WINDOWS {
        let every = all.len().div_ceil(WINDOWS);
        all = all.into_iter().step_by(every).collect();
    }
    all
}

fn of_run(index: usize, run: &Run, length: f64) -> Vec<Window> {
    let edges = edges(run, length);
    let count = edges.len().saturating_sub(1);
    let window = |from: f64, first: usize, strides: usize| Window {
        run: index,
        from,
        strides: (first..(first + strides).min(count)).map(|k| [edges[k], edges[k + 1]]).collect(),
    };
    if count == 0 {
        return Vec::new();
    }
    if count <= STRIDES {
        let mut whole = window(run.t[0], 0, count);
        let kept = count.min(COMPARED);
        whole.strides = (0..kept).map(|k| whole.strides[k * (count - 1) / (kept - 1).max(1)]).collect();
        return vec![whole];
    }
    // A window begins one stride before the first stride that is compared.
    let last = count - STRIDES_OF_MANY;
    let first = |k: usize| (1 + k * (last - 1) / (WINDOWS_OF_RUN - 1)).min(last);
    (0..WINDOWS_OF_RUN).map(|k| window(edges[first(k) - 1], first(k), STRIDES_OF_MANY)).collect()
}

/// Times between strides [s]: at each full turn of the joint that turns farthest. If all joints swing, at each period of the stride
/// frequency, or after each `length`.
fn edges(run: &Run, length: f64) -> Vec<f64> {
    let way = |q: &Vec<f64>| q[q.len() - 1] - q[0];
    let farthest = run.q.iter().max_by(|a, b| way(a).abs().total_cmp(&way(b).abs()));
    let Some(q) = farthest else { return Vec::new() };
    let end = run.t[run.t.len() - 1];
    let moved = run.q.iter().filter_map(|q| q.iter().position(|a| (a - q[0]).abs() > MOVES)).min();
    let Some(moves) = moved.map(|i| run.t[i]) else { return Vec::new() };
    if way(q).abs() < TURNS * TAU {
        let period = run.frequency.filter(|f| f.abs() > 0.02).map_or(length, |f| 1.0 / f.abs());
        let start = moves + period;
        let count = ((end - start) / period).floor().max(0.0) as usize;
        return (0..=count).map(|k| start + k as f64 * period).collect();
    }
    let sign = way(q).signum();
    let (mut edges, mut next) = (Vec::new(), LEAD_IN * TAU);
    for i in 1..q.len() {
        let [before, now] = [i - 1, i].map(|i| sign * (q[i] - q[0]));
        while before < next && now >= next {
            edges.push(run.t[i - 1] + (run.t[i] - run.t[i - 1]) * (next - before) / (now - before));
            next += TAU;
        }
        if now - next > 10.0 * TAU {
            break; // the angle jumps by many turns: broken data
        }
    }
    edges
}

/// The integral of a signal from its start to each sample, for means between any two times.
pub struct Integral<'a> {
    t: &'a [f64],
    sums: Vec<f64>,
    values: &'a [f64],
}

impl<'a> Integral<'a> {
    /// The signal is linear between its samples.
    pub fn new(t: &'a [f64], values: &'a [f64]) -> Self {
        let mut sum = 0.0;
        let mut sums = vec![0.0; values.len()];
        for i in 1..values.len() {
            sum += 0.5 * (values[i] + values[i - 1]) * (t[i] - t[i - 1]);
            sums[i] = sum;
        }
        Self { t, sums, values }
    }

    fn at(&self, t: f64) -> f64 {
        let right = self.t.partition_point(|&p| p < t).clamp(1, self.t.len() - 1);
        let (a, b) = (self.t[right - 1], self.t[right]);
        let share = ((t - a) / (b - a)).clamp(0.0, 1.0);
        let (va, vb) = (self.values[right - 1], self.values[right]);
        self.sums[right - 1] + (b - a) * share * (va + 0.5 * share * (vb - va))
    }

    /// Mean from `a` to `b`.
    pub fn mean(&self, a: f64, b: f64) -> f64 {
        (self.at(b) - self.at(a)) / (b - a)
    }
}

/// Begin and end of each part of a stride.
pub fn bins([from, to]: [f64; 2]) -> impl Iterator<Item = [f64; 2]> {
    let edge = move |k: usize| from + (to - from) * k as f64 / BINS as f64;
    (0..BINS).map(move |k| [edge(k), edge(k + 1)])
}
