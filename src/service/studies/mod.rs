//! `sandgait.v1.StudyService`: the offline tools, as the command line has them.
//!
//! * [`decode`]: requests to studies that are ready to run; [`encode`]: their results as tables.
//! * [`line`]: one study at a time, the others in line, each told how far it has come.

mod decode;
mod encode;
mod line;

use super::frame::Frame;
use super::proto::study_service_server::StudyService;
use super::proto::{self, DiagnoseRequest, DiagnoseResponse, IntrudeRequest, IntrudeResponse};
use super::proto::{EvaluateRequest, EvaluateResponse, SweepRequest, SweepResponse, WalkRequest, WalkResponse};
use super::{off_runtime, wire};
use crate::error::{Error, Result};
use crate::evaluate::Study;
use crate::progress::Progress;
use crate::sweep::{grid, optimize, walk_all};
use line::{Answer, Line};
use std::path::Path;
use tokio_stream::wrappers::ReceiverStream;
use tokio_util::sync::CancellationToken;
use tonic::{Request, Response, Status};

/// Largest request [bytes]: 40,000 rows of a force log, the most that are diagnosed, have about 8 MB.
pub const MOST_BYTES: usize = 64 << 20;

/// Largest network that is evaluated [bytes].
pub const LARGEST_POLICY: usize = crate::policy::MOST_BYTES;

/// The studies of one server.
pub struct Studies {
    line: Line,
}

impl Studies {
    /// Cancelling `stop` ends every study.
    pub fn new(stop: CancellationToken) -> Self {
        Self { line: Line::new(stop) }
    }
}

type Events<T> = ReceiverStream<std::result::Result<T, Status>>;

#[tonic::async_trait]
impl StudyService for Studies {
    async fn intrude(
        &self,
        request: Request<Frame<IntrudeRequest>>,
    ) -> std::result::Result<Response<IntrudeResponse>, Status> {
        let (request, _share) = Frame::only(request, wire::PLAIN).await?;
        let table = off_runtime(move || {
            let (rotation, sand) = decode::intrude(request)?;
            Ok(encode::table(encode::loads(&rotation.loads(&sand.description)?), sand.warnings))
        });
        Ok(Response::new(IntrudeResponse { table: Some(table.await?) }))
    }

    type WalkStream = Events<WalkResponse>;

    async fn walk(
        &self,
        request: Request<Frame<WalkRequest>>,
    ) -> std::result::Result<Response<Self::WalkStream>, Status> {
        let (request, share) = Frame::only(request, wire::PLAIN).await?;
        let walks = off_runtime(move || decode::walk(request)).await?;
        let work = move |progress: &dyn Progress| {
            let _share = &share;
            let results = walk_all(walks.engine, &walks.trials, progress)?;
            let columns = std::iter::once(encode::frequencies(&walks.trials)).chain(encode::walks(&results));
            let table = encode::table(columns.collect(), walks.warnings);
            Ok(WalkResponse { event: Some(proto::walk_response::Event::Table(table)) })
        };
        self.line.enter(work).map(Response::new)
    }

    type SweepStream = Events<SweepResponse>;

    async fn sweep(
        &self,
        request: Request<Frame<SweepRequest>>,
    ) -> std::result::Result<Response<Self::SweepStream>, Status> {
        let (request, share) = Frame::only(request, &wire::SWEEP).await?;
        let sweep = off_runtime(move || decode::sweep(request)).await?;
        let work = move |progress: &dyn Progress| {
            let _share = &share;
            let columns = match sweep.optimize {
                None => encode::grid(&sweep.axes, &grid(&sweep.base, &sweep.axes, progress)?),
                Some(goal) => {
                    encode::optimum(&sweep.axes, &optimize::optimize(&sweep.base, &sweep.axes, goal, progress)?)
                }
            };
            let table = encode::table(columns, sweep.warnings);
            Ok(SweepResponse { event: Some(proto::sweep_response::Event::Table(table)) })
        };
        self.line.enter(work).map(Response::new)
    }

    type EvaluateStream = Events<EvaluateResponse>;

    async fn evaluate(
        &self,
        request: Request<Frame<EvaluateRequest>>,
    ) -> std::result::Result<Response<Self::EvaluateStream>, Status> {
        let (request, share) = Frame::only(request, &wire::EVALUATE).await?;
        let study = off_runtime(move || Study::new(&decode::evaluate(request)?)).await?;
        let work = move |progress: &dyn Progress| {
            let _share = &share;
            let table = encode::table(encode::evaluation(&study.run(progress)?), Vec::new());
            Ok(EvaluateResponse { event: Some(proto::evaluate_response::Event::Table(table)) })
        };
        self.line.enter(work).map(Response::new)
    }

    type DiagnoseStream = Events<DiagnoseResponse>;

    async fn diagnose(
        &self,
        request: Request<Frame<DiagnoseRequest>>,
    ) -> std::result::Result<Response<Self::DiagnoseStream>, Status> {
        let (request, share) = Frame::only(request, &wire::DIAGNOSE).await?;
        let (data, experiment) = off_runtime(move || decode::diagnose(request)).await?;
        let work = move |progress: &dyn Progress| {
            let _share = &share;
            // The diagnosis reads and writes files: it gets a directory that only this user can enter.
            let directory = tempfile::tempdir().map_err(|e| unusable(&e))?;
            let (path, out) = (directory.path().join("data"), directory.path().join("out"));
            std::fs::write(&path, &data.content).map_err(|e| unusable(&e))?;
            let named = |e: Error| decode::renamed(e, &path, &data.name);
            let diagnosis = crate::diagnose::diagnose(&path, &experiment, progress).map_err(named)?;
            diagnosis.write(&out)?;
            let diagnosis = proto::Diagnosis {
                report_json: read(&out.join("report.json"))?,
                report_html: read(&out.join("report.html"))?,
                sand_toml: read(&out.join("sand.toml"))?,
                curves: Some(encode::table(encode::curves(&diagnosis.curves), Vec::new())),
            };
            Ok(DiagnoseResponse { event: Some(proto::diagnose_response::Event::Diagnosis(diagnosis)) })
        };
        self.line.enter(work).map(Response::new)
    }
}

fn read(path: &Path) -> Result<String> {
    std::fs::read_to_string(path).map_err(|e| unusable(&e))
}

fn unusable(error: &std::io::Error) -> Error {
    Error::Exhausted(format!("the server's directory for temporary files cannot be used: {error}"))
}

impl Answer for WalkResponse {
    fn progress(progress: proto::Progress) -> Self {
        Self { event: Some(proto::walk_response::Event::Progress(progress)) }
    }
}

impl Answer for SweepResponse {
    fn progress(progress: proto::Progress) -> Self {
        Self { event: Some(proto::sweep_response::Event::Progress(progress)) }
    }
}

impl Answer for EvaluateResponse {
    fn progress(progress: proto::Progress) -> Self {
        Self { event: Some(proto::evaluate_response::Event::Progress(progress)) }
    }
}

impl Answer for DiagnoseResponse {
    fn progress(progress: proto::Progress) -> Self {
        Self { event: Some(proto::diagnose_response::Event::Progress(progress)) }
    }
}
