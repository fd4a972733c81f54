//! Limits the memory of requests before they are read.
//!
//! ```text
//!  call ──▶ length of the next message ──▶ too large: refused ──▶ large: waits for its share ──▶ read ──▶ RequestFrame
//! ```
//!
//! Small messages need no share. The large messages of all calls together may take [`Intake::room`]. While a message
//! waits for its share, HTTP/2's flow control stops its sender. A request holds its [`Share`] until it has released its
//! memory and its answer has been sent; see `outgoing.rs`.

use super::connection_table::ConnectionHandle;
use super::fields::{LONGEST_OPTIONS, MessageLayout, SMALL};
use super::limits::Limits;
use super::price::{self, COPIES, CallBounds};
use super::share::{Share, UNIT, units};
use super::unread::UnreadShare;
use crate::error::{Error, Result};
use axum::body::{Body, BodyDataStream};
use axum::extract::{Request, State};
use axum::middleware::Next;
use axum::response::Response;
use bytes::Bytes;
use futures_util::{StreamExt as _, stream};
use parking_lot::Mutex;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;
use tokio::sync::Semaphore;
use tokio::time::{Instant, timeout, timeout_at};
use tonic::Status;

/// Longest wait of a request for its share: our choice, longer than the largest step and shorter than the time limits
/// of clients.
const WAIT: Duration = Duration::from_secs(30);

/// Time between two attempts to enlarge a share: our choice, short compared with most requests.
const AGAIN: Duration = Duration::from_millis(20);

/// Time limit for the arrival of a call's first message. A large message has this time in addition to the time of its
/// transfer at 1 MiB/s. Our choice, because a slow or busy client may pause for some seconds.
const ARRIVAL: Duration = Duration::from_secs(10);

/// Number of bytes before a message: a flag and the message's length (gRPC over HTTP2, Length-Prefixed-Message).
const HEADER: usize = 5;

type BoxError = Box<dyn std::error::Error + Send + Sync>;

/// The memory of a server's requests.
pub struct Intake {
    shares: Arc<Semaphore>,
    /// [bytes]
    room: usize,
    /// Largest message of any call [bytes].
    largest: usize,
    /// Memory of the answers of single calls. Large requests, which may hold their shares for long, cannot take it.
    answers: Arc<Semaphore>,
    /// Locked while the answer of a single call is made. Long answers are made one after the other, so that other work
    /// of the runtime has its turn in between.
    maker: tokio::sync::Mutex<()>,
    /// See [`Limits::stall`].
    stall: Duration,
}

/// Part of the memory for requests that only the answers of single calls may take: our choice, hundreds of descriptions of
/// sessions under the smallest limit.
const ANSWERS: usize = 8;

impl Limits {
    /// Memory for requests: a quarter of all memory, but at most twice what the largest request needs.
    pub fn of_requests(&self) -> usize {
        (self.memory / 4).min(2 * COPIES * self.request)
    }

    /// Memory for environments.
    pub fn of_environments(&self) -> usize {
        self.memory - self.of_requests()
    }
}

impl Intake {
    pub fn new(limits: &Limits) -> Arc<Self> {
        // The other half is for freed requests whose memory the allocator keeps: our choice, because the server of
        // `tests/faults/price.rs` kept that much. Below some size the server could accept no request; the minimum,
        // twice the longest options, is our choice.
        let room = (limits.of_requests() / 2).max(COPIES * 2 * LONGEST_OPTIONS);
        let shares = Arc::new(Semaphore::new(room / UNIT));
        let answers = Arc::new(Semaphore::new(room / ANSWERS / UNIT));
        let maker = tokio::sync::Mutex::default();
        Arc::new(Self { shares, room, answers, maker, largest: limits.request.min(room / COPIES), stall: limits.stall })
    }

    /// Bytes that a client may send on a stream before the server has read them; on a connection twice as many. Our
    /// choice: enough for a step of the largest usual batch, and so few that 32 connections stay within the memory for
    /// requests.
    pub fn window(&self) -> u32 {
        (self.room / 64).clamp(64 << 10, 4 << 20) as u32
    }

    /// Largest memory of the answers that one connection leaves unread [bytes], unless a single answer takes more: our
    /// choice, so that eight such connections leave room for others.
    pub fn most_unread(&self) -> usize {
        self.room / 16
    }

    /// Largest memory that is reserved for the work of a study [bytes]: our choice, so that other requests go on beside it.
    pub fn most_of_a_study(&self) -> usize {
        self.room / 4
    }

    /// Makes the answer of a single call when no other one is being made.
    pub async fn make<T>(&self, make: &impl Fn() -> T) -> T {
        let _turn = self.maker.lock().await;
        make()
    }

    /// A share for a request's work and results, if it is free now.
    pub fn try_share(&self, bytes: usize) -> Option<Share> {
        let permit = self.shares.clone().try_acquire_many_owned(units(bytes)).ok()?;
        Some(Share::new(permit, self.room))
    }

    /// A share for a single call's answer, if it is free now.
    pub fn try_answer_share(&self, bytes: usize) -> Option<Share> {
        let permit = self.answers.clone().try_acquire_many_owned(self.of_answer(bytes)).ok()?;
        Some(Share::new(permit, self.room / ANSWERS))
    }

    /// Waits for a share for a single call's answer.
    pub async fn answer_share(&self, bytes: usize) -> Result<Share> {
        match timeout(WAIT, self.answers.clone().acquire_many_owned(self.of_answer(bytes))).await {
            Ok(Ok(permit)) => Ok(Share::new(permit, self.room / ANSWERS)),
            _ => Err(Error::Exhausted("the memory for answers is taken by others; try again".into())),
        }
    }

    /// An answer that is larger than all memory for answers takes all of it.
    fn of_answer(&self, bytes: usize) -> u32 {
        units(bytes).min((self.room / ANSWERS / UNIT) as u32)
    }

    /// Waits until `share` can take `bytes` more. Whoever holds a share must not stand in the queue for another one, where all others
    /// would wait for it; so it asks again and again.
    pub async fn grow(&self, share: &Share, bytes: usize) -> Result<()> {
        self.fits(bytes + share.bytes())?;
        let end = Instant::now() + WAIT;
        loop {
            match share.grow(bytes) {
                Err(_) if Instant::now() < end => tokio::time::sleep(AGAIN).await,
                done => return done,
            }
        }
    }

    /// Refuses more than all requests may take.
    fn fits(&self, bytes: usize) -> Result<()> {
        if bytes <= self.room {
            return Ok(());
        }
        let [needed, room] = [bytes, self.room].map(|b| b.div_ceil(1 << 20));
        Err(Error::Exhausted(format!("needs about {needed} MiB, requests may take {room} MiB")))
    }

    /// Waits for a share.
    pub async fn share(&self, bytes: usize) -> Result<Share> {
        self.fits(bytes)?;
        let units = units(bytes).min((self.room / UNIT) as u32);
        match timeout(WAIT, self.shares.clone().acquire_many_owned(units)).await {
            Ok(Ok(permit)) => Ok(Share::new(permit, self.room)),
            _ => Err(Error::Exhausted("the memory for large requests is taken by others; try again".into())),
        }
    }
}

/// The bounds of a call's messages, and the shares of its present message and answer.
#[derive(Clone)]
pub struct Messages(Arc<MessagesState>);

struct MessagesState {
    call: &'static CallBounds,
    /// Size of messages [bytes] for which the call's session has reserved memory already.
    free: AtomicUsize,
    share: Mutex<Option<Share>>,
    answer: Mutex<Option<UnreadShare>>,
    /// Size of the last answer [bytes].
    ahead: AtomicUsize,
    stall: Duration,
    link: Option<ConnectionHandle>,
}

impl Messages {
    fn new(call: &'static CallBounds, stall: Duration, link: Option<ConnectionHandle>) -> Self {
        Self(Arc::new(MessagesState {
            call,
            free: AtomicUsize::new(SMALL),
            share: Mutex::default(),
            answer: Mutex::default(),
            ahead: AtomicUsize::new(0),
            stall,
            link,
        }))
    }

    pub fn of<T>(request: &tonic::Request<T>) -> Self {
        // Only calls in tests lack this extension, because they do not come through [`pass`].
        request
            .extensions()
            .get::<Self>()
            .cloned()
            .unwrap_or_else(|| Self::new(price::of_call(""), Limits::DEFAULT.stall, None))
    }

    /// From now on messages of up to `bytes` need no share, because the session's reservation includes them.
    pub fn let_pass(&self, bytes: usize) {
        self.0.free.store(bytes.max(SMALL), Ordering::Relaxed);
    }

    pub fn layout(&self) -> Option<&'static MessageLayout> {
        self.0.call.layout
    }

    /// The share of the message that tonic reads or has just read, if this message is large.
    pub fn take_share(&self) -> Option<Share> {
        self.0.share.lock().take()
    }

    /// An answer's hold on `share`, until its client has read its `bytes`.
    pub fn unread(&self, share: Arc<Share>, bytes: usize) -> UnreadShare {
        // Of the earlier answers, only the last can still be in the queue.
        let ahead = self.0.ahead.swap(bytes, Ordering::Relaxed);
        UnreadShare::new(share, [bytes, ahead], self.0.stall, self.0.link.clone())
    }

    /// Memory of the answers that the connection's client has not read [bytes].
    pub fn unread_bytes(&self) -> usize {
        self.0.link.as_ref().map_or(0, |link| link.unread.load(Ordering::Relaxed))
    }

    /// The call's next answer holds `share` until it has been sent.
    pub fn hold_for_answer(&self, share: Option<UnreadShare>) {
        *self.0.answer.lock() = share;
    }

    pub fn take_answer_share(&self) -> Option<UnreadShare> {
        self.0.answer.lock().take()
    }
}

/// Reads a call's messages one by one, each when there is memory for it.
pub async fn pass(State(intake): State<Arc<Intake>>, mut call: Request, next: Next) -> Response {
    let bounds = price::of_call(call.uri().path());
    let link = call.extensions().get::<ConnectionHandle>().cloned();
    let messages = Messages::new(bounds, intake.stall, link);
    call.extensions_mut().insert(messages.clone());
    let metered = |body: Body| {
        let limit = bounds.largest.min(intake.largest).min(intake.room / COPIES);
        let (body, first) = (body.into_data_stream(), Some(Instant::now() + ARRIVAL));
        let reader =
            MessageReader { body, arrived: Bytes::new(), missing: 0, deadline: first, messages, intake, limit };
        Body::from_stream(stream::try_unfold(reader, MessageReader::next))
    };
    next.run(call.map(metered)).await
}

/// The messages of a call as they arrive.
struct MessageReader {
    body: BodyDataStream,
    /// Bytes that have arrived and were not passed on yet.
    arrived: Bytes,
    /// Missing bytes of the present message.
    missing: usize,
    /// Time by which the present message must have arrived; only a call's first message and large messages have a time
    /// limit.
    deadline: Option<Instant>,
    messages: Messages,
    intake: Arc<Intake>,
    limit: usize,
}

impl MessageReader {
    /// The next bytes for tonic, from the present message or from several small messages.
    async fn next(mut self) -> std::result::Result<Option<(Bytes, Self)>, BoxError> {
        loop {
            let ready = self.ready();
            if ready > 0 {
                let bytes = self.arrived.split_to(ready);
                return Ok(Some((bytes, self)));
            }
            if self.missing == 0
                && let Some(length) = length(&self.arrived)
            {
                self.begin(length).await?;
                continue;
            }
            let late = |_| Status::deadline_exceeded("message: it has not arrived in time");
            let next = match self.deadline {
                Some(deadline) => timeout_at(deadline, self.body.next()).await.map_err(late)?,
                None => self.body.next().await,
            };
            match next.transpose()? {
                Some(bytes) if self.arrived.is_empty() => self.arrived = bytes,
                Some(bytes) => self.arrived = [&self.arrived[..], &bytes].concat().into(),
                // tonic refuses a message that is cut off.
                None if self.arrived.is_empty() => return Ok(None),
                None => return Ok(Some((std::mem::take(&mut self.arrived), self))),
            }
        }
    }

    /// Number of bytes that have arrived and belong to the present message, or to small messages after it. A large
    /// message comes alone, because [`Messages`] keeps only one share, for the message that tonic reads.
    fn ready(&mut self) -> usize {
        let mut end = self.missing.min(self.arrived.len());
        self.missing -= end;
        if self.missing == 0 && end > 0 {
            self.deadline = None;
        }
        let small = self.messages.0.free.load(Ordering::Relaxed).min(self.limit);
        while self.missing == 0
            && let Some(length) = length(&self.arrived[end..]).filter(|length| *length <= small)
        {
            let whole = end + HEADER + length;
            end = whole.min(self.arrived.len());
            self.missing = whole - end;
            self.deadline = self.deadline.filter(|_| self.missing > 0);
        }
        end
    }

    /// Waits for the share of a large message that begins here.
    async fn begin(&mut self, length: usize) -> std::result::Result<(), Status> {
        let refused = |why: String| Status::resource_exhausted(format!("message: {why}"));
        if length > self.limit {
            return Err(refused(format!("{length} bytes are more than this call takes, {}", self.limit)));
        }
        if self.messages.0.share.lock().is_some() {
            return Err(Status::invalid_argument("message: this call takes only one message"));
        }
        let share = self.intake.share(COPIES * length).await.map_err(|e| refused(e.to_string()))?;
        *self.messages.0.share.lock() = Some(share);
        self.missing = HEADER + length;
        self.deadline = Some(Instant::now() + ARRIVAL + Duration::from_secs((length >> 20) as u64));
        Ok(())
    }
}

/// Length of the message that begins here, if its header is complete.
fn length(bytes: &[u8]) -> Option<usize> {
    let header = bytes.first_chunk::<HEADER>()?;
    Some(u32::from_be_bytes([header[1], header[2], header[3], header[4]]) as usize)
}
