//! One RunSession stream: requests are answered one by one, in order.
//!
//! ```text
//!  message ──decode──▶ Operation ──▶ Pool (worker threads) ──encode──▶ message
//!     └── refused: Failure, nothing has changed, the stream goes on
//! ```
//!
//! A client may send requests before it has read earlier answers. The server reads the next message after it has
//! answered the last one, so flow control slows a fast sender. This file does not compute: a light request is checked
//! on the async thread, a heavy one on a blocking thread, and the pool's threads step and encode.

use super::building::{LastAnswer, TURN};
use super::decode::RequestWeight;
use super::frame::RequestFrame;
use super::intake::{Intake, Messages};
use super::proto::run_session_request::Request;
use super::proto::run_session_response::Response;
use super::proto::{Attached, RunSessionRequest, RunSessionResponse, Snapshot};
use super::sessions::SessionGuard;
use super::sessions::{Sessions, StreamHold};
use super::share::Share;
use super::work::SessionWork;
use super::{decode, price, rollout, status, view};
use crate::error::{Error, Result as Checked};
use crate::pool::{Pool, Prepared};
use futures_util::{Stream, stream};
use prost::Message;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use tokio::sync::mpsc;
use tonic::{Status, Streaming};

/// The data that a call has from its start.
pub struct SessionCall {
    pub messages: Messages,
    pub intake: Arc<Intake>,
}

/// The answers to `requests`.
pub fn run(
    requests: Streaming<RequestFrame<RunSessionRequest>>,
    call: SessionCall,
    sessions: Arc<Sessions>,
    pool: Arc<Pool>,
) -> impl Stream<Item = Result<RunSessionResponse, Status>> {
    let run = SessionStream { requests, call, sessions, pool, attached: None, answers: None, share: None };
    stream::try_unfold(run, |mut run| async move {
        let answer = run.answer().await?;
        if let Some(RunSessionResponse { response: Some(Response::Failure(refused)), .. }) = &answer {
            run.sessions.metrics.ended(refused.code.into());
        }
        let messages = &run.call.messages;
        let bytes = answer.as_ref().map_or(0, Message::encoded_len);
        messages.hold_for_answer(run.share.clone().map(|share| messages.unread(share, bytes)));
        Ok(answer.map(|answer| (answer, run)))
    })
}

/// The state of a stream.
struct SessionStream {
    requests: Streaming<RequestFrame<RunSessionRequest>>,
    call: SessionCall,
    sessions: Arc<Sessions>,
    pool: Arc<Pool>,
    /// None until the first message has named the session.
    attached: Option<Attachment>,
    /// Receives the present request's answers.
    answers: Option<mpsc::Receiver<RunSessionResponse>>,
    /// Memory of the present request. Its answers hold it, too, until they have been sent.
    share: Option<Arc<Share>>,
}

/// Detaches from the session when the stream ends.
struct Attachment {
    hold: StreamHold,
    sessions: Arc<Sessions>,
}

impl Drop for Attachment {
    fn drop(&mut self) {
        self.sessions.detach(&self.hold);
    }
}

impl SessionStream {
    /// The next answer; None when the client has no more requests.
    async fn answer(&mut self) -> Result<Option<RunSessionResponse>, Status> {
        loop {
            if let Some(answers) = &mut self.answers {
                if let Some(answer) = answers.recv().await {
                    return Ok(Some(answer));
                }
                self.answers = None;
            }
            let Some(request) = self.next_request().await? else { return Ok(None) };
            if let Some(answer) = self.begin(request).await? {
                return Ok(Some(answer));
            }
        }
    }

    /// The next message, unless the session or the server ends first.
    async fn next_request(&mut self) -> Result<Option<RunSessionRequest>, Status> {
        self.share = None;
        let end = self.attached.as_ref().map_or(self.sessions.stop(), |a| &a.hold.end).clone();
        let message = tokio::select! {
            biased;
            () = end.cancelled() => None,
            message = self.requests.message() => Some(message),
        };
        let Some(message) = message else { return Err(self.ended()) };
        let Some(frame) = message.map_err(status::unreadable)? else { return Ok(None) };
        let (request, share) = frame.open(&self.call.messages).await?;
        self.share = share.map(Arc::new);
        Ok(Some(request))
    }

    /// The reason why the stream has no session any more.
    fn ended(&self) -> Status {
        let taken = |a: &Attachment| self.sessions.was_taken(&a.hold);
        if self.sessions.stop().is_cancelled() {
            Status::unavailable("the server is shutting down")
        } else if self.attached.as_ref().is_some_and(taken) {
            Status::aborted("another stream has taken the session")
        } else {
            Status::cancelled("the session was closed")
        }
    }

    /// The session that the stream's first message names.
    fn attach(&mut self, session_id: &str) -> Result<(), Status> {
        if session_id.is_empty() {
            let reason = "missing; a stream's first message names its session";
            return Err(status::status(&Error::invalid("session_id", reason)));
        }
        let hold = self.sessions.attach(session_id).map_err(|e| status::status(&e))?;
        self.attached = Some(Attachment { hold, sessions: self.sessions.clone() });
        Ok(())
    }

    /// Starts work on a request. Some: the immediate answer.
    async fn begin(&mut self, request: RunSessionRequest) -> Result<Option<RunSessionResponse>, Status> {
        if self.attached.is_none() {
            self.attach(&request.session_id)?;
        }
        let Some(Attachment { hold, .. }) = &self.attached else { return Err(self.ended()) };
        let sequence = request.sequence;
        let at_once = |response| Ok(Some(RunSessionResponse { sequence, response: Some(response) }));
        if !request.session_id.is_empty() && request.session_id != hold.id {
            let reason = format!("{:?} is not this stream's; leave it empty or open a stream", request.session_id);
            return at_once(Response::Failure(status::failure(&Error::invalid("session_id", reason))));
        }
        let end = hold.end.clone();
        let Some(mut guard) = self.sessions.take(hold).await else { return Err(self.ended()) };
        if matches!(request.request, Some(Request::Attach(_))) {
            let last_sequence = guard.done().map_or(0, |done| done.sequence);
            return at_once(Response::Attached(Attached { last_sequence }));
        }
        if let Some(answer) = guard.done().and_then(|done| repeated(done, sequence)) {
            return Ok(Some(answer));
        }
        self.call.messages.let_pass(decode::largest_step(guard.batch()));
        let batch = guard.batch();
        let priced = request.request.as_ref().map_or(Ok(0), |request| price::of_request(request, batch));
        let grows = decode::weight(&request) == RequestWeight::Long;
        let (guard, share) = match priced {
            Ok(0) if !grows => (guard, Ok(None)),
            Ok(bytes) => self.paid(guard, bytes).await?,
            Err(error) => (guard, Err(error)),
        };
        let (answers, receiver) = mpsc::channel(2);
        let mut work = SessionWork { sequence, guard, answers, end, share: self.share.clone() };
        self.answers = Some(receiver);
        match share {
            Err(error) => {
                work.refuse(&error);
                return Ok(None);
            }
            Ok(Some(share)) => {
                self.share = Some(share.clone());
                work.share = Some(share);
            }
            Ok(None) => {}
        }
        self.start(work, request).await;
        Ok(None)
    }

    /// A share of `bytes`, besides the share of the message. While this waits for the share, it does not hold the
    /// environments.
    async fn paid(
        &self,
        guard: SessionGuard,
        bytes: usize,
    ) -> Result<(SessionGuard, Checked<Option<Arc<Share>>>), Status> {
        let intake = &self.call.intake;
        if let Some(message) = &self.share
            && message.grow(bytes).is_ok()
        {
            return Ok((guard, Ok(Some(message.clone()))));
        }
        if self.share.is_none()
            && let Some(share) = intake.try_share(bytes)
        {
            return Ok((guard, Ok(Some(Arc::new(share)))));
        }
        drop(guard);
        let Some(Attachment { hold, .. }) = &self.attached else { return Err(self.ended()) };
        let own = self.share.as_ref().map_or(0, |share| share.bytes());
        let share = match self.share.is_none() {
            true => hold.end.run_until_cancelled(intake.share(bytes)).await.ok_or_else(|| self.ended())?,
            // Two requests that wait while each holds memory could wait for each other for ever.
            false => Err(Error::Exhausted(format!(
                "needs about {} MiB besides its message, which are taken by others; try again",
                (own + bytes).div_ceil(1 << 20)
            ))),
        };
        let Some(guard) = self.sessions.take(hold).await else { return Err(self.ended()) };
        Ok((guard, share.map(|share| Some(Arc::new(share)))))
    }

    /// Starts the work on the thread that suits it. Long work occupies no thread while it waits for its turn.
    async fn start(&self, work: SessionWork, request: RunSessionRequest) {
        let (pool, weight) = (self.pool.clone(), decode::weight(&request));
        if let Some(Request::Render(render)) = request.request {
            tokio::spawn(view::render(work, render));
            return;
        }
        if weight == RequestWeight::Long
            && let Some(request @ (Request::Reset(_) | Request::Restore(_))) = request.request
        {
            tokio::spawn(prepare(work, request, self.sessions.clone(), pool));
            return;
        }
        // A panic drops the work, which then ends its session; this thread's other work must go on.
        let begin = move || drop(catch_unwind(AssertUnwindSafe(|| carry_out(work, request.request, &pool))));
        match weight {
            RequestWeight::Light => begin(),
            RequestWeight::Short => drop(tokio::task::spawn_blocking(begin)),
            RequestWeight::Long => {
                let sessions = self.sessions.clone();
                let Some(Attachment { hold, .. }) = &self.attached else { return };
                let end = hold.end.clone();
                tokio::spawn(async move {
                    let turn = sessions.turn(|| {
                        begin();
                        Ok(())
                    });
                    end.run_until_cancelled(turn).await
                });
            }
        }
    }
}

/// The answer to a request out of sequence: the last answer again, or a refusal.
fn repeated(done: &LastAnswer, sequence: u64) -> Option<RunSessionResponse> {
    match sequence {
        0 => None,
        n if n == done.sequence => done.answer.clone(),
        n if n == done.sequence + 1 => None,
        n => {
            let (last, next) = (done.sequence, done.sequence + 1);
            let reason = format!("sequence: {n} follows {last}; {next} is next, {last} repeats the last answer");
            let failure = Response::Failure(status::failure(&Error::OutOfOrder(reason)));
            Some(RunSessionResponse { sequence, response: Some(failure) })
        }
    }
}

/// Prepares a reset or a restore in turns, until nobody waits for it any more, and starts it.
async fn prepare(mut work: SessionWork, request: Request, sessions: Arc<Sessions>, pool: Arc<Pool>) {
    let (seal, end) = (sessions.seal.clone(), work.end.clone());
    let begin = move || {
        work.watch();
        let preparing = decode::preparing(work.batch(), request, &seal);
        Ok((work, preparing))
    };
    // If nobody waits any more, or the turn panics, the work is dropped, which returns the environments or ends the
    // session.
    let Some(Ok((mut work, mut preparing))) = end.run_until_cancelled(sessions.turn(begin)).await else { return };
    loop {
        let part = match preparing {
            Ok(part) => part,
            Err(error) => return work.refuse(&error),
        };
        let own = pool.clone();
        let turn = move || {
            Ok(match part.go_on(work.batch(), TURN) {
                Ok(Prepared::Later(part)) => Some((work, Ok(part))),
                Ok(Prepared::Now(operation)) => {
                    work.run(operation, &own);
                    None
                }
                Err(error) => Some((work, Err(error))),
            })
        };
        let Some(Ok(Some(rest))) = end.run_until_cancelled(sessions.turn(turn)).await else { return };
        (work, preparing) = rest;
    }
}

/// Checks a request and starts its operation.
fn carry_out(mut work: SessionWork, request: Option<Request>, pool: &Arc<Pool>) {
    let seal = work.guard.sessions.seal.clone();
    work.watch();
    let operation = match request {
        Some(Request::Save(_)) => {
            let saved = work.batch().save().and_then(|s| s.to_bytes(&seal));
            return work.answer(saved.map(|data| Response::Snapshot(Snapshot { data: data.into() })));
        }
        Some(Request::Rollout(request)) => return rollout::start(work, &request, pool.clone()),
        Some(Request::PolicyRollout(request)) => return rollout::start_network(work, &request, pool.clone()),
        Some(Request::Observe(request)) => {
            let seen = view::observe(work.batch(), &request);
            return work.answer(seen.map(Response::Observation));
        }
        request => decode::operation(work.batch(), request, &seal),
    };
    match operation {
        Ok(operation) => work.run(operation, pool),
        Err(error) => work.refuse(&error),
    }
}
