//! One study at a time on all cores; others wait in a queue.
//!
//! ```text
//!  enter ──▶ in line ──▶ computed on a thread of lower priority ──▶ result
//!              └── call cancelled, or server stops ──▶ gone, its place and the cores free
//! ```

use super::compute::StudyWork;
use super::thread;
use crate::error::{Error, Result};
use crate::intake::{Intake, Messages};
use crate::price;
use crate::progress::Progress;
use crate::proto::Progress as Event;
use crate::share::Share;
use crate::status;
use crate::unread::UnreadShare;
use futures_util::StreamExt as _;
use futures_util::stream::BoxStream;
use parking_lot::Mutex;
use prost::Message;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use tokio::sync::{Semaphore, mpsc};
use tokio_stream::wrappers::ReceiverStream;
use tokio_util::sync::CancellationToken;
use tonic::Status;

/// Largest number of studies in line, including the running one: our choice, so that their requests stay within 1 GiB.
const PLACES: usize = 16;

/// Largest number of events that wait for a slow client: our choice, because old progress helps nobody. Further events
/// are left out, but the result is always sent.
const EVENTS: usize = 8;

/// Smallest progress that is reported: our choice, some 200 events a study.
const STEP: f64 = 0.005;

/// A message of a study's stream.
pub trait StudyMessage: Message + 'static {
    type Result: Send + 'static;
    fn progress(event: Event) -> Self;
    fn result(result: Self::Result) -> Self;
}

/// The queue of one server.
pub struct StudyQueue {
    slot: Arc<Semaphore>,
    taken: Arc<AtomicUsize>,
    stop: CancellationToken,
    intake: Arc<Intake>,
}

/// A place in the queue; returned when dropped.
struct QueuePlace {
    taken: Arc<AtomicUsize>,
    /// Number of studies before this one when it entered.
    ahead: usize,
}

impl QueuePlace {
    fn take(taken: &Arc<AtomicUsize>) -> Result<Self> {
        let next = |n: usize| (n < PLACES).then_some(n + 1);
        match taken.fetch_update(Ordering::Relaxed, Ordering::Relaxed, next) {
            Ok(ahead) => Ok(Self { taken: taken.clone(), ahead }),
            Err(_) => Err(Error::Exhausted(format!("all {PLACES} places in this server's queue of studies are taken"))),
        }
    }
}

impl Drop for QueuePlace {
    fn drop(&mut self) {
        self.taken.fetch_sub(1, Ordering::Relaxed);
    }
}

/// A study's progress, and its result at the end.
pub type Events<A> = BoxStream<'static, std::result::Result<A, Status>>;

/// What a study sends: an event; the result also carries its share of the memory.
type StudyItem<A> = (std::result::Result<A, Status>, Option<UnreadShare>);

impl StudyQueue {
    /// Cancelling `stop` ends every study.
    pub fn new(stop: CancellationToken, intake: Arc<Intake>) -> Self {
        Self { slot: Arc::new(Semaphore::new(1)), taken: Arc::default(), stop, intake }
    }

    /// Computes `work` in its turn. The stream reports its progress and ends with its result or a status; dropping
    /// the stream stops the work at its next report. `share`, the memory of the request, is held until the result has
    /// been sent.
    pub fn enter<A: StudyMessage>(
        &self,
        share: Option<Share>,
        messages: Messages,
        work: StudyWork<A::Result>,
    ) -> std::result::Result<Events<A>, Status> {
        let place = QueuePlace::take(&self.taken).map_err(|e| status::status(&e))?;
        let (events, receiver) = mpsc::channel(EVENTS);
        let (slot, stop, intake) = (self.slot.clone(), self.stop.clone(), self.intake.clone());
        let own = messages.clone();
        tokio::spawn(async move {
            let turn = async {
                if place.ahead > 0 {
                    let stage = match place.ahead {
                        1 => "waiting for another study of this server".to_owned(),
                        n => format!("waiting for {n} other studies of this server"),
                    };
                    let event = Event { fraction: 0.0, stage, ahead: place.ahead as u32 };
                    // The code below notices a client that has disconnected.
                    let _ = events.send((Ok(A::progress(event)), None)).await;
                }
                slot.acquire_owned().await.ok()
            };
            let permit = tokio::select! {
                permit = turn => permit,
                () = events.closed() => None,
                () = stop.cancelled() => None,
            };
            let (answer, share) = match permit {
                None => (Err(Status::cancelled("the study was stopped before its turn came")), share),
                Some(permit) => {
                    let progress =
                        ProgressSender { events: events.clone(), stop: stop.clone(), last: Mutex::default() };
                    // The place and the slot are held until the work has actually ended, and its result has a share of
                    // the memory: clients may leave results unread.
                    let held = (permit, place);
                    let done = thread::run(move || (work(&progress), share, held));
                    let failed = Err(Error::Internal("the study failed inside the server".into()));
                    let (done, share, _held) = match done {
                        Ok(done) => match done.await {
                            Ok((done, share, held)) => (done, share, Some(held)),
                            Err(_) => (failed, None, None),
                        },
                        Err(error) => {
                            (Err(Error::Exhausted(format!("cannot start a thread for a study: {error}"))), None, None)
                        }
                    };
                    match done.map(A::result) {
                        Ok(result) => match shared(&intake, share, price::answer_bytes(&result)).await {
                            Ok(share) => (Ok(result), share),
                            Err(error) => (Err(status::status(&error)), None),
                        },
                        Err(error) => (Err(status::status(&error)), share),
                    }
                }
            };
            let stopped = answer.is_err() && stop.is_cancelled();
            let answer = if stopped { Err(Status::unavailable("the server stops")) } else { answer };
            // If the caller has left, the result is not needed.
            let bytes = answer.as_ref().map_or(0, Message::encoded_len);
            let share = share.map(|share| own.unread(Arc::new(share), bytes));
            let _ = events.send((answer, share)).await;
        });
        let sent = ReceiverStream::new(receiver).map(move |(event, share): StudyItem<A>| {
            messages.hold_for_answer(share);
            event
        });
        Ok(sent.boxed())
    }
}

/// The share of a result of `bytes`, which is not smaller than the share of its request.
async fn shared(intake: &Intake, request: Option<Share>, bytes: usize) -> Result<Option<Share>> {
    match request {
        // The request's memory is free now, but its share covers the result. It cannot wait for more while it holds
        // this.
        Some(share) => {
            share.grow(bytes.saturating_sub(share.bytes()))?;
            Ok(Some(share))
        }
        None if bytes <= price::SMALL_ANSWER => Ok(None),
        None => intake.share(bytes).await.map(Some),
    }
}

/// Reports a study's progress to its client, and stops the study when its client has left.
struct ProgressSender<A> {
    events: mpsc::Sender<StudyItem<A>>,
    stop: CancellationToken,
    /// The last report. Several threads report, so the order varies; only larger values are sent.
    last: Mutex<Option<(f64, String)>>,
}

impl<A: StudyMessage> Progress for ProgressSender<A> {
    fn report(&self, done: f64, stage: &str) -> Result<()> {
        if self.events.is_closed() || self.stop.is_cancelled() {
            return Err(Error::Cancelled("the study was stopped".into()));
        }
        let mut last = self.last.lock();
        let before = last.as_ref().map_or(0.0, |l| l.0);
        let fraction = done.clamp(before, 1.0);
        let news = last.as_ref().is_none_or(|l| l.1 != stage) || fraction >= before + STEP;
        let event = Event { fraction, stage: stage.to_owned(), ahead: 0 };
        if news && self.events.try_send((Ok(A::progress(event)), None)).is_ok() {
            *last = Some((fraction, stage.to_owned()));
        }
        Ok(())
    }
}
