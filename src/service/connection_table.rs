//! The present connections of a listener, and the choice of those that are closed to make room for new ones.

use parking_lot::Mutex;
use std::collections::HashMap;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};
use tokio_util::sync::CancellationToken;

/// Time limit for a TLS handshake, and for a peer's first call: our choice, because clients need only some
/// milliseconds.
pub const OPENING: Duration = Duration::from_secs(10);

/// How long a connection may be without a call, and without an admitted call: our choice, as long as a session's default
/// lease. A program that watches the health connects again after this time.
const IDLE: Duration = Duration::from_secs(300);

/// Largest number of calls at the same time on a connection without an admitted call: our choice, twice the number of
/// services whose health a program may watch.
const STRANGE: usize = 16;

/// While so many connections never had an admitted call, further connections may have few streams: our choice. HTTP/2
/// keeps some kB of each stream, before any of our code sees the call, and no connection can change its number of
/// streams later.
const CROWD: usize = 4;

/// Largest number of calls on a connection that never had an admitted call: our choice, three checks of the health in
/// each second of [`IDLE`]. The answers to so many calls fit into a socket's buffers, so they do not stay in ours.
const STRANGE_TOTAL: usize = 1000;

/// The present connections of one listener.
pub struct ConnectionTable {
    pub most: usize,
    /// Largest number of calls at the same time on all connections without an admitted call.
    strangers: usize,
    entries: Mutex<ConnectionEntries>,
}

#[derive(Default)]
struct ConnectionEntries {
    next: u64,
    all: HashMap<u64, ConnectionEntry>,
}

struct ConnectionEntry {
    /// Number of calls that have not ended, and how many of them were admitted. An admitted call has the token, if a
    /// token is required. Calls for the server's health need no token and do not count as admitted.
    calls: usize,
    admitted: usize,
    /// When the connection was accepted, or when its last call ended.
    since: Instant,
    /// When the connection was accepted, or when its last admitted call ended.
    since_admitted: Instant,
    /// Number of calls that it has begun; None after an admitted one.
    strange: Option<usize>,
    /// Number of its calls that were refused, because it had [`STRANGE`] others.
    refused: usize,
    /// Has the connection begun a call?
    used: bool,
    pub end: CancellationToken,
}

impl ConnectionEntry {
    /// Number of calls at the same time that nobody vouches for.
    fn strangers(&self) -> usize {
        if self.admitted == 0 { self.calls } else { 0 }
    }
}

impl ConnectionTable {
    /// A table of at most `most` connections, with at most `strangers` calls on those without an admitted call.
    pub fn new(most: usize, strangers: usize) -> Arc<Self> {
        Arc::new(Self { most, strangers, entries: Mutex::default() })
    }

    /// Adds a connection. If there is no room, this closes the connection that has been without an admitted call for
    /// the longest time. None if all connections have admitted calls.
    pub fn admit(self: &Arc<Self>, peer: Option<SocketAddr>) -> Option<ConnectionHandle> {
        let mut entries = self.entries.lock();
        if entries.all.len() >= self.most {
            let idle = entries.all.iter().filter(|(_, e)| e.admitted == 0);
            let oldest = *idle.min_by_key(|(id, e)| (e.since, **id))?.0;
            entries.all.remove(&oldest)?.end.cancel();
        }
        let is_in_crowd = entries.all.values().filter(|e| e.strange.is_some()).count() >= CROWD;
        let (id, end) = (entries.next, CancellationToken::new());
        entries.next += 1;
        let (since, strange) = (Instant::now(), Some(0));
        let entry = ConnectionEntry {
            calls: 0,
            admitted: 0,
            since,
            since_admitted: since,
            strange,
            refused: 0,
            used: false,
            end: end.clone(),
        };
        entries.all.insert(id, entry);
        let (table, unread, is_known) = (self.clone(), AtomicUsize::new(0), AtomicBool::new(false));
        Some(ConnectionHandle(Arc::new(ConnectionState { table, id, peer, end, unread, is_in_crowd, is_known })))
    }

    /// Closes connections that have been without a call, or without an admitted call, for too long.
    pub fn close_idle(&self) {
        let idle = |e: &ConnectionEntry| e.calls == 0 && e.since.elapsed() > if e.used { IDLE } else { OPENING };
        let late = |e: &ConnectionEntry| idle(e) || (e.admitted == 0 && e.since_admitted.elapsed() > IDLE);
        self.entries.lock().all.extract_if(|_, e| late(e)).for_each(|(_, e)| e.end.cancel());
    }

    pub fn close_all(&self) {
        self.entries.lock().all.drain().for_each(|(_, e)| e.end.cancel());
    }

    fn change(&self, id: u64, change: impl FnOnce(&mut ConnectionEntry)) {
        if let Some(entry) = self.entries.lock().all.get_mut(&id) {
            change(entry);
        }
    }
}

/// A connection, as its calls see it. It leaves the table when the last copy is dropped.
#[derive(Clone)]
pub struct ConnectionHandle(Arc<ConnectionState>);

pub struct ConnectionState {
    table: Arc<ConnectionTable>,
    id: u64,
    /// None for a Unix socket.
    pub peer: Option<SocketAddr>,
    /// Cancelled when the connection must end.
    pub end: CancellationToken,
    /// Memory of the answers that its client has not read [bytes].
    pub unread: AtomicUsize,
    /// Were there [`CROWD`] strangers when it was accepted?
    pub is_in_crowd: bool,
    /// Has it begun an admitted call?
    is_known: AtomicBool,
}

impl std::ops::Deref for ConnectionHandle {
    type Target = ConnectionState;

    fn deref(&self) -> &ConnectionState {
        &self.0
    }
}

impl Drop for ConnectionState {
    fn drop(&mut self) {
        self.table.entries.lock().all.remove(&self.id);
    }
}

impl ConnectionHandle {
    /// The peer, for logs.
    pub fn name(&self) -> String {
        self.peer.map_or_else(|| "a Unix socket".into(), |a| a.to_string())
    }

    /// Has the connection begun an admitted call?
    pub fn is_known(&self) -> bool {
        self.is_known.load(Ordering::Relaxed)
    }

    /// Counts a call until the returned value is dropped. None: it is one too many on a connection without an admitted
    /// call. If all such connections together have too many, the oldest other one is closed.
    pub fn begin(&self, admitted: bool) -> Option<OpenCall> {
        self.is_known.fetch_or(admitted, Ordering::Relaxed);
        let mut entries = self.table.entries.lock();
        if let Some(entry) = entries.all.get_mut(&self.id) {
            entry.strange = entry.strange.filter(|_| !admitted).map(|n| n + 1);
            if entry.strange.is_some_and(|n| n > STRANGE_TOTAL) {
                entry.end.cancel();
            }
            if !admitted && entry.admitted == 0 && entry.calls >= STRANGE {
                entry.refused += 1;
                // Its streams would take memory of HTTP/2, a thousand of them 1 MB.
                if entry.refused > STRANGE {
                    entry.end.cancel();
                }
                return None;
            }
            entry.calls += 1;
            entry.admitted += usize::from(admitted);
            entry.used = true;
        }
        let strangers: usize = entries.all.values().map(ConnectionEntry::strangers).sum();
        if !admitted && strangers > self.table.strangers {
            let others = entries.all.iter().filter(|(id, e)| **id != self.id && e.strangers() > 0);
            if let Some(oldest) = others.min_by_key(|(id, e)| (e.since_admitted, **id)).map(|(id, _)| *id)
                && let Some(entry) = entries.all.remove(&oldest)
            {
                entry.end.cancel();
            }
        }
        Some(OpenCall { link: self.clone(), admitted })
    }

    /// Number of its admitted calls that have not ended.
    pub fn admitted(&self) -> usize {
        self.table.entries.lock().all.get(&self.id).map_or(0, |entry| entry.admitted)
    }

    /// Counts a call until the connection ends. A call that is not `admitted` makes room for others.
    pub fn keep(&self, admitted: bool) {
        self.table.change(self.id, |e| (e.calls, e.admitted, e.used) = (1, usize::from(admitted), true));
    }

    /// Closes the connection.
    pub fn close(&self) {
        self.end.cancel();
    }
}

/// A call that has not ended.
pub struct OpenCall {
    link: ConnectionHandle,
    admitted: bool,
}

impl Drop for OpenCall {
    fn drop(&mut self) {
        self.link.table.change(self.link.id, |e| {
            e.calls = e.calls.saturating_sub(1);
            e.admitted = e.admitted.saturating_sub(usize::from(self.admitted));
            e.since = Instant::now();
            e.since_admitted = if self.admitted { e.since } else { e.since_admitted };
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn alive(links: &[ConnectionHandle]) -> Vec<usize> {
        (0..links.len()).filter(|k| !links[*k].end.is_cancelled()).collect()
    }

    /// Calls that need no token do not keep a connection open for ever, and do not keep others out.
    #[test]
    fn connections_without_admitted_calls_make_room() {
        let table = ConnectionTable::new(3, 100);
        let mut links: Vec<_> = (0..3).map(|_| table.admit(None).unwrap()).collect();
        let call = links[0].begin(true);
        let _health = links[1].begin(false);
        links.push(table.admit(None).unwrap());
        assert_eq!(alive(&links), [0, 2, 3], "the oldest without an admitted call");
        let _others = [links[2].begin(true), links[3].begin(true)];
        assert!(table.admit(None).is_none(), "all have admitted calls");
        drop(call);
        links.push(table.admit(None).unwrap());
        assert_eq!(alive(&links), [2, 3, 4]);
        drop(links.pop());
        assert_eq!(table.entries.lock().all.len(), 2);
    }

    #[test]
    fn connections_are_closed_that_never_began_a_call_or_ended_it_long_ago() {
        let table = ConnectionTable::new(9, 100);
        let links: Vec<_> = (0..4).map(|_| table.admit(None).unwrap()).collect();
        let age = |k: usize, age| table.change(k as u64, |e| e.since = Instant::now().checked_sub(age).unwrap());
        let second = Duration::from_secs(1);
        let _call = links[0].begin(false);
        drop((links[1].begin(true), links[2].begin(true)));
        [(0, IDLE - second), (1, IDLE - second), (2, IDLE + second), (3, OPENING + second)]
            .into_iter()
            .for_each(|(k, time)| age(k, time));
        table.close_idle();
        assert_eq!(alive(&links), [0, 1]);
    }
    /// Connections without an admitted call have few calls at the same time, alone and together, and an end.
    #[test]
    fn calls_without_a_token_are_few_and_end() {
        let table = ConnectionTable::new(9, 20);
        let links: Vec<_> = (0..3).map(|_| table.admit(None).unwrap()).collect();
        let flood = table.admit(None).unwrap();
        let calls: Vec<_> = (0..2 * STRANGE).filter_map(|_| flood.begin(false)).collect();
        assert!(calls.len() == STRANGE && !flood.end.is_cancelled());
        assert!(flood.begin(false).is_none() && flood.end.is_cancelled(), "it goes on and on");
        drop((calls, flood));
        let watches: Vec<_> = (0..30).filter_map(|_| links[0].begin(false)).collect();
        assert_eq!((watches.len(), alive(&links)), (STRANGE, vec![0, 1, 2]));
        let own = links[1].begin(true);
        let many: Vec<_> = (0..30).filter_map(|_| links[1].begin(false)).collect();
        assert_eq!((many.len(), alive(&links)), (30, vec![0, 1, 2]), "a client with the token may do more");
        let others: Vec<_> = (0..5).filter_map(|_| links[2].begin(false)).collect();
        assert_eq!((others.len(), alive(&links)), (5, vec![1, 2]), "the oldest makes room");
        let age =
            |k: usize| table.change(k as u64, |e| e.since_admitted = Instant::now().checked_sub(2 * IDLE).unwrap());
        (1..3).for_each(age);
        table.close_idle();
        assert_eq!(alive(&links), [1], "a health that is watched keeps no connection open");
        drop(own);
        let again = table.admit(None).unwrap();
        (0..STRANGE_TOTAL).for_each(|_| drop(again.begin(false)));
        assert!(!again.end.is_cancelled());
        drop(again.begin(false));
        assert!(again.end.is_cancelled());
    }
}
