//! Runs episodes in parallel: a shard has as many seeds as its engine takes, and shards run on all cores.

use super::episode::{Columns, EpisodeSums};
use super::gait::Gait;
use crate::env::Shard;
use crate::env::registry::Blueprint;
use crate::error::Result;
use crate::parallel;
use crate::progress::Progress;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

/// Episodes of one gait, one for each seed.
pub struct EpisodeJob<'a> {
    pub blueprint: &'a Blueprint,
    pub gait: &'a Gait,
    pub seeds: &'a [u64],
}

/// Control steps between two reports of progress: some milliseconds of work, our choice.
const REPORT_STEPS: usize = 50;
/// A report follows sooner after this time, because control steps of many time steps are long: our choice.
const REPORT_TIME: Duration = Duration::from_millis(50);

/// The episodes of every job, in order of its seeds. An episode depends on its seed alone, not on its neighbours,
/// the threads or the other jobs. An error of `progress` stops the work.
pub fn play(jobs: &[EpisodeJob], progress: &dyn Progress) -> Result<Vec<Vec<EpisodeSums>>> {
    let size = |job: &EpisodeJob| job.blueprint.engine.shard_size();
    let blocks: Vec<(&EpisodeJob, &[u64])> =
        jobs.iter().flat_map(|job| job.seeds.chunks(size(job)).map(move |seeds| (job, seeds))).collect();
    let longest = |job: &EpisodeJob| job.blueprint.task.spec().max_episode_steps as usize;
    let total: usize = blocks.iter().map(|(job, _)| longest(job)).sum();
    let (done, episodes) = (AtomicUsize::new(0), jobs.iter().map(|job| job.seeds.len()).sum::<usize>());
    let stage = format!("{episodes} episodes");
    let advance = |steps: usize| {
        let steps = done.fetch_add(steps, Ordering::Relaxed) + steps;
        progress.report((steps as f64 / total as f64).min(1.0), &stage)
    };
    let played = parallel::map(&blocks, |(job, seeds)| {
        // After a stop no further block starts.
        advance(0)?;
        let (steps, episodes) = block(job, seeds, &advance)?;
        // Reports the steps that episodes did not make because they ended early, and the last steps that were not
        // reported yet.
        advance(longest(job) - steps / REPORT_STEPS * REPORT_STEPS)?;
        Ok(episodes)
    });
    let mut played = played.into_iter();
    jobs.iter()
        .map(|job| {
            let blocks = played.by_ref().take(job.seeds.len().div_ceil(size(job)));
            Ok(blocks.collect::<Result<Vec<_>>>()?.concat())
        })
        .collect()
}

/// Runs until the last of these episodes has ended; returns the number of steps. `report` is called after every
/// [`REPORT_STEPS`] steps with their number, and sooner if they are long.
fn block(job: &EpisodeJob, seeds: &[u64], report: &dyn Fn(usize) -> Result<()>) -> Result<(usize, Vec<EpisodeSums>)> {
    let spec = job.blueprint.task.spec();
    let (columns, period) = (Columns::of(spec)?, 1.0 / spec.control_rate);
    let mut shard = Shard::new(job.blueprint, seeds.len())?;
    shard.reset(|_| true, Some(seeds), |_| None);
    let mut player = job.gait.player(seeds);
    let mut actions = vec![0.0; seeds.len() * spec.action.len()];
    let mut episodes: Vec<_> = seeds.iter().map(|seed| EpisodeSums { seed: *seed, ..EpisodeSums::default() }).collect();
    let (mut steps, mut reported) = (0, Instant::now());
    while episodes.iter().any(|e| !e.over) {
        let running: Vec<usize> = (0..seeds.len()).filter(|i| !episodes[*i].over).collect();
        running.iter().for_each(|i| episodes[*i].look(&shard, *i, period));
        player.act(&shard, &mut actions)?;
        shard.step(&actions);
        running.iter().for_each(|i| episodes[*i].add(&shard, *i, columns, period));
        steps += 1;
        if steps % REPORT_STEPS == 0 {
            report(REPORT_STEPS)?;
        } else if reported.elapsed() > REPORT_TIME {
            report(0)?;
        } else {
            continue;
        }
        reported = Instant::now();
    }
    Ok((steps, episodes))
}
