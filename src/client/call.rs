//! Calls with one answer. Each has a connection of its own.

use super::address::ServerAddress;
use super::{environments, lost};
use crate::service::PROTOCOL;
use crate::service::proto::{CloseSessionRequest, CreateSessionRequest, CreateSessionResponse};
use crate::service::proto::{DescribeRequest, DescribeResponse};
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
pub async fn describe(place: &ServerAddress) -> Result<DescribeResponse, Status> {
    soon(async { Ok(environments(place).await?.describe(DescribeRequest {}).await?.into_inner()) }).await
}

/// Reserves environments, which have no state before their first reset.
pub async fn create_session(
    place: &ServerAddress,
    task_id: String,
    num_envs: u32,
    options: &Value,
) -> Result<CreateSessionResponse, Status> {
    let options = match crate::service::from_json(options).kind {
        Some(prost_types::value::Kind::StructValue(options)) => Some(options),
        _ => None,
    };
    let request = CreateSessionRequest { task_id, num_envs, options, protocol: PROTOCOL };
    soon(async { Ok(environments(place).await?.create_session(request).await?.into_inner()) }).await
}

/// Frees a session, if the server answers within `time`.
pub async fn close_session(place: &ServerAddress, session_id: String, time: Duration) -> Result<(), Status> {
    let call = async {
        environments(place).await?.close_session(CloseSessionRequest { session_id }).await?;
        Ok(())
    };
    timeout(time, call).await.unwrap_or_else(|_| Err(Status::deadline_exceeded("the session was not closed")))
}
