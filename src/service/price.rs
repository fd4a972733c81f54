//! What each call may cost at most, checked before its work begins. `docs/serving.md` has this as a table.
//!
//! ```text
//!  length of the message ≤ CallBounds::largest ──▶ its fields and values are counted (CallBounds::layout) ──▶ unpacked
//!   ──▶ memory of the work and its answer (of_request) ──▶ a share of the memory for requests ──▶ work
//! ```
//!
//! Two bytes can be an empty list, which takes 32 bytes when it is unpacked, so the size of a message limits neither
//! memory nor time. Therefore all fields of a message are counted before it is unpacked, down to the values of its
//! options.
//!
//! Time has another bound: all work of more than some 10 ms is done in parts, and ends after the present part if nobody
//! waits for it any more (`SessionWork::end`, `Progress::report`).

use super::proto;
use super::proto::run_session_request::Request;
use crate::error::{Error, Result};
use crate::pool::Batch;
use crate::session::view;

/// The bounds of a call's messages.
pub struct CallBounds {
    method: &'static str,
    /// Largest message [bytes].
    pub largest: usize,
    /// Memory of a message and of what is made from it, as a multiple of its size.
    pub copies: usize,
    pub layout: MessageLayout,
}

const fn call(method: &'static str, largest: usize, layout: MessageLayout) -> CallBounds {
    CallBounds { method, largest, copies: COPIES, layout }
}

/// Memory of a message with its unpacked parts, as a multiple of its size: actions are copied once.
pub const COPIES: usize = 2;

/// Memory of a study of trials as a multiple of its message. A row of 32 bytes is unpacked to 32 bytes. It becomes a
/// motion of 64 bytes, then an outcome of 72 bytes, then 64 bytes of a table, which is encoded once.
const TRIAL_COPIES: usize = 10;

/// Messages of at most this size [bytes] need no share of the memory for requests: our choice, as 1,024 take 16 MiB.
pub const SMALL: usize = 16 << 10;

/// Size of the texts and options of a request [bytes].
const TEXTS: usize = LONGEST_OPTIONS + SMALL;

/// Bounds of the calls. A call that is not listed has messages of at most [`SMALL`] bytes.
static CALLS: [CallBounds; 11] = [
    call("CreateSession", TEXTS, &CREATE_SESSION),
    // `--max-message-mib` bounds these messages, too.
    call("RunSession", usize::MAX, &RUN_SESSION),
    call("DescribeSession", SMALL, &SESSION_ID),
    call("CloseSession", SMALL, &SESSION_ID),
    call("Process", TEXTS, PLAIN),
    // These requests can have a robot and sand as files.
    call("Intrude", TEXTS, PLAIN),
    call("Walk", TEXTS, PLAIN),
    call("Sweep", TEXTS, &SWEEP),
    call("Evaluate", LARGEST_POLICY + TEXTS, &EVALUATE),
    CallBounds { method: "Trials", largest: LARGEST_TRIALS, copies: TRIAL_COPIES, layout: &TRIALS },
    call("Diagnose", LARGEST_DIAGNOSIS, &DIAGNOSE),
];

static OTHER: CallBounds = call("", SMALL, PLAIN);

/// The bounds of the call with this path: `/package.Service/Method`.
pub fn of_call(path: &str) -> &'static CallBounds {
    let method = path.rsplit('/').next();
    CALLS.iter().find(|call| Some(call.method) == method).unwrap_or(&OTHER)
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

/// Memory of a diagnosis for each row of its data [bytes]: 929 MiB were measured for 40,000 rows of a force log, when
/// all models ran at the same time (2026-11-23).
const DIAGNOSED_ROW: usize = 24 << 10;

/// Refuses data whose diagnosis would take more than `memory` [bytes], which is all memory that a server may use.
/// Nothing reserves this memory, but only one study runs at a time.
///
/// # Errors
/// The data have too many rows.
pub fn check_diagnosis(data: &[u8], memory: usize) -> Result<()> {
    // The reader ends a row at a line feed, at a carriage return, and at both together.
    let alone = data.windows(2).filter(|pair| pair[0] == b'\r' && pair[1] != b'\n').count();
    let (rows, most) = (alone + data.iter().filter(|byte| **byte == b'\n').count(), memory / DIAGNOSED_ROW);
    if rows > most {
        let limit = memory >> 20;
        return Err(Error::Exhausted(format!(
            "data: {rows} rows are more than {most}, which a diagnosis within this server's {limit} MiB may have"
        )));
    }
    Ok(())
}

/// The fields of a message that are inspected or have a maximum length.
pub type MessageLayout = &'static [FieldBounds];

pub struct FieldBounds {
    number: u64,
    name: &'static str,
    /// [bytes]
    longest: usize,
    /// May the field occur more than once?
    repeated: bool,
    /// The layout of its contents, if it is a message.
    inside: Option<MessageLayout>,
}

/// A message whose fields are only counted.
const PLAIN: MessageLayout = &[];

/// Longest options of a session or a reset [bytes]: our choice. A packed robot, the longest option, has up to 224 KiB,
/// and the text of a `sand.toml` some 2 KiB.
pub const LONGEST_OPTIONS: usize = 256 << 10;

/// Largest number of fields of one message: our choice, twice the number of seeds of the largest usual session, if each seed is a
/// field.
const MOST_FIELDS: usize = 1 << 17;

/// Largest number of messages inside one message: our choice, enough for some 1,000 values of options. All options of a task
/// together have some 50.
const MOST_MESSAGES: usize = 4_096;

/// Deepest nesting of messages: our choice, below prost's 100. A list inside a list takes two levels, a table three.
const DEEPEST: usize = 48;

const fn once(number: u64, name: &'static str, longest: usize, inside: Option<MessageLayout>) -> FieldBounds {
    FieldBounds { number, name, longest, repeated: false, inside }
}

const fn any(number: u64, name: &'static str, inside: MessageLayout) -> FieldBounds {
    FieldBounds { number, name, longest: usize::MAX, repeated: true, inside: Some(inside) }
}

static STRUCT: [FieldBounds; 1] = [any(1, "options", &ENTRY)];
static ENTRY: [FieldBounds; 1] = [any(2, "options", &VALUE)];
static VALUE: [FieldBounds; 2] = [any(5, "options", &STRUCT), any(6, "options", &LIST)];
static LIST: [FieldBounds; 1] = [any(1, "options", &VALUE)];

const fn options(number: u64) -> FieldBounds {
    once(number, "options", LONGEST_OPTIONS, Some(&STRUCT))
}

/// An id has 32 characters, so a text of more than 256 bytes is no id. Our choice.
const fn session_id() -> FieldBounds {
    once(1, "session_id", 256, None)
}

static SESSION_ID: [FieldBounds; 1] = [session_id()];

static CREATE_SESSION: [FieldBounds; 2] = [once(1, "task_id", 256, None), options(3)];

static RESET: [FieldBounds; 1] = [options(3)];

static RUN_SESSION: [FieldBounds; 10] = [
    session_id(),
    once(3, "reset", usize::MAX, Some(&RESET)),
    once(4, "step", usize::MAX, Some(PLAIN)),
    once(5, "attach", usize::MAX, Some(PLAIN)),
    once(6, "save", usize::MAX, Some(PLAIN)),
    once(7, "restore", usize::MAX, Some(PLAIN)),
    once(8, "rollout", usize::MAX, Some(PLAIN)),
    // Indices of environments: one byte of a message can become four.
    once(20, "render", 256 << 10, Some(PLAIN)),
    once(21, "observe", usize::MAX, Some(PLAIN)),
    once(30, "policy_rollout", usize::MAX, Some(PLAIN)),
];

/// Largest mesh of a body [bytes]: our choice, 80,000 triangles in binary STL.
const LARGEST_MESH: usize = 4 << 20;

static FILE: [FieldBounds; 1] = [once(2, "mesh", LARGEST_MESH, None)];

/// Largest request of a diagnosis [bytes]: our choice. 40,000 rows of a force log, the most that a diagnosis takes,
/// have about 8 MB; logs of robots may have more rows.
const LARGEST_DIAGNOSIS: usize = 64 << 20;

/// Largest network that is evaluated [bytes].
const LARGEST_POLICY: usize = crate::policy::MOST_BYTES;

/// Largest number of a body's motions in one request: our choice, some ten minutes of computing.
pub const MOST_TRIALS: usize = 1_000_000;

/// Largest request of trials [bytes]: all columns, a mesh and a description of the sand.
const LARGEST_TRIALS: usize = 64 * MOST_TRIALS + LARGEST_MESH + LONGEST_OPTIONS;

/// Largest column of a request of trials [bytes]: a number for each motion.
const COLUMN: usize = 8 * MOST_TRIALS;

static TRIALS: [FieldBounds; 6] = [
    once(1, "shape", 1 << 10, None),
    once(2, "mesh", LARGEST_MESH + (64 << 10), Some(&FILE)),
    once(3, "velocity", 3 * COLUMN, None),
    once(4, "spin", 3 * COLUMN, None),
    once(5, "depth", COLUMN, None),
    once(6, "load", COLUMN, None),
];

static VARIATION: [FieldBounds; 0] = [];

static SWEEP: [FieldBounds; 2] = [any(1, "vary", &VARIATION), any(2, "set", &VARIATION)];

static EVALUATE: [FieldBounds; 1] = [options(4)];

static DIAGNOSE: [FieldBounds; 1] = [once(3, "values", LONGEST_OPTIONS, Some(&STRUCT))];

/// Refuses a message that would unpack to more than `layout` allows.
pub fn check(bytes: &[u8], layout: MessageLayout) -> Result<()> {
    FieldCount::default().message(bytes, layout, 0)
}

/// The counts so far.
#[derive(Default)]
struct FieldCount {
    fields: usize,
    messages: usize,
}

impl FieldCount {
    fn message(&mut self, mut bytes: &[u8], layout: MessageLayout, depth: usize) -> Result<()> {
        let mut seen = 0_u32;
        while !bytes.is_empty() {
            self.fields += 1;
            if self.fields > MOST_FIELDS {
                return Err(Error::invalid("message", format!("more than {MOST_FIELDS} fields")));
            }
            let (number, value) = field(&mut bytes).ok_or_else(unreadable)?;
            let (Some(k), Some(value)) = (layout.iter().position(|f| f.number == number), value) else { continue };
            let FieldBounds { name, longest, repeated, inside, .. } = &layout[k];
            if value.len() > *longest {
                return Err(Error::invalid(*name, format!("{} bytes are more than {longest}", value.len())));
            }
            if !repeated && seen & (1 << k) != 0 {
                return Err(Error::invalid(*name, "given twice"));
            }
            seen |= 1 << k;
            let Some(inside) = inside else { continue };
            self.messages += 1;
            if self.messages > MOST_MESSAGES || depth >= DEEPEST {
                return Err(Error::invalid(*name, "too many values, or nested too deeply"));
            }
            self.message(value, inside, depth + 1)?;
        }
        Ok(())
    }
}

fn unreadable() -> Error {
    Error::invalid("message", "cannot be read: it is no protobuf or is cut off")
}

/// Takes one field off `bytes`: its number, and its value if that has a length. None if this is no valid field.
fn field<'a>(bytes: &mut &'a [u8]) -> Option<(u64, Option<&'a [u8]>)> {
    let key = varint(bytes)?;
    let mut skip = |length: usize| bytes.split_off(..length);
    let value = match key & 7 {
        0 => varint(bytes).map(|_| None)?,
        1 => skip(8).map(|_| None)?,
        2 => {
            let length = usize::try_from(varint(bytes)?).ok()?;
            Some(bytes.split_off(..length)?)
        }
        5 => skip(4).map(|_| None)?,
        // Groups; our messages have none.
        _ => return None,
    };
    Some((key >> 3, value))
}

fn varint(bytes: &mut &[u8]) -> Option<u64> {
    let mut value = 0;
    for shift in (0..64).step_by(7) {
        let byte = *bytes.split_off_first()?;
        value |= u64::from(byte & 0x7f) << shift;
        if byte < 0x80 {
            return Some(value);
        }
    }
    None
}

#[cfg(test)]
mod tests;
