//! `--max-requests-per-second`: limits the requests of a peer over all its connections and streams.

use super::connections::table::Peer;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync;
use tokio::time::{Instant, sleep_until};

/// Number of peers that are remembered; further ones are counted together. Our choice: some 500 KiB.
const MOST: usize = 4096;

/// Requests may come this much early, because timers are no finer than a millisecond.
const EARLY: Duration = Duration::from_millis(5);

/// Time at which a peer's next request may be read. Waiting requests take turns; a request that is cancelled does not
/// delay the others.
type Next = Arc<sync::Mutex<Instant>>;

/// Limits the requests of each peer of one server.
pub struct Rate {
    period: Duration,
    peers: Mutex<HashMap<Peer, Next>>,
}

impl Rate {
    pub fn new(per_second: u32) -> Self {
        Self { period: Duration::from_secs(1) / per_second.max(1), peers: Mutex::default() }
    }

    /// Waits until another request of `peer` may be read.
    pub async fn turn(&self, peer: Peer) {
        let next = self.next_of(peer);
        let mut next = next.lock().await;
        if *next > Instant::now() {
            sleep_until(*next).await;
        }
        let earliest = Instant::now().checked_sub(EARLY).unwrap_or(*next);
        *next = earliest.max(*next) + self.period;
    }

    fn next_of(&self, peer: Peer) -> Next {
        let mut peers = self.peers.lock().unwrap_or_else(PoisonError::into_inner);
        if peers.len() >= MOST && !peers.contains_key(&peer) {
            // A peer that may send at once need not be remembered.
            let now = Instant::now();
            peers.retain(|_, next| next.try_lock().map_or(true, |time| *time > now));
        }
        let peer = if peers.len() >= MOST && !peers.contains_key(&peer) { Peer::Others } else { peer };
        peers.entry(peer).or_insert_with(|| Arc::new(sync::Mutex::new(Instant::now()))).clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::Ipv4Addr;

    fn peer(n: u32) -> Peer {
        Peer::of(Ipv4Addr::from_bits(n).into())
    }

    /// Measures the time of `count` requests of one peer.
    async fn time(rate: &Rate, peer: Peer, count: u32) -> Duration {
        let begun = Instant::now();
        for _ in 0..count {
            rate.turn(peer).await;
        }
        begun.elapsed()
    }

    #[tokio::test]
    async fn peers_do_not_wait_for_each_other() {
        let rate = Rate::new(20);
        let (one, other) = tokio::join!(time(&rate, peer(1), 11), time(&rate, peer(2), 6));
        assert!(one >= 9 * rate.period, "{one:?}");
        assert!(other >= 4 * rate.period && other < one, "{other:?} {one:?}");
    }

    #[tokio::test]
    async fn who_leaves_the_line_takes_no_turn() {
        let rate = Rate::new(1);
        rate.turn(peer(1)).await;
        let begun = Instant::now();
        for _ in 0..20 {
            let waiting = tokio::time::timeout(Duration::ZERO, rate.turn(peer(1)));
            assert!(waiting.await.is_err());
        }
        rate.turn(peer(1)).await;
        assert!(begun.elapsed() < 15 * rate.period, "20 who left");
    }

    #[tokio::test]
    async fn the_table_of_peers_is_bounded() {
        let rate = Rate { period: Duration::from_secs(3600), peers: Mutex::default() };
        for n in 0..MOST as u32 {
            // Each peer has made its request and would have to wait for the next.
            rate.turn(peer(n)).await;
        }
        assert!(Arc::ptr_eq(&rate.next_of(peer(u32::MAX)), &rate.next_of(Peer::Others)), "all places are taken");
        assert!(rate.peers.lock().unwrap().len() <= MOST + 1);
        // Peers that may send at once are removed to make room.
        let quick = Rate::new(u32::MAX);
        for n in 0..3 * MOST as u32 {
            quick.turn(peer(n)).await;
            assert!(quick.peers.lock().unwrap().len() <= MOST + 1);
        }
    }
}
