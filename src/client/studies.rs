//! Studies on a server: progress, then the result.

use super::address::ServerAddress;
use super::{lost, study_client};
use crate::service::proto::{StudyRequest, StudyResponse, study_response};
use crate::service::status;
use crate::service::studies::convert;
use crate::study::{Content, StudyResult};
use futures_util::future::BoxFuture;
use futures_util::stream::{BoxStream, StreamExt as _};
use std::collections::BTreeMap;
use tonic::{Code, Status};

/// An event of a study.
pub enum StudyEvent {
    /// Finished share, and the present stage.
    Progress(f64, String),
    /// The result, and its `about` as text.
    Done(StudyResult, String),
}

pub type StudyEvents = BoxStream<'static, Result<StudyEvent, Status>>;

/// A study by its name, with its arguments as words and with its files.
pub struct StudyCall {
    pub name: String,
    pub words: Vec<String>,
    pub files: BTreeMap<String, Content>,
}

/// Requests a study; dropping its events stops it.
#[inline(never)]
pub fn study(place: &ServerAddress, call: StudyCall) -> BoxFuture<'_, Result<StudyEvents, Status>> {
    Box::pin(begin(place, call))
}

async fn begin(place: &ServerAddress, call: StudyCall) -> Result<StudyEvents, Status> {
    let StudyCall { name, words: arguments, files } = call;
    let files = files.into_iter().map(|(name, content)| convert::input(name, content)).collect();
    let answers = study_client(place).await?.study(StudyRequest { name, arguments, files }).await;
    let refused = |status: Status| match status.code() {
        Code::Unimplemented => {
            Status::unimplemented("this server is older than the client and has no rpc Study; update the server")
        }
        _ => lost(status),
    };
    Ok(answers.map_err(refused)?.into_inner().map(|answer| event(answer.map_err(lost)?)).boxed())
}

fn event(answer: StudyResponse) -> Result<StudyEvent, Status> {
    match answer.event {
        Some(study_response::Event::Progress(progress)) => Ok(StudyEvent::Progress(progress.fraction, progress.stage)),
        Some(study_response::Event::Result(result)) => {
            let done = convert::of_result(result).map(|(result, about)| StudyEvent::Done(result, about));
            done.map_err(|e| status::status(&e))
        }
        None => Err(Status::internal("an answer without content")),
    }
}

/// The next event; None: the stream has ended.
pub async fn next(events: &mut StudyEvents) -> Option<Result<StudyEvent, Status>> {
    events.next().await
}
