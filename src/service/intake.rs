//! Limits the memory of requests before they are read.
//!
//! ```text
//!  call ──▶ length of the next message ──▶ too large: refused ──▶ large: waits for its share ──▶ read ──▶ Frame
//! ```
//!
//! Small messages pass. Large messages of all calls together may take [`Intake::room`]. While one waits, HTTP/2's
//! flow control stops its sender. A request holds its [`Share`] until it has released its memory.

use super::sessions::Limits;
use super::wire::{LARGEST_DIAGNOSIS, LARGEST_POLICY, LARGEST_TRIALS, LONGEST_OPTIONS};
use crate::error::{Error, Result};
use axum::body::{Body, BodyDataStream};
use axum::extract::{Request, State};
use axum::middleware::Next;
use axum::response::Response;
use bytes::{Bytes, BytesMut};
use futures_util::{StreamExt as _, stream};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::{Instant, timeout, timeout_at};
use tonic::Status;

/// Messages of at most this size [bytes] need no share.
const SMALL: usize = 16 << 10;

/// Unit of shares [bytes].
const UNIT: usize = 1 << 10;

/// Longest wait of a request for its share: our choice, longer than the largest step and shorter than the time limits
/// of clients.
const WAIT: Duration = Duration::from_secs(30);

/// Time limit for the arrival of a large message, in addition to its transfer at 1 MiB/s. Our choice, because a slow or
/// busy client may pause for some seconds.
const ARRIVAL: Duration = Duration::from_secs(10);

/// Memory of a message with its unpacked parts, as a multiple of the message's size: actions are copied once.
const COPIES: usize = 2;

/// Bytes before a message: a flag and its length.
const HEADER: usize = 5;

type BoxError = Box<dyn std::error::Error + Send + Sync>;

/// The memory of a server's requests.
pub struct Intake {
    shares: Arc<Semaphore>,
    /// [bytes]
    room: usize,
    /// Largest message [bytes].
    largest: usize,
}

/// Part of the memory for requests; given back when it is dropped.
pub struct Share(#[expect(dead_code, reason = "held for its end")] OwnedSemaphorePermit);

impl Limits {
    /// Memory for requests: a quarter of all, but no more than the largest request needs.
    pub fn of_requests(&self) -> usize {
        (self.memory / 4).min(COPIES * self.request)
    }

    /// Memory for environments.
    pub fn of_environments(&self) -> usize {
        self.memory - self.of_requests()
    }
}

impl Intake {
    pub fn new(limits: &Limits) -> Arc<Self> {
        // Below some size no request would be possible: our choice, twice the longest options.
        let room = limits.of_requests().max(COPIES * 2 * LONGEST_OPTIONS);
        let shares = Arc::new(Semaphore::new(room / UNIT));
        Arc::new(Self { shares, room, largest: limits.request.min(room / COPIES) })
    }

    /// Bytes that a client may send on a stream before the server has read them; twice that on a connection. Our
    /// choice: enough for a step of the largest usual batch, limited so that 32 connections stay within the memory for
    /// requests.
    pub fn window(&self) -> u32 {
        (self.room / 64).clamp(64 << 10, 4 << 20) as u32
    }

    /// Largest message of the call `path` [bytes].
    fn limit(&self, path: &str) -> usize {
        let limit = match path.rsplit('/').next() {
            Some("RunSession") => self.largest,
            Some("CreateSession" | "Process") => LONGEST_OPTIONS + SMALL,
            // A robot and sand as files.
            Some("Intrude" | "Walk" | "Sweep") => LONGEST_OPTIONS + SMALL,
            Some("Evaluate") => LARGEST_POLICY + LONGEST_OPTIONS + SMALL,
            Some("Trials") => LARGEST_TRIALS,
            Some("Diagnose") => LARGEST_DIAGNOSIS,
            _ => SMALL,
        };
        limit.min(self.largest)
    }

    /// Waits for memory for a request's results.
    pub async fn share(&self, bytes: usize) -> Result<Share> {
        if bytes > self.room {
            let [needed, room] = [bytes, self.room].map(|b| b.div_ceil(1 << 20));
            return Err(Error::Exhausted(format!("needs about {needed} MiB, requests may take {room} MiB")));
        }
        let units = bytes.div_ceil(UNIT).min(self.room / UNIT) as u32;
        match timeout(WAIT, self.shares.clone().acquire_many_owned(units)).await {
            Ok(Ok(permit)) => Ok(Share(permit)),
            _ => Err(Error::Exhausted("the memory for large requests is taken by others; try again".into())),
        }
    }
}

/// Holds a call's large messages until they are taken, and the limit of its small ones.
#[derive(Clone, Default)]
pub struct Door(Arc<Inner>);

#[derive(Default)]
struct Inner {
    /// Size of messages [bytes] for which the call's session has reserved memory already.
    free: AtomicUsize,
    large: Mutex<Option<(Bytes, Share)>>,
}

impl Door {
    pub fn of<T>(request: &tonic::Request<T>) -> Self {
        request.extensions().get::<Self>().cloned().unwrap_or_default()
    }

    /// From now on messages of up to `bytes` need no share, because the session's reservation includes them.
    pub fn let_pass(&self, bytes: usize) {
        self.0.free.store(bytes, Ordering::Relaxed);
    }

    fn free(&self) -> usize {
        self.0.free.load(Ordering::Relaxed).max(SMALL)
    }

    /// The message: `bytes` or, if `bytes` is empty, the large message that the empty one stands for.
    pub fn take(&self, bytes: Bytes) -> (Bytes, Option<Share>) {
        let mut large = self.0.large.lock().unwrap_or_else(PoisonError::into_inner);
        match large.take_if(|_| bytes.is_empty()) {
            Some((bytes, share)) => (bytes, Some(share)),
            None => (bytes, None),
        }
    }

    fn put(&self, bytes: Bytes, share: Share) -> std::result::Result<(), Status> {
        let mut large = self.0.large.lock().unwrap_or_else(PoisonError::into_inner);
        if large.is_some() {
            return Err(Status::invalid_argument("message: this call takes only one message"));
        }
        *large = Some((bytes, share));
        Ok(())
    }
}

/// Reads a call's messages one by one, each when there is memory for it.
pub async fn pass(State(intake): State<Arc<Intake>>, mut call: Request, next: Next) -> Response {
    let (door, limit) = (Door::default(), intake.limit(call.uri().path()));
    call.extensions_mut().insert(door.clone());
    let metered = |body: Body| {
        let messages =
            Messages { body: body.into_data_stream(), arrived: Bytes::new(), missing: 0, door, intake, limit };
        Body::from_stream(stream::try_unfold(messages, Messages::next))
    };
    next.run(call.map(metered)).await
}

/// The messages of a call.
struct Messages {
    body: BodyDataStream,
    /// Bytes that have arrived and were not passed on yet.
    arrived: Bytes,
    /// Missing bytes of the incomplete small message.
    missing: usize,
    door: Door,
    intake: Arc<Intake>,
    limit: usize,
}

impl Messages {
    /// The next bytes for tonic: small messages unchanged, and an empty message in place of a large one.
    async fn next(mut self) -> std::result::Result<Option<(Bytes, Self)>, BoxError> {
        loop {
            let small = self.small();
            if small > 0 {
                let bytes = self.arrived.split_to(small);
                return Ok(Some((bytes, self)));
            }
            if let Some(length) = length(&self.arrived) {
                let flag = self.arrived[0];
                self.large(length).await?;
                return Ok(Some((vec![flag, 0, 0, 0, 0].into(), self)));
            }
            match self.body.next().await.transpose()? {
                Some(bytes) if self.arrived.is_empty() => self.arrived = bytes,
                Some(bytes) => self.arrived = [&self.arrived[..], &bytes].concat().into(),
                None if self.arrived.is_empty() => return Ok(None),
                // An incomplete header, which tonic refuses.
                None => return Ok(Some((std::mem::take(&mut self.arrived), self))),
            }
        }
    }

    /// Number of the bytes that have arrived and belong to small messages.
    fn small(&mut self) -> usize {
        let mut end = self.missing.min(self.arrived.len());
        self.missing -= end;
        let small = self.door.free().min(self.limit);
        while self.missing == 0
            && let Some(length) = length(&self.arrived[end..]).filter(|length| *length <= small)
        {
            let whole = end + HEADER + length;
            end = whole.min(self.arrived.len());
            self.missing = whole - end;
        }
        end
    }

    /// Reads the present large message and puts it into the [`Door`].
    async fn large(&mut self, length: usize) -> std::result::Result<(), Status> {
        if length > self.limit {
            let limit = self.limit;
            return Err(Status::resource_exhausted(format!(
                "message: {length} bytes are more than this call takes, {limit}"
            )));
        }
        let share = self.intake.share(COPIES * length).await;
        let share = share.map_err(|e| Status::resource_exhausted(format!("message: {e}")))?;
        let time = ARRIVAL + Duration::from_secs((length >> 20) as u64);
        let deadline = Instant::now() + time;
        let late = |_| Status::resource_exhausted(format!("message: not there within {} s", time.as_secs()));
        let mut message = BytesMut::with_capacity(length);
        drop(self.arrived.split_to(HEADER));
        loop {
            let part = self.arrived.split_to(self.arrived.len().min(length - message.len()));
            message.extend_from_slice(&part);
            if message.len() == length {
                return self.door.put(message.freeze(), share);
            }
            let cut_off = || Status::invalid_argument("message: cannot be read: it is cut off");
            let next = timeout_at(deadline, self.body.next()).await.map_err(late)?;
            self.arrived = next.ok_or_else(cut_off)?.map_err(|_| cut_off())?;
        }
    }
}

/// Length of the message that begins here, if its header is complete.
fn length(bytes: &[u8]) -> Option<usize> {
    let header = bytes.first_chunk::<HEADER>()?;
    Some(u32::from_be_bytes([header[1], header[2], header[3], header[4]]) as usize)
}
