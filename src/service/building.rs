//! Environments of a session, and how they are made in turns.

use super::limits::Reservation;
use super::proto::RunSessionResponse;
use crate::error::{Error, Result};
use crate::pool::{Batch, Building};
use std::time::Duration;

/// The environments of a session.
pub struct SessionEnvironments {
    pub batch: Batch,
    pub books: SessionRecord,
}

/// What a session keeps besides its environments: its last answer, and its reservation of memory.
pub struct SessionRecord {
    pub done: LastAnswer,
    pub reservation: Reservation,
}

/// The state of a session's requests.
#[derive(Clone, Default)]
pub struct LastAnswer {
    /// Number of the last request that was answered.
    pub sequence: u64,
    /// The answer to this request. None if the request changed nothing, because such a request can be repeated.
    pub answer: Option<RunSessionResponse>,
}

/// Frees environments, if there are any, on a blocking thread of the async runtime, because many of them take a while.
pub fn release<T: Send + 'static>(environments: Option<T>) {
    match tokio::runtime::Handle::try_current() {
        Ok(runtime) if environments.is_some() => drop(runtime.spawn_blocking(|| drop(environments))),
        _ => drop(environments),
    }
}

/// A session under construction; None once it is finished.
pub struct SessionBuilder(pub Option<(Building, Reservation)>);

impl Drop for SessionBuilder {
    fn drop(&mut self) {
        release(self.0.take());
    }
}

impl SessionBuilder {
    /// Makes environments for one turn.
    pub fn go_on(mut self) -> Result<Self> {
        self.0.as_mut().map_or(Ok(()), |(building, _)| building.go_on(TURN))?;
        Ok(self)
    }

    pub fn missing(&self) -> usize {
        self.0.as_ref().map_or(0, |(building, _)| building.missing())
    }

    /// Makes the remaining environments now; returns all of them.
    pub fn finish(mut self) -> Result<SessionEnvironments> {
        let (building, reservation) = self.0.take().ok_or_else(failed)?;
        Ok(SessionEnvironments {
            batch: building.finish()?,
            books: SessionRecord { done: LastAnswer::default(), reservation },
        })
    }
}

/// The error after a panic.
pub fn failed() -> Error {
    Error::Internal("the request failed inside the server".into())
}

/// Length of one turn of making environments. Our choice: short for clients that wait, and much longer than a change of
/// threads takes (some 50 µs).
pub const TURN: Duration = Duration::from_millis(10);
