//! The memory of answers, until they have left the server.
//!
//! ```text
//!  answer ──encode──▶ bytes and their share of the memory ──▶ HTTP/2's queue ──▶ socket: the share is free again
//!                                                               └── not in time: the connection is closed
//! ```
//!
//! HTTP/2 queues the bytes of an answer and asks for the next answer before the client has read the first. Therefore
//! the queued bytes themselves hold the share; the stream that made the answer does not.

use super::connection_table::ConnectionHandle;
use super::intake::{Messages, Share};
use axum::body::Body;
use axum::extract::{Request, State};
use axum::middleware::Next;
use axum::response::Response;
use bytes::Bytes;
use http_body_util::BodyExt as _;
use std::sync::Arc;
use std::time::Duration;
use tokio::task::AbortHandle;

/// Slowest transfer of an answer [bytes/s]: our choice, some 8 Mbit/s. [`super::Limits::stall`] is added to the time that this transfer takes.
const SLOWEST: usize = 1 << 20;

/// Bytes that hold their share of the memory for requests until HTTP/2 has sent them, or drops them because the stream
/// or the connection has ended.
struct UnsentAnswer {
    bytes: Bytes,
    _share: Arc<Share>,
    _limit: TimeLimit,
}

impl AsRef<[u8]> for UnsentAnswer {
    fn as_ref(&self) -> &[u8] {
        &self.bytes
    }
}

/// A task that closes the connection when the time is over. Dropping this ends the task.
struct TimeLimit(AbortHandle);

impl TimeLimit {
    fn new(link: ConnectionHandle, time: Duration) -> Self {
        let late = async move {
            tokio::time::sleep(time).await;
            tracing::warn!(peer = link.name(), "a connection was closed: its client does not read a large answer");
            link.close();
        };
        Self(tokio::spawn(late).abort_handle())
    }
}

impl Drop for TimeLimit {
    fn drop(&mut self) {
        self.0.abort();
    }
}

/// Lets each answer of a call hold the share that was given to [`Messages::hold_for_answer`]. If the client does not
/// read an answer within `stall` and the time of its transfer, the connection is closed.
pub async fn pass(State(stall): State<Duration>, call: Request, next: Next) -> Response {
    let messages = call.extensions().get::<Messages>().cloned();
    let link = call.extensions().get::<ConnectionHandle>().cloned();
    let answers = next.run(call).await;
    let (Some(messages), Some(link)) = (messages, link) else { return answers };
    let mut ahead = 0;
    answers.map(|body| {
        Body::new(body.map_frame(move |frame| {
            frame.map_data(|bytes| {
                // Of the earlier answers, only the last can still be in the queue.
                let queued = std::mem::replace(&mut ahead, bytes.len()) + bytes.len();
                let Some(share) = messages.take_answer_share() else { return bytes };
                let time = stall + Duration::from_secs((queued / SLOWEST) as u64);
                Bytes::from_owner(UnsentAnswer { bytes, _share: share, _limit: TimeLimit::new(link.clone(), time) })
            })
        }))
    })
}
