//! One study at a time on all cores; others wait in a queue.
//!
//! ```text
//!  enter ──▶ in line ──▶ computed on a thread of lower priority ──▶ result
//!              └── call cancelled, or server stops ──▶ gone, its place and the cores free
//! ```

use super::{convert, of_client, thread};
use crate::error::{Error, Result};
use crate::intake::{Intake, Messages};
use crate::price;
use crate::progress::Progress;
use crate::proto::study_response::Event;
use crate::proto::{self, StudyResponse};
use crate::share::Share;
use crate::status;
use crate::study::StudyWork;
use crate::unread::UnreadShare;
use futures_util::StreamExt as _;
use futures_util::stream::BoxStream;
use parking_lot::Mutex;
use prost::Message;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc};
use tokio_stream::wrappers::ReceiverStream;
use tokio_util::sync::CancellationToken;
use tonic::Status;

/// Largest number of studies in line, including the running one: our choice, so that their requests stay within 1 GiB.
const PLACES: usize = 16;

/// Largest number of events that wait for a slow client: our choice, because old progress helps nobody. Further events
/// are left out, but the result is always sent.
const EVENTS: usize = 8;

const STOPPED: &str = "the study was stopped";

/// Smallest progress that is reported: our choice, some 200 events a study.
const STEP: f64 = 0.005;

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
pub type Events = BoxStream<'static, std::result::Result<StudyResponse, Status>>;

/// What a study sends: an event; the result also carries its share of the memory.
type StudyItem = (std::result::Result<StudyResponse, Status>, Option<UnreadShare>);

fn progress(fraction: f64, stage: String, ahead: u32) -> StudyResponse {
    StudyResponse { event: Some(Event::Progress(proto::Progress { fraction, stage, ahead })) }
}

impl StudyQueue {
    /// Cancelling `stop` ends every study.
    pub fn new(stop: CancellationToken, intake: Arc<Intake>) -> Self {
        Self { slot: Arc::new(Semaphore::new(1)), taken: Arc::default(), stop, intake }
    }

    /// A request's `share` with `bytes` more, for what will be made of its files. It may wait for them.
    pub async fn more(&self, share: Option<Share>, bytes: usize) -> Result<Option<Share>> {
        grown(&self.intake, share, bytes).await
    }

    /// Computes `work` in its turn, and at once if it is quick. The stream reports its progress and ends with its result or a
    /// status; dropping the stream stops the work at its next report. `share`, the memory of the request, is held until the
    /// result has been sent.
    pub fn enter(
        &self,
        share: Option<Share>,
        messages: Messages,
        work: StudyWork,
    ) -> std::result::Result<Events, Status> {
        let place = (!work.quick).then(|| QueuePlace::take(&self.taken)).transpose().map_err(|e| status::status(&e))?;
        let (events, receiver) = mpsc::channel(EVENTS);
        let (slot, stop, intake) = (self.slot.clone(), self.stop.clone(), self.intake.clone());
        let own = messages.clone();
        tokio::spawn(async move {
            let turn = turn(place, slot, &events);
            let turn = tokio::select! {
                turn = turn => turn,
                () = events.closed() => None,
                () = stop.cancelled() => None,
            };
            let answer = match turn {
                None => Err(Status::cancelled("the study was stopped before its turn came")),
                Some(turn) => {
                    let sender = ProgressSender { events: events.clone(), stop: stop.clone(), last: Mutex::default() };
                    compute(work, turn, share, &intake, sender).await.map_err(|e| status::status(&e))
                }
            };
            let stopped = answer.is_err() && stop.is_cancelled();
            let (answer, share) = match answer {
                Ok((result, share)) => (Ok(StudyResponse { event: Some(Event::Result(result)) }), share),
                Err(_) if stopped => (Err(Status::unavailable("the server stops")), None),
                Err(status) => (Err(status), None),
            };
            // If the caller has left, the result is not needed.
            let bytes = answer.as_ref().map_or(0, Message::encoded_len);
            let share = share.map(|share| own.unread(Arc::new(share), bytes));
            let _ = events.send((answer, share)).await;
        });
        let sent = ReceiverStream::new(receiver).map(move |(event, share): StudyItem| {
            messages.hold_for_answer(share);
            event
        });
        Ok(sent.boxed())
    }
}

/// What a study holds while it is computed: the cores and its place. A quick study holds nothing.
type Turn = Option<(OwnedSemaphorePermit, QueuePlace)>;

/// Waits for the cores; None: the server stops.
async fn turn(place: Option<QueuePlace>, slot: Arc<Semaphore>, events: &mpsc::Sender<StudyItem>) -> Option<Turn> {
    let Some(place) = place else { return Some(None) };
    if place.ahead > 0 {
        let stage = match place.ahead {
            1 => "waiting for another study of this server".to_owned(),
            n => format!("waiting for {n} other studies of this server"),
        };
        // `enter` notices a client that has disconnected.
        let _ = events.send((Ok(progress(0.0, stage, place.ahead as u32)), None)).await;
    }
    let permit = slot.acquire_owned().await.ok()?;
    Some(Some((permit, place)))
}

/// Does the work on a thread of lower priority; returns the result with its share of the memory. `turn` is held until the work has
/// actually ended and its result has a share: clients may leave results unread.
async fn compute(
    work: StudyWork,
    turn: Turn,
    share: Option<Share>,
    intake: &Intake,
    sender: ProgressSender,
) -> Result<(proto::StudyResult, Option<Share>)> {
    // One study runs at a time, and it may need more than requests may take; so only a part is reserved.
    let share = tokio::select! {
        share = grown(intake, share, work.bytes.min(intake.most_of_a_study())) => share?,
        () = sender.events.closed() => return Err(Error::Cancelled(STOPPED.into())),
        () = sender.stop.cancelled() => return Err(Error::Cancelled(STOPPED.into())),
    };
    if work.quick {
        return Ok((convert::result(work.finish(&sender).map_err(of_client)?), share));
    }
    let run = move || (work.finish(&sender).map(convert::result).map_err(of_client), share, turn);
    let done = thread::run(run).map_err(|e| Error::Exhausted(format!("cannot start a thread for a study: {e}")))?;
    let failed = |_| Error::Internal("the study failed inside the server".into());
    let (result, share, _turn) = done.await.map_err(failed)?;
    let result = result?;
    let share = shared(intake, share, price::answer_bytes(&result)).await?;
    Ok((result, share))
}

/// A share of `bytes` more.
async fn grown(intake: &Intake, share: Option<Share>, bytes: usize) -> Result<Option<Share>> {
    match share {
        _ if bytes <= price::SMALL_ANSWER => Ok(share),
        Some(share) => intake.grow(&share, bytes).await.map(|()| Some(share)),
        None => intake.share(bytes).await.map(Some),
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
struct ProgressSender {
    events: mpsc::Sender<StudyItem>,
    stop: CancellationToken,
    /// The last report. Several threads report, so the order varies; only larger values are sent.
    last: Mutex<Option<(f64, String)>>,
}

impl Progress for ProgressSender {
    fn report(&self, done: f64, stage: &str) -> Result<()> {
        if self.events.is_closed() || self.stop.is_cancelled() {
            return Err(Error::Cancelled(STOPPED.into()));
        }
        let mut last = self.last.lock();
        let before = last.as_ref().map_or(0.0, |l| l.0);
        let fraction = done.clamp(before, 1.0);
        let news = last.as_ref().is_none_or(|l| l.1 != stage) || fraction >= before + STEP;
        if news && self.events.try_send((Ok(progress(fraction, stage.to_owned(), 0)), None)).is_ok() {
            *last = Some((fraction, stage.to_owned()));
        }
        Ok(())
    }
}
