//! One RunSession stream: requests are answered one by one, in order.
//!
//! ```text
//!  message ──decode──▶ Operation ──▶ Pool (worker threads) ──encode──▶ message
//!     └── refused: Failure, nothing has changed, the stream goes on
//! ```
//!
//! A client may send ahead; the next message is read after the last one was answered, so flow control slows a fast
//! sender. This file does not compute: a light request is checked on the async thread, a heavy one on a blocking
//! thread, and the pool's threads step and encode.

use super::connections::Link;
use super::frame::Frame;
use super::intake::{Door, Intake, Share};
use super::loan::Loan;
use super::proto::run_session_request::Request;
use super::proto::run_session_response::Response;
use super::proto::{Attached, RunSessionRequest, RunSessionResponse, Snapshot};
use super::sessions::{Done, Hold, Sessions};
use super::work::{Reply, Work};
use super::{decode, rollout, status, view, wire};
use crate::error::Error;
use crate::pool::Pool;
use futures_util::{Stream, stream};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use tokio::sync::mpsc;
use tonic::{Status, Streaming};

/// Data of a call from its start.
pub struct Call {
    pub door: Door,
    pub intake: Arc<Intake>,
    /// None in tests without a connection.
    pub link: Option<Link>,
}

/// The answers to `requests`.
pub fn run(
    requests: Streaming<Frame<RunSessionRequest>>,
    call: Call,
    sessions: Arc<Sessions>,
    pool: Arc<Pool>,
) -> impl Stream<Item = Result<RunSessionResponse, Status>> {
    let run = Run { requests, call, first: true, sessions, pool, attached: None, answers: None, share: None };
    stream::try_unfold(run, |mut run| async move {
        let answer = run.answer().await?;
        if let Some(RunSessionResponse { response: Some(Response::Failure(refused)), .. }) = &answer {
            run.sessions.metrics.ended(refused.code.into());
        }
        Ok(answer.map(|answer| (answer, run)))
    })
}

/// The state of a stream.
struct Run {
    requests: Streaming<Frame<RunSessionRequest>>,
    call: Call,
    /// Has no message been read yet? The first one is counted with the call.
    first: bool,
    sessions: Arc<Sessions>,
    pool: Arc<Pool>,
    /// None until the first message has named the session.
    attached: Option<Guard>,
    /// Receives the present request's answers.
    answers: Option<mpsc::Receiver<RunSessionResponse>>,
    /// Memory of the present request and its answer. It is released at the next request, when the answer has been
    /// sent.
    share: Option<Arc<Share>>,
}

/// Detaches from the session when the stream ends.
struct Guard {
    hold: Hold,
    sessions: Arc<Sessions>,
}

impl Drop for Guard {
    fn drop(&mut self) {
        self.sessions.detach(&self.hold);
    }
}

impl Run {
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
        let first = std::mem::take(&mut self.first);
        let message = async {
            if let Some(link) = self.call.link.as_ref().filter(|_| !first) {
                link.turn().await;
            }
            self.requests.message().await
        };
        let message = tokio::select! {
            biased;
            () = end.cancelled() => None,
            message = message => Some(message),
        };
        let Some(message) = message else { return Err(self.ended()) };
        let Some(frame) = message.map_err(status::unreadable)? else { return Ok(None) };
        let (request, share) = frame.open(&self.call.door, &wire::RUN_SESSION).map_err(|e| status::status(&e))?;
        self.share = share.map(Arc::new);
        Ok(Some(request))
    }

    /// The reason why the stream has no session any more.
    fn ended(&self) -> Status {
        let taken = |a: &Guard| self.sessions.was_taken(&a.hold);
        if self.sessions.stop().is_cancelled() {
            Status::unavailable("the server is shutting down")
        } else if self.attached.as_ref().is_some_and(taken) {
            Status::aborted("another stream has taken the session")
        } else {
            Status::cancelled("the session was closed")
        }
    }

    /// Starts work on a request. Some: the immediate answer.
    async fn begin(&mut self, request: RunSessionRequest) -> Result<Option<RunSessionResponse>, Status> {
        let hold = match &self.attached {
            Some(attached) => &attached.hold,
            None if request.session_id.is_empty() => {
                let reason = "missing; a stream's first message names its session";
                return Err(status::status(&Error::invalid("session_id", reason)));
            }
            None => {
                let hold = self.sessions.attach(&request.session_id).map_err(|e| status::status(&e))?;
                &self.attached.insert(Guard { hold, sessions: self.sessions.clone() }).hold
            }
        };
        let sequence = request.sequence;
        let at_once = |response| Ok(Some(RunSessionResponse { sequence, response: Some(response) }));
        if !request.session_id.is_empty() && request.session_id != hold.id {
            let reason = format!("{:?} is not this stream's; leave it empty or open a stream", request.session_id);
            return at_once(Response::Failure(status::failure(&Error::invalid("session_id", reason))));
        }
        // This wait comes before the environments are taken, because it may be interrupted.
        let pictures = match &request.request {
            Some(Request::Render(render)) => Some(self.call.intake.share(view::size(render)).await),
            _ => None,
        };
        let Some(environments) = self.sessions.take(hold).await else { return Err(self.ended()) };
        if matches!(request.request, Some(Request::Attach(_))) {
            let last_sequence = environments.done.sequence;
            self.sessions.give_back(&hold.id, environments);
            return at_once(Response::Attached(Attached { last_sequence }));
        }
        if let Some(answer) = repeated(&environments.done, sequence) {
            self.sessions.give_back(&hold.id, environments);
            return Ok(Some(answer));
        }
        self.call.door.let_pass(decode::largest_step(&environments.batch));
        let (sender, receiver) = mpsc::channel(2);
        let loan = Loan::new(self.sessions.clone(), hold.id.clone());
        let reply = Reply { sequence, loan, answers: sender, share: None };
        let mut work = Work { environments, reply };
        self.answers = Some(receiver);
        if let Some(Err(error)) = &pictures {
            work.refuse(error);
            return Ok(None);
        }
        if let Some(Ok(share)) = pictures {
            self.share = Some(Arc::new(share));
        }
        work.reply.share = self.share.clone();
        start(work, request, self.pool.clone());
        Ok(None)
    }
}

/// The answer to a request out of sequence: the last answer again, or a refusal.
fn repeated(done: &Done, sequence: u64) -> Option<RunSessionResponse> {
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

fn start(work: Work, request: RunSessionRequest, pool: Arc<Pool>) {
    let light = decode::is_light(&request);
    // A panic drops the work, which then ends its session; this thread's other work must go on.
    let begin = move || drop(catch_unwind(AssertUnwindSafe(|| carry_out(work, request.request, &pool))));
    if light {
        begin();
    } else {
        tokio::task::spawn_blocking(begin);
    }
}

/// Checks a request and starts its operation.
fn carry_out(mut work: Work, request: Option<Request>, pool: &Arc<Pool>) {
    let batch = &mut work.environments.batch;
    let seal = &work.reply.loan.sessions.seal;
    let operation = match request {
        Some(Request::Save(_)) => {
            let saved = batch.save().and_then(|s| s.to_bytes(seal));
            return work.tell(saved.map(|data| Response::Snapshot(Snapshot { data: data.into() })));
        }
        Some(Request::Rollout(request)) => return rollout::start(work, &request, pool.clone()),
        Some(Request::PolicyRollout(request)) => return rollout::start_network(work, &request, pool.clone()),
        Some(Request::Render(request)) => {
            let seen = view::render(batch, &request);
            return work.tell(seen.map(Response::Pictures));
        }
        Some(Request::Observe(request)) => {
            let seen = view::observe(batch, &request);
            return work.tell(seen.map(Response::Observation));
        }
        request => decode::operation(batch, request, seal),
    };
    match operation {
        Ok(operation) => work.run(operation, pool),
        Err(error) => work.refuse(&error),
    }
}
