//! Studies on a server: progress, then the result.

use super::address::ServerAddress;
use super::{lost, studies};
use crate::service::proto::{DiagnoseResponse, Progress, TableResponse, diagnose_response, table_response};
use crate::service::studies::compute::{StudyRequest, StudyResult};
use futures_util::stream::{self, BoxStream, StreamExt as _};
use tonic::{Response, Status, Streaming};

/// An event of a study.
pub enum StudyEvent {
    /// Finished share, and the present stage.
    Progress(f64, String),
    Done(StudyResult),
}

impl From<Progress> for StudyEvent {
    fn from(progress: Progress) -> Self {
        Self::Progress(progress.fraction, progress.stage)
    }
}

fn of_table(answer: TableResponse) -> Option<StudyEvent> {
    Some(match answer.event? {
        table_response::Event::Progress(progress) => progress.into(),
        table_response::Event::Table(table) => StudyEvent::Done(StudyResult::Table(table)),
    })
}

fn of_diagnosis(answer: DiagnoseResponse) -> Option<StudyEvent> {
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
    let table = |answer: Result<Response<Streaming<TableResponse>>, Status>| {
        answer.map(|answer| events(answer.into_inner(), of_table)).map_err(lost)
    };
    match study {
        StudyRequest::Intrude(request) => {
            let table = client.intrude(request).await.map_err(lost)?.into_inner().table.unwrap_or_default();
            Ok(stream::iter([Ok(StudyEvent::Done(StudyResult::Table(table)))]).boxed())
        }
        StudyRequest::Trials(request) => table(client.trials(request).await),
        StudyRequest::Walk(request) => table(client.walk(request).await),
        StudyRequest::Sweep(request) => table(client.sweep(request).await),
        StudyRequest::Evaluate(request) => table(client.evaluate(request).await),
        StudyRequest::Diagnose(request) => {
            Ok(events(client.diagnose(request).await.map_err(lost)?.into_inner(), of_diagnosis))
        }
    }
}

/// The next event; None: the stream has ended.
pub async fn next(events: &mut StudyEvents) -> Option<Result<StudyEvent, Status>> {
    events.next().await
}
