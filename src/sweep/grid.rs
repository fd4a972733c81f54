//! Simulates a walk for every design of a grid.

use super::figure::values;
use super::{Design, SweepAxis, walk_all};
use crate::error::{Result, check_range};
use crate::progress::{PartialProgress, Progress};
use crate::sim::engine::EngineKind;
use crate::sim::walk::{WalkResult, WalkTrial};

/// More walks than this are refused: our choice, about an hour of one core.
pub const MOST_WALKS: usize = 500_000;

/// Walks whose models are in memory at the same time: our choice, some 100 MiB.
const PORTION: usize = 4096;

/// One walk for each grid point; the last axis varies fastest. An error of `progress` stops the walks.
pub fn grid(base: &Design, axes: &[SweepAxis], progress: &dyn Progress) -> Result<Vec<WalkResult>> {
    let count = check_grid(base, axes)?;
    let mut results = Vec::with_capacity(count);
    while results.len() < count {
        let portion = results.len()..(results.len() + PORTION).min(count);
        let ends = [portion.start, portion.end].map(|i| i as f64 / count as f64);
        let trials = portion.map(|i| trial(base, axes, i)).collect::<Result<Vec<_>>>()?;
        results.extend(walk_all(EngineKind::Lanes, &trials, &PartialProgress::new(progress, ends))?);
    }
    Ok(results)
}

/// Refuses a grid that is too large, and each value that the base design cannot have; returns the number of its
/// points.
pub fn check_grid(base: &Design, axes: &[SweepAxis]) -> Result<usize> {
    let count: usize = axes.iter().map(|a| a.values.len()).product();
    check_range("number of walks", count as f64, 1.0..=MOST_WALKS as f64)?;
    let mut stride = 1;
    for axis in axes.iter().rev() {
        // Tests each value with the other axes at their first values, because testing all combinations would take too
        // long.
        (0..axis.values.len()).try_for_each(|k| trial(base, axes, k * stride).map(drop))?;
        stride *= axis.values.len();
    }
    Ok(count)
}

fn trial(base: &Design, axes: &[SweepAxis], index: usize) -> Result<WalkTrial> {
    let mut design = base.clone();
    for (axis, value) in axes.iter().zip(values(axes, index)) {
        axis.parameter.set(&mut design, value)?;
    }
    let trial = design.trial()?;
    trial.validate()?;
    Ok(trial)
}
