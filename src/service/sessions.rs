//! Who holds which environments.
//!
//! ```text
//!  create ──▶ idle ──attach──▶ attached ──stream ends──▶ freed
//!              └──── close, or 30 s without a stream ──────▲
//! ```

use super::status::SESSION;
use crate::env::task::Blueprint;
use crate::error::{Error, Result};
use crate::pool::Batch;
use serde_json::Value;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio_util::sync::CancellationToken;

/// What one server lends out.
#[derive(Clone, Debug)]
pub struct Limits {
    pub sessions: usize,
    /// Environments in one session.
    pub environments: usize,
    /// Estimated memory of all environments together [bytes].
    pub memory: usize,
    /// A session nobody has opened a stream for is freed after this time.
    pub unattached: Duration,
}

impl Default for Limits {
    /// Our choice: room for any training, and half of a 16 GiB machine.
    fn default() -> Self {
        Self { sessions: 1024, environments: 65_536, memory: 8 << 30, unattached: Duration::from_secs(30) }
    }
}

/// What is lent out now.
#[derive(Default)]
struct Usage {
    sessions: usize,
    memory: usize,
}

/// A session's share of the server's limits; given back when it is dropped.
pub struct Reservation {
    usage: Arc<Mutex<Usage>>,
    memory: usize,
}

impl Drop for Reservation {
    fn drop(&mut self) {
        let mut usage = lock(&self.usage);
        usage.sessions -= 1;
        usage.memory -= self.memory;
    }
}

/// The environments of a session, with the share of the limits they take for as long as they exist.
pub struct Environments {
    pub batch: Batch,
    pub reservation: Reservation,
}

/// Frees environments, if any, off the async runtime's threads: it takes a while when they are many.
pub fn release(environments: Option<Environments>) {
    match tokio::runtime::Handle::try_current() {
        Ok(runtime) if environments.is_some() => drop(runtime.spawn_blocking(|| drop(environments))),
        _ => drop(environments),
    }
}

/// One session.
struct Entry {
    /// None while a stream holds them.
    environments: Option<Environments>,
    /// Cancelled when the session is closed or the server stops.
    end: CancellationToken,
}

/// All sessions of a server.
pub struct Sessions {
    limits: Limits,
    usage: Arc<Mutex<Usage>>,
    entries: Mutex<HashMap<String, Entry>>,
    stop: CancellationToken,
}

/// Every change under these locks is one step, so the data are sound even if a holder panicked.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Sessions {
    /// Cancelling `stop` ends every stream after the operation it has in flight.
    pub fn new(limits: Limits, stop: CancellationToken) -> Arc<Self> {
        Arc::new(Self { limits, usage: Arc::default(), entries: Mutex::default(), stop })
    }

    /// Cancelled when the server stops.
    pub fn stop(&self) -> &CancellationToken {
        &self.stop
    }

    /// A new session of `envs` environments, which waits for its stream. Building takes time: not for the async
    /// runtime's threads.
    pub fn create(&self, task: &str, envs: usize, options: Value) -> Result<(String, Blueprint)> {
        if envs == 0 || envs > self.limits.environments {
            let range = format!("{envs} is outside [1, {}]", self.limits.environments);
            let error = if envs == 0 {
                Error::invalid("num_envs", range)
            } else {
                Error::Exhausted(format!("num_envs: {range}"))
            };
            return Err(error);
        }
        let blueprint = Blueprint::new(task, options)?;
        let reservation = self.reserve(envs * blueprint.bytes_per_env())?;
        let environments = Environments { batch: Batch::new(&blueprint, envs)?, reservation };
        tracing::debug!(task, envs, "a session was created");
        // 128 random bits: nobody else can guess it, and it is not logged.
        let id = format!("{:032x}", rand::random::<u128>());
        let entry = Entry { environments: Some(environments), end: self.stop.child_token() };
        lock(&self.entries).insert(id.clone(), entry);
        Ok((id, blueprint))
    }

    fn reserve(&self, memory: usize) -> Result<Reservation> {
        let mut usage = lock(&self.usage);
        if usage.sessions >= self.limits.sessions {
            return Err(Error::Exhausted(format!("all {} sessions of this server are taken", self.limits.sessions)));
        }
        let free = self.limits.memory.saturating_sub(usage.memory);
        if memory > free {
            let [needed, free] = [memory, free].map(|bytes| bytes.div_ceil(1 << 20));
            return Err(Error::Exhausted(format!(
                "num_envs: needs about {needed} MiB, {free} MiB are left to sessions"
            )));
        }
        usage.sessions += 1;
        usage.memory += memory;
        Ok(Reservation { usage: self.usage.clone(), memory })
    }

    /// Hands the session's environments to a stream. When `end` is cancelled the stream shall end.
    pub fn attach(&self, id: &str) -> Result<(Environments, CancellationToken)> {
        let mut entries = lock(&self.entries);
        let entry = entries.get_mut(id).ok_or_else(|| unknown(id))?;
        let taken = || Error::OutOfOrder(format!("{SESSION} {id:?} already has a stream"));
        Ok((entry.environments.take().ok_or_else(taken)?, entry.end.clone()))
    }

    /// Ends a session, whether or not a stream holds it.
    pub fn close(&self, id: &str) -> Result<()> {
        let entry = lock(&self.entries).remove(id).ok_or_else(|| unknown(id))?;
        tracing::debug!("a session was closed");
        entry.end.cancel();
        release(entry.environments);
        Ok(())
    }

    /// Frees the session if no stream has taken it in time.
    pub async fn expire(self: Arc<Self>, id: String) {
        tokio::select! {
            () = tokio::time::sleep(self.limits.unattached) => {}
            () = self.stop.cancelled() => {}
        }
        let mut entries = lock(&self.entries);
        if entries.get(&id).is_some_and(|e| e.environments.is_some()) {
            let entry = entries.remove(&id);
            drop(entries);
            release(entry.and_then(|e| e.environments));
            tracing::debug!("a session expired before it had a stream");
        }
    }
}

/// Ids of other sessions are nobody's business, so none are listed.
fn unknown(id: &str) -> Error {
    Error::unknown(SESSION, id, &["sessions that have not ended"])
}
