//! Errors of predictions, and the scatter of measurements for comparison.

use super::data::{SteadyState, Wheel};
use crate::parallel;
use crate::progress::Latch;
use crate::sand::SandDescription;
use crate::sand::intruder::{DepthOrLoad, Status, Trial, compute};
use rand::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

/// Number of bootstrap resamples of the conditions for an interval: our choice, because the interval's ends then vary
/// by less than a tenth of its width.
const RESAMPLES: usize = 400;

/// A sand's predictions for one row.
#[derive(Clone, Copy, Debug)]
pub struct Prediction {
    /// Forces at the measured sinkage [N].
    pub force: [f64; 3],
    /// Sinkage [m] and forces [N] under the measured load; None if there is no equilibrium.
    pub carried: Option<(f64, [f64; 3])>,
}

/// A measured row and its prediction.
#[derive(Clone, Copy, Debug)]
pub struct MeasuredPair {
    pub wheel: usize,
    pub row: SteadyState,
    pub prediction: Prediction,
}

/// Predicts every row of a wheel in `sand`. After a stop the predictions are unfinished.
pub fn predict(
    index: usize,
    wheel: &Wheel,
    sand: &SandDescription,
    rows: &[SteadyState],
    latch: &Latch,
) -> Vec<MeasuredPair> {
    parallel::map(rows, |row| {
        if latch.stopped() {
            let prediction = Prediction { force: [f64::NAN; 3], carried: None };
            return MeasuredPair { wheel: index, row: *row, prediction };
        }
        let at = |given| compute(&wheel.body, sand, &Trial { given, ..row.trial });
        let under = at(DepthOrLoad::Load(row.force[2]));
        let carried = (under.status == Status::Ok).then_some((under.depth, under.force));
        MeasuredPair {
            wheel: index,
            row: *row,
            prediction: Prediction { force: at(DepthOrLoad::Depth(row.depth)).force, carried },
        }
    })
}

/// Names of the root mean square errors: Fx, Fy, Fz at the measured sinkage in % of the mean load; sinkage in mm; Fx,
/// Fy under the measured load in % of the mean load.
pub const FIGURES: [&str; 6] = ["Fx %", "Fy %", "Fz %", "sinkage mm", "Fx under load %", "Fy under load %"];

/// [`FIGURES`] of some rows.
#[derive(Clone, Debug)]
pub struct ForceErrors {
    pub rows: usize,
    pub without_equilibrium: usize,
    pub values: [f64; 6],
}

pub fn errors(pairs: &[MeasuredPair]) -> ForceErrors {
    let load = pairs.iter().map(|p| p.row.force[2]).sum::<f64>() / pairs.len() as f64;
    let percent = 100.0 / load;
    let at = |k: usize| percent * rms(pairs.iter().map(|p| p.prediction.force[k] - p.row.force[k]));
    let carried = || pairs.iter().filter_map(|p| p.prediction.carried.map(|c| (p.row, c)));
    let under = |k: usize| percent * rms(carried().map(|(row, (_, force))| force[k] - row.force[k]));
    let sinkage = 1e3 * rms(carried().map(|(row, (depth, _))| depth - row.depth));
    ForceErrors {
        rows: pairs.len(),
        without_equilibrium: pairs.len() - carried().count(),
        values: [at(0), at(1), at(2), sinkage, under(0), under(1)],
    }
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0), |(sum, count), x| (sum + x * x, count + 1));
    (sum / f64::from(count)).sqrt()
}

/// 95 % intervals of [`FIGURES`] by a bootstrap over conditions, each with all its repetitions.
pub fn intervals(pairs: &[MeasuredPair]) -> [[f64; 2]; 6] {
    let groups = conditions(pairs);
    let mut random = Xoshiro256PlusPlus::seed_from_u64(1);
    let drawn: Vec<[f64; 6]> = (0..RESAMPLES)
        .map(|_| {
            let draw = |_| &groups[random.random_range(0..groups.len())];
            let resample: Vec<MeasuredPair> = (0..groups.len()).flat_map(draw).copied().collect();
            errors(&resample).values
        })
        .collect();
    std::array::from_fn(|k| {
        let mut sorted: Vec<f64> = drawn.iter().map(|v| v[k]).collect();
        sorted.sort_by(f64::total_cmp);
        [0.025, 0.975].map(|share| sorted[(share * (RESAMPLES - 1) as f64).round() as usize])
    })
}

fn conditions(pairs: &[MeasuredPair]) -> Vec<Vec<MeasuredPair>> {
    let key = |pair: &MeasuredPair| (pair.wheel, pair.row.condition());
    let mut groups: Vec<Vec<MeasuredPair>> = Vec::new();
    for pair in pairs {
        match groups.iter_mut().find(|group| key(&group[0]) == key(pair)) {
            Some(group) => group.push(*pair),
            None => groups.push(vec![*pair]),
        }
    }
    groups
}

/// Scatter of repetitions about their condition's mean: Fx, Fy, Fz in % of the mean load, sinkage in mm.
pub fn scatter(pairs: &[MeasuredPair]) -> [f64; 4] {
    let load = pairs.iter().map(|p| p.row.force[2]).sum::<f64>() / pairs.len() as f64;
    let groups = conditions(pairs);
    let of = |value: &dyn Fn(&SteadyState) -> f64| {
        let (mut squares, mut freedom) = (0.0, 0.0);
        for group in groups.iter().filter(|g| g.len() > 1) {
            let mean = group.iter().map(|p| value(&p.row)).sum::<f64>() / group.len() as f64;
            squares += group.iter().map(|p| (value(&p.row) - mean).powi(2)).sum::<f64>();
            freedom += group.len() as f64 - 1.0;
        }
        (squares / freedom).sqrt()
    };
    let force = |k: usize| 100.0 / load * of(&|row: &SteadyState| row.force[k]);
    [force(0), force(1), force(2), 1e3 * of(&|row: &SteadyState| row.depth)]
}

/// Regimes in which a model may fail: a name and its rows.
pub type Regime = (&'static str, fn(&SteadyState) -> bool);

pub const REGIMES: [Regime; 7] = [
    ("locked wheel, slip ratio −1", |r| r.slip < -0.9),
    ("skid, slip ratio −0.9 to −0.55", |r| (-0.9..-0.55).contains(&r.slip)),
    ("commanded slip ratio −0.5 to 0.5", |r| r.slip.abs() <= 0.55),
    ("measured slip ratio −0.5 to 0.5", |r| r.slip.abs() <= 0.5),
    ("spin, slip ratio above 0.55", |r| r.slip > 0.55),
    ("slip angle 0°", |r| r.slip_angle.abs() < 1.0),
    ("slip angle 45° and more", |r| r.slip_angle.abs() >= 45.0),
];
