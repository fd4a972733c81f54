//! Incoming connections: accepted, encrypted, and passed on after their first bytes.
//!
//! ```text
//!  accept ──▶ a place in the table ──▶ TLS handshake ──▶ first bytes ──▶ HTTP
//!                  │                    └── each connection in a task of its own, within a time ──┘
//!                  └── no room: the connection without a stream for the longest time is closed; if all have
//!                      streams, the new connection is closed
//! ```
//!
//! Accepting does not wait for any peer, so silent peers do not delay others.
//!
//! * [`table`]: the present connections; [`wire`]: a connection's bytes.

pub mod table;
mod wire;

pub use table::{Caps, Table};
pub use wire::{Connection, Greeting, Link};

use super::rate::Rate;
use super::refusals::{Refusal, Refusals};
use super::security::Tls;
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;
use table::{Peer, Place};
use tokio::net::{TcpListener, TcpStream, UnixListener};
use tokio::sync::mpsc;
use tokio::time::{interval, timeout};
use tokio_stream::StreamExt as _;
use tokio_util::sync::CancellationToken;
use tonic::transport::server::TcpIncoming;
use wire::Wire;

/// Time limit of a TLS handshake: our choice, ten times what a slow line needs.
const HANDSHAKE: Duration = Duration::from_secs(5);

/// Time limit for a peer's first bytes: our choice; clients send them at once.
const SILENCE: Duration = Duration::from_secs(10);

/// A TCP peer that is silent for this long gets a keepalive probe, and is dropped if it does not answer for as long
/// again.
pub const KEEPALIVE: Duration = Duration::from_secs(60);

/// Time to wait before accepting again when it failed (no file descriptors left), and the longest wait for closed
/// connections to end.
const PAUSE: Duration = Duration::from_millis(50);

/// Interval at which idle connections are searched.
const LOOK: Duration = Duration::from_secs(1);

/// Accepted connections that wait for HTTP.
const WAITING: usize = 64;

/// File descriptors for other purposes: files of sessions, listeners, the runtime. Our choice.
const RESERVE: usize = 64;

impl Caps {
    /// Limits: `all` connections, `peer` for one peer, at most as many as this process has descriptors besides
    /// `others`. At most a quarter may be without first bytes, our choice, so that they do not displace the rest.
    pub fn new(all: usize, peer: usize, others: usize) -> Self {
        let Rlimit { mut current, maximum } = getrlimit(Resource::Nofile);
        // The soft limit exists for programs that use `select`; this one does not.
        if setrlimit(Resource::Nofile, Rlimit { current: maximum, maximum }).is_ok() {
            current = maximum;
        }
        let descriptors = current.map_or(usize::MAX, |n| usize::try_from(n).unwrap_or(usize::MAX));
        let room = descriptors.saturating_sub(RESERVE + others).max(4);
        if room < all {
            tracing::info!(
                connections = room,
                descriptors,
                "fewer connections than allowed: descriptors are the limit"
            );
        }
        let all = all.min(room);
        Self { all, peer, opening: all.div_ceil(4) }
    }
}

/// Source of connections.
pub enum Socket {
    Tcp(TcpIncoming),
    Unix(UnixListener),
}

impl From<TcpListener> for Socket {
    /// Without nodelay a small call takes 44 ms; `Server::tcp_nodelay` is ignored when we bring the listener.
    fn from(listener: TcpListener) -> Self {
        Self::Tcp(TcpIncoming::from(listener).with_nodelay(Some(true)).with_keepalive(Some(KEEPALIVE)))
    }
}

impl Socket {
    async fn accept(&mut self) -> io::Result<(Wire, Peer, Option<SocketAddr>)> {
        match self {
            Self::Tcp(incoming) => {
                let stream = incoming.next().await.unwrap_or_else(|| Err(io::ErrorKind::NotConnected.into()))?;
                let address = stream.peer_addr()?;
                Ok((Wire::Tcp(stream), Peer::of(address.ip()), Some(address)))
            }
            Self::Unix(listener) => Ok((Wire::Unix(listener.accept().await?.0), Peer::Local, None)),
        }
    }
}

/// Converts what a socket accepts.
#[derive(Clone)]
pub struct Door {
    pub table: Arc<Table>,
    /// Encryption; for TCP only.
    pub tls: Option<Tls>,
    pub greeting: Greeting,
    pub rate: Option<Arc<Rate>>,
    pub refusals: Arc<Refusals>,
}

impl Door {
    /// The connections of `socket` after their first bytes, until `stop` is cancelled.
    pub fn open(self, socket: Socket, stop: CancellationToken) -> mpsc::Receiver<Connection> {
        let (sender, receiver) = mpsc::channel(WAITING);
        tokio::spawn(async move { stop.run_until_cancelled(self.accept(socket, sender, &stop)).await });
        receiver
    }

    async fn accept(&self, mut socket: Socket, sender: mpsc::Sender<Connection>, stop: &CancellationToken) {
        let mut look = interval(LOOK);
        loop {
            // A connection that does not end must not stop the others.
            let _ = timeout(PAUSE, self.table.few_closing()).await;
            let accepted = tokio::select! {
                accepted = socket.accept() => accepted,
                _ = look.tick() => {
                    self.table.close_idle();
                    self.refusals.log_suppressed();
                    continue;
                }
            };
            match accepted {
                Ok((wire, peer, address)) => self.begin(wire, peer, address, &sender, stop),
                Err(error) => {
                    self.refusals.log(Refusal::Accept, "", &error.to_string());
                    tokio::time::sleep(PAUSE).await;
                }
            }
        }
    }

    /// Continues with a connection in a new task.
    fn begin(
        &self,
        wire: Wire,
        peer: Peer,
        address: Option<SocketAddr>,
        sender: &mpsc::Sender<Connection>,
        stop: &CancellationToken,
    ) {
        let name = address.map_or_else(|| "a Unix socket".into(), |a| a.to_string());
        let Some(place) = self.table.admit(peer) else {
            self.refusals.log(Refusal::Connection, &name, "all the others have calls");
            return;
        };
        let link = Link { peer, address, calls: place.calls(), rate: self.rate.clone() };
        let (door, sender, stop, end) = (self.clone(), sender.clone(), stop.clone(), place.end.clone());
        tokio::spawn(async move {
            let opened = tokio::select! {
                opened = door.greet(wire, place, link) => opened,
                () = end.cancelled() => Err((Refusal::Connection, "closed to make room for a later connection".into())),
                () = stop.cancelled() => return,
            };
            match opened {
                // Sending fails only if the server has ended.
                Ok(connection) => drop(sender.send(connection).await),
                Err((kind, reason)) => door.refusals.log(kind, &name, &reason),
            }
        });
    }

    /// Waits until the connection is encrypted, if required, and the peer has sent its first bytes.
    async fn greet(&self, wire: Wire, place: Place, link: Link) -> Result<Connection, (Refusal, String)> {
        let wire = match (wire, &self.tls) {
            (Wire::Tcp(stream), Some(tls)) => Self::encrypt(tls, stream).await.map_err(|e| (Refusal::Handshake, e))?,
            (wire, _) => wire,
        };
        match timeout(SILENCE, Connection::open(wire, place, link, self.greeting)).await {
            Ok(opened) => opened.map_err(|e| (Refusal::Silent, e.to_string())),
            Err(_) => Err((Refusal::Silent, format!("silent for {} s", SILENCE.as_secs()))),
        }
    }

    async fn encrypt(tls: &Tls, stream: TcpStream) -> Result<Wire, String> {
        match timeout(HANDSHAKE, tls.shake_hands(stream)).await {
            Ok(Ok(stream)) => Ok(Wire::Tls(Box::new(stream))),
            Ok(Err(error)) => Err(error.to_string()),
            Err(_) => Err(format!("not done within {} s", HANDSHAKE.as_secs())),
        }
    }
}
