//! Runs many walks: robots that walk equally long share the lanes of one block, and blocks share the cores.

use crate::error::Result;
use crate::parallel;
use crate::progress::Progress;
use crate::sim::engine::EngineKind;
use crate::sim::walk::{WalkResult, WalkTrial, walk_many};
use parking_lot::Mutex;

/// Walks all trials; the results have the order of the trials. An error of `progress` stops all of them within a second of simulated
/// time.
///
/// A block has one law, regularisation and time step, and equally many plates in every lane. Among trials that agree in
/// these, those of similar duration share a block, because a block runs until its slowest robot has finished its
/// strides.
pub fn walk_all(engine: EngineKind, trials: &[WalkTrial], progress: &dyn Progress) -> Result<Vec<WalkResult>> {
    let mut order: Vec<usize> = (0..trials.len()).collect();
    order.sort_by(|a, b| {
        let key = |i: &usize| (kind(&trials[*i]), trials[*i].duration());
        let ((ka, da), (kb, db)) = (key(a), key(b));
        ka.cmp(&kb).then(da.total_cmp(&db))
    });
    let lanes = engine.lanes()?;
    let mut blocks: Vec<Vec<usize>> = Vec::new();
    for index in order {
        match blocks.last_mut() {
            Some(block) if block.len() < lanes && kind(&trials[block[0]]) == kind(&trials[index]) => {
                block.push(index);
            }
            _ => blocks.push(vec![index]),
        }
    }
    // The slowest walks are last. They are started first, so that they do not keep a single core busy at the end.
    blocks.reverse();
    let clock = SweepProgress::of(trials, &blocks, progress);
    let outcomes = parallel::map(&blocks, |block| {
        // After a stop no further block starts.
        clock.advance(0.0)?;
        let packed: Vec<WalkTrial> = block.iter().map(|i| trials[*i].clone()).collect();
        walk_many(engine, &packed, &|seconds| clock.advance(seconds))
    });
    let mut results = vec![None; trials.len()];
    for (block, outcomes) in blocks.iter().zip(outcomes) {
        for (index, result) in block.iter().zip(outcomes?) {
            results[*index] = Some(result);
        }
    }
    Ok(results.into_iter().flatten().collect())
}

/// Simulated time of all blocks together, the measure of progress.
struct SweepProgress<'a> {
    /// [s]
    total: f64,
    /// [s]
    passed: Mutex<f64>,
    stage: String,
    progress: &'a dyn Progress,
}

impl<'a> SweepProgress<'a> {
    fn of(trials: &[WalkTrial], blocks: &[Vec<usize>], progress: &'a dyn Progress) -> Self {
        let longest = |block: &Vec<usize>| block.iter().map(|i| trials[*i].duration()).fold(0.0, f64::max);
        let total = blocks.iter().map(longest).sum();
        Self { total, passed: Mutex::new(0.0), stage: format!("{} walks", trials.len()), progress }
    }

    fn advance(&self, seconds: f64) -> Result<()> {
        let mut passed = self.passed.lock();
        *passed += seconds;
        let share = (*passed / self.total).min(1.0);
        drop(passed);
        self.progress.report(share, &self.stage)
    }
}

/// Properties that all robots of a block have in common.
fn kind(trial: &WalkTrial) -> (&'static str, [u64; 5], usize, usize, bool) {
    let (model, scene) = (&trial.model, &trial.model.scene);
    let surface = &scene.surface;
    let numbers =
        [scene.dt, surface.rest_speed, surface.leading_edge_gate, surface.sign_gate, surface.friction.unwrap_or(-1.0)];
    let plates = model.belly.len() + 1000 * model.legs.iter().flatten().map(|b| b.plates.len()).sum::<usize>();
    (scene.law.name(), numbers.map(f64::to_bits), model.joints(), plates, trial.frequency == 0.0)
}
