//! `sandgait.v1.StudyService`: the studies of the command line.
//!
//! * [`convert`]: files and results as messages.
//! * [`line`]: computes one study at a time while the others wait in a queue, and reports progress.
//! * [`thread`]: the threads of studies, which yield to steps.

pub mod convert;
mod line;
mod thread;

use super::frame::RequestFrame;
use super::intake::{Intake, Messages};
use super::proto::StudyRequest;
use super::proto::study_service_server::StudyService;
use super::{off_runtime, status};
use crate::error::{Error, Result as Checked};
use crate::study::{self, AnyStudy, Inputs, StudyWork};
use axum::body::Body;
use axum::extract::Request as Call;
use axum::middleware::Next;
use line::{Events, StudyQueue};
use std::sync::Arc;
use tokio_util::sync::CancellationToken;
use tonic::{Request, Response, Status};

/// The studies of one server.
pub struct Studies {
    line: StudyQueue,
    /// All memory that the server may use [bytes].
    memory: usize,
}

impl Studies {
    /// Cancelling `stop` ends every study. `memory`: all that the server may use [bytes].
    pub fn new(stop: CancellationToken, memory: usize, intake: Arc<Intake>) -> Self {
        Self { line: StudyQueue::new(stop, intake), memory }
    }
}

#[tonic::async_trait]
impl StudyService for Studies {
    type StudyStream = Events;

    async fn study(&self, request: Request<RequestFrame<StudyRequest>>) -> Result<Response<Events>, Status> {
        let messages = Messages::of(&request);
        let (request, share) = RequestFrame::only(request).await?;
        let memory = self.memory;
        let (study, inputs) = off_runtime(move || read(request).map_err(of_client)).await?;
        let cost = study.cost(&inputs);
        let share = self.line.more(share, cost).await.map_err(|e| status::status(&e))?;
        let work = off_runtime(move || checked(study, &inputs, memory).map_err(of_client)).await?;
        self.line.enter(share, messages, work).map(Response::new)
    }
}

/// The study of a request, with its files.
fn read(request: StudyRequest) -> Checked<(Box<dyn AnyStudy>, Inputs)> {
    let StudyRequest { name, arguments, files } = request;
    let study = study::named(&name)?.parse(&arguments)?;
    Ok((study, Inputs::sent(convert::inputs(files)?)))
}

/// The work of a study, within `memory` [bytes].
fn checked(study: Box<dyn AnyStudy>, inputs: &Inputs, memory: usize) -> Checked<StudyWork> {
    let work = study.check(inputs)?;
    if work.bytes > memory {
        let [needed, limit] = [work.bytes, memory].map(|bytes| bytes >> 20);
        let reason = format!("the study needs about {needed} MiB, more than this server's {limit} MiB");
        return Err(Error::Exhausted(reason));
    }
    Ok(work)
}

/// An error about a file is the client's, because all files are.
fn of_client(error: Error) -> Error {
    match error {
        Error::File { path, reason } => Error::invalid(path, reason),
        other => other,
    }
}

/// The calls of clients of earlier versions, one for each study.
const OLD_CALLS: [&str; 6] = ["Intrude", "Trials", "Walk", "Sweep", "Evaluate", "Diagnose"];

/// Refuses the calls of older clients with a line that says what to do.
pub async fn refuse_old(call: Call, next: Next) -> axum::response::Response {
    let method = call.uri().path().strip_prefix("/sandgait.v1.StudyService/");
    match method.filter(|method| OLD_CALLS.contains(method)) {
        None => next.run(call).await,
        Some(method) => {
            let reason = format!("StudyService/{method} is gone, because all studies use rpc Study; update the client");
            Status::unimplemented(reason).into_http::<Body>()
        }
    }
}
