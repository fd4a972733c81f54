//! Turns rows and tables into messages.

use super::proto;
use super::sessions::SessionSummary;
use super::values;
use crate::env::registry::{Blueprint, Keyword};
use crate::env::rollout::{Recorded, Rollout};
use crate::env::shard::Rows;
use crate::env::{Column, Spec};
use crate::pool::Batch;
use bytes::Bytes;

/// Rows of the last operation, copied once from the shards into little-endian columns.
pub fn batch(batch: &Batch) -> proto::Batch {
    let floats = |column: fn(&Rows) -> &[f32]| floats(batch.shards().iter().map(move |s| column(&s.rows)));
    let flags = |column: fn(&Rows) -> &[u8]| -> Bytes {
        batch.shards().iter().flat_map(move |s| column(&s.rows)).copied().collect::<Vec<_>>().into()
    };
    proto::Batch {
        observations: floats(|r| &r.observations),
        rewards: floats(|r| &r.rewards),
        terminated: flags(|r| &r.terminated),
        truncated: flags(|r| &r.truncated),
        infos: floats(|r| &r.infos),
        final_indices: final_indices(batch),
        final_observations: floats(|r| &r.final_observations),
    }
}

/// The steps of a rollout that were made since the last part. `made`: number of steps of the rollout so far. `actions`:
/// whether the message includes the actions, because a network chose them.
pub fn rollout(batch: &Batch, made: usize, is_last: bool, actions: bool) -> proto::RolloutPart {
    let shards = batch.shards();
    let steps = shards.first().map_or(0, |s| s.rollout.steps.len());
    let recorded = |column: fn(&Recorded) -> &[f32]| {
        floats((0..steps).flat_map(move |step| shards.iter().map(move |s| column(&s.rollout.steps[step]))))
    };
    let flags = |column: fn(&Rollout) -> &[u8]| -> Bytes {
        shards.iter().flat_map(move |s| column(&s.rollout)).copied().collect::<Vec<_>>().into()
    };
    let mut part = proto::RolloutPart {
        first_step: (made - steps) as u32,
        steps: steps as u32,
        observations: recorded(|r| &r.observations),
        rewards: recorded(|r| &r.rewards),
        ..Default::default()
    };
    if actions {
        part.actions = recorded(|r| &r.actions);
    }
    if is_last {
        part.returns = shards.iter().flat_map(|s| &s.rollout.returns).flat_map(|r| r.to_le_bytes()).collect();
        part.lengths = shards.iter().flat_map(|s| &s.rollout.lengths).flat_map(|n| n.to_le_bytes()).collect();
        part.terminated = flags(|r| &r.terminated);
        part.truncated = flags(|r| &r.truncated);
    }
    part
}

fn floats<'a>(parts: impl Iterator<Item = &'a [f32]> + Clone) -> Bytes {
    let length: usize = parts.clone().map(<[f32]>::len).sum();
    let mut bytes = vec![0; 4 * length];
    let mut free = bytes.as_chunks_mut().0;
    for part in parts {
        // Slice by slice this compiles to a plain copy; a single iterator over all numbers would be ten times slower.
        let (now, later) = free.split_at_mut(part.len());
        now.iter_mut().zip(part).for_each(|(out, value)| *out = value.to_le_bytes());
        free = later;
    }
    bytes.into()
}

/// A shard counts environments from its own first environment, a message from the batch's first one.
fn final_indices(batch: &Batch) -> Bytes {
    let mut bytes = Vec::new();
    let mut start = 0;
    for shard in batch.shards() {
        let ended = shard.rows.ended.iter().map(|i| start + i);
        bytes.extend(ended.flat_map(u32::to_le_bytes));
        start += shard.envs() as u32;
    }
    bytes.into()
}

/// A task's tables, and its options with their values in `blueprint`.
pub fn task(blueprint: &Blueprint) -> proto::Task {
    let Spec { id, summary, observation, action, info, reward, max_episode_steps, control_rate, .. } =
        blueprint.task.spec();
    proto::Task {
        id: (*id).into(),
        summary: summary.clone(),
        observation: columns(observation),
        action: columns(action),
        info: columns(info),
        reward_terms: reward.len() as u32,
        max_episode_steps: *max_episode_steps,
        control_rate: *control_rate,
        options: blueprint.keywords().into_iter().map(option).collect(),
    }
}

fn columns(table: &[Column]) -> Vec<proto::Column> {
    let column = |c: &Column| proto::Column { name: c.name.clone(), unit: c.unit.into(), low: c.low, high: c.high };
    table.iter().map(column).collect()
}

fn option(keyword: Keyword) -> proto::Option {
    proto::Option {
        name: keyword.name.into(),
        summary: keyword.summary,
        default_value: Some(values::from_json(&keyword.value)),
        at_reset: keyword.at_reset,
    }
}

/// A session as lists and logs show it.
pub fn summary(summary: &SessionSummary) -> proto::SessionSummary {
    proto::SessionSummary {
        name: summary.name.clone(),
        task_id: summary.blueprint.task.spec().id.into(),
        num_envs: summary.envs as u32,
        attached: summary.attached,
        sequence: summary.sequence,
        idle_seconds: summary.idle.as_secs_f64(),
    }
}
