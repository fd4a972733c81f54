//! A rollout request: some steps at a time, so that it ends when the client leaves; then all environments are
//! restored.

use super::proto;
use super::proto::RunSessionResponse;
use super::proto::run_session_response::Response;
use super::work::Work;
use super::{decode, encode};
use crate::error::Result;
use crate::pool::{Batch, Operation, Pool, Roll};
use crate::session::roll::pace;
use std::sync::Arc;
use std::time::Instant;
use tokio::sync::oneshot;

/// Checks a rollout of actions and starts it.
pub fn start(work: Work, request: &proto::Rollout, pool: Arc<Pool>) {
    let trajectories = request.trajectories;
    let roll = |batch: &Batch| batch.roll(decode::floats("actions", &request.actions)?, trajectories);
    begin(work, roll, trajectories, pool);
}

/// Checks a rollout of a network and starts it.
pub fn start_network(work: Work, request: &proto::PolicyRollout, pool: Arc<Pool>) {
    let proto::PolicyRollout { onnx, steps, trajectories } = request;
    begin(work, |batch| batch.roll_network(onnx, *steps, *trajectories), *trajectories, pool);
}

fn begin(work: Work, roll: impl FnOnce(&Batch) -> Result<Roll>, trajectories: bool, pool: Arc<Pool>) {
    let batch = &work.environments.batch;
    let plan = roll(batch).and_then(|roll| Ok((roll, batch.keep()?)));
    match plan {
        Ok((roll, back)) => drop(tokio::spawn(run(work, roll, back, trajectories, pool))),
        Err(error) => work.refuse(&error),
    }
}

async fn run(work: Work, roll: Roll, back: Operation, trajectories: bool, pool: Arc<Pool>) {
    let Work { environments, mut reply } = work;
    let (batch, rest) = environments.into_parts();
    let (sequence, sessions, answers) = (reply.sequence, reply.loan.sessions.clone(), reply.answers.clone());
    let begun = Instant::now();
    let part = |part| RunSessionResponse { sequence, response: Some(Response::Rollout(part)) };
    let stop = sessions.stop();
    let rolled = async {
        let (mut batch, mut last, mut count) = (batch, roll.clone(), 1);
        let mut answer = None;
        let mut failed = None;
        while let Some(steps) = last.next(count) {
            last = steps.clone();
            let (made, is_last) = (steps.made(), steps.made() == steps.total());
            let turn = Instant::now();
            batch = pooled(&pool, batch, Operation::Roll(steps)).await?;
            failed = batch.shards().iter().find_map(|s| s.rollout.failed.clone());
            if failed.is_some() {
                break;
            }
            count = pace(count, turn.elapsed());
            let rows = encode::rollout(&batch, made, is_last, roll.chooses());
            if is_last {
                answer = Some(rows);
            } else if answers.is_closed() || stop.is_cancelled() {
                break;
            } else if trajectories {
                // A client that does not read slows the rollout. A client that has left ends the rollout, and so does the
                // server's end.
                let sent = stop.run_until_cancelled(answers.send(part(rows))).await;
                if !matches!(sent, Some(Ok(()))) {
                    break;
                }
            }
        }
        sessions.metrics.rolled(begun.elapsed(), &batch);
        pooled(&pool, batch, back).await.map(|batch| (batch, answer, failed))
    };
    match rolled.await {
        Ok((batch, _, Some(error))) => {
            reply.with(rest, batch).refuse(&error);
        }
        Ok((batch, answer, None)) => {
            let work = reply.with(rest, batch);
            // The stream has room for the last answer after it has read the earlier ones.
            let room = stop.run_until_cancelled(answers.reserve()).await.is_some_and(|room| room.is_ok());
            let Some(mut last) = answer.filter(|_| room) else { return work.give_back() };
            if !trajectories {
                (last.first_step, last.steps) = (0, roll.total() as u32);
            }
            work.finish(Response::Rollout(last), false);
        }
        Err(error) => reply.lose(&error),
    }
}

/// [`Pool::run`] as a future.
async fn pooled(pool: &Pool, batch: Batch, operation: Operation) -> Result<Batch> {
    let (sender, receiver) = oneshot::channel();
    pool.run(batch, operation, |batch| {
        // The receiver below waits until it has the batch.
        let _ = sender.send(batch);
    });
    let closed = |_| Err(crate::error::Error::Exhausted("the worker pool was closed".into()));
    receiver.await.unwrap_or_else(closed)
}
