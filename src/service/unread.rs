//! The memory of an answer that its client has not read yet.

use super::connection_table::ConnectionHandle;
use super::share::Share;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;
use tokio::task::AbortHandle;

/// Slowest transfer of an answer [bytes/s]: our choice, some 8 Mbit/s. [`super::Limits::stall`] is added to the time that this transfer takes.
const SLOWEST: usize = 1 << 20;

/// An answer's share of the memory for requests. If the client does not read the answer in time, its connection is
/// closed. Dropping this releases the memory.
pub struct UnreadShare {
    _share: Arc<Share>,
    _limit: Option<TimeLimit>,
    /// The size of the answer, and the connection that counts it.
    bytes: usize,
    link: Option<ConnectionHandle>,
}

impl UnreadShare {
    /// `bytes`: size of the answer; `ahead`: of those before it in the queue. `link`: the connection, which only tests
    /// lack.
    pub fn new(share: Arc<Share>, [bytes, ahead]: [usize; 2], stall: Duration, link: Option<ConnectionHandle>) -> Self {
        let time = stall + Duration::from_secs(((bytes + ahead) / SLOWEST) as u64);
        if let Some(link) = &link {
            link.unread.fetch_add(bytes, Ordering::Relaxed);
        }
        let limit = link.clone().map(|link| TimeLimit::new(link, time));
        Self { _share: share, _limit: limit, bytes, link }
    }
}

impl Drop for UnreadShare {
    fn drop(&mut self) {
        if let Some(link) = &self.link {
            link.unread.fetch_sub(self.bytes, Ordering::Relaxed);
        }
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
