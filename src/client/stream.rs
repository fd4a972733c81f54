//! One RunSession stream. Answers come in the order of the requests.

use super::address::ServerAddress;
use super::keeper::Keeper;
use super::{cut, environments, runtime, wait};
use crate::service::proto::run_session_request::Request;
use crate::service::proto::run_session_response::Response;
use crate::service::proto::{Attach, RunSessionRequest, RunSessionResponse};
use parking_lot::Mutex;
use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;
use tokio::runtime::Runtime;
use tokio::sync::mpsc;
use tokio_stream::wrappers::UnboundedReceiverStream;
use tonic::{Status, Streaming};

/// A stream to one session; threads may share it.
pub struct Stream {
    requests: Mutex<Option<mpsc::UnboundedSender<RunSessionRequest>>>,
    answers: Mutex<Streaming<RunSessionResponse>>,
    keeper: Keeper,
    runtime: Arc<Runtime>,
    /// Number of the last request that the session has answered.
    pub last_sequence: u64,
}

impl Stream {
    /// Attaches to session `session_id` at `place`. `stopped` is called now and then; its error ends the attempt.
    pub fn open<E>(
        place: ServerAddress,
        session_id: String,
        mut stopped: impl FnMut() -> Result<(), E>,
    ) -> Result<Result<Self, Status>, E> {
        let runtime = match runtime() {
            Ok(runtime) => Arc::new(runtime),
            Err(status) => return Ok(Err(status)),
        };
        let opening = async {
            let (sender, receiver) = mpsc::unbounded_channel();
            let request = Some(Request::Attach(Attach {}));
            let attach = RunSessionRequest { session_id, sequence: 0, request };
            // The receiver exists until the stream below takes it.
            let _ = sender.send(attach);
            let mut client = environments(&place).await?;
            let mut answers = client.run_session(UnboundedReceiverStream::new(receiver)).await?.into_inner();
            match answers.message().await?.and_then(|answer| answer.response) {
                Some(Response::Attached(attached)) => Ok((sender, answers, attached.last_sequence)),
                Some(_) => Err(Status::internal("the server did not attach")),
                None => Err(ended()),
            }
        };
        let mut opening = pin!(opening);
        let opened = loop {
            match wait(&runtime, opening.as_mut(), PATIENCE) {
                Some(opened) => break opened,
                None => stopped()?,
            }
        };
        Ok(opened.map_err(cut).and_then(|(sender, answers, last_sequence)| {
            let keeper = Keeper::new(runtime.clone()).map_err(|e| Status::unavailable(e.to_string()))?;
            let (requests, answers) = (Mutex::new(Some(sender)), Mutex::new(answers));
            Ok(Self { requests, answers, keeper, runtime, last_sequence })
        }))
    }

    /// Queues a request without waiting. `here`: the caller waits for the answer next, and the request is sent while it
    /// waits.
    pub fn send(&self, request: RunSessionRequest, here: bool) {
        if let Some(requests) = &*self.requests.lock() {
            // If the stream is broken, the call that waits for the answer gets the error.
            let _ = requests.send(request);
        }
        if !here {
            self.keeper.ahead();
        }
    }

    /// The next answer, if it comes within `time`.
    pub fn receive(&self, time: Duration) -> Option<Result<RunSessionResponse, Status>> {
        self.keeper.waits();
        let mut answers = self.answers.lock();
        let message = pin!(answers.message());
        let answer = wait(&self.runtime, message, time)?;
        Some(answer.map_err(cut).and_then(|answer| answer.ok_or_else(ended)))
    }

    /// Ends the stream; the session stays for the time of its lease.
    pub fn close(&self) {
        *self.requests.lock() = None;
    }
}

/// Interval of checks whether the caller still waits: our choice, well within the 100 ms in which Ctrl-C must act.
pub const PATIENCE: Duration = Duration::from_millis(20);

fn ended() -> Status {
    Status::cancelled("the server closed this session; make the environment anew")
}
