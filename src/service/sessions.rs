//! Sessions and their environments.
//!
//! ```text
//!  create ──▶ idle ◀──stream ends──┬──attach──▶ attached
//!              │                   └── a new stream takes it from the old one
//!              └── close, or a lease's time without a stream ──▶ freed
//! ```
//!
//! Environments are created in turns of some milliseconds, with one turn at a time for each processor. So a client that
//! creates very many environments delays neither clients that create few nor the steps of other clients. If it
//! disconnects, the work ends.
//!
//! The environments are stored here whenever no operation runs on them, so a broken stream loses nothing.

mod guard;

pub use guard::{SessionGuard, broken};

use super::building::{SessionBuilder, SessionEnvironments, failed, release};
use super::limits::{Limits, Reservation, fits};
use super::metrics::{Metrics, Usage};
use super::names::name;
use super::status::SESSION;
use super::viewer::watchers::Watchers;
use crate::env::registry::Blueprint;
use crate::error::{Error, Result};
use crate::parallel::processors;
use crate::pool::{Building, Seal, check_envs};
use parking_lot::Mutex;
use serde_json::Value;
use std::collections::HashMap;
use std::sync::{Arc, OnceLock};
use std::time::Duration;
use tokio::sync::{Notify, Semaphore};
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

/// One session.
struct SessionEntry {
    blueprint: Blueprint,
    envs: usize,
    /// None while an operation has the environments.
    environments: Option<SessionEnvironments>,
    /// Notified when the environments are back.
    back: Arc<Notify>,
    sequence: u64,
    /// Number of the stream that has the session, or of the last stream that had it.
    stream: u64,
    attached: bool,
    /// Time at which the session lost its last stream, by the monotonic clock, which nobody can set.
    idle_since: Instant,
    /// Both are cancelled when the session is closed or the server stops. `stream_end` is also cancelled when another
    /// stream takes the session.
    end: CancellationToken,
    stream_end: CancellationToken,
}

/// A session that no client can reach, because the server has stopped.
pub struct StoppedSession {
    pub id: String,
    pub blueprint: Blueprint,
    pub environments: SessionEnvironments,
}

/// A stream's attachment to a session.
pub struct StreamHold {
    pub id: String,
    /// Number of this attachment in its session.
    pub stream: u64,
    /// When this is cancelled, the stream must end.
    pub end: CancellationToken,
}

/// The public facts about a session.
pub struct SessionSummary {
    pub name: String,
    pub blueprint: Blueprint,
    pub envs: usize,
    pub attached: bool,
    pub sequence: u64,
    pub idle: Duration,
}

/// Called with the id of a session that has ended.
type Forget = Box<dyn Fn(&str) + Send + Sync>;

/// All sessions of a server.
pub struct Sessions {
    limits: Limits,
    usage: Arc<Mutex<Usage>>,
    entries: Mutex<HashMap<String, SessionEntry>>,
    /// Turns for making environments, one for each processor.
    turns: Arc<Semaphore>,
    stop: CancellationToken,
    /// Makes and checks the tags of snapshots.
    pub seal: Seal,
    pub metrics: Arc<Metrics>,
    pub watchers: Arc<Watchers>,
    /// Called with the name of each session that ends, if the server keeps files of sessions.
    pub forget: OnceLock<Forget>,
}

/// See [`Sessions::unanswered`].
pub struct UnansweredSession {
    sessions: Arc<Sessions>,
    hold: StreamHold,
    answered: bool,
}

impl UnansweredSession {
    /// The client gets its answer now.
    pub fn answered(mut self) {
        self.answered = true;
    }
}

impl Drop for UnansweredSession {
    fn drop(&mut self) {
        if self.answered {
            self.sessions.detach(&self.hold);
        } else {
            // It may have ended meanwhile.
            drop(self.sessions.close(&self.hold.id));
        }
    }
}

impl Sessions {
    /// Cancelling `stop` ends every stream after its present operation.
    pub fn new(limits: Limits, seal: Seal, stop: CancellationToken) -> Arc<Self> {
        let watchers = Watchers::new(limits.watchers);
        Arc::new(Self {
            limits,
            usage: Arc::default(),
            entries: Mutex::default(),
            turns: Arc::new(Semaphore::new(processors())),
            stop,
            seal,
            metrics: Arc::default(),
            watchers,
            forget: OnceLock::new(),
        })
    }

    /// This token is cancelled when the server stops.
    pub fn stop(&self) -> &CancellationToken {
        &self.stop
    }

    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    pub fn usage(&self) -> Usage {
        *self.usage.lock()
    }

    /// A new session of `envs` environments, which waits for its stream. If the caller stops waiting, the session is
    /// removed.
    pub async fn create(self: &Arc<Self>, task: String, envs: usize, options: Value) -> Result<(String, Blueprint)> {
        let (sessions, id) = (self.clone(), task.clone());
        let begin = move || {
            let blueprint = Blueprint::new(&id, options)?;
            Ok((sessions.begin(&blueprint, envs)?.go_on()?, blueprint))
        };
        let (mut making, blueprint) = self.turn(begin).await?;
        while making.missing() > 0 {
            making = self.turn(|| making.go_on()).await?;
        }
        // 128 random bits: nobody can guess the id, and it is not logged.
        let id = format!("{:032x}", rand::random::<u128>());
        tracing::info!(session = name(&id), task, envs, "a session was created");
        self.add(id.clone(), blueprint.clone(), making.finish()?)?;
        Ok((id, blueprint))
    }

    /// Runs `part`, which takes some milliseconds, on a blocking thread when its turn has come. Because the turns are
    /// few, a blocking thread is always left for short work.
    pub async fn turn<T: Send + 'static>(&self, part: impl FnOnce() -> Result<T> + Send + 'static) -> Result<T> {
        // The semaphore is never closed, so `acquire` cannot fail. The permit goes with the work, which continues
        // even if no caller waits.
        let turn = self.turns.clone().acquire_owned().await;
        let work = move || {
            let _turn = turn;
            part()
        };
        tokio::task::spawn_blocking(work).await.unwrap_or_else(|_| Err(failed()))
    }

    /// Creates environments now, and reserves their share of the limits. This takes long, so the async runtime's
    /// threads must not call it.
    pub fn build(&self, blueprint: &Blueprint, envs: usize) -> Result<SessionEnvironments> {
        self.begin(blueprint, envs)?.finish()
    }

    /// Reserves the share of the limits for environments that are not created yet.
    fn begin(&self, blueprint: &Blueprint, envs: usize) -> Result<SessionBuilder> {
        check_envs(envs, self.limits.environments)?;
        let reservation = self.reserve(envs, blueprint)?;
        Ok(SessionBuilder(Some((Building::new(blueprint, envs)?, reservation))))
    }

    /// Makes a session available to clients.
    pub fn add(&self, id: String, blueprint: Blueprint, environments: SessionEnvironments) -> Result<()> {
        let end = self.stop.child_token();
        let entry = SessionEntry {
            blueprint,
            envs: environments.batch.envs(),
            sequence: environments.books.done.sequence,
            environments: Some(environments),
            back: Arc::default(),
            stream: 0,
            attached: false,
            idle_since: Instant::now(),
            stream_end: end.child_token(),
            end,
        };
        let mut entries = self.entries.lock();
        if self.stop.is_cancelled() {
            return Err(Error::Cancelled("the server is shutting down".into()));
        }
        let same = name(&id);
        if entries.keys().any(|other| name(other) == same) {
            // Another session has this name with a probability of one in four thousand million. Names in logs, lists
            // and files must be unique.
            return Err(Error::Exhausted("the session's name is taken; try again".into()));
        }
        entries.insert(id, entry);
        Ok(())
    }

    fn reserve(&self, environments: usize, blueprint: &Blueprint) -> Result<Reservation> {
        let memory = blueprint.bytes(environments);
        let mut usage = self.usage.lock();
        if usage.sessions >= self.limits.sessions {
            return Err(Error::Exhausted(format!("all {} sessions of this server are taken", self.limits.sessions)));
        }
        let most = self.limits.of_environments();
        fits("num_envs", memory, most.saturating_sub(usage.memory))?;
        usage.sessions += 1;
        usage.environments += environments;
        usage.memory += memory;
        Ok(Reservation { usage: self.usage.clone(), environments, memory, most })
    }

    /// Attaches a new stream to the session, in place of its present one.
    pub fn attach(&self, id: &str) -> Result<StreamHold> {
        self.hold(id, true)
    }

    /// Attaches a new stream to the session if it has none.
    pub fn attach_free(&self, id: &str) -> Result<StreamHold> {
        self.hold(id, false)
    }

    fn hold(&self, id: &str, take: bool) -> Result<StreamHold> {
        let mut entries = self.entries.lock();
        let entry = entries.get_mut(id).ok_or_else(|| unknown(id))?;
        if entry.attached && !take {
            return Err(Error::OutOfOrder("another connection has it".into()));
        }
        entry.stream_end.cancel();
        entry.stream_end = entry.end.child_token();
        entry.stream += 1;
        entry.attached = true;
        Ok(StreamHold { id: id.into(), stream: entry.stream, end: entry.stream_end.clone() })
    }

    /// Holds a session whose client does not know its id yet. Its lease begins with the answer, which may have to wait for
    /// memory; if there is no answer, the session ends.
    pub fn unanswered(self: &Arc<Self>, id: &str) -> Result<UnansweredSession> {
        Ok(UnansweredSession { sessions: self.clone(), hold: self.attach(id)?, answered: false })
    }

    /// Has another stream taken this session?
    pub fn was_taken(&self, hold: &StreamHold) -> bool {
        self.entries.lock().get(&hold.id).is_some_and(|e| e.stream != hold.stream)
    }

    /// Detaches a stream: its work ends, and the lease begins, unless another stream has the session.
    pub fn detach(&self, hold: &StreamHold) {
        hold.end.cancel();
        if let Some(entry) = self.entries.lock().get_mut(&hold.id).filter(|e| e.stream == hold.stream) {
            (entry.attached, entry.idle_since) = (false, Instant::now());
        }
    }

    /// Waits until no operation runs on the session's environments, and takes them. None if the session or the server
    /// has ended, or if another stream has the session.
    pub async fn take(self: &Arc<Self>, hold: &StreamHold) -> Option<SessionGuard> {
        loop {
            // Registers for the notification before the check, so that environments that come back between the check
            // and the wait are not missed.
            let back = {
                let mut entries = self.entries.lock();
                let running = |e: &&mut SessionEntry| e.stream == hold.stream && !self.stop.is_cancelled();
                let entry = entries.get_mut(&hold.id).filter(running)?;
                if let Some(environments) = entry.environments.take() {
                    return Some(SessionGuard::new(self.clone(), hold.id.clone(), environments));
                }
                entry.back.clone().notified_owned()
            };
            tokio::select! {
                () = back => {}
                () = hold.end.cancelled() => return None,
            }
        }
    }

    /// Returns environments after an operation; frees them if the session was closed meanwhile.
    pub fn give_back(&self, id: &str, environments: SessionEnvironments) {
        let mut entries = self.entries.lock();
        let Some(entry) = entries.get_mut(id) else {
            drop(entries);
            return release(Some(environments));
        };
        entry.sequence = environments.books.done.sequence;
        entry.environments = Some(environments);
        // All waiting streams are notified, because one of them may have lost the session meanwhile and would
        // ignore the notification.
        entry.back.notify_waiters();
    }

    /// Ends a session, with or without a stream.
    pub fn close(&self, id: &str) -> Result<()> {
        let entry = self.entries.lock().remove(id).ok_or_else(|| unknown(id))?;
        tracing::info!(session = name(id), "a session was closed");
        entry.end.cancel();
        self.ended(id);
        release(entry.environments);
        Ok(())
    }

    /// A session has ended, so nobody watches it, and it is not restored.
    fn ended(&self, id: &str) {
        self.watchers.ended(id);
        if let Some(forget) = self.forget.get() {
            forget(&name(id));
        }
    }

    /// Ends a session that no stream has.
    pub fn close_free(&self, id: &str) -> Result<()> {
        if self.entries.lock().get(id).is_some_and(|e| e.attached) {
            return Err(Error::OutOfOrder("another connection has it".into()));
        }
        self.close(id)
    }

    /// Removes the sessions on which no operation runs. The server has stopped, so no operation begins any more.
    pub fn idle(&self) -> Vec<StoppedSession> {
        let idle = |(id, e): (String, SessionEntry)| {
            Some(StoppedSession { id, blueprint: e.blueprint, environments: e.environments? })
        };
        self.entries.lock().extract_if(|_, e| e.environments.is_some()).filter_map(idle).collect()
    }

    pub fn describe(&self, id: &str) -> Result<SessionSummary> {
        self.entries.lock().get(id).map(|e| e.summary(id)).ok_or_else(|| unknown(id))
    }

    /// The session with this name in logs and lists.
    pub fn named(&self, session: &str) -> Option<SessionSummary> {
        self.entries.lock().iter().find(|(id, _)| name(id) == session).map(|(id, entry)| entry.summary(id))
    }

    pub fn list(&self) -> Vec<SessionSummary> {
        let mut all: Vec<_> = self.entries.lock().iter().map(|(id, entry)| entry.summary(id)).collect();
        all.sort_by(|a, b| a.name.cmp(&b.name));
        all
    }

    /// Frees sessions whose lease has run out, until the server stops.
    pub async fn expire(self: Arc<Self>) {
        let pause = (self.limits.lease / 10).clamp(Duration::from_millis(5), Duration::from_secs(5));
        while self.stop.run_until_cancelled(tokio::time::sleep(pause)).await.is_some() {
            let late = |e: &SessionEntry| {
                !e.attached && e.environments.is_some() && e.idle_since.elapsed() > self.limits.lease
            };
            let late: Vec<_> = self.entries.lock().extract_if(|_, entry| late(entry)).collect();
            for (id, entry) in late {
                tracing::info!(session = name(&id), "a session's lease has run out");
                self.ended(&id);
                release(entry.environments);
            }
        }
    }
}

impl SessionEntry {
    fn summary(&self, id: &str) -> SessionSummary {
        SessionSummary {
            name: name(id),
            blueprint: self.blueprint.clone(),
            envs: self.envs,
            attached: self.attached,
            sequence: self.sequence,
            idle: if self.attached { Duration::ZERO } else { self.idle_since.elapsed() },
        }
    }
}

/// The error does not list other ids, because they are secret.
fn unknown(id: &str) -> Error {
    Error::unknown(SESSION, id, &["sessions that have not ended"])
}

#[cfg(test)]
mod tests;
