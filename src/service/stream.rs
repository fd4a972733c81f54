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

use super::connections::Link;
use super::proto::run_session_request::Request;
use super::proto::run_session_response::Response;
use super::proto::{Attached, RunSessionRequest, RunSessionResponse, Snapshot};
use super::sessions::{Done, Environments, Hold, Sessions};
use super::{decode, encode, rollout, status, view};
use crate::error::Error;
use crate::pool::{Operation, Pool};
use futures_util::{Stream, stream};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use tokio::sync::mpsc;
use tonic::{Status, Streaming};

/// The answers to `requests`.
pub fn run(
    requests: Streaming<RunSessionRequest>,
    link: Option<Link>,
    sessions: Arc<Sessions>,
    pool: Arc<Pool>,
) -> impl Stream<Item = Result<RunSessionResponse, Status>> {
    let run = Run { requests, link, first: true, sessions, pool, attached: None, answers: None };
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
    requests: Streaming<RunSessionRequest>,
    link: Option<Link>,
    /// No message was read yet: it counts as one with the call.
    first: bool,
    sessions: Arc<Sessions>,
    pool: Arc<Pool>,
    /// None until the first message has named the session.
    attached: Option<Guard>,
    /// Where the present request's answers come from.
    answers: Option<mpsc::Receiver<RunSessionResponse>>,
}

/// Lets the session go when the stream ends.
struct Guard {
    hold: Hold,
    sessions: Arc<Sessions>,
}

impl Drop for Guard {
    fn drop(&mut self) {
        self.sessions.detach(&self.hold);
    }
}

/// What a request was given for its work; every path but a panic ends in [`Work::finish`].
pub struct Work {
    pub environments: Environments,
    pub sequence: u64,
    pub sessions: Arc<Sessions>,
    pub id: String,
    pub answers: mpsc::Sender<RunSessionResponse>,
}

impl Run {
    /// The next answer; none when the client has no more requests.
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
        let end = self.attached.as_ref().map_or(self.sessions.stop(), |a| &a.hold.end).clone();
        let first = std::mem::take(&mut self.first);
        let message = async {
            if let Some(link) = self.link.as_ref().filter(|_| !first) {
                link.turn().await;
            }
            self.requests.message().await
        };
        let message = tokio::select! {
            biased;
            () = end.cancelled() => None,
            message = message => Some(message),
        };
        match message {
            Some(message) => message.map_err(status::unreadable),
            None => Err(self.ended()),
        }
    }

    /// Why the stream has no session any more.
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

    /// Starts work on a request. Some: it is answered at once.
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
        let (sender, receiver) = mpsc::channel(2);
        self.answers = Some(receiver);
        let (sessions, id) = (self.sessions.clone(), hold.id.clone());
        let work = Work { environments, sequence, sessions, id, answers: sender };
        start(work, request, self.pool.clone());
        Ok(None)
    }
}

/// The answer to a request that is not the next one: the last one's again, or a refusal.
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
    let (sessions, id) = (work.sessions.clone(), work.id.clone());
    let begin = move || {
        // A panic here would leave the session without its environments, and its clients waiting.
        if catch_unwind(AssertUnwindSafe(|| carry_out(work, request.request, &pool))).is_err() {
            lost(&sessions, &id, &Error::Exhausted("a request could not be prepared".into()));
        }
    };
    if light {
        begin();
    } else {
        tokio::task::spawn_blocking(begin);
    }
}

/// Checks a request and starts its operation.
fn carry_out(mut work: Work, request: Option<Request>, pool: &Arc<Pool>) {
    let batch = &mut work.environments.batch;
    let operation = match request {
        Some(Request::Save(_)) => {
            let saved = batch.save().and_then(|s| s.to_bytes());
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
        request => decode::operation(batch, request),
    };
    match operation {
        Ok(operation) => work.run(operation, pool),
        Err(error) => work.refuse(&error),
    }
}

impl Work {
    /// Carries `operation` out and answers with the batch that it gives.
    fn run(self, operation: Operation, pool: &Pool) {
        let Self { environments, sequence, sessions, id, answers } = self;
        let (batch, rest) = environments.into_parts();
        let ran = sessions.metrics.begin(&operation, batch.envs());
        pool.run(batch, operation, move |batch| match batch {
            Ok(batch) => {
                let response = Response::Batch(encode::batch(&batch));
                ran(&batch);
                sessions.watchers.saw(&id, &batch);
                let environments = rest.with(batch);
                Self { environments, sequence, sessions, id, answers }.finish(response, true);
            }
            Err(error) => lost(&sessions, &id, &error),
        });
    }

    /// Answers a request that changes nothing.
    fn tell(self, answer: crate::Result<Response>) {
        match answer {
            Ok(response) => self.finish(response, false),
            Err(error) => self.refuse(&error),
        }
    }

    /// Refuses the request; the environments are as they were.
    pub fn refuse(self, error: &Error) {
        self.finish(Response::Failure(status::failure(error)), true);
    }

    /// Puts the environments back and answers. A request that changed nothing need not keep its answer: it can be
    /// carried out again.
    pub fn finish(mut self, response: Response, keep: bool) {
        let answer = RunSessionResponse { sequence: self.sequence, response: Some(response) };
        if self.sequence > 0 {
            self.environments.done = Done { sequence: self.sequence, answer: keep.then(|| answer.clone()) };
        }
        self.sessions.give_back(&self.id, self.environments);
        // The stream may be gone; whoever takes the session next asks for the answer again. The channel has room: this
        // is the last of a request's answers, and the stream reads them all before it reads the next request.
        let _ = self.answers.try_send(answer);
    }
}

/// Something panicked and took the environments with it.
pub fn lost(sessions: &Sessions, id: &str, error: &Error) {
    tracing::error!(session = super::sessions::name(id), %error, "a session was lost");
    // It may have been closed meanwhile.
    let _ = sessions.close(id);
}
