//! From messages to checked operations. Everything a client sends passes through here before it means anything.

use super::proto::{self, run_session_request::Request};
use super::values;
use crate::env::{ResetOptions, options};
use crate::error::{Error, Result};
use crate::pool::{Batch, Operation, Snapshot};

/// The operation `request` asks of `batch`; on an error the batch is as it was.
pub fn operation(batch: &mut Batch, request: Option<Request>) -> Result<Operation> {
    match request {
        Some(Request::Step(step)) if step.held.is_empty() => batch.step(floats("actions", &step.actions)?),
        Some(Request::Step(step)) => batch.step_but(floats("actions", &step.actions)?, flags("held", &step.held)?),
        Some(Request::Reset(reset)) => {
            let chosen = if reset.mask.is_empty() { None } else { Some(flags("mask", &reset.mask)?) };
            let seeds = if reset.seeds.is_empty() { None } else { Some(reset.seeds) };
            let changes: ResetOptions = options::parse(values::to_json(reset.options)?)?;
            batch.reset(chosen, seeds, changes)
        }
        Some(Request::Restore(restore)) => {
            let snapshot = Snapshot::from_bytes(&restore.snapshot)?;
            let sources = if restore.sources.is_empty() { None } else { Some(indices("sources", &restore.sources)?) };
            batch.restore(&snapshot, sources.as_deref())
        }
        // The others are no operations: they were answered before.
        Some(_) | None => {
            let known = "neither reset, step, attach, save, restore, rollout, policy_rollout, render nor observe";
            Err(Error::invalid("request", known))
        }
    }
}

/// Is this request cheap enough to check on the thread that received it? Models are built from reset options, and
/// 16 KiB of actions (more than 600 hexapods) take microseconds to check.
pub fn is_light(request: &proto::RunSessionRequest) -> bool {
    match &request.request {
        Some(Request::Step(step)) => step.actions.len() <= 16_384,
        Some(Request::Reset(reset)) => reset.options.is_none() && reset.seeds.len() <= 2_048,
        Some(Request::Save(_) | Request::Restore(_) | Request::Rollout(_) | Request::PolicyRollout(_)) => false,
        Some(Request::Render(_) | Request::Observe(_)) => false,
        Some(Request::Attach(_)) | None => true,
    }
}

pub fn floats(field: &str, bytes: &[u8]) -> Result<Vec<f32>> {
    let (numbers, rest) = bytes.as_chunks();
    if !rest.is_empty() {
        return Err(Error::invalid(field, format!("{} bytes are no whole number of f32", bytes.len())));
    }
    Ok(numbers.iter().map(|b| f32::from_le_bytes(*b)).collect())
}

fn indices(field: &str, bytes: &[u8]) -> Result<Vec<u32>> {
    let (numbers, rest) = bytes.as_chunks();
    if !rest.is_empty() {
        return Err(Error::invalid(field, format!("{} bytes are no whole number of u32", bytes.len())));
    }
    Ok(numbers.iter().map(|b| u32::from_le_bytes(*b)).collect())
}

fn flags(field: &str, bytes: &[u8]) -> Result<Vec<bool>> {
    let flag = |(i, byte): (usize, &u8)| match byte {
        0 => Ok(false),
        1 => Ok(true),
        other => Err(Error::invalid(format!("{field}[{i}]"), format!("{other} is neither 0 nor 1"))),
    };
    bytes.iter().enumerate().map(flag).collect()
}
