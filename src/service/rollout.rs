//! A rollout request: some steps at a time, so that other sessions get their turns and a client that leaves is noticed;
//! then everything is put back to where it was.

use super::proto;
use super::proto::run_session_response::Response;
use super::proto::{RolloutPart, RunSessionResponse};
use super::stream::{Work, lost};
use super::{decode, encode};
use crate::error::Result;
use crate::pool::{Batch, Operation, Pool, Roll};
use std::sync::Arc;
use tokio::sync::oneshot;

/// Steps between two looks at who else waits: some milliseconds of work on a shard.
const STEPS: usize = 16;

/// Checks a rollout and starts it.
pub fn start(mut work: Work, request: &proto::Rollout, pool: Arc<Pool>) {
    let batch = &mut work.environments.batch;
    let plan = decode::floats("actions", &request.actions).and_then(|actions| {
        let roll = batch.roll(actions, request.trajectories)?;
        // Checked before anything runs: once it has, the environments must be put back.
        let back = batch.save().and_then(|snapshot| batch.restore(&snapshot, None))?;
        Ok((roll, back))
    });
    match plan {
        Ok((roll, back)) => drop(tokio::spawn(run(work, roll, back, request.trajectories, pool))),
        Err(error) => work.refuse(&error),
    }
}

async fn run(work: Work, roll: Roll, back: Operation, trajectories: bool, pool: Arc<Pool>) {
    let Work { environments, sequence, sessions, id, answers } = work;
    let (batch, rest) = environments.into_parts();
    let part = |part| RunSessionResponse { sequence, response: Some(Response::Rollout(part)) };
    let rolled = async {
        let (mut batch, mut next) = (batch, roll.next(STEPS));
        let mut last = RolloutPart::default();
        while let Some(steps) = next {
            let (made, is_last) = (steps.made(), steps.made() == steps.total());
            next = steps.next(STEPS);
            batch = pooled(&pool, batch, Operation::Roll(steps)).await?;
            last = encode::rollout(&batch, made, is_last);
            // A client that does not read slows this down; one that has gone ends it.
            if answers.is_closed() || (trajectories && !is_last && answers.send(part(last.clone())).await.is_err()) {
                break;
            }
        }
        if !trajectories {
            (last.first_step, last.steps) = (0, roll.total() as u32);
        }
        pooled(&pool, batch, back).await.map(|batch| (batch, last))
    };
    match rolled.await {
        Ok((batch, last)) => {
            // The stream has room for the last answer once it has read those before.
            if answers.reserve().await.is_ok() {
                let environments = rest.with(batch);
                Work { environments, sequence, sessions, id, answers }.finish(Response::Rollout(last), false);
            } else {
                sessions.give_back(&id, rest.with(batch));
            }
        }
        Err(error) => lost(&sessions, &id, &error),
    }
}

/// [`Pool::run`], awaited.
async fn pooled(pool: &Pool, batch: Batch, operation: Operation) -> Result<Batch> {
    let (sender, receiver) = oneshot::channel();
    pool.run(batch, operation, |batch| {
        // Whoever waits below is there until it has this.
        let _ = sender.send(batch);
    });
    let closed = |_| Err(crate::Error::Exhausted("the worker pool was closed".into()));
    receiver.await.unwrap_or_else(closed)
}
