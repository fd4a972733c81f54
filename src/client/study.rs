//! Studies on a server: progress, then the result.

use super::address::ServerAddress;
use super::{lost, studies};
use crate::service::proto::{self, DiagnoseResponse, EvaluateResponse, SweepResponse, TrialsResponse, WalkResponse};
use crate::service::proto::{diagnose_response, evaluate_response, sweep_response, trials_response, walk_response};
use crate::service::studies::compute::{Outcome, Study};
use futures_util::stream::{self, BoxStream, StreamExt as _};
use tonic::{Status, Streaming};

/// An event of a study.
pub enum Event {
    /// Finished share, and the present stage.
    Progress(f64, String),
    Done(Outcome),
}

impl From<proto::Progress> for Event {
    fn from(progress: proto::Progress) -> Self {
        Self::Progress(progress.fraction, progress.stage)
    }
}

impl From<proto::Table> for Event {
    fn from(table: proto::Table) -> Self {
        Self::Done(Outcome::Table(table))
    }
}

fn tried(answer: TrialsResponse) -> Option<Event> {
    Some(match answer.event? {
        trials_response::Event::Progress(progress) => progress.into(),
        trials_response::Event::Table(table) => table.into(),
    })
}

fn walk_event(answer: WalkResponse) -> Option<Event> {
    Some(match answer.event? {
        walk_response::Event::Progress(progress) => progress.into(),
        walk_response::Event::Table(table) => table.into(),
    })
}

fn swept(answer: SweepResponse) -> Option<Event> {
    Some(match answer.event? {
        sweep_response::Event::Progress(progress) => progress.into(),
        sweep_response::Event::Table(table) => table.into(),
    })
}

fn evaluated(answer: EvaluateResponse) -> Option<Event> {
    Some(match answer.event? {
        evaluate_response::Event::Progress(progress) => progress.into(),
        evaluate_response::Event::Table(table) => table.into(),
    })
}

fn diagnosed(answer: DiagnoseResponse) -> Option<Event> {
    Some(match answer.event? {
        diagnose_response::Event::Progress(progress) => progress.into(),
        diagnose_response::Event::Diagnosis(diagnosis) => Event::Done(Outcome::Diagnosis(diagnosis)),
    })
}

pub type Events = BoxStream<'static, Result<Event, Status>>;

fn events<T: 'static>(answers: Streaming<T>, of: fn(T) -> Option<Event>) -> Events
where
    Streaming<T>: Send,
{
    let missing = || Status::internal("an answer without content");
    answers.map(move |answer| answer.map_err(lost).and_then(|answer| of(answer).ok_or_else(missing))).boxed()
}

/// Requests a study; dropping its events stops it.
pub async fn study(place: &ServerAddress, study: Study) -> Result<Events, Status> {
    let mut client = studies(place).await?;
    Ok(match study {
        Study::Intrude(request) => {
            let table = client.intrude(request).await.map_err(lost)?.into_inner().table.unwrap_or_default();
            stream::iter([Ok(table.into())]).boxed()
        }
        Study::Trials(request) => events(client.trials(request).await.map_err(lost)?.into_inner(), tried),
        Study::Walk(request) => events(client.walk(request).await.map_err(lost)?.into_inner(), walk_event),
        Study::Sweep(request) => events(client.sweep(request).await.map_err(lost)?.into_inner(), swept),
        Study::Evaluate(request) => events(client.evaluate(request).await.map_err(lost)?.into_inner(), evaluated),
        Study::Diagnose(request) => events(client.diagnose(request).await.map_err(lost)?.into_inner(), diagnosed),
    })
}

/// The next event; None: the stream has ended.
pub async fn next(events: &mut Events) -> Option<Result<Event, Status>> {
    events.next().await
}
