//! The limits of a server, and what sessions have reserved of them.

use super::metrics::Usage;
use crate::error::{Error, Result};
use crate::session::{MOST_ENVIRONMENTS, MOST_MEMORY};
use parking_lot::Mutex;
use std::sync::Arc;
use std::time::Duration;

/// The limits of one server.
#[derive(Clone, Debug)]
pub struct Limits {
    pub sessions: usize,
    /// Largest number of environments in one session.
    pub environments: usize,
    /// Memory of all environments (estimated) and of requests together [bytes]; see [`super::intake`].
    pub memory: usize,
    /// A session without a stream is freed after this time.
    pub lease: Duration,
    /// Largest request [bytes].
    pub request: usize,
    /// Largest number of watchers of the live page.
    pub watchers: usize,
    /// Time in which a client must have read an answer that takes memory for requests, in addition to the answer's
    /// transfer at 1 MiB/s.
    pub stall: Duration,
    /// Largest number of connections at the same time.
    pub connections: u32,
    /// Largest number of calls at the same time on one connection.
    pub streams: u32,
}

impl Limits {
    /// Our choice: this suffices for any training, and takes half of the memory of a 16 GiB machine. A request may be
    /// as large as a step of the largest session, or as a rollout of some minutes. Each session may have a connection
    /// and a call.
    pub const DEFAULT: Self = Self {
        sessions: 1024,
        environments: MOST_ENVIRONMENTS,
        memory: MOST_MEMORY,
        lease: Duration::from_secs(300),
        request: 256 << 20,
        watchers: 64,
        stall: Duration::from_secs(60),
        connections: 1024,
        streams: 1024,
    };
}

impl Default for Limits {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// A session's share of the server's limits; given back when it is dropped.
pub struct Reservation {
    pub(super) usage: Arc<Mutex<Usage>>,
    pub(super) environments: usize,
    pub(super) memory: usize,
    /// The part of `memory` that is for models.
    pub(super) models: usize,
    /// Memory for all sessions [bytes].
    pub(super) most: usize,
}

/// Refuses `field` if it needs more memory than is free.
pub fn fits(field: &str, needed: usize, free: usize) -> Result<()> {
    if needed <= free {
        return Ok(());
    }
    let [needed, free] = [needed, free].map(|bytes| bytes.div_ceil(1 << 20));
    Err(Error::Exhausted(format!("{field}: needs about {needed} MiB, {free} MiB are left to sessions")))
}

impl Reservation {
    /// Reserves `models` bytes for models, in place of the bytes that were reserved for models before.
    pub fn set_models(&mut self, models: usize) -> Result<()> {
        let mut usage = self.usage.lock();
        let others = usage.memory - self.models;
        // A smaller reservation is always possible.
        if models > self.models {
            fits("models", models, self.most.saturating_sub(others))?;
        }
        usage.memory = others + models;
        self.memory = self.memory - self.models + models;
        self.models = models;
        Ok(())
    }

    pub fn models(&self) -> usize {
        self.models
    }
}

impl Drop for Reservation {
    fn drop(&mut self) {
        let mut usage = self.usage.lock();
        usage.sessions -= 1;
        usage.environments -= self.environments;
        usage.memory -= self.memory;
    }
}
