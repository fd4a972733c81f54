//! The log of refusals: at most one line a second of each kind, so that refusals do not fill a disk.

use parking_lot::Mutex;
use std::time::{Duration, Instant};

/// Time between two lines of one kind: our choice, 86,400 lines a day at most.
const PAUSE: Duration = Duration::from_secs(1);

#[derive(Clone, Copy, Debug)]
pub enum Refusal {
    Token,
    Handshake,
    Connection,
    Accept,
    Watcher,
}

const KINDS: [(Refusal, &str); 5] = [
    (Refusal::Token, "a call without this server's token was refused"),
    (Refusal::Handshake, "a TLS handshake failed"),
    (Refusal::Connection, "a connection was closed"),
    // No file descriptors are left.
    (Refusal::Accept, "cannot accept a connection"),
    (Refusal::Watcher, "a watcher was refused: the limit is reached"),
];

/// The lines of one kind.
#[derive(Default)]
struct LogLines {
    last: Option<Instant>,
    suppressed: u64,
}

/// The refusals of one server.
#[derive(Default)]
pub struct Refusals([Mutex<LogLines>; KINDS.len()]);

impl Refusals {
    /// Logs a refusal, unless a line of its kind was written within the last second.
    pub fn log(&self, kind: Refusal, peer: &str, reason: &str) {
        if let Some(suppressed) = self.due(kind, Instant::now(), true) {
            tracing::warn!(peer, reason, suppressed, "{}", KINDS[kind as usize].1);
        }
    }

    /// Logs how many refusals had no line, so that the last refusals of a burst also get a line. Must be called from
    /// time to time.
    pub fn log_suppressed(&self) {
        for (kind, words) in KINDS {
            if let Some(suppressed) = self.due(kind, Instant::now(), false) {
                tracing::warn!(suppressed, "{words}");
            }
        }
    }

    /// If a line may be written now, the number of refusals since the last line. `more`: there is a new refusal.
    fn due(&self, kind: Refusal, now: Instant, more: bool) -> Option<u64> {
        let mut lines = self.0[kind as usize].lock();
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
