//! One RunSession stream: requests are answered one by one, in order.
//!
//! ```text
//!  message ──decode──▶ Operation ──▶ Pool (worker threads) ──encode──▶ message
//!     └── refused: Failure, nothing has changed, the stream goes on
//! ```
//!
//! A client may send ahead; the next message is read when the last one is answered, so a fast sender is slowed down
//! by flow control. Nothing here computes: a light request is checked on the async thread, a heavy one on a blocking
//! thread, and the pool's threads step and encode.

use super::proto::run_session_request::Request;
use super::proto::run_session_response::Response;
use super::proto::{RunSessionRequest, RunSessionResponse};
use super::sessions::{Environments, Sessions};
use super::{decode, encode, sessions, status};
use crate::error::Error;
use crate::pool::Pool;
use futures_util::{Stream, stream};
use std::sync::Arc;
use tokio::sync::oneshot;
use tokio_util::sync::CancellationToken;
use tonic::{Status, Streaming};

/// The answers to `requests`.
pub fn run(
    requests: Streaming<RunSessionRequest>,
    sessions: Arc<Sessions>,
    pool: Arc<Pool>,
) -> impl Stream<Item = Result<RunSessionResponse, Status>> {
    let run = Run { requests, sessions, pool, attached: None };
    stream::try_unfold(run, |mut run| async move { Ok(run.answer().await?.map(|answer| (answer, run))) })
}

/// The state of a stream.
struct Run {
    requests: Streaming<RunSessionRequest>,
    sessions: Arc<Sessions>,
    pool: Arc<Pool>,
    /// None until the first message has named the session.
    attached: Option<Attached>,
}

/// The session a stream holds; it ends with the stream.
struct Attached {
    id: String,
    sessions: Arc<Sessions>,
    /// Cancelled when the session is closed by name or the server stops.
    end: CancellationToken,
    /// None while an operation runs.
    environments: Option<Environments>,
}

impl Drop for Attached {
    fn drop(&mut self) {
        sessions::release(self.environments.take());
        // Fails if the session was closed by name: then it is gone already.
        let _ = self.sessions.close(&self.id);
    }
}

/// An operation's result on its way back to the stream.
struct Answer {
    environments: Environments,
    response: Response,
}

impl Run {
    /// Answers the next request; none when the client has no more.
    async fn answer(&mut self) -> Result<Option<RunSessionResponse>, Status> {
        let Some(request) = self.next_request().await? else { return Ok(None) };
        let attached = match &mut self.attached {
            Some(attached) => attached,
            none => none.insert(Attached::new(&request.session_id, &self.sessions).map_err(|e| status::status(&e))?),
        };
        let sequence = request.sequence;
        let response = match attached.check_id(&request.session_id) {
            Ok(()) => attached.carry_out(request, &self.pool).await?,
            Err(error) => Response::Failure(status::failure(&error)),
        };
        Ok(Some(RunSessionResponse { sequence, response: Some(response) }))
    }

    /// The next message, unless the session or the server ends first.
    async fn next_request(&mut self) -> Result<Option<RunSessionRequest>, Status> {
        let end = self.attached.as_ref().map_or(self.sessions.stop(), |a| &a.end);
        tokio::select! {
            biased;
            () = end.cancelled() => Err(match self.sessions.stop().is_cancelled() {
                true => Status::unavailable("the server is shutting down"),
                false => Status::cancelled("the session was closed"),
            }),
            message = self.requests.message() => message.map_err(status::unreadable),
        }
    }
}

impl Attached {
    fn new(id: &str, sessions: &Arc<Sessions>) -> crate::Result<Self> {
        let (environments, end) = sessions.attach(id)?;
        Ok(Self { id: id.into(), sessions: sessions.clone(), end, environments: Some(environments) })
    }

    /// Only the first message of a stream has to name the session.
    fn check_id(&self, id: &str) -> crate::Result<()> {
        if id.is_empty() || id == self.id {
            return Ok(());
        }
        Err(Error::invalid(
            "session_id",
            format!("{id:?} is not this stream's session; leave it empty or open a stream"),
        ))
    }

    async fn carry_out(&mut self, request: RunSessionRequest, pool: &Arc<Pool>) -> Result<Response, Status> {
        let lost = || status::bug("the simulation of this session failed");
        let environments = self.environments.take().ok_or_else(lost)?;
        let (sender, receiver) = oneshot::channel();
        let light = decode::is_light(&request);
        let pool = pool.clone();
        let begin = move || begin(environments, request.request, &pool, sender);
        if light {
            begin();
        } else {
            tokio::task::spawn_blocking(begin);
        }
        let answer = receiver.await.map_err(|_| lost())?;
        self.environments = Some(answer.environments);
        Ok(answer.response)
    }
}

/// Checks a request and starts its operation. The answer comes through `sender`; if the stream is gone by then, the
/// environments are freed. If a worker panicked there is no answer.
fn begin(mut environments: Environments, request: Option<Request>, pool: &Pool, sender: oneshot::Sender<Answer>) {
    let operation = match decode::operation(&mut environments.batch, request) {
        Ok(operation) => operation,
        Err(error) => {
            let _ = sender.send(Answer { environments, response: Response::Failure(status::failure(&error)) });
            return;
        }
    };
    let Environments { batch, reservation } = environments;
    pool.run(batch, operation, move |batch| {
        if let Ok(batch) = batch {
            let response = Response::Batch(encode::batch(&batch));
            let _ = sender.send(Answer { environments: Environments { batch, reservation }, response });
        }
    });
}
