//! `sandgait.v1.StudyService`: the offline tools, as the command line has them.
//!
//! * [`compute`]: the studies themselves, also for callers in this process.
//! * [`decode`]: requests to studies that are ready to run; [`encode`]: their results as tables.
//! * [`line`]: one study at a time, the others in a queue, with progress reports.

pub mod compute;
mod decode;
mod encode;
mod line;

use super::frame::RequestFrame;
use super::intake::Messages;
use super::proto::study_service_server::StudyService;
use super::proto::{self, DiagnoseRequest, DiagnoseResponse, IntrudeRequest, IntrudeResponse};
use super::proto::{EvaluateRequest, EvaluateResponse, SweepRequest, SweepResponse, WalkRequest, WalkResponse};
use super::proto::{TrialsRequest, TrialsResponse};
use super::status::status;
use super::{off_runtime, price};
use line::{Events, StudyMessage, StudyQueue};
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
    pub fn new(stop: CancellationToken, memory: usize) -> Self {
        Self { line: StudyQueue::new(stop), memory }
    }
}

#[tonic::async_trait]
impl StudyService for Studies {
    async fn intrude(
        &self,
        request: Request<RequestFrame<IntrudeRequest>>,
    ) -> std::result::Result<Response<IntrudeResponse>, Status> {
        let (request, _share) = RequestFrame::only(request).await?;
        off_runtime(move || compute::intrude(request)).await.map(Response::new)
    }

    type TrialsStream = Events<TrialsResponse>;

    async fn trials(
        &self,
        request: Request<RequestFrame<TrialsRequest>>,
    ) -> std::result::Result<Response<Self::TrialsStream>, Status> {
        let messages = Messages::of(&request);
        let (request, share) = RequestFrame::only(request).await?;
        let work = off_runtime(move || compute::trials(request)).await?;
        self.line.enter(share, messages, work).map(Response::new)
    }

    type WalkStream = Events<WalkResponse>;

    async fn walk(
        &self,
        request: Request<RequestFrame<WalkRequest>>,
    ) -> std::result::Result<Response<Self::WalkStream>, Status> {
        let messages = Messages::of(&request);
        let (request, share) = RequestFrame::only(request).await?;
        let work = off_runtime(move || compute::walk(request)).await?;
        self.line.enter(share, messages, work).map(Response::new)
    }

    type SweepStream = Events<SweepResponse>;

    async fn sweep(
        &self,
        request: Request<RequestFrame<SweepRequest>>,
    ) -> std::result::Result<Response<Self::SweepStream>, Status> {
        let messages = Messages::of(&request);
        let (request, share) = RequestFrame::only(request).await?;
        let work = off_runtime(move || compute::sweep(request)).await?;
        self.line.enter(share, messages, work).map(Response::new)
    }

    type EvaluateStream = Events<EvaluateResponse>;

    async fn evaluate(
        &self,
        request: Request<RequestFrame<EvaluateRequest>>,
    ) -> std::result::Result<Response<Self::EvaluateStream>, Status> {
        let messages = Messages::of(&request);
        let (request, share) = RequestFrame::only(request).await?;
        let work = off_runtime(move || compute::evaluate(request)).await?;
        self.line.enter(share, messages, work).map(Response::new)
    }

    type DiagnoseStream = Events<DiagnoseResponse>;

    async fn diagnose(
        &self,
        request: Request<RequestFrame<DiagnoseRequest>>,
    ) -> std::result::Result<Response<Self::DiagnoseStream>, Status> {
        let messages = Messages::of(&request);
        let (request, share) = RequestFrame::only(request).await?;
        let data = request.data.as_ref().map_or(&[][..], |data| &data.content);
        price::check_diagnosis(data, self.memory).map_err(|e| status(&e))?;
        let work = off_runtime(move || compute::diagnose(request)).await?;
        self.line.enter(share, messages, work).map(Response::new)
    }
}

impl StudyMessage for TrialsResponse {
    fn progress(progress: proto::Progress) -> Self {
        Self { event: Some(proto::trials_response::Event::Progress(progress)) }
    }
}

impl StudyMessage for WalkResponse {
    fn progress(progress: proto::Progress) -> Self {
        Self { event: Some(proto::walk_response::Event::Progress(progress)) }
    }
}

impl StudyMessage for SweepResponse {
    fn progress(progress: proto::Progress) -> Self {
        Self { event: Some(proto::sweep_response::Event::Progress(progress)) }
    }
}

impl StudyMessage for EvaluateResponse {
    fn progress(progress: proto::Progress) -> Self {
        Self { event: Some(proto::evaluate_response::Event::Progress(progress)) }
    }
}

impl StudyMessage for DiagnoseResponse {
    fn progress(progress: proto::Progress) -> Self {
        Self { event: Some(proto::diagnose_response::Event::Progress(progress)) }
    }
}
