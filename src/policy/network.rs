//! Runs a network.

use super::operator::Program;
use super::price::Price;
use super::read;
use super::{LANES, Lanes};
use crate::env::Spec;
use crate::error::{Error, Result};

/// A deterministic policy of one task. All threads that run it share it.
#[derive(Debug)]
pub struct Network {
    program: Program,
    observation: usize,
    /// Bounds of each number of an action.
    bounds: Vec<[f32; 2]>,
}

impl Network {
    /// Reads `onnx`, a file's bytes, and checks that it is a policy of the task with this `spec`. See
    /// `docs/evaluate.md` for what a file may contain.
    pub fn new(onnx: &[u8], spec: &Spec) -> Result<Self> {
        let (observation, action) = (spec.observation.len(), spec.action.len());
        let program = read::program(onnx, [observation, action])?;
        let bounds = spec.action.iter().map(|c| [c.low as f32, c.high as f32]).collect();
        Ok(Self { program, observation, bounds })
    }

    /// What the network costs while it is used.
    pub fn price(&self) -> Price {
        Price::of(&self.program, self.observation)
    }

    /// Computes `actions`, f32 [n, action], clipped to their bounds, from `observations`, f32 [n, observation]. NaN in
    /// an action is an error.
    pub fn act(&self, observations: &[f32], actions: &mut [f32]) -> Result<()> {
        let mut values = vec![vec![[0.0; LANES]; self.observation]];
        values.extend(self.program.steps.iter().map(|step| vec![[0.0; LANES]; step.width]));
        let (wide, width) = (self.observation * LANES, self.bounds.len() * LANES);
        for (block, (rows, out)) in observations.chunks(wide).zip(actions.chunks_mut(width)).enumerate() {
            for (lane, row) in rows.chunks_exact(self.observation).enumerate() {
                values[0].iter_mut().zip(row).for_each(|(x, number)| x[lane] = *number);
            }
            self.compute(&mut values);
            for (lane, row) in out.chunks_exact_mut(self.bounds.len()).enumerate() {
                for (k, (out, [low, high])) in row.iter_mut().zip(&self.bounds).enumerate() {
                    let chosen = values[self.program.action][k][lane];
                    if chosen.is_nan() {
                        let which = format!("action[{}][{k}]", block * LANES + lane);
                        return Err(Error::invalid("policy", format!("{which} is not a number")));
                    }
                    *out = chosen.clamp(*low, *high);
                }
            }
        }
        Ok(())
    }

    fn compute(&self, values: &mut [Vec<Lanes>]) {
        for (k, step) in self.program.steps.iter().enumerate() {
            let (before, rest) = values.split_at_mut(k + 1);
            step.operator.compute(before, &mut rest[0]);
        }
    }
}
