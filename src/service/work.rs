//! The work of one request: the session's environments, and the obligation to answer.

use super::encode;
use super::intake::Share;
use super::lent::{Lent, broken};
use super::proto::RunSessionResponse;
use super::proto::run_session_response::Response;
use super::sessions::Done;
use super::status;
use crate::error::{Error, Result};
use crate::pool::{Batch, Operation, Pool};
use std::sync::Arc;
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

/// A request with its session's environments. Dropping it returns them; if a panic has destroyed them, it answers
/// with INTERNAL and ends the session.
pub struct Work {
    pub sequence: u64,
    pub lent: Lent,
    pub answers: mpsc::Sender<RunSessionResponse>,
    /// Cancelled when nobody waits for the answer any more: the client has left, another stream has taken the session,
    /// or the session or the server ends.
    pub end: CancellationToken,
    /// Memory share of the request.
    pub share: Option<Arc<Share>>,
}

impl Drop for Work {
    fn drop(&mut self) {
        if self.lent.is_lost() {
            self.lose(&broken());
        }
    }
}

impl Work {
    pub fn batch(&mut self) -> &mut Batch {
        self.lent.batch()
    }

    /// The environments are lost: answers and ends the session.
    pub fn lose(&mut self, error: &Error) {
        // A stream that does not read loses its session without this answer.
        let _ = self.answers.try_send(self.response(Response::Failure(status::failure(error))));
        self.lent.lose(error);
    }

    pub fn response(&self, response: Response) -> RunSessionResponse {
        RunSessionResponse { sequence: self.sequence, response: Some(response) }
    }

    /// Runs `operation` and answers with its batch.
    pub fn run(mut self, operation: Operation, pool: &Pool) {
        let batch = self.lent.take();
        let ran = self.lent.sessions.metrics.begin(&operation, batch.envs());
        pool.run(batch, operation, move |batch| match batch {
            Ok(batch) => {
                let response = Response::Batch(encode::batch(&batch));
                ran(&batch);
                self.lent.sessions.watchers.saw(&self.lent.id, &batch);
                self.lent.put(batch);
                self.finish(response, true);
            }
            Err(error) => self.lose(&error),
        });
    }

    /// Answers a request that changes nothing.
    pub fn tell(self, answer: Result<Response>) {
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
        if let Some(books) = self.lent.books.as_mut().filter(|_| self.sequence > 0) {
            books.done = Done { sequence: self.sequence, answer };
        }
    }
}

