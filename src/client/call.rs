//! Calls with one answer. Each has a connection of its own. Futures are boxed, so that calls are compiled here, and not again in each
//! crate that waits for them.

use super::address::ServerAddress;
use super::{environments, lost};
use crate::service::PROTOCOL;
use crate::service::proto::{CloseSessionRequest, CreateSessionRequest, CreateSessionResponse};
use crate::service::proto::{DescribeRequest, DescribeResponse};
use futures_util::future::BoxFuture;
use serde_json::Value;
use std::time::Duration;
use tokio::time::timeout;
use tonic::Status;

/// Longest wait for an answer: our choice. A request may wait 30 s for memory of the server, and then its environments
/// are made.
const PATIENCE: Duration = Duration::from_secs(60);

async fn soon<T>(call: impl Future<Output = Result<T, Status>>) -> Result<T, Status> {
    let late = || Status::deadline_exceeded(format!("no answer within {} s", PATIENCE.as_secs()));
    timeout(PATIENCE, call).await.map_err(|_| late())?.map_err(lost)
}

/// Properties of the server, and its tasks.
#[inline(never)]
pub fn describe(place: &ServerAddress) -> BoxFuture<'_, Result<DescribeResponse, Status>> {
    Box::pin(soon(async { Ok(environments(place).await?.describe(DescribeRequest {}).await?.into_inner()) }))
}

/// Reserves environments, which have no state before their first reset.
#[inline(never)]
pub fn create_session<'a>(
    place: &'a ServerAddress,
    task_id: String,
    num_envs: u32,
    options: &Value,
) -> BoxFuture<'a, Result<CreateSessionResponse, Status>> {
    let options = match crate::service::from_json(options).kind {
        Some(prost_types::value::Kind::StructValue(options)) => Some(options),
        _ => None,
    };
    let request = CreateSessionRequest { task_id, num_envs, options, protocol: PROTOCOL };
    Box::pin(soon(async { Ok(environments(place).await?.create_session(request).await?.into_inner()) }))
}

/// Frees a session, if the server answers within `time`.
#[inline(never)]
pub fn close_session(place: &ServerAddress, session_id: String, time: Duration) -> BoxFuture<'_, Result<(), Status>> {
    let call = async move {
        environments(place).await?.close_session(CloseSessionRequest { session_id }).await?;
        Ok(())
    };
    let late = || Err(Status::deadline_exceeded("the session was not closed"));
    Box::pin(async move { timeout(time, call).await.unwrap_or_else(|_| late()) })
}
