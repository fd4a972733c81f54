//! A search for the best design within bounds: particle swarm, because the speed of a walk has kinks and local optima,
//! gradients are not known, and a whole swarm walks at once in the lanes.

use super::{Axis, Design, Measure, walk_all};
use crate::error::{Error, Result};
use crate::sim::walk::{Trial, WalkResult};
use argmin::core::{CostFunction, Executor, State};
use argmin::solver::particleswarm::ParticleSwarm;
use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;
use std::borrow::Borrow;

/// Robots in the swarm: two full blocks of lanes, one a core of a small machine.
const SWARM: usize = 32;
/// Moves of the swarm: our choice; two parameters are found to about 1 % of their range.
const MOVES: u64 = 25;
/// The same search every time.
const SEED: u64 = 1;

/// Walks that a search makes.
pub const WALKS: usize = SWARM * (MOVES as usize + 1);

/// The best design found.
pub struct Optimum {
    /// In the axes' order and units.
    pub values: Vec<f64>,
    pub result: WalkResult,
}

struct Problem<'a, F> {
    base: &'a Design,
    axes: &'a [Axis],
    measure: Measure,
    done: &'a F,
}

impl<F: Fn(usize) + Sync> Problem<'_, F> {
    fn trial(&self, values: &[f64]) -> Result<Trial> {
        let mut design = self.base.clone();
        for (axis, value) in self.axes.iter().zip(values) {
            axis.parameter.set(&mut design, &value.to_string())?;
        }
        design.trial()
    }

    fn walk(&self, swarm: &[&[f64]]) -> Result<Vec<WalkResult>> {
        let trials = swarm.iter().map(|values| self.trial(values)).collect::<Result<Vec<_>>>()?;
        walk_all(&trials, self.done)
    }
}

impl<F: Fn(usize) + Sync> CostFunction for Problem<'_, F> {
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

/// Searches between the least and greatest value of each axis.
pub fn optimize(base: &Design, axes: &[Axis], measure: Measure, done: &(impl Fn(usize) + Sync)) -> Result<Optimum> {
    let (mut low, mut high) = (Vec::new(), Vec::new());
    for axis in axes {
        let reason = format!("{} needs two numbers to search between", axis.parameter.name);
        let values = axis.numbers().filter(|v| v.len() > 1).ok_or_else(|| Error::invalid("--vary", reason))?;
        low.push(values.iter().copied().fold(f64::INFINITY, f64::min));
        high.push(values.iter().copied().fold(f64::NEG_INFINITY, f64::max));
    }
    let problem = Problem { base, axes, measure, done };
    // Wrong bounds are the user's to mend: say so before the search.
    problem.trial(&low)?;
    problem.trial(&high)?;
    let random = Xoshiro256PlusPlus::seed_from_u64(SEED);
    let swarm = ParticleSwarm::new((low, high), SWARM).with_rng_generator(random);
    let run = Executor::new(problem, swarm).configure(|state| state.max_iters(MOVES)).run();
    let run = run.map_err(|e| Error::Exhausted(format!("the search failed: {e}")))?;
    let best = run.state.get_best_param().ok_or_else(|| Error::Exhausted("the search found nothing".into()))?;
    let values = best.position.clone();
    let problem = Problem { base, axes, measure, done: &|_| () };
    let result = problem.walk(&[&values])?;
    let result = result.into_iter().next().ok_or_else(|| Error::Exhausted("the search found nothing".into()))?;
    Ok(Optimum { values, result })
}
