//! An accepted connection after its first bytes, as HTTP reads and writes it.

use super::Peer;
use super::table::{Call, Calls, Place};
use crate::rate::Rate;
use std::io::{self, IoSlice};
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncReadExt as _, AsyncWrite, AsyncWriteExt as _, ReadBuf};
use tokio::net::{TcpStream, UnixStream};
use tokio::time::{Sleep, sleep};
use tokio_rustls::server::TlsStream;
use tokio_util::sync::WaitForCancellationFutureOwned;
use tonic::transport::server::Connected;

/// The transport of the bytes.
pub enum Wire {
    Tcp(TcpStream),
    Tls(Box<TlsStream<TcpStream>>),
    Unix(UnixStream),
}

/// Calls `$call` on whichever stream `$wire` is.
macro_rules! on {
    ($wire:expr, $stream:ident => $call:expr) => {
        match $wire {
            Wire::Tcp($stream) => $call,
            Wire::Tls($stream) => $call,
            Wire::Unix($stream) => $call,
        }
    };
}

impl AsyncRead for Wire {
    fn poll_read(self: Pin<&mut Self>, cx: &mut Context<'_>, into: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        on!(self.get_mut(), stream => Pin::new(stream).poll_read(cx, into))
    }
}

impl AsyncWrite for Wire {
    fn poll_write(self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        on!(self.get_mut(), stream => Pin::new(stream).poll_write(cx, bytes))
    }

    fn poll_write_vectored(
        self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        parts: &[IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        on!(self.get_mut(), stream => Pin::new(stream).poll_write_vectored(cx, parts))
    }

    fn is_write_vectored(&self) -> bool {
        on!(self, stream => stream.is_write_vectored())
    }

    fn poll_flush(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        on!(self.get_mut(), stream => Pin::new(stream).poll_flush(cx))
    }

    fn poll_shutdown(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        on!(self.get_mut(), stream => Pin::new(stream).poll_shutdown(cx))
    }
}

/// The start of HTTP/2 (RFC 9113, section 3.4).
const PREFACE: &[u8; 24] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n";

/// SETTINGS, empty, and GOAWAY with PROTOCOL_ERROR (RFC 9113, sections 6.5 and 6.8). A TLS client reports this as
/// "wrong version number", which is clearer than a reset.
const REFUSAL: &[u8] = b"\0\0\0\x04\0\0\0\0\0\0\0\x08\x07\0\0\0\0\0\0\0\0\0\0\0\0\x01";

/// The first bytes that a peer must send.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Greeting {
    Http2,
    /// Any first bytes, for HTTP/1.
    Any,
}

/// The first bytes of a connection.
#[derive(Default)]
struct First {
    bytes: [u8; PREFACE.len()],
    length: usize,
    /// Number of bytes that were read.
    read: usize,
}

impl First {
    /// Reads until the first bytes are complete.
    async fn read(wire: &mut Wire, greeting: Greeting) -> io::Result<Self> {
        let mut first = Self::default();
        loop {
            match wire.read(&mut first.bytes[first.length..]).await? {
                0 => return Err(io::ErrorKind::UnexpectedEof.into()),
                n => first.length += n,
            }
            let given = &first.bytes[..first.length];
            if greeting == Greeting::Any || given == PREFACE {
                return Ok(first);
            }
            if !PREFACE.starts_with(given) {
                refuse(wire).await?;
                return Err(io::Error::other("it does not speak HTTP/2"));
            }
        }
    }
}

/// Answers a peer with another protocol, and reads its remaining bytes: if the connection were closed at once it
/// would be reset, and the answer lost. The caller limits the time.
async fn refuse(wire: &mut Wire) -> io::Result<()> {
    wire.write_all(REFUSAL).await?;
    wire.shutdown().await?;
    let mut rest = [0; 1024];
    while wire.read(&mut rest).await? > 0 {}
    Ok(())
}

/// A connection in the server's table.
pub struct Connection {
    wire: Wire,
    first: First,
    /// Longest time for which the peer may accept no bytes.
    patience: Option<Duration>,
    stalled: Option<Pin<Box<Sleep>>>,
    end: Pin<Box<WaitForCancellationFutureOwned>>,
    link: Link,
    _place: Place,
}

impl Connection {
    /// Waits for the peer's first bytes.
    pub async fn open(mut wire: Wire, place: Place, link: Link, greeting: Greeting) -> io::Result<Self> {
        let first = First::read(&mut wire, greeting).await?;
        place.opened();
        let patience = (greeting == Greeting::Any).then_some(PATIENCE);
        let end = Box::pin(place.end.clone().cancelled_owned());
        Ok(Self { wire, first, patience, stalled: None, end, link, _place: place })
    }

    pub fn link(&self) -> &Link {
        &self.link
    }

    /// Is the peer too slow, given that a write returned `written`?
    fn check<T>(&mut self, cx: &mut Context<'_>, written: Poll<io::Result<T>>) -> Poll<io::Result<T>> {
        let Some(patience) = self.patience.filter(|_| written.is_pending()) else {
            self.stalled = None;
            return written;
        };
        let stalled = self.stalled.get_or_insert_with(|| Box::pin(sleep(patience)));
        ready!(stalled.as_mut().poll(cx));
        Poll::Ready(Err(io::ErrorKind::TimedOut.into()))
    }
}

/// Longest time for which a watching browser may accept no bytes: our choice; its tab may be inactive for some seconds.
const PATIENCE: Duration = Duration::from_secs(60);

impl AsyncRead for Connection {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, into: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        if self.end.as_mut().poll(cx).is_ready() {
            // The reader sees the same as if the peer had closed the connection.
            return Poll::Ready(Ok(()));
        }
        let First { bytes, length, read } = &mut self.first;
        if read < length {
            let n = into.remaining().min(*length - *read);
            into.put_slice(&bytes[*read..][..n]);
            *read += n;
            return Poll::Ready(Ok(()));
        }
        Pin::new(&mut self.wire).poll_read(cx, into)
    }
}

impl AsyncWrite for Connection {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.wire).poll_write(cx, bytes);
        self.check(cx, written)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        parts: &[IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.wire).poll_write_vectored(cx, parts);
        self.check(cx, written)
    }

    fn is_write_vectored(&self) -> bool {
        self.wire.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        let written = Pin::new(&mut self.wire).poll_flush(cx);
        self.check(cx, written)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.wire).poll_shutdown(cx)
    }
}

impl Connected for Connection {
    type ConnectInfo = Link;

    fn connect_info(&self) -> Link {
        self.link.clone()
    }
}

/// The connection of a call.
#[derive(Clone)]
pub struct Link {
    pub(super) peer: Peer,
    /// None for a Unix socket.
    pub(super) address: Option<SocketAddr>,
    pub(super) calls: Calls,
    pub(super) rate: Option<Arc<Rate>>,
}

impl Link {
    /// For logs.
    pub fn name(&self) -> String {
        self.address.map_or_else(|| "a Unix socket".into(), |a| a.to_string())
    }

    /// Counts a call until the returned value is dropped.
    pub fn begin(&self) -> Call {
        self.calls.begin()
    }

    /// Waits until the peer may make another request.
    pub async fn turn(&self) {
        if let Some(rate) = &self.rate {
            rate.turn(self.peer).await;
        }
    }
}
