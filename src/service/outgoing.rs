//! The memory of answers, until they have left the server.
//!
//! ```text
//!  answer ──encode──▶ bytes and their share of the memory ──▶ HTTP/2's queue ──▶ socket: the share is free again
//!    └── the client reads nothing: the answer waits here     └── not in time: the connection is closed
//! ```
//!
//! HTTP/2 queues the bytes of an answer and asks for the next answer before the client has read the first. Therefore
//! the queued bytes themselves hold the share; the stream that made the answer does not. If the client's window is
//! closed, HTTP/2 does not even ask for the first answer, which then waits unpacked, with its share in [`Messages`].

use super::intake::{Intake, Messages};
use super::price;
use super::status;
use super::unread::UnreadShare;
use crate::error::{Error, Result};
use axum::body::Body;
use axum::extract::Request;
use axum::middleware::Next;
use bytes::Bytes;
use http_body_util::BodyExt as _;
use prost::Message;
use std::sync::Arc;
use tonic::{Response, Status};

/// Bytes that hold their share of the memory for requests until HTTP/2 has sent them, or drops them because the stream
/// or the connection has ended.
struct UnsentAnswer {
    bytes: Bytes,
    _share: UnreadShare,
}

impl AsRef<[u8]> for UnsentAnswer {
    fn as_ref(&self) -> &[u8] {
        &self.bytes
    }
}

/// Lets each answer of a call hold the share that was given to [`Messages::hold_for_answer`].
pub async fn pass(call: Request, next: Next) -> axum::response::Response {
    let messages = call.extensions().get::<Messages>().cloned();
    let answers = next.run(call).await;
    let Some(messages) = messages else { return answers };
    answers.map(|body| {
        Body::new(body.map_frame(move |frame| {
            frame.map_data(|bytes| {
                let Some(share) = messages.take_answer_share() else { return bytes };
                Bytes::from_owner(UnsentAnswer { bytes, _share: share })
            })
        }))
    })
}

/// The only answer of a call, made when there is memory for it.
///
/// # Errors
/// `make` fails, or others have the memory.
pub async fn answer<T: Message>(
    intake: &Intake,
    messages: &Messages,
    make: impl Fn() -> Result<T>,
) -> std::result::Result<Response<T>, Status> {
    let refused = |e| status::status(&e);
    let mut answer = intake.make(&make).await.map_err(refused)?;
    let bytes = price::answer_bytes(&answer);
    if bytes > price::SMALL_ANSWER {
        let unread = messages.unread_bytes();
        if unread > 0 && unread + bytes > intake.most_unread() {
            let reason = format!("this connection's client must first read {} KiB of other answers", unread >> 10);
            return Err(refused(Error::Exhausted(reason)));
        }
        let share = match intake.try_answer_share(bytes) {
            Some(share) => share,
            None => {
                // While it waits, it takes no memory.
                drop(answer);
                let share = intake.answer_share(bytes).await.map_err(refused)?;
                answer = intake.make(&make).await.map_err(refused)?;
                share
            }
        };
        messages.hold_for_answer(Some(messages.unread(Arc::new(share), bytes)));
    }
    Ok(Response::new(answer))
}
