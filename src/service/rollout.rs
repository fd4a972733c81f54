//! Carries out a request for a rollout, some steps at a time, so that the work can end when nobody waits for it any
//! more. Then all environments are restored.

use super::encode;
use super::proto::run_session_response::Response;
use super::proto::{self, RolloutPart};
use super::sessions::broken;
use super::work::SessionWork;
use crate::decode;
use crate::error::{Error, Result};
use crate::pool::{Batch, Operation, Pool, Roll};
use crate::session::roll::Rolling;
use std::sync::Arc;
use std::time::Instant;
use tokio::sync::oneshot;

/// Checks a rollout of actions and starts it.
pub fn start(work: SessionWork, request: &proto::Rollout, pool: Arc<Pool>) {
    let trajectories = request.trajectories;
    let roll = |batch: &Batch| batch.roll(decode::floats("actions", &request.actions)?, trajectories);
    begin(work, roll, trajectories, pool);
}

/// Checks a rollout of a network and starts it.
pub fn start_network(work: SessionWork, request: &proto::PolicyRollout, pool: Arc<Pool>) {
    let proto::PolicyRollout { onnx, steps, trajectories } = request;
    begin(work, |batch| batch.roll_network(onnx, *steps, *trajectories), *trajectories, pool);
}

fn begin(mut work: SessionWork, roll: impl FnOnce(&Batch) -> Result<Roll>, trajectories: bool, pool: Arc<Pool>) {
    let batch = work.batch();
    match roll(batch).and_then(|roll| Ok((roll, batch.keep()?))) {
        Ok((roll, back)) => drop(tokio::spawn(run(work, roll, back, trajectories, pool))),
        Err(error) => work.refuse(&error),
    }
}

async fn run(mut work: SessionWork, roll: Roll, back: Operation, trajectories: bool, pool: Arc<Pool>) {
    let rolled = parts(&mut work, &roll, trajectories, &pool).await;
    let restored = match rolled {
        Ok(rolled) => {
            // The environments are restored in any case.
            work.batch().set_stop(None);
            pooled(&mut work, &pool, back, |_| ()).await.map(|()| rolled)
        }
        Err(error) => Err(error),
    };
    match restored {
        Err(error) => work.lose(&error),
        Ok(Err(Error::Cancelled(_))) => {}
        Ok(Err(error)) => work.refuse(&error),
        Ok(Ok(mut last)) => {
            if !trajectories {
                (last.first_step, last.steps) = (0, roll.total() as u32);
            }
            let (answers, end) = (work.answers.clone(), work.end.clone());
            let answer = work.response(Response::Rollout(last));
            work.settle(None);
            // The environments go back before a slow client reads the answer; the answer's memory is in use until the
            // client has read it.
            let _share = work.share.clone();
            drop(work);
            let _ = end.run_until_cancelled(answers.send(answer)).await;
        }
    }
}

/// Makes all steps, and returns the results after the last one. The outer error means that the environments are lost.
async fn parts(
    work: &mut SessionWork,
    roll: &Roll,
    trajectories: bool,
    pool: &Arc<Pool>,
) -> Result<Result<RolloutPart>> {
    let begun = Instant::now();
    let sessions = work.guard.sessions.clone();
    let mut rolling = Rolling::new(roll);
    let stopped = || Ok(Err(Error::Cancelled("nobody waits for the rollout any more".into())));
    while let Some(operation) = rolling.next_part() {
        let (made, is_last, chooses) = (rolling.made(), rolling.is_last(), roll.chooses());
        // Encoded on the thread that made the last step. If the part was stopped, only some shards have its steps, and nobody
        // waits for it.
        let encoded = move |batch: &Batch| match batch.was_stopped() {
            true => Ok(RolloutPart::default()),
            false => Rolling::check(batch).map(|()| encode::rollout(batch, made, is_last, chooses)),
        };
        let part = match pooled(work, pool, operation, encoded).await? {
            Ok(part) => part,
            Err(error) => return Ok(Err(error)),
        };
        if work.batch().was_stopped() {
            return stopped();
        }
        rolling.went();
        if is_last {
            sessions.metrics.rolled(begun.elapsed(), work.batch());
            return Ok(Ok(part));
        }
        if work.end.is_cancelled() {
            return stopped();
        }
        if trajectories {
            // A client that does not read slows the rollout.
            let part = work.response(Response::Rollout(part));
            let sent = work.end.run_until_cancelled(work.answers.send(part)).await;
            if !matches!(sent, Some(Ok(()))) {
                return stopped();
            }
        }
    }
    Err(Error::Internal("the rollout ended without a last part".into()))
}

/// [`Pool::run`] as a future; `then` reads the results on the pool's thread.
async fn pooled<T: Send + 'static>(
    work: &mut SessionWork,
    pool: &Pool,
    operation: Operation,
    then: impl FnOnce(&Batch) -> T + Send + 'static,
) -> Result<T> {
    let (sender, receiver) = oneshot::channel();
    pool.run(work.guard.take(), operation, |batch| {
        // The receiver below waits until it has the batch.
        let _ = sender.send(batch.map(|batch| (then(&batch), batch)));
    });
    let (read, batch) = receiver.await.unwrap_or_else(|_| Err(broken()))?;
    work.guard.put(batch);
    Ok(read)
}
