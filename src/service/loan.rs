//! A session whose environments are in an operation.

use super::names::name;
use super::sessions::{Environments, Sessions};
use crate::error::Error;
use std::sync::Arc;

/// Ends the session if it is dropped before the environments are back. This happens in a panic, which destroys the
/// environments; the session's clients would otherwise wait for ever.
pub struct Loan {
    pub sessions: Arc<Sessions>,
    pub id: String,
    /// The environments are back, or the session has been ended.
    settled: bool,
}

impl Loan {
    pub fn new(sessions: Arc<Sessions>, id: String) -> Self {
        Self { sessions, id, settled: false }
    }

    /// Marks that the environments are back.
    pub fn give_back(&mut self, environments: Environments) {
        self.settled = true;
        self.sessions.give_back(&self.id, environments);
    }

    /// Marks that the environments are lost.
    pub fn lose(&mut self, error: &Error) {
        self.settled = true;
        tracing::error!(session = name(&self.id), %error, "a session was lost");
        // The session may have been closed meanwhile.
        let _ = self.sessions.close(&self.id);
    }

    /// Did the operation panic?
    pub fn is_lost(&self) -> bool {
        !self.settled && !self.sessions.stop().is_cancelled()
    }
}

impl Drop for Loan {
    fn drop(&mut self) {
        // When the server ends, operations are dropped with their environments.
        if self.is_lost() {
            self.lose(&broken());
        }
    }
}

/// The error of a request whose work panicked.
pub fn broken() -> Error {
    Error::Internal("the request failed inside the server, and its session is lost".into())
}
