//! The present connections, and which one is closed to make room.

use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::Notify;
use tokio_util::sync::CancellationToken;

/// How long a connection may be without a stream: our choice, as long as a session's default lease.
const IDLE: Duration = Duration::from_secs(300);

/// How long a connection may take for its first bytes before it can be closed to make room: our choice. Many
/// clients that connect at once on a busy machine need some hundred ms.
const PATIENCE: Duration = Duration::from_secs(1);

/// Closed connections that may still have their file descriptors. Our choice: a quarter of the descriptors that are
/// reserved besides those of connections.
const CLOSING: usize = 16;

/// The origin of a connection, for the limits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Peer {
    /// An IPv4 address, or the first 64 bits of an IPv6 address, because a host with one IPv6 address usually has
    /// all of that network.
    Host(IpAddr),
    /// The other end of a Unix socket.
    Local,
    /// All other peers together, if the table is full.
    Others,
}

impl Peer {
    pub fn of(address: IpAddr) -> Self {
        match address.to_canonical() {
            IpAddr::V6(v6) => Self::Host(IpAddr::V6((v6.to_bits() & !u128::from(u64::MAX)).into())),
            v4 => Self::Host(v4),
        }
    }
}

/// Largest numbers of connections at the same time.
#[derive(Clone, Copy, Debug)]
pub struct Caps {
    /// Connections of all peers together.
    pub all: usize,
    /// Connections of one peer. The owner of a Unix socket may have as many as all peers together.
    pub peer: usize,
    /// Connections whose peers have not sent anything yet. For a second there may be more.
    pub opening: usize,
}

/// The connections of one listener.
pub struct Table {
    caps: Caps,
    entries: Mutex<Entries>,
    /// A closed connection has given back its place.
    ended: Notify,
}

#[derive(Default)]
struct Entries {
    next: u64,
    all: HashMap<u64, Entry>,
    /// Number of connections that are closed but have not given back their places.
    closing: usize,
}

struct Entry {
    peer: Peer,
    opening: bool,
    /// Number of calls that have not ended.
    streams: usize,
    /// Time at which the connection was accepted, sent its first bytes, or ended its last stream, whichever was last.
    since: Instant,
    end: CancellationToken,
}

impl Entry {
    /// May the connection be closed to make room for another one?
    fn is_idle(&self) -> bool {
        self.streams == 0
    }
}

impl Entries {
    fn count(&self, which: impl Fn(&Entry) -> bool) -> usize {
        self.all.values().filter(|e| which(e)).count()
    }

    /// Closes the connection without streams that has waited longest, among those that `which` selects.
    fn close_oldest(&mut self, which: impl Fn(&Entry) -> bool) -> bool {
        let idle = self.all.iter().filter(|(_, e)| e.is_idle() && which(e));
        let Some(id) = idle.min_by_key(|(id, e)| (e.since, **id)).map(|(id, _)| *id) else { return false };
        self.close(id);
        true
    }

    fn close(&mut self, id: u64) {
        if let Some(entry) = self.all.remove(&id) {
            self.closing += 1;
            entry.end.cancel();
        }
    }

    /// The peer with most of the connections that `which` selects.
    fn greediest(&self, which: impl Fn(&Entry) -> bool) -> Option<Peer> {
        let mut counts = HashMap::new();
        self.all.values().filter(|e| which(e)).for_each(|e| *counts.entry(e.peer).or_insert(0) += 1);
        counts.into_iter().max_by_key(|(_, n)| *n).map(|(peer, _)| peer)
    }
}

impl Table {
    pub fn new(caps: Caps) -> Arc<Self> {
        Arc::new(Self { caps, entries: Mutex::default(), ended: Notify::new() })
    }

    /// Every change under this lock is one step, so the data are consistent even after a panic.
    fn lock(&self) -> MutexGuard<'_, Entries> {
        self.entries.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A place for a new connection. If there is no room, the connection that has been without a stream for the longest
    /// time is closed: one of this peer if the peer has too many, otherwise one of the peer with the most. None if all
    /// these connections have streams.
    pub fn admit(self: &Arc<Self>, peer: Peer) -> Option<Place> {
        self.admit_at(peer, Instant::now())
    }

    fn admit_at(self: &Arc<Self>, peer: Peer, since: Instant) -> Option<Place> {
        let (mut entries, caps) = (self.lock(), self.caps);
        if entries.count(|e| e.opening) >= caps.opening {
            let greedy = entries.greediest(|e| e.opening);
            let slow = |e: &Entry| e.opening && since.saturating_duration_since(e.since) >= PATIENCE;
            entries.close_oldest(|e| slow(e) && Some(e.peer) == greedy);
        }
        let crowded = peer != Peer::Local && entries.count(|e| e.peer == peer) >= caps.peer;
        if crowded && !entries.close_oldest(|e| e.peer == peer) {
            return None;
        }
        if entries.all.len() >= caps.all {
            let greedy = entries.greediest(Entry::is_idle);
            if !entries.close_oldest(|e| Some(e.peer) == greedy) {
                return None;
            }
        }
        let (id, end) = (entries.next, CancellationToken::new());
        entries.next += 1;
        entries.all.insert(id, Entry { peer, opening: true, streams: 0, since, end: end.clone() });
        Some(Place { table: self.clone(), id, end })
    }

    /// Closes connections that have been without a stream for too long.
    pub fn close_idle(&self) {
        let mut entries = self.lock();
        let late = |e: &Entry| e.is_idle() && !e.opening && e.since.elapsed() > IDLE;
        let late: Vec<_> = entries.all.iter().filter(|(_, e)| late(e)).map(|(id, _)| *id).collect();
        late.into_iter().for_each(|id| entries.close(id));
    }

    /// Waits until few closed connections still have their descriptors. Without this, a burst of connections would be
    /// accepted faster than the tasks of the closed ones end, and use all descriptors.
    pub async fn few_closing(&self) {
        while self.lock().closing >= CLOSING {
            self.ended.notified().await;
        }
    }

    fn change(&self, id: u64, change: impl FnOnce(&mut Entry)) {
        if let Some(entry) = self.lock().all.get_mut(&id) {
            change(entry);
        }
    }
}

/// A connection's place in the table, given back when this is dropped.
pub struct Place {
    table: Arc<Table>,
    id: u64,
    /// Cancelled when the connection must end.
    pub end: CancellationToken,
}

impl Drop for Place {
    fn drop(&mut self) {
        let mut entries = self.table.lock();
        if entries.all.remove(&self.id).is_none() {
            entries.closing -= 1;
            self.table.ended.notify_one();
        }
    }
}

impl Place {
    /// Marks that the connection has sent its first bytes.
    pub fn opened(&self) {
        self.table.change(self.id, |e| (e.opening, e.since) = (false, Instant::now()));
    }

    /// The counter of this connection's calls.
    pub fn calls(&self) -> Calls {
        Calls { table: self.table.clone(), id: self.id }
    }
}

/// Counts the calls of a connection.
#[derive(Clone)]
pub struct Calls {
    table: Arc<Table>,
    id: u64,
}

impl Calls {
    /// Counts a call until the returned value is dropped.
    pub fn begin(&self) -> Call {
        self.table.change(self.id, |e| e.streams += 1);
        Call(self.clone())
    }
}

/// A call that has not ended.
pub struct Call(Calls);

impl Drop for Call {
    fn drop(&mut self) {
        self.0.table.change(self.0.id, |e| (e.streams, e.since) = (e.streams.saturating_sub(1), Instant::now()));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::{Ipv4Addr, Ipv6Addr};

    fn peer(n: u32) -> Peer {
        Peer::of(Ipv4Addr::from_bits(n).into())
    }

    fn alive(places: &[Place]) -> Vec<usize> {
        (0..places.len()).filter(|k| !places[*k].end.is_cancelled()).collect()
    }

    #[test]
    fn silent_connections_make_room_for_later_ones_the_greediest_peers_first() {
        let table = Table::new(Caps { all: 100, peer: 50, opening: 4 });
        let begun = Instant::now();
        let mut places: Vec<_> = [1, 2, 2, 2, 2].map(|n| table.admit_at(peer(n), begun).unwrap()).into();
        assert_eq!(alive(&places), [0, 1, 2, 3, 4], "those that come at once have a second");
        let later = |s| begun + Duration::from_secs(s);
        places.push(table.admit_at(peer(3), later(1)).unwrap());
        assert_eq!(alive(&places), [0, 2, 3, 4, 5], "the oldest of peer 2, not the oldest of all");
        for place in &places[2..4] {
            place.opened();
        }
        places.push(table.admit_at(peer(2), later(2)).unwrap());
        places.push(table.admit_at(peer(2), later(2)).unwrap());
        assert_eq!(alive(&places), [0, 2, 3, 5, 6, 7], "who has begun to speak takes no such place");
    }

    #[test]
    fn who_has_streams_is_never_closed_for_another() {
        let table = Table::new(Caps { all: 4, peer: 2, opening: 100 });
        let mut places: Vec<_> = [1, 1].map(|n| table.admit(peer(n)).unwrap()).into();
        let busy = places[0].calls().begin();
        places.push(table.admit(peer(1)).unwrap());
        assert_eq!(alive(&places), [0, 2], "the peer's connection without a stream makes room");
        let other = places[2].calls().begin();
        assert!(table.admit(peer(1)).is_none(), "both have streams");
        places.extend([2, 3].map(|n| table.admit(peer(n)).unwrap()));
        let rest: Vec<_> = places[3..].iter().map(|p| p.calls().begin()).collect();
        assert!(table.admit(peer(4)).is_none(), "all have streams");
        drop((busy, other, rest));
        assert!(table.admit(peer(4)).is_some());
        // Dropped at once, so its place is free again.
        drop(places);
        assert_eq!(table.lock().all.len(), 0);
    }

    #[test]
    fn a_socket_of_ones_own_has_no_limit_of_its_own() {
        let table = Table::new(Caps { all: 3, peer: 1, opening: 100 });
        let places: Vec<_> = (0..3).map(|_| table.admit(Peer::Local).unwrap()).collect();
        assert_eq!(alive(&places), [0, 1, 2]);
    }

    #[test]
    fn addresses_of_one_host_are_one_peer() {
        let v6 = |text: &str| Peer::of(text.parse::<Ipv6Addr>().unwrap().into());
        assert_eq!(v6("2001:db8::1"), v6("2001:db8::ffff:0:0:2"));
        assert_ne!(v6("2001:db8::1"), v6("2001:db8:0:1::1"));
        assert_eq!(v6("::ffff:127.0.0.1"), Peer::of(Ipv4Addr::LOCALHOST.into()));
    }
}
