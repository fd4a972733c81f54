//! The watchers of each environment.

use super::frames::{Frames, Latest, ViewedState, ViewerFrame, encode, next_blocks};
use crate::env::AnyTask;
use crate::names::name;
use crate::pool::Batch;
use bytes::Bytes;
use parking_lot::Mutex;
use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};
use tokio::sync::broadcast::Receiver;

/// Least interval between frames of an environment: our choice, 60 a second, the rate of screens.
const PAUSE: Duration = Duration::from_micros(16_600);

/// The interval is also at least this time for each watcher, so that frames are less frequent with many watchers. Our
/// choice: 2,000 frames a second in all, some percent of a processor.
const EACH: Duration = Duration::from_micros(500);

/// All watchers of this server.
pub struct Watchers {
    most: usize,
    /// Number of watchers. Every step reads it; without watchers a step does nothing else here.
    count: AtomicUsize,
    sessions: Mutex<HashMap<String, Vec<WatchedEnvironment>>>,
}

/// An environment that is watched.
struct WatchedEnvironment {
    index: usize,
    watchers: usize,
    /// When the next frame is due.
    next: Instant,
    latest: Latest,
    frames: Frames,
}

/// The registration of a watcher, which ends when this is dropped.
pub struct Watcher {
    watchers: Arc<Watchers>,
    session: String,
    index: usize,
    frames: Receiver<ViewerFrame>,
    /// The last header that was sent.
    head: Bytes,
}

impl Watchers {
    /// At most `most` watchers.
    pub fn new(most: usize) -> Arc<Self> {
        Arc::new(Self { most, count: AtomicUsize::new(0), sessions: Mutex::default() })
    }

    pub fn most(&self) -> usize {
        self.most
    }

    /// Follows environment `index` of the session named `session`; None if there are too many watchers. Needs a
    /// tokio runtime.
    pub fn watch(self: &Arc<Self>, session: &str, index: usize, task: &Arc<dyn AnyTask>) -> Option<Watcher> {
        let mut sessions = self.sessions.lock();
        let count = self.count.load(Ordering::Relaxed);
        if count >= self.most {
            return None;
        }
        let all = sessions.entry(session.into()).or_default();
        let at = all.iter().position(|w| w.index == index).unwrap_or_else(|| {
            let (latest, frames) = encode(task.clone());
            all.push(WatchedEnvironment { index, watchers: 0, next: Instant::now(), latest, frames });
            all.len() - 1
        });
        all[at].watchers += 1;
        let frames = all[at].frames.subscribe();
        self.count.store(count + 1, Ordering::Relaxed);
        drop(sessions);
        Some(Watcher { watchers: self.clone(), session: session.into(), index, frames, head: Bytes::new() })
    }

    /// The server calls this function after each reset or step of session `id`. It reads a counter and, when a frame is due,
    /// copies a state.
    pub fn saw(&self, id: &str, batch: &Batch) {
        let count = self.count.load(Ordering::Relaxed);
        if count == 0 {
            return;
        }
        let pause = PAUSE.max(EACH * u32::try_from(count).unwrap_or(u32::MAX));
        let (session, now) = (name(id), Instant::now());
        let mut sessions = self.sessions.lock();
        for watched in sessions.get_mut(&session).into_iter().flatten().filter(|w| w.next <= now) {
            // An environment before its first reset has no state to show.
            if let Ok(look) = batch.look(watched.index, true) {
                watched.latest.send_replace(Some(Arc::new(ViewedState::of(look))));
                watched.next = now + pause;
            }
        }
    }

    /// Session `id` has ended; ends the streams of its watchers.
    pub fn ended(&self, id: &str) {
        if self.count.load(Ordering::Relaxed) > 0 {
            let gone = self.sessions.lock().remove(&name(id));
            drop(gone);
        }
    }

    fn leave(&self, session: &str, index: usize) {
        let mut sessions = self.sessions.lock();
        self.count.fetch_sub(1, Ordering::Relaxed);
        // The session may have ended.
        let Some(all) = sessions.get_mut(session) else { return };
        all.iter_mut().filter(|w| w.index == index).for_each(|w| w.watchers = w.watchers.saturating_sub(1));
        all.retain(|w| w.watchers > 0);
        if all.is_empty() {
            sessions.remove(session);
        }
    }
}

impl Watcher {
    /// The next blocks; None when the session has ended.
    pub async fn next(&mut self) -> Option<Bytes> {
        next_blocks(&mut self.frames, &mut self.head).await
    }
}

impl Drop for Watcher {
    fn drop(&mut self) {
        self.watchers.leave(&self.session, self.index);
    }
}
