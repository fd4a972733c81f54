//! A session's environments while a request works on them.

use super::names::name;
use super::sessions::{Books, Done, Environments, Sessions};
use crate::error::Error;
use crate::pool::Batch;
use std::sync::Arc;

/// A session's environments, out for one request. Dropping this returns them, unless the pool has lost them or the
/// thread panics; then the session ends, because its clients would otherwise wait for ever.
pub struct Lent {
    pub sessions: Arc<Sessions>,
    pub id: String,
    /// None while the pool has it.
    batch: Option<Batch>,
    /// None after the environments were returned or lost.
    pub books: Option<Books>,
}

impl Lent {
    pub fn new(sessions: Arc<Sessions>, id: String, environments: Environments) -> Self {
        let Environments { batch, books } = environments;
        Self { sessions, id, batch: Some(batch), books: Some(books) }
    }

    /// The session's last request.
    pub fn done(&self) -> Done {
        self.books.as_ref().map_or_else(Done::default, |books| books.done.clone())
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

impl Drop for Lent {
    fn drop(&mut self) {
        if self.is_lost() {
            return self.lose(&broken());
        }
        if let (Some(batch), Some(books)) = (self.batch.take(), self.books.take()) {
            self.sessions.give_back(&self.id, Environments { batch, books });
        }
    }
}

/// The error of a request whose work panicked.
pub fn broken() -> Error {
    Error::Internal("the request failed inside the server, and its session is lost".into())
}
