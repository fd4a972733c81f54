//! The bytes of a connection come in slices, and other tasks run between two of them.

use super::connection_table::ConnectionHandle;
use std::future::poll_fn;
use std::io;
use std::pin::{Pin, pin};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::{Context, Poll, ready};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

/// Largest number of bytes that are read at once from a connection without an admitted call: our choice, some 16 heads of
/// calls, as many as such a connection may have at the same time.
const STRANGE_SLICE: usize = 2048;

/// The same for other connections: our choice, some hundred small calls, which take 20 ms.
const SLICE: usize = 8192;

/// A stream of bytes that lets other tasks run after each full slice. Without this, HTTP/2 takes up a thousand calls before
/// our code sees the first one: of a stranger, whose connection is then closed, they take 19 ms of processor time instead of
/// 2, and steps of other clients wait for a thousand short calls of a client with the token.
pub struct SlicedStream<S> {
    stream: S,
    link: ConnectionHandle,
    turn: ReadTurn,
}

/// The right to read one slice, which a connection gets each time that its task runs. HTTP/2 tries to read more than once
/// before it lets other tasks run.
#[derive(Clone, Default)]
pub struct ReadTurn(Arc<AtomicBool>);

impl ReadTurn {
    /// Gives `connection` a turn each time that it is polled.
    pub async fn of_each_poll<F: Future>(self, connection: F) -> F::Output {
        let mut connection = pin!(connection);
        poll_fn(|context| {
            self.0.store(true, Ordering::Relaxed);
            connection.as_mut().poll(context)
        })
        .await
    }
}

impl<S> SlicedStream<S> {
    pub fn new(stream: S, link: ConnectionHandle, turn: ReadTurn) -> Self {
        Self { stream, link, turn }
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for SlicedStream<S> {
    fn poll_read(mut self: Pin<&mut Self>, context: &mut Context<'_>, into: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        if !self.turn.0.load(Ordering::Relaxed) {
            context.waker().wake_by_ref();
            return Poll::Pending;
        }
        let most = if self.link.is_known() { SLICE } else { STRANGE_SLICE };
        let length = most.min(into.remaining());
        let mut slice = ReadBuf::new(into.initialize_unfilled_to(length));
        ready!(Pin::new(&mut self.stream).poll_read(context, &mut slice))?;
        let read = slice.filled().len();
        into.advance(read);
        self.turn.0.store(read < length, Ordering::Relaxed);
        Poll::Ready(Ok(()))
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for SlicedStream<S> {
    fn poll_write(mut self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.stream).poll_write(context, bytes)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.stream).poll_write_vectored(context, bytes)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }
}
