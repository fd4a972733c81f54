//! Who looks at which environment.

use crate::pool::Batch;
use crate::service::sessions::name;
use crate::service::view;
use crate::view::recording::{head_block, rows_block};
use bytes::Bytes;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::mpsc;

/// Blocks that wait for a browser that reads slowly; what does not fit is left out.
const WAITING: usize = 64;

/// A browser gets moments at least this far apart: our choice, four a control step of the tasks. An environment that is
/// trained steps faster than anyone can see.
const PAUSE: Duration = Duration::from_millis(5);

/// Everyone who looks at this server.
#[derive(Default)]
pub struct Watchers {
    /// How many: read at every step, so that a server which nobody looks at does no more than this.
    count: AtomicUsize,
    all: Mutex<Vec<Watched>>,
}

/// What one of them looks at.
struct Watched {
    session: String,
    index: usize,
    /// Header of what was sent last.
    header: String,
    next: Instant,
    sender: mpsc::Sender<Bytes>,
}

/// One who looks, until this is dropped.
pub struct Watcher {
    watchers: Arc<Watchers>,
    receiver: mpsc::Receiver<Bytes>,
}

impl Watchers {
    /// Sound even if a holder panicked: every change is a single push or retain.
    fn lock(&self) -> MutexGuard<'_, Vec<Watched>> {
        self.all.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Follows environment `index` of the session that is called `session`.
    pub fn watch(self: &Arc<Self>, session: &str, index: usize) -> Watcher {
        let (sender, receiver) = mpsc::channel(WAITING);
        let (session, header, next) = (session.to_owned(), String::new(), Instant::now());
        let mut all = self.lock();
        all.push(Watched { session, index, header, next, sender });
        self.count.store(all.len(), Ordering::Relaxed);
        drop(all);
        Watcher { watchers: self.clone(), receiver }
    }

    /// The session `id` has just been reset or stepped.
    pub fn saw(&self, id: &str, batch: &Batch) {
        if self.count.load(Ordering::Relaxed) == 0 {
            return;
        }
        let (session, now) = (name(id), Instant::now());
        for watched in self.lock().iter_mut().filter(|w| w.session == session && w.next <= now) {
            watched.tell(batch);
            watched.next = now + PAUSE;
        }
    }
}

impl Watched {
    /// Sends the moment, after a header if that has changed; what the browser has no room for is left out.
    fn tell(&mut self, batch: &Batch) {
        // An environment that was not reset yet has nothing to show.
        let Ok(look) = batch.look(self.index, true) else { return };
        let header = view::header(&look);
        let mut block = rows_block(&view::row(&look));
        if header != self.header {
            block = [head_block(&header), block].concat();
        }
        if self.sender.try_send(block.into()).is_ok() {
            self.header = header;
        }
    }
}

impl Watcher {
    /// The next block.
    pub async fn next(&mut self) -> Option<Bytes> {
        self.receiver.recv().await
    }
}

impl Drop for Watcher {
    fn drop(&mut self) {
        self.receiver.close();
        let mut all = self.watchers.lock();
        all.retain(|w| !w.sender.is_closed());
        self.watchers.count.store(all.len(), Ordering::Relaxed);
    }
}
