//! What each call may cost at most, checked before its work begins. `docs/limits.md` has the bounds.
//!
//! ```text
//!  length of the message ≤ CallBounds::largest ──▶ its fields and values are counted (fields.rs) ──▶ unpacked
//!   ──▶ memory of the work and its answer (of_request) ──▶ a share of the memory for requests ──▶ work
//! ```
//!
//! Two bytes can be an empty list, which takes 32 bytes when it is unpacked, so the size of a message limits neither
//! memory nor time. Therefore all fields of a message are counted before it is unpacked, down to the values of its
//! options.
//!
//! A thing says its own size: the work of a study (`Study::cost`, `StudyWork::bytes`), a task with its model, names and texts
//! (`AnyTask::count_memory`), an environment with its rocks (`AnyTask::bytes_per_env`), a message with its fields (`fields`) and an answer with its bytes
//! ([`answer_bytes`]). The server adds up what they say.
//!
//! Time has another bound: all work of more than some 10 ms is done in parts, and ends after the present part if nobody
//! waits for it any more (`SessionWork::end`, `Progress::report`).

use super::fields::{self, MessageLayout, SMALL};
use super::proto;
use super::proto::run_session_request::Request;
use crate::error::{Error, Result};
use crate::pool::Batch;
use crate::session::view;
use prost::Message;
use std::collections::HashMap;
use std::sync::LazyLock;

/// The bounds of a call's messages.
pub struct CallBounds {
    /// Largest message [bytes].
    pub largest: usize,
    pub layout: Option<&'static MessageLayout>,
}

/// Memory of a message with its unpacked parts, as a multiple of its size: actions are copied once.
pub const COPIES: usize = 2;

/// Memory of a call with a small message and a small answer [bytes]: 6 to 8 kB were measured for the call, its stream of
/// HTTP/2 and its task; a small message seldom waits.
pub const CALL: usize = 16 << 10;

/// The bounds of the methods of our services, by their paths.
static CALLS: LazyLock<HashMap<&'static str, CallBounds>> = LazyLock::new(|| {
    let bounds = |path: &'static str| {
        let layout = fields::of_method(path);
        (path, CallBounds { largest: layout.map_or(SMALL, MessageLayout::largest), layout })
    };
    fields::methods().map(bounds).collect()
});

/// Any other call: its messages are not unpacked by us.
static OTHER: CallBounds = CallBounds { largest: SMALL, layout: None };

/// The bounds of the call with this path: `/package.Service/Method`.
pub fn of_call(path: &str) -> &'static CallBounds {
    CALLS.get(path).unwrap_or(&OTHER)
}

/// Memory of an answer with its unpacked parts, as a multiple of its size on the wire: measured with the descriptions of
/// tasks, whose many short texts take the most.
const UNPACKED: usize = 4;

/// Answers of at most this size [bytes] are in the price of their call.
pub const SMALL_ANSWER: usize = CALL / 4;

/// Memory of an answer that has not been sent [bytes].
pub fn answer_bytes(answer: &impl Message) -> usize {
    UNPACKED * answer.encoded_len()
}

/// Largest memory of a session's request and its answer [bytes], besides the message and what the session has reserved.
/// Requests that make models or snapshots add this memory while they make them.
///
/// # Errors
/// The request asks for more than any request may.
pub fn of_request(request: &Request, batch: &Batch) -> Result<usize> {
    let parts = |trajectories: bool| if trajectories { PARTS * batch.part_bytes() } else { 0 };
    Ok(match request {
        Request::Attach(_) | Request::Step(_) | Request::SetCommand(_) | Request::Reset(_) | Request::Save(_) => 0,
        // The session's reservation includes the copy of each episode that a restore makes.
        Request::Restore(_) => 0,
        // What cannot be observed is refused without a header.
        Request::Observe(observe) => {
            let look = batch.look(observe.index as usize, observe.ended);
            look.map_or(0, |look| HEADERS * look.model.drawing_bytes())
        }
        Request::Rollout(rollout) => parts(rollout.trajectories),
        // Weights, and their arrangement in lanes.
        Request::PolicyRollout(network) => 2 * network.onnx.len() + parts(network.trajectories),
        Request::Render(render) => {
            let (all, one) = pixels(render)?;
            // All pixels, and the larger of two: the present picture's canvas with its pixels, or the message's copy.
            3 * all + (7 * one).max(3 * all)
        }
    })
}

/// Most copies of an observation's header at once: two while it grows, one in the message, one in HTTP/2's queue.
const HEADERS: usize = 4;

/// Largest number of copies of a part of a rollout at the same time: the rows, one copy that is being encoded, two that
/// wait for the stream, and two as bytes in the queue of HTTP/2.
const PARTS: usize = 6;

/// Largest number of pictures of one request: our choice, 64 × 64 of them. A picture takes some 0.2 ms or more, however
/// few pixels it has.
const MOST_PICTURES: usize = 4096;

/// Number of pixels of all pictures together, and of one picture.
fn pixels(render: &proto::Render) -> Result<(usize, usize)> {
    let (count, size) = (render.indices.len(), [render.width, render.height]);
    if count > MOST_PICTURES {
        return Err(Error::invalid("indices", format!("{count} pictures are more than {MOST_PICTURES}")));
    }
    Ok((view::check_pixels(count, size)?, view::check_pixels(count.min(1), size)?))
}

#[cfg(test)]
mod tests;
