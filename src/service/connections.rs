//! Incoming connections. Each is one task, from the TLS handshake to its end.
//!
//! ```text
//!  accept ──▶ an entry in the table ──▶ TLS handshake ──▶ HTTP/2: calls, or HTTP/1: one request for a page
//!                └── no room: the connection that has been without an admitted call for the longest time is closed;
//!                    if all have admitted calls, the new connection is closed
//! ```
//!
//! Accepting never waits for a peer. Limits for single peers, such as connections a second, are the work of a reverse
//! proxy; `docs/serving.md` has an example.
//!
//! rustls and hyper are called directly, because tonic and `axum::serve` cannot close a chosen connection.

use super::connection_table::{ConnectionHandle, ConnectionTable, OPENING};
use super::platform::{UnixListener, descriptors, limit_silence};
use super::refusals::{Refusal, Refusals};
use super::security::Tls;
use super::sliced::{ReadTurn, SlicedStream};
use axum::Router;
use axum::extract::Request;
use axum::response::Response;
use hyper::body::Incoming;
use hyper::server::conn::{http1, http2};
use hyper::service::service_fn;
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use hyper_util::server::graceful::{GracefulShutdown, Watcher};
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpListener;
use tokio::sync::Semaphore;
use tokio::time::{interval, timeout};
use tokio_util::sync::CancellationToken;
use tower_service::Service as _;

/// A peer that acknowledges no data, or answers no HTTP/2 ping, for this time is dropped. Our choice, because a
/// browser's tab may be inactive for some seconds.
const SILENCE: Duration = Duration::from_secs(60);

/// Time limit for calls to end after the server stops: our choice, because a step takes milliseconds, and the server
/// must end within 5 s.
const GRACE: Duration = Duration::from_secs(3);

/// After a connection could not be accepted because no file descriptors were left, the server waits for this time: our
/// choice. Without it the server would try again at once and keep a processor busy.
const PAUSE: Duration = Duration::from_millis(50);

/// Time between two searches for idle connections: our choice, a tenth of [`OPENING`], the shorter of their limits.
const TICK: Duration = Duration::from_secs(1);

/// Largest number of closed connections that still have their file descriptors. Our choice: a quarter of [`RESERVE`].
const CLOSING: usize = 16;

/// Number of file descriptors for other purposes: files of sessions, listeners, the runtime. Our choice.
const RESERVE: usize = 64;

/// Number of connections, at most `wanted`, for which the limit of file descriptors leaves room besides `others`
/// connections on other listeners. The room is at least 4.
pub fn room(wanted: usize, others: usize) -> usize {
    let descriptors = descriptors();
    let room = descriptors.saturating_sub(RESERVE + others).max(4);
    if room < wanted {
        tracing::info!(connections = room, descriptors, "fewer connections than allowed: descriptors are the limit");
    }
    wanted.min(room)
}

/// A source of connections.
pub enum ListenSocket {
    Tcp(TcpListener),
    Unix(UnixListener),
}

/// The byte stream of a connection.
trait ByteStream: AsyncRead + AsyncWrite + Send + Unpin {}

impl<T: AsyncRead + AsyncWrite + Send + Unpin> ByteStream for T {}

/// An accepted connection, before its TLS handshake.
enum Accepted {
    Tcp(tokio::net::TcpStream, SocketAddr),
    Unix(Box<dyn ByteStream>),
}

impl ListenSocket {
    async fn accept(&self) -> io::Result<Accepted> {
        match self {
            Self::Tcp(listener) => {
                let (stream, address) = listener.accept().await?;
                // Without this a small call takes 44 ms.
                stream.set_nodelay(true)?;
                limit_silence(&stream, SILENCE)?;
                Ok(Accepted::Tcp(stream, address))
            }
            Self::Unix(listener) => Ok(Accepted::Unix(Box::new(listener.accept().await?.0))),
        }
    }
}

/// The protocol of a listener's connections.
#[derive(Clone)]
pub enum Protocol {
    /// Calls.
    Http2 {
        /// Largest number of calls at a time on one connection.
        streams: u32,
        /// The same, for connections that come while there are many strangers.
        few: u32,
        /// Bytes that a client may send on a stream before the server has read them.
        window: u32,
        /// Largest frame [bytes].
        frame: u32,
    },
    /// One request for a page.
    Http1,
}

/// A listener's connections and the routes that they reach.
#[derive(Clone)]
pub struct Connections {
    pub table: Arc<ConnectionTable>,
    pub tls: Option<Tls>,
    pub protocol: Protocol,
    pub routes: Router,
    pub refusals: Arc<Refusals>,
}

impl Connections {
    /// Serves the connections that `socket` accepts until `stop` is cancelled. Then waits until all calls have ended or
    /// [`GRACE`] is over.
    pub async fn serve(self, socket: ListenSocket, stop: CancellationToken) {
        let permits = self.table.most + CLOSING;
        let free = Arc::new(Semaphore::new(permits));
        let (graceful, mut tick) = (GracefulShutdown::new(), interval(TICK));
        let mut permit = None;
        while !stop.is_cancelled() {
            let next = async {
                if permit.is_none() {
                    // The semaphore is never closed.
                    permit = free.clone().acquire_owned().await.ok();
                }
                socket.accept().await
            };
            let accepted = tokio::select! {
                accepted = next => accepted,
                () = stop.cancelled() => break,
                _ = tick.tick() => {
                    self.table.close_idle();
                    self.refusals.log_suppressed();
                    continue;
                }
            };
            match accepted {
                Ok(accepted) => {
                    let peer = if let Accepted::Tcp(_, address) = accepted { Some(address) } else { None };
                    let Some(link) = self.table.admit(peer) else {
                        let name = peer.map_or_else(String::new, |p| p.to_string());
                        self.refusals.log(Refusal::Connection, &name, "all the others have calls");
                        continue;
                    };
                    let (own, watcher, permit, stop) = (self.clone(), graceful.watcher(), permit.take(), stop.clone());
                    tokio::spawn(async move {
                        own.run(accepted, link, watcher, stop).await;
                        drop(permit);
                    });
                }
                Err(error) => {
                    self.refusals.log(Refusal::Accept, "", &error.to_string());
                    tokio::time::sleep(PAUSE).await;
                }
            }
        }
        if timeout(GRACE, graceful.shutdown()).await.is_err() {
            tracing::warn!("connections were cut that did not end in time");
            self.table.close_all();
        }
    }

    async fn run(self, accepted: Accepted, link: ConnectionHandle, watcher: Watcher, stop: CancellationToken) {
        let end = link.end.clone();
        let closed = async {
            let opened = tokio::select! {
                opened = self.open(accepted) => opened,
                () = stop.cancelled() => return,
            };
            match opened {
                Ok(stream) => self.answer(stream, &link, watcher).await,
                Err(reason) => self.refusals.log(Refusal::Handshake, &link.name(), &reason),
            }
        };
        tokio::select! {
            () = closed => {}
            () = end.cancelled() => {}
        }
        if end.is_cancelled() && !stop.is_cancelled() {
            self.refusals.log(Refusal::Connection, &link.name(), "closed: idle, slow, or to make room for another");
        }
    }

    /// The connection's bytes, decrypted.
    async fn open(&self, accepted: Accepted) -> std::result::Result<Box<dyn ByteStream>, String> {
        match (accepted, &self.tls) {
            (Accepted::Tcp(stream, _), Some(tls)) => match timeout(OPENING, tls.shake_hands(stream)).await {
                Ok(Ok(stream)) => Ok(Box::new(stream)),
                Ok(Err(error)) => Err(error.to_string()),
                Err(_) => Err(format!("not done within {} s", OPENING.as_secs())),
            },
            (Accepted::Tcp(stream, _), None) => Ok(Box::new(stream)),
            (Accepted::Unix(stream), _) => Ok(stream),
        }
    }

    async fn answer(&self, stream: Box<dyn ByteStream>, link: &ConnectionHandle, watcher: Watcher) {
        let is_page = matches!(self.protocol, Protocol::Http1);
        let service = service_fn(move |mut request: Request<Incoming>| {
            request.extensions_mut().insert(link.clone());
            let (mut routes, link) = (self.routes.clone(), link.clone());
            async move {
                let answer = routes.call(request).await;
                // Until its request has been read to its end, a connection is idle: it may not hold a place.
                if is_page {
                    let gives_way = |answer: &Response| answer.extensions().get::<GivesWay>().is_some();
                    link.keep(!answer.as_ref().is_ok_and(gives_way));
                }
                answer
            }
        });
        // Errors on a connection concern its peer only.
        match self.protocol {
            Protocol::Http2 { streams, few, window, frame } => {
                let mut builder = http2::Builder::new(TokioExecutor::new());
                builder
                    .timer(TokioTimer::new())
                    .max_concurrent_streams(if link.is_in_crowd { few } else { streams })
                    .initial_stream_window_size(window)
                    .initial_connection_window_size(2 * window)
                    .max_frame_size(frame);
                if link.peer.is_some() {
                    builder.keep_alive_interval(SILENCE).keep_alive_timeout(SILENCE);
                }
                let turn = ReadTurn::default();
                let stream = TokioIo::new(SlicedStream::new(stream, link.clone(), turn.clone()));
                drop(turn.of_each_poll(watcher.watch(builder.serve_connection(stream, service))).await);
            }
            Protocol::Http1 => {
                let mut builder = http1::Builder::new();
                // A connection that waits for another request would only take a place.
                builder.timer(TokioTimer::new()).header_read_timeout(OPENING).keep_alive(false);
                drop(watcher.watch(builder.serve_connection(TokioIo::new(stream), service)).await);
            }
        }
    }
}

/// Marks an answer whose connection is closed if others need its place.
#[derive(Clone, Copy)]
pub struct GivesWay;

/// Largest number of connections to the page of metrics: our choice, for some programs that ask at the same time.
pub const METRICS: usize = 32;

/// Largest number of connections to the live page besides the connections of watchers: our choice, enough for some
/// browsers.
pub const BESIDE_WATCHERS: usize = 128;

/// Answers requests for pages with `routes`, on at most `most` connections, until `stop` is cancelled.
pub async fn pages(
    listener: TcpListener,
    routes: Router,
    most: usize,
    refusals: Arc<Refusals>,
    stop: CancellationToken,
) {
    let connections =
        Connections { table: ConnectionTable::new(most, most), tls: None, protocol: Protocol::Http1, routes, refusals };
    connections.serve(ListenSocket::Tcp(listener), stop).await;
}
