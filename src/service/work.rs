//! The work of one request: the session's environments, and the obligation to answer.

use super::building::LastAnswer;
use super::encode;
use super::proto::RunSessionResponse;
use super::proto::run_session_response::Response;
use super::sessions::{SessionGuard, broken};
use super::share::Share;
use super::status;
use crate::error::{Error, Result};
use crate::pool::{Batch, Operation, Pool};
use std::sync::Arc;
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

/// A request with its session's environments. Dropping it returns them; if a panic has destroyed them, it answers
/// with INTERNAL and ends the session.
pub struct SessionWork {
    pub sequence: u64,
    pub guard: SessionGuard,
    pub answers: mpsc::Sender<RunSessionResponse>,
    /// Cancelled when nobody waits for the answer any more: the client has left, another stream has taken the session,
    /// or the session or the server ends.
    pub end: CancellationToken,
    /// Memory share of the request.
    pub share: Option<Arc<Share>>,
}

impl Drop for SessionWork {
    fn drop(&mut self) {
        if self.guard.is_lost() {
            self.lose(&broken());
        }
    }
}

impl SessionWork {
    pub fn batch(&mut self) -> &mut Batch {
        self.guard.batch()
    }

    /// The environments are lost: answers and ends the session.
    pub fn lose(&mut self, error: &Error) {
        // A stream that does not read loses its session without this answer.
        let _ = self.answers.try_send(self.response(Response::Failure(status::failure(error))));
        self.guard.lose(error);
    }

    pub fn response(&self, response: Response) -> RunSessionResponse {
        RunSessionResponse { sequence: self.sequence, response: Some(response) }
    }

    /// From now on the memory of models and snapshots that the batch makes is taken from the request's share, and an
    /// operation ends when nobody waits for it any more.
    pub fn watch(&mut self) {
        let end = self.end.clone();
        self.batch().set_stop(Some(Arc::new(move || end.is_cancelled())));
        if let Some(share) = self.share.clone() {
            self.batch().set_account(Some(Arc::new(move |bytes| share.grow(bytes))));
        }
    }

    /// Runs `operation` and answers with its batch.
    pub fn run(mut self, operation: Operation, pool: &Pool) {
        let changed = self.batch().bytes_during(&operation);
        if let Some(bytes) = changed
            && let Err(error) = self.guard.reserve(&operation.field(), bytes)
        {
            return self.refuse(&error);
        }
        let batch = self.guard.take();
        let ran = self.guard.sessions.metrics.begin(&operation, batch.envs());
        pool.run(batch, operation, move |batch| match batch {
            // Nobody waits for an answer; the next stream may make the request again.
            Ok(batch) if batch.was_stopped() => {
                self.guard.put(batch);
                self.released(changed);
            }
            Ok(batch) => {
                let response = Response::Batch(encode::batch(&batch));
                ran(&batch);
                self.guard.sessions.watchers.saw(&self.guard.id, &batch);
                self.guard.put(batch);
                self.released(changed);
                self.finish(response, true);
            }
            Err(error) => self.lose(&error),
        });
    }

    fn released(&mut self, changed: Option<usize>) {
        if changed.is_some() {
            self.guard.release();
        }
    }

    /// Answers a request that changes nothing.
    pub fn answer(self, answer: Result<Response>) {
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
        let (answer, answers) = (self.response(response), self.answers.clone());
        self.settle(keep.then(|| answer.clone()));
        drop(self);
        // The stream may be gone; the next stream of the session asks for the answer again. The channel has room:
        // this is the last of a request's answers, and the stream reads them all before it reads the next request.
        let _ = answers.try_send(answer);
    }

    /// Notes that the request is answered.
    pub fn settle(&mut self, answer: Option<RunSessionResponse>) {
        if let Some(books) = self.guard.books.as_mut().filter(|_| self.sequence > 0) {
            books.done = LastAnswer { sequence: self.sequence, answer };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::env::registry::Blueprint;
    use crate::limits::Limits;
    use crate::pool::Seal;
    use crate::sessions::Sessions;
    use serde_json::Value;
    use tokio_util::sync::CancellationToken;
    use tonic::Code;

    /// A session's environments in an operation, and the channel of its answers.
    fn guard(sessions: &Arc<Sessions>) -> (SessionWork, mpsc::Receiver<RunSessionResponse>) {
        let blueprint = Blueprint::new("sandgait/HexapodGait-v1", Value::Null).unwrap();
        let environments = sessions.build(&blueprint, 2).unwrap();
        let (answers, receiver) = mpsc::channel(2);
        sessions.add("one".into(), blueprint.clone(), sessions.build(&blueprint, 1).unwrap()).unwrap();
        let guard = SessionGuard::new(sessions.clone(), "one".into(), environments);
        (SessionWork { sequence: 7, guard, answers, end: CancellationToken::new(), share: None }, receiver)
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

    /// The panic is in the pool: the worker that runs the last shard encodes the answer.
    #[test]
    fn a_panic_while_an_answer_is_made_is_answered() {
        let (sessions, pool) = (sessions(), Pool::new(1));
        for _ in 0..2 {
            let (mut work, answers) = guard(&sessions);
            let operation = work.batch().reset(None, None, Default::default()).unwrap();
            let batch = work.guard.take();
            pool.run(batch, operation, move |batch| {
                work.guard.put(batch.unwrap());
                panic!("on purpose");
            });
            check(&sessions, answers);
        }
        assert_eq!(sessions.usage().sessions, 0);
    }

    /// The panic is in a task of the runtime, for example in a rollout.
    #[test]
    fn a_panic_between_the_parts_of_a_rollout_is_answered() {
        let sessions = sessions();
        let (work, answers) = guard(&sessions);
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
        let (work, mut answers) = guard(&sessions);
        work.refuse(&Error::invalid("x", "y"));
        assert!(matches!(answers.blocking_recv().unwrap().response, Some(Response::Failure(_))));
        assert_eq!(sessions.list().len(), 1);
    }
}
