//! `sandgait.v1.StudyService`: the offline tools, as the command line has them.
//!
//! * [`compute`]: checks requests and computes the studies, also for callers in this process.
//! * [`encode`]: their results as tables.
//! * [`line`]: runs one study at a time while the others wait in a queue, and reports progress.
//! * [`thread`]: the threads of studies, which yield to steps.

pub mod compute;
mod encode;
mod line;
mod thread;

use super::frame::RequestFrame;
use super::intake::{Intake, Messages};
use super::proto::study_service_server::StudyService;
use super::proto::{self, Diagnosis, EvaluateRequest, SweepRequest, Table, TableResponse, TrialsRequest, WalkRequest};
use super::proto::{DiagnoseRequest, DiagnoseResponse, IntrudeRequest, IntrudeResponse};
use super::{off_runtime, outgoing, price};
use crate::error::Result as Checked;
use compute::StudyWork;
use line::{Events, StudyMessage, StudyQueue};
use prost::Message;
use std::sync::Arc;
use tokio_util::sync::CancellationToken;
use tonic::{Request, Response, Status};

/// The studies of one server.
pub struct Studies {
    line: StudyQueue,
    /// All memory that the server may use [bytes].
    memory: usize,
    intake: Arc<Intake>,
}

impl Studies {
    /// Cancelling `stop` ends every study. `memory`: all that the server may use [bytes].
    pub fn new(stop: CancellationToken, memory: usize, intake: Arc<Intake>) -> Self {
        Self { line: StudyQueue::new(stop, intake.clone()), memory, intake }
    }

    /// Checks a request, and computes its study in its turn.
    async fn run<R: Message + Default + 'static, A: StudyMessage>(
        &self,
        request: Request<RequestFrame<R>>,
        check: impl FnOnce(R) -> Checked<StudyWork<A::Result>> + Send + 'static,
    ) -> Result<Response<Events<A>>, Status> {
        let messages = Messages::of(&request);
        let (request, share) = RequestFrame::only(request).await?;
        let work = off_runtime(move || check(request)).await?;
        self.line.enter(share, messages, work).map(Response::new)
    }
}

#[tonic::async_trait]
impl StudyService for Studies {
    async fn intrude(
        &self,
        request: Request<RequestFrame<IntrudeRequest>>,
    ) -> Result<Response<IntrudeResponse>, Status> {
        let messages = Messages::of(&request);
        let (request, _share) = RequestFrame::only(request).await?;
        let table = off_runtime(move || compute::intrude(request)).await?;
        let answer = || Ok(IntrudeResponse { table: Some(table.clone()) });
        outgoing::answer(&self.intake, &messages, answer).await
    }

    type TrialsStream = Events<TableResponse>;

    async fn trials(&self, request: Request<RequestFrame<TrialsRequest>>) -> Answers<TableResponse> {
        self.run(request, compute::trials).await
    }

    type WalkStream = Events<TableResponse>;

    async fn walk(&self, request: Request<RequestFrame<WalkRequest>>) -> Answers<TableResponse> {
        self.run(request, compute::walk).await
    }

    type SweepStream = Events<TableResponse>;

    async fn sweep(&self, request: Request<RequestFrame<SweepRequest>>) -> Answers<TableResponse> {
        self.run(request, compute::sweep).await
    }

    type EvaluateStream = Events<TableResponse>;

    async fn evaluate(&self, request: Request<RequestFrame<EvaluateRequest>>) -> Answers<TableResponse> {
        self.run(request, compute::evaluate).await
    }

    type DiagnoseStream = Events<DiagnoseResponse>;

    async fn diagnose(&self, request: Request<RequestFrame<DiagnoseRequest>>) -> Answers<DiagnoseResponse> {
        let memory = self.memory;
        let check = move |request: DiagnoseRequest| {
            let data = request.data.as_ref().map_or(&[][..], |data| &data.content);
            price::check_diagnosis(data, memory)?;
            compute::diagnose(request)
        };
        self.run(request, check).await
    }
}

type Answers<A> = Result<Response<Events<A>>, Status>;

impl StudyMessage for TableResponse {
    type Result = Table;

    fn progress(progress: proto::Progress) -> Self {
        Self { event: Some(proto::table_response::Event::Progress(progress)) }
    }

    fn result(table: Table) -> Self {
        Self { event: Some(proto::table_response::Event::Table(table)) }
    }
}

impl StudyMessage for DiagnoseResponse {
    type Result = Diagnosis;

    fn progress(progress: proto::Progress) -> Self {
        Self { event: Some(proto::diagnose_response::Event::Progress(progress)) }
    }

    fn result(diagnosis: Diagnosis) -> Self {
        Self { event: Some(proto::diagnose_response::Event::Diagnosis(diagnosis)) }
    }
}
