//! A search for the best design within bounds. It is a particle swarm, because the speed of a walk has kinks and
//! local optima, gradients are not known, and the walks of a swarm run side by side in the lanes.

use super::{Design, SweepAxis, SweepMeasure, walk_all};
use crate::error::{Error, Result};
use crate::progress::{PartialProgress, Progress};
use crate::sim::engine::EngineKind;
use crate::sim::walk::{WalkResult, WalkTrial};
use argmin::core::{CostFunction, Executor, State};
use argmin::solver::particleswarm::ParticleSwarm;
use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;
use std::borrow::Borrow;
use std::cell::Cell;

/// Robots in the swarm: our choice, two full blocks of lanes, one block for each core of a small machine.
const SWARM: usize = 32;
/// Moves of the swarm: our choice, because two parameters are then found to about 1 % of their range.
const MOVES: u64 = 25;
/// The same seed in every search, so that a search can be repeated; the number is arbitrary.
const SEED: u64 = 1;

/// Number of walks in a search.
pub const WALKS: usize = SWARM * (MOVES as usize + 1);

/// The best design found.
pub struct Optimum {
    /// In the axes' order and units.
    pub values: Vec<f64>,
    pub result: WalkResult,
}

struct Problem<'a> {
    base: &'a Design,
    axes: &'a [SweepAxis],
    measure: SweepMeasure,
    progress: &'a dyn Progress,
    /// Number of simulated robots.
    simulated: Cell<usize>,
}

impl Problem<'_> {
    fn trial(&self, values: &[f64]) -> Result<WalkTrial> {
        trial(self.base, self.axes, values)
    }

    fn walk(&self, swarm: &[&[f64]]) -> Result<Vec<WalkResult>> {
        let trials = swarm.iter().map(|values| self.trial(values)).collect::<Result<Vec<_>>>()?;
        let before = self.simulated.get();
        self.simulated.set(before + swarm.len());
        let ends = [before, before + swarm.len()].map(|n| (n as f64 / WALKS as f64).min(1.0));
        walk_all(EngineKind::Lanes, &trials, &PartialProgress::new(self.progress, ends))
    }
}

fn trial(base: &Design, axes: &[SweepAxis], values: &[f64]) -> Result<WalkTrial> {
    let mut design = base.clone();
    for (axis, value) in axes.iter().zip(values) {
        axis.parameter.set(&mut design, &value.to_string())?;
    }
    let trial = design.trial()?;
    trial.validate()?;
    Ok(trial)
}

impl CostFunction for Problem<'_> {
    type Param = Vec<f64>;
    type Output = f64;

    fn cost(&self, values: &Vec<f64>) -> std::result::Result<f64, argmin::core::Error> {
        Ok(self.walk(&[values])?.iter().map(|r| self.measure.cost(r)).sum())
    }

    fn bulk_cost<P>(&self, swarm: &[P]) -> std::result::Result<Vec<f64>, argmin::core::Error>
    where
        P: Borrow<Vec<f64>> + argmin::core::SyncAlias,
        f64: argmin::core::SendAlias,
        Vec<f64>: argmin::core::SendAlias,
    {
        let swarm: Vec<&[f64]> = swarm.iter().map(|p| p.borrow().as_slice()).collect();
        Ok(self.walk(&swarm)?.iter().map(|r| self.measure.cost(r)).collect())
    }
}

/// Least and greatest value of each axis. Designs at both bounds are simulated once, so that wrong bounds give an
/// error.
pub fn bounds(base: &Design, axes: &[SweepAxis]) -> Result<[Vec<f64>; 2]> {
    let [low, high] = SweepAxis::ends(axes)?;
    trial(base, axes, &low)?;
    trial(base, axes, &high)?;
    Ok([low, high])
}

/// Searches between the least and greatest value of each axis. An error of `progress` stops the search.
pub fn optimize(base: &Design, axes: &[SweepAxis], measure: SweepMeasure, progress: &dyn Progress) -> Result<Optimum> {
    let [low, high] = bounds(base, axes)?;
    let problem = Problem { base, axes, measure, progress, simulated: Cell::new(0) };
    let random = Xoshiro256PlusPlus::seed_from_u64(SEED);
    let swarm = ParticleSwarm::new((low, high), SWARM).with_rng_generator(random);
    let run = Executor::new(problem, swarm).configure(|state| state.max_iters(MOVES)).run();
    let failed = |e: argmin::core::Error| match e.downcast::<Error>() {
        Ok(ours) => ours,
        Err(other) => Error::Exhausted(format!("the search failed: {other}")),
    };
    let run = run.map_err(failed)?;
    let best = run.state.get_best_param().ok_or_else(|| Error::Exhausted("the search found nothing".into()))?;
    let values = best.position.clone();
    let result = crate::sim::walk::walk(EngineKind::Lanes, &trial(base, axes, &values)?)?;
    Ok(Optimum { values, result })
}
