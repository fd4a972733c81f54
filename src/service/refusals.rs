//! The log of refusals, sampled, so that a thousand refusals a second do not fill a disk.

use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Time between two lines of one kind: our choice, 86,400 lines a day at most.
const PAUSE: Duration = Duration::from_secs(1);

/// Kinds of refusals; each is sampled separately.
#[derive(Clone, Copy, Debug)]
pub enum Refusal {
    /// A call without the server's token.
    Token,
    /// A TLS handshake that failed or took too long.
    Handshake,
    /// A connection that did not send the first bytes of its protocol.
    Silent,
    /// A connection beyond the limits, or one that was closed to make room.
    Connection,
    /// The system could not accept a connection: no file descriptors are left.
    Accept,
    /// A watcher beyond the limit.
    Watcher,
}

const KINDS: [Refusal; 6] =
    [Refusal::Token, Refusal::Handshake, Refusal::Silent, Refusal::Connection, Refusal::Accept, Refusal::Watcher];

impl Refusal {
    fn says(self) -> &'static str {
        match self {
            Self::Token => "a call without this server's token was refused",
            Self::Handshake => "a TLS handshake failed",
            Self::Silent => "a connection was closed that sent no first bytes",
            Self::Connection => "a connection was closed: the limit is reached",
            Self::Accept => "cannot accept a connection",
            Self::Watcher => "a watcher was refused: the limit is reached",
        }
    }
}

/// The lines of one kind.
#[derive(Default)]
struct Lines {
    last: Option<Instant>,
    suppressed: u64,
}

/// The refusals of one server.
#[derive(Default)]
pub struct Refusals([Mutex<Lines>; KINDS.len()]);

impl Refusals {
    /// Logs a refusal, unless a line of its kind was written within the last second.
    pub fn log(&self, kind: Refusal, peer: &str, reason: &str) {
        if let Some(suppressed) = self.due(kind, Instant::now(), true) {
            tracing::warn!(peer, reason, suppressed, "{}", kind.says());
        }
    }

    /// Logs how many refusals had no line, so that the last ones of a burst are not lost. Must be called from time
    /// to time.
    pub fn log_suppressed(&self) {
        for kind in KINDS {
            if let Some(suppressed) = self.due(kind, Instant::now(), false) {
                tracing::warn!(suppressed, "{}", kind.says());
            }
        }
    }

    /// If a line may be written now, the number of refusals since the last one. `more` means that there is a new
    /// refusal.
    fn due(&self, kind: Refusal, now: Instant, more: bool) -> Option<u64> {
        let mut lines = self.0[kind as usize].lock().unwrap_or_else(PoisonError::into_inner);
        let early = lines.last.is_some_and(|last| now < last + PAUSE);
        if early || (!more && lines.suppressed == 0) {
            lines.suppressed += u64::from(more);
            return None;
        }
        lines.last = Some(now);
        Some(std::mem::take(&mut lines.suppressed))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_line_a_second_and_none_is_forgotten() {
        let (refusals, begun) = (Refusals::default(), Instant::now());
        let at = |ms, more| refusals.due(Refusal::Token, begun + Duration::from_millis(ms), more);
        assert_eq!(at(0, true), Some(0));
        assert!((1..1000).all(|ms| at(ms, true).is_none()));
        assert_eq!(refusals.due(Refusal::Handshake, begun, true), Some(0), "another kind has its own lines");
        assert_eq!(at(1000, false), Some(999));
        assert_eq!(at(2500, false), None, "nothing is left to tell");
        assert_eq!((at(2500, true), at(3600, true)), (Some(0), Some(0)));
    }
}
