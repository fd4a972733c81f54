//! A session whose environments are on their way through an operation.

use super::names::name;
use super::sessions::{Environments, Sessions};
use crate::error::Error;
use std::sync::Arc;

/// Ends the session if it is dropped before the environments are back: then something panicked and took them along, and
/// without them a session would keep its clients waiting for ever.
pub struct Loan {
    pub sessions: Arc<Sessions>,
    pub id: String,
    /// The environments are back, or the session's end was told.
    settled: bool,
}

impl Loan {
    pub fn new(sessions: Arc<Sessions>, id: String) -> Self {
        Self { sessions, id, settled: false }
    }

    /// The environments are back.
    pub fn give_back(&mut self, environments: Environments) {
        self.settled = true;
        self.sessions.give_back(&self.id, environments);
    }

    /// They will not come back.
    pub fn lose(&mut self, error: &Error) {
        self.settled = true;
        tracing::error!(session = name(&self.id), %error, "a session was lost");
        // It may have been closed meanwhile.
        let _ = self.sessions.close(&self.id);
    }

    /// Did something panic?
    pub fn is_lost(&self) -> bool {
        !self.settled && !self.sessions.stop().is_cancelled()
    }
}

impl Drop for Loan {
    fn drop(&mut self) {
        // At the server's end operations are given up with their environments.
        if self.is_lost() {
            self.lose(&broken());
        }
    }
}

/// What is said of a request whose work panicked.
pub fn broken() -> Error {
    Error::Internal("the request failed inside the server, and its session is lost".into())
}
