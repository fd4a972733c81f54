//! Studies on a server: progress, then the result.

use super::address::ServerAddress;
use super::{lost, studies};
use crate::service::proto::{self, DiagnoseResponse, EvaluateResponse, SweepResponse, TrialsResponse, WalkResponse};
use crate::service::proto::{diagnose_response, evaluate_response, sweep_response, trials_response, walk_response};
use crate::service::studies::compute::{StudyRequest, StudyResult};
use futures_util::stream::{self, BoxStream, StreamExt as _};
use tonic::{Status, Streaming};

/// An event of a study.
pub enum StudyEvent {
    /// Finished share, and the present stage.
    Progress(f64, String),
    Done(StudyResult),
}

impl From<proto::Progress> for StudyEvent {
    fn from(progress: proto::Progress) -> Self {
        Self::Progress(progress.fraction, progress.stage)
    }
}

impl From<proto::Table> for StudyEvent {
    fn from(table: proto::Table) -> Self {
        Self::Done(StudyResult::Table(table))
    }
}

fn tried(answer: TrialsResponse) -> Option<StudyEvent> {
    Some(match answer.event? {
        trials_response::Event::Progress(progress) => progress.into(),
        trials_response::Event::Table(table) => table.into(),
    })
}

fn walk_event(answer: WalkResponse) -> Option<StudyEvent> {
    Some(match answer.event? {
        walk_response::Event::Progress(progress) => progress.into(),
        walk_response::Event::Table(table) => table.into(),
    })
}

fn swept(answer: SweepResponse) -> Option<StudyEvent> {
    Some(match answer.event? {
        sweep_response::Event::Progress(progress) => progress.into(),
        sweep_response::Event::Table(table) => table.into(),
    })
}

fn evaluated(answer: EvaluateResponse) -> Option<StudyEvent> {
    Some(match answer.event? {
        evaluate_response::Event::Progress(progress) => progress.into(),
        evaluate_response::Event::Table(table) => table.into(),
    })
}

fn diagnosed(answer: DiagnoseResponse) -> Option<StudyEvent> {
    Some(match answer.event? {
        diagnose_response::Event::Progress(progress) => progress.into(),
        diagnose_response::Event::Diagnosis(diagnosis) => StudyEvent::Done(StudyResult::Diagnosis(diagnosis)),
    })
}

pub type StudyEvents = BoxStream<'static, Result<StudyEvent, Status>>;

fn events<T: 'static>(answers: Streaming<T>, of: fn(T) -> Option<StudyEvent>) -> StudyEvents
where
    Streaming<T>: Send,
{
    let missing = || Status::internal("an answer without content");
    answers.map(move |answer| answer.map_err(lost).and_then(|answer| of(answer).ok_or_else(missing))).boxed()
}

/// Requests a study; dropping its events stops it.
pub async fn study(place: &ServerAddress, study: StudyRequest) -> Result<StudyEvents, Status> {
    let mut client = studies(place).await?;
    Ok(match study {
        StudyRequest::Intrude(request) => {
            let table = client.intrude(request).await.map_err(lost)?.into_inner().table.unwrap_or_default();
            stream::iter([Ok(table.into())]).boxed()
        }
        StudyRequest::Trials(request) => events(client.trials(request).await.map_err(lost)?.into_inner(), tried),
        StudyRequest::Walk(request) => events(client.walk(request).await.map_err(lost)?.into_inner(), walk_event),
        StudyRequest::Sweep(request) => events(client.sweep(request).await.map_err(lost)?.into_inner(), swept),
        StudyRequest::Evaluate(request) => {
            events(client.evaluate(request).await.map_err(lost)?.into_inner(), evaluated)
        }
        StudyRequest::Diagnose(request) => {
            events(client.diagnose(request).await.map_err(lost)?.into_inner(), diagnosed)
        }
    })
}

/// The next event; None: the stream has ended.
pub async fn next(events: &mut StudyEvents) -> Option<Result<StudyEvent, Status>> {
    events.next().await
}
