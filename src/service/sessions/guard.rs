//! A session's environments while a request works on them.
//!
//! When the guard is dropped, the environments go back to the session. If a panic has destroyed them, the request gets INTERNAL
//! and the session ends.

use super::Sessions;
use crate::building::{LastAnswer, SessionEnvironments, SessionRecord};
use crate::error::{Error, Result};
use crate::names::name;
use crate::pool::Batch;
use std::sync::Arc;

/// A session's environments, taken out for one request. Dropping this returns them, unless the pool has lost them or
/// the thread panics; then the session ends, because its clients would otherwise wait for ever.
pub struct SessionGuard {
    pub sessions: Arc<Sessions>,
    pub id: String,
    /// None while the pool has it.
    batch: Option<Batch>,
    /// None after the environments were returned or lost.
    pub books: Option<SessionRecord>,
}

impl SessionGuard {
    pub fn new(sessions: Arc<Sessions>, id: String, environments: SessionEnvironments) -> Self {
        let SessionEnvironments { batch, books } = environments;
        Self { sessions, id, batch: Some(batch), books: Some(books) }
    }

    /// The session's last request.
    pub fn done(&self) -> Option<&LastAnswer> {
        self.books.as_ref().map(|books| &books.done)
    }

    /// # Panics
    /// While the pool has the batch.
    pub fn batch(&mut self) -> &mut Batch {
        self.batch.as_mut().expect("who takes the batch puts it back")
    }

    /// Takes the batch for the pool; [`Self::put`] must follow.
    ///
    /// # Panics
    /// If the pool has it already.
    pub fn take(&mut self) -> Batch {
        self.batch.take().expect("who takes the batch puts it back")
    }

    pub fn put(&mut self, batch: Batch) {
        self.batch = Some(batch);
    }

    /// Reserves `bytes` for the environments while an operation changes their tasks. `field`: what the user gave, for the
    /// refusal.
    pub fn reserve(&mut self, field: &str, bytes: usize) -> Result<()> {
        match &mut self.books {
            // Before the operation the environments still have what is reserved now.
            Some(books) => books.reservation.set(field, bytes.max(books.reservation.memory)),
            None => Ok(()),
        }
    }

    /// Reserves what the environments take after [`Self::reserve`] and the operation.
    pub fn release(&mut self) {
        if let (Some(books), Some(batch)) = (&mut self.books, &self.batch) {
            // This is not more than was reserved, so it is always possible.
            let _ = books.reservation.set("options", batch.bytes());
        }
    }

    /// Ends the session, because the environments are lost.
    pub fn lose(&mut self, error: &Error) {
        (self.batch, self.books) = (None, None);
        tracing::error!(session = name(&self.id), %error, "a session was lost");
        // The session may have been closed meanwhile.
        let _ = self.sessions.close(&self.id);
    }

    /// Did a panic destroy the environments? When the server ends, the pool drops them, too.
    pub fn is_lost(&self) -> bool {
        let destroyed = self.batch.is_none() || std::thread::panicking();
        self.books.is_some() && destroyed && !self.sessions.stop().is_cancelled()
    }
}

impl Drop for SessionGuard {
    fn drop(&mut self) {
        if self.is_lost() {
            return self.lose(&broken());
        }
        if let (Some(mut batch), Some(books)) = (self.batch.take(), self.books.take()) {
            batch.set_account(None);
            batch.set_stop(None);
            self.sessions.give_back(&self.id, SessionEnvironments { batch, books });
        }
    }
}

/// The error of a request whose work panicked.
pub fn broken() -> Error {
    Error::Internal("the request failed inside the server, and its session is lost".into())
}
