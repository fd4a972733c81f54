//! The work of one request: the session's environments, and the obligation to answer.

use super::encode;
use super::intake::Share;
use super::loan::{Loan, broken};
use super::proto::RunSessionResponse;
use super::proto::run_session_response::Response;
use super::sessions::{Bookkeeping, Done, Environments};
use super::status;
use crate::error::Error;
use crate::pool::{Batch, Operation, Pool};
use std::sync::Arc;
use tokio::sync::mpsc;

/// The inputs of a request's work.
pub struct Work {
    pub environments: Environments,
    pub reply: Reply,
}

/// The obligation that comes with the environments of a [`Work`]: [`Work::finish`] returns them and answers the
/// request. If a panic prevents that, dropping this answers with INTERNAL and ends the session.
pub struct Reply {
    pub sequence: u64,
    pub loan: Loan,
    pub answers: mpsc::Sender<RunSessionResponse>,
    /// Memory share of the request.
    pub share: Option<Arc<Share>>,
}

impl Drop for Reply {
    fn drop(&mut self) {
        if self.loan.is_lost() {
            self.lose(&broken());
        }
    }
}

impl Reply {
    /// The environments are lost: answers and ends the session.
    pub fn lose(&mut self, error: &Error) {
        let response = Some(Response::Failure(status::failure(error)));
        // A stream that does not read loses its session without this answer.
        let _ = self.answers.try_send(RunSessionResponse { sequence: self.sequence, response });
        self.loan.lose(error);
    }

    /// The work with its environments, which an operation has returned intact.
    pub fn with(self, rest: Bookkeeping, batch: Batch) -> Work {
        Work { environments: rest.with(batch), reply: self }
    }
}

impl Work {
    /// Runs `operation` and answers with its batch.
    pub fn run(self, operation: Operation, pool: &Pool) {
        let Self { environments, mut reply } = self;
        let (batch, rest) = environments.into_parts();
        let ran = reply.loan.sessions.metrics.begin(&operation, batch.envs());
        pool.run(batch, operation, move |batch| match batch {
            Ok(batch) => {
                let response = Response::Batch(encode::batch(&batch));
                ran(&batch);
                reply.loan.sessions.watchers.saw(&reply.loan.id, &batch);
                reply.with(rest, batch).finish(response, true);
            }
            Err(error) => reply.lose(&error),
        });
    }

    /// Answers a request that changes nothing.
    pub fn tell(self, answer: crate::error::Result<Response>) {
        match answer {
            Ok(response) => self.finish(response, false),
            Err(error) => self.refuse(&error),
        }
    }

    /// Refuses the request; the environments are unchanged.
    pub fn refuse(self, error: &Error) {
        self.finish(Response::Failure(status::failure(error)), true);
    }

    /// Returns the environments and answers. A request that changed nothing need not keep its answer, because it
    /// can be repeated.
    pub fn finish(mut self, response: Response, keep: bool) {
        let sequence = self.reply.sequence;
        let answer = RunSessionResponse { sequence, response: Some(response) };
        if sequence > 0 {
            self.environments.done = Done { sequence, answer: keep.then(|| answer.clone()) };
        }
        let answers = self.reply.answers.clone();
        self.give_back();
        // The stream may be gone; the next stream of the session asks for the answer again. The channel has room:
        // this is the last of a request's answers, and the stream reads them all before it reads the next request.
        let _ = answers.try_send(answer);
    }

    /// Returns the environments without an answer, because no client waits for it.
    pub fn give_back(mut self) {
        self.reply.loan.give_back(self.environments);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::env::registry::Blueprint;
    use crate::pool::Seal;
    use crate::sessions::{Limits, Sessions};
    use serde_json::Value;
    use tokio_util::sync::CancellationToken;
    use tonic::Code;

    /// A session's environments in an operation, and the channel of its answers.
    fn lent(sessions: &Arc<Sessions>) -> (Work, mpsc::Receiver<RunSessionResponse>) {
        let blueprint = Blueprint::new("sandgait/HexapodGait-v1", Value::Null).unwrap();
        let environments = sessions.build(&blueprint, 2).unwrap();
        let (answers, receiver) = mpsc::channel(2);
        sessions.add("one".into(), blueprint.clone(), sessions.build(&blueprint, 1).unwrap()).unwrap();
        let loan = Loan::new(sessions.clone(), "one".into());
        (Work { environments, reply: Reply { sequence: 7, loan, answers, share: None } }, receiver)
    }

    fn sessions() -> Arc<Sessions> {
        Sessions::new(Limits::default(), Seal::default(), CancellationToken::new())
    }

    fn check(sessions: &Sessions, mut answers: mpsc::Receiver<RunSessionResponse>) {
        let RunSessionResponse { sequence, response } = answers.blocking_recv().unwrap();
        let Some(Response::Failure(failure)) = response else { panic!("{response:?}") };
        assert_eq!((sequence, failure.code), (7, i32::from(Code::Internal)));
        assert!(failure.message.ends_with("please report this as a bug"), "{}", failure.message);
        assert!(answers.blocking_recv().is_none());
        assert!(sessions.list().is_empty(), "the session has ended");
    }

    /// In the pool: the worker that runs the last shard encodes the answer.
    #[test]
    fn a_panic_while_an_answer_is_made_is_answered() {
        let (sessions, pool) = (sessions(), Pool::new(1));
        for _ in 0..2 {
            let (mut work, answers) = lent(&sessions);
            let operation = work.environments.batch.reset(None, None, Default::default()).unwrap();
            let Work { environments, reply } = work;
            let (batch, rest) = environments.into_parts();
            pool.run(batch, operation, move |batch| {
                let _work = reply.with(rest, batch.unwrap());
                panic!("on purpose");
            });
            check(&sessions, answers);
        }
        assert_eq!(sessions.usage().sessions, 0);
    }

    /// In a task of the runtime, for example a rollout.
    #[test]
    fn a_panic_between_the_parts_of_a_rollout_is_answered() {
        let sessions = sessions();
        let (work, answers) = lent(&sessions);
        let runtime = tokio::runtime::Runtime::new().unwrap();
        let task = runtime.spawn(async move {
            let _work = work;
            tokio::task::yield_now().await;
            panic!("on purpose");
        });
        assert!(runtime.block_on(task).unwrap_err().is_panic());
        check(&sessions, answers);
    }

    #[test]
    fn a_session_whose_environments_are_back_goes_on() {
        let sessions = sessions();
        let (work, mut answers) = lent(&sessions);
        work.refuse(&Error::invalid("x", "y"));
        assert!(matches!(answers.blocking_recv().unwrap().response, Some(Response::Failure(_))));
        assert_eq!(sessions.list().len(), 1);
    }
}
