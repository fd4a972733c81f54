//! Turns messages into checked operations. Every request passes through here first.

use super::proto::{self, run_session_request::Request};
use super::values;
use crate::env::ResetOptions;
use crate::error::{Error, Result};
use crate::pool::{Batch, Operation, Preparing, Seal, Snapshot};

/// The operation on `batch` that `request` describes; after an error the batch is unchanged.
pub fn operation(batch: &mut Batch, request: Option<Request>, seal: &Seal) -> Result<Operation> {
    let envs = batch.envs();
    match request {
        Some(Request::Step(step)) => {
            let (actions, held) = (step_actions(batch, &step.actions)?, &step.held);
            match held.is_empty() {
                true => batch.step(actions),
                false => batch.step_but(actions, flags("held", held, envs)?),
            }
        }
        Some(request @ (Request::Reset(_) | Request::Restore(_))) => preparing(batch, request, seal)?.finish(batch),
        Some(Request::SetCommand(set)) => batch.set_command(&floats("commands", &set.commands)?),
        // The other requests are not operations; they were answered before.
        Some(_) | None => Err(unknown()),
    }
}

fn unknown() -> Error {
    let known = "neither reset, step, attach, save, restore, rollout, policy_rollout, render, observe nor set_command";
    Error::invalid("request", known)
}

/// The reset or restore that `request` describes, before its tasks and episodes are made.
pub fn preparing(batch: &Batch, request: Request, seal: &Seal) -> Result<Preparing> {
    let envs = batch.envs();
    match request {
        Request::Reset(reset) => {
            let chosen = if reset.mask.is_empty() { None } else { Some(flags("mask", &reset.mask, envs)?) };
            let seeds = if reset.seeds.is_empty() { None } else { Some(reset.seeds) };
            let changes = ResetOptions::new(values::to_json(reset.options)?)?;
            batch.prepare_reset(chosen, seeds, changes)
        }
        Request::Restore(restore) => {
            let sources =
                if restore.sources.is_empty() { None } else { Some(indices("sources", &restore.sources, envs)?) };
            let snapshot = Snapshot::from_bytes(&restore.snapshot, seal)?;
            batch.prepare_restore(snapshot, sources)
        }
        _ => Err(unknown()),
    }
}

/// Largest size of messages that are checked on the thread that received them [bytes]: our choice, because 16 KiB of
/// actions (more than 600 hexapods) take microseconds.
const LIGHT: usize = 16 << 10;

/// How long a request keeps the thread that checks it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RequestWeight {
    /// Some microseconds: the thread that received the request checks it.
    Light,
    /// Some milliseconds: a blocking thread checks it.
    Short,
    /// Longer: a blocking thread checks it, in turns.
    Long,
}

/// How long this request keeps the thread that checks it. A reset with options makes this thread build models, which
/// takes long.
pub fn weight(request: &proto::RunSessionRequest) -> RequestWeight {
    match &request.request {
        Some(Request::Step(step)) if step.actions.len() + step.held.len() <= LIGHT => RequestWeight::Light,
        Some(Request::Step(_) | Request::Observe(_)) => RequestWeight::Short,
        Some(Request::Reset(reset)) if reset.options.is_some() => RequestWeight::Long,
        Some(Request::Reset(reset)) if 8 * reset.seeds.len() + reset.mask.len() <= LIGHT => RequestWeight::Light,
        Some(Request::Reset(_)) => RequestWeight::Short,
        Some(Request::SetCommand(set)) if set.commands.len() <= LIGHT => RequestWeight::Light,
        Some(Request::SetCommand(_)) => RequestWeight::Short,
        Some(Request::Attach(_)) | None => RequestWeight::Light,
        Some(_) => RequestWeight::Long,
    }
}

pub fn floats(field: &str, bytes: &[u8]) -> Result<Vec<f32>> {
    let (numbers, rest) = bytes.as_chunks();
    if !rest.is_empty() {
        return Err(Error::invalid(field, format!("{} bytes are no whole number of f32", bytes.len())));
    }
    Ok(numbers.iter().map(|b| f32::from_le_bytes(*b)).collect())
}

/// Size of the session's largest message, envelope included, that is a step, a command or a reset without options
/// [bytes].
pub fn largest_step(batch: &Batch) -> usize {
    let step = 4 * batch.spec().action.len() + 1;
    let (reset, command) = (8 + 1, 4 * 3);
    batch.envs() * step.max(reset).max(command) + 256
}

/// A step's actions; a wrong length is refused before unpacking.
fn step_actions(batch: &Batch, bytes: &[u8]) -> Result<Vec<f32>> {
    let width = batch.spec().action.len();
    match bytes.len() == 4 * batch.envs() * width || !bytes.len().is_multiple_of(4) {
        true => floats("actions", bytes),
        false => Err(batch.wrong_rows("actions", bytes.len() / 4, width)),
    }
}

fn indices(field: &str, bytes: &[u8], envs: usize) -> Result<Vec<u32>> {
    let (numbers, rest) = bytes.as_chunks();
    if !rest.is_empty() {
        return Err(Error::invalid(field, format!("{} bytes are no whole number of u32", bytes.len())));
    }
    check_count(field, numbers.len(), envs)?;
    Ok(numbers.iter().map(|b| u32::from_le_bytes(*b)).collect())
}

fn flags(field: &str, bytes: &[u8], envs: usize) -> Result<Vec<bool>> {
    check_count(field, bytes.len(), envs)?;
    let flag = |(i, byte): (usize, &u8)| match byte {
        0 => Ok(false),
        1 => Ok(true),
        other => Err(Error::invalid(format!("{field}[{i}]"), format!("{other} is neither 0 nor 1"))),
    };
    bytes.iter().enumerate().map(flag).collect()
}

fn check_count(field: &str, count: usize, envs: usize) -> Result<()> {
    if count == envs {
        return Ok(());
    }
    Err(Error::invalid(field, format!("{count} entries for {envs} environments")))
}
