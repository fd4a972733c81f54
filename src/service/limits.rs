//! The limits of a server, and what sessions have reserved of them.

use super::metrics::Usage;
use super::price::CALL;
use crate::error::{Error, Result};
use crate::session::{MOST_ENVIRONMENTS, MOST_MEMORY};
use parking_lot::Mutex;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::Semaphore;

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

impl Limits {
    /// Number of admitted calls at the same time: they may take an eighth of the memory.
    pub fn calls(&self) -> usize {
        (self.memory / 8 / CALL).clamp(64, Semaphore::MAX_PERMITS)
    }

    /// Largest HTTP/2 frame that is accepted [bytes]. A frame is held in memory until it is whole, also of peers without
    /// the token, so all connections together may take an eighth of the memory. The least is the least that HTTP/2 allows
    /// (RFC 9113, 6.5.2), which cuts large messages into many frames; the most is our choice.
    pub fn frame(&self) -> u32 {
        (self.memory / 8 / self.connections.max(1) as usize).clamp(16 << 10, 1 << 20) as u32
    }

    /// Number of streams of a connection that comes while there are many strangers. All connections together may then take
    /// a sixteenth of the memory: HTTP/2 keeps some 1 KiB of each stream (measured). The least is our choice, the number of
    /// calls that a stranger may have.
    pub fn few_streams(&self) -> u32 {
        let few = self.memory / 16 / self.connections.max(1) as usize / 1024;
        (few.clamp(16, 1 << 20) as u32).min(self.streams)
    }

    /// Number of calls at the same time on all connections without an admitted call: they may take 1/128 of the memory.
    /// Health is all that they can ask for, so our choice of the most is far above the number of programs that monitor
    /// a server.
    pub fn strangers(&self) -> usize {
        (self.memory / 128 / CALL).clamp(32, 1024)
    }
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
    /// Reserves `memory` bytes for `field` in place of what was reserved before.
    pub fn set(&mut self, field: &str, memory: usize) -> Result<()> {
        let mut usage = self.usage.lock();
        let others = usage.memory - self.memory;
        // A smaller reservation is always possible.
        if memory > self.memory {
            fits(field, memory - self.memory, self.most.saturating_sub(usage.memory))?;
        }
        usage.memory = others + memory;
        self.memory = memory;
        Ok(())
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
