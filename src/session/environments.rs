//! A session of this process. Its environments are stored here, except while a thread works on them.
//!
//! ```text
//!  take ──▶ guard ──┬── run ──▶ pool ──▶ back, with an answer
//!                   ├── answer ──▶ back, with this answer
//!                   └── dropped ──▶ back as it was; in a panic: lost
//! ```
//!
//! A caller can stop waiting for an answer and take it later; the answer is kept until the next request.

use super::roll::{self, Rolled};
use super::{MOST_ENVIRONMENTS, MOST_MEMORY};
use crate::env::registry::Blueprint;
use crate::error::{Error, Result};
use crate::pool::{Batch, Building, Operation, Pool, Roll, check_envs};
use parking_lot::{Condvar, Mutex};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Largest number of shards with which the caller's thread helps: our choice, well within the 100 ms in which Ctrl-C
/// must act. A step of a shard takes some 1 ms with rapier, 0.1 ms with lanes.
const SOON: usize = 64;

/// Between two checks whether the caller still waits, environments are created for this time: our choice, a tenth of
/// the time in which Ctrl-C must act.
const BUILDING: Duration = Duration::from_millis(10);

/// The answer to the last request.
pub enum Answer {
    /// A reset, step or restore; its rows are in the shards.
    Rows,
    Rolled(Rolled),
    /// The request was refused and changed nothing.
    Refused(Error),
}

/// Each session has only one `BatchState`, so the size of a `BatchState` does not matter.
#[allow(clippy::large_enum_variant)]
enum BatchState {
    Idle(Batch),
    Running,
    Lost(Error),
    Closed,
}

struct BatchSlot {
    state: BatchState,
    answer: Option<Answer>,
}

struct SharedBatch {
    slot: Mutex<BatchSlot>,
    back: Condvar,
    /// The caller has stopped waiting for a rollout.
    stop: AtomicBool,
}

/// The environments of one session. Threads may share it; one thread has them at a time.
#[derive(Clone)]
pub struct Environments {
    shared: Arc<SharedBatch>,
}

/// The environments, while a thread works on them.
pub struct EnvironmentsGuard {
    /// None after the environments were passed on.
    batch: Option<Batch>,
    shared: Arc<SharedBatch>,
}

fn closed() -> Error {
    Error::OutOfOrder("this environment is closed".into())
}

impl SharedBatch {
    fn put(&self, state: BatchState, answer: Option<Answer>) {
        let mut slot = self.slot.lock();
        let unwanted = if matches!(slot.state, BatchState::Closed) {
            Some(state)
        } else {
            (slot.state, slot.answer) = (state, answer);
            None
        };
        drop(slot);
        self.back.notify_all();
        drop(unwanted); // freeing many environments takes a while
    }
}

impl Environments {
    /// `envs` environments of `blueprint`, which need a first reset; the work ends when `stopped` returns true.
    pub fn new(blueprint: &Blueprint, envs: usize, stopped: impl Fn() -> bool) -> Result<Self> {
        let bytes = blueprint.bytes(check_envs(envs, MOST_ENVIRONMENTS)?);
        if bytes > MOST_MEMORY {
            let [needed, most] = [bytes, MOST_MEMORY].map(|bytes| bytes >> 20);
            return Err(Error::Exhausted(format!("num_envs: needs about {needed} MiB, more than {most} MiB")));
        }
        let mut building = Building::new(blueprint, envs)?;
        while building.missing() > 0 {
            if stopped() {
                return Err(Error::Cancelled("the caller does not wait for the environments any more".into()));
            }
            building.go_on(BUILDING)?;
        }
        let slot = Mutex::new(BatchSlot { state: BatchState::Idle(building.finish()?), answer: None });
        Ok(Self { shared: Arc::new(SharedBatch { slot, back: Condvar::new(), stop: AtomicBool::new(false) }) })
    }

    /// The environments, if they are available within `time`; None: a thread still works on them.
    pub fn take(&self, time: Duration) -> Option<Result<EnvironmentsGuard>> {
        let away = |slot: &mut BatchSlot| matches!(slot.state, BatchState::Running);
        let mut slot = self.shared.slot.lock();
        if away(&mut slot) && !time.is_zero() {
            self.shared.back.wait_while_for(&mut slot, away, time);
        }
        match std::mem::replace(&mut slot.state, BatchState::Running) {
            BatchState::Idle(batch) => Some(Ok(EnvironmentsGuard { batch: Some(batch), shared: self.shared.clone() })),
            BatchState::Running => None,
            other => {
                let error = if let BatchState::Lost(error) = &other { error.clone() } else { closed() };
                slot.state = other;
                Some(Err(error))
            }
        }
    }

    /// Is an answer pending, or still kept from the last request?
    pub fn owes(&self) -> bool {
        let slot = self.shared.slot.lock();
        slot.answer.is_some() || matches!(slot.state, BatchState::Running)
    }

    /// Ends a rollout in progress soon, with a refusal.
    pub fn stop(&self) {
        self.shared.stop.store(true, Ordering::Relaxed);
    }

    /// Frees the environments, now or when the thread that has them returns them.
    pub fn close(&self) {
        self.stop();
        let mut slot = self.shared.slot.lock();
        let state = std::mem::replace(&mut slot.state, BatchState::Closed);
        drop(slot);
        self.shared.back.notify_all();
        drop(state);
    }
}

impl EnvironmentsGuard {
    /// # Panics
    /// Never: functions that pass the environments on consume the guard.
    pub fn batch(&mut self) -> &mut Batch {
        self.batch.as_mut().expect("a guard has its environments until it ends")
    }

    /// The answer to the last request.
    pub fn answer(&self) -> Option<Answer> {
        self.shared.slot.lock().answer.take()
    }

    /// Returns the environments with this answer.
    pub fn end(mut self, answer: Option<Answer>) {
        if let Some(batch) = self.batch.take() {
            self.shared.put(BatchState::Idle(batch), answer);
        }
    }

    /// Marks the environments as lost, because of `error`.
    fn lose(mut self, error: Error) {
        self.batch = None;
        self.shared.put(BatchState::Lost(error), None);
    }

    /// Runs the operation that `check` returns; if it refuses, the refusal is the answer.
    pub fn run(mut self, pool: &Pool, check: impl FnOnce(&mut Batch) -> Result<Operation>) {
        match check(self.batch()) {
            Err(error) => self.end(Some(Answer::Refused(error))),
            Ok(operation) => {
                let Some(batch) = self.batch.take() else { return };
                // When the pool ends, it drops this function without calling it; then no caller is left.
                pool.run(batch, operation, move |batch| self.back(batch));
            }
        }
    }

    /// Is the work of a step so short that the caller's thread may help with it?
    pub fn is_soon(&mut self) -> bool {
        self.batch().shards().len() <= SOON
    }

    /// The same as [`EnvironmentsGuard::run`], but this thread works, too, and the work is done when this returns. For
    /// work that [is soon done](Self::is_soon) this is faster, because fewer threads have to wake up.
    pub fn run_here(mut self, pool: &Pool, check: impl FnOnce(&mut Batch) -> Result<Operation>) {
        match check(self.batch()) {
            Err(error) => self.end(Some(Answer::Refused(error))),
            Ok(operation) => {
                let Some(batch) = self.batch.take() else { return };
                let done = pool.help(batch, operation);
                self.back(done);
            }
        }
    }

    fn back(mut self, batch: Result<Batch>) {
        match batch {
            Ok(batch) => {
                self.batch = Some(batch);
                self.end(Some(Answer::Rows));
            }
            Err(error) => self.lose(error),
        }
    }

    /// Makes a whole rollout, and restores the environments.
    pub fn roll(mut self, pool: &Pool, record: bool, check: impl FnOnce(&Batch) -> Result<Roll>) {
        self.shared.stop.store(false, Ordering::Relaxed);
        let batch = self.batch();
        let plan = check(batch).and_then(|roll| Ok((roll, batch.keep()?)));
        let (roll, back) = match plan {
            Ok(plan) => plan,
            Err(error) => return self.end(Some(Answer::Refused(error))),
        };
        let Some(batch) = self.batch.take() else { return };
        let shared = self.shared.clone();
        match roll::run(pool, batch, &roll, back, record, || shared.stop.load(Ordering::Relaxed)) {
            Ok((batch, rolled)) => {
                self.batch = Some(batch);
                self.end(Some(rolled.map_or_else(Answer::Refused, Answer::Rolled)));
            }
            Err(error) => self.lose(error),
        }
    }
}

impl Drop for EnvironmentsGuard {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.batch = None;
            let lost = Error::Internal("the environments of this session were lost".into());
            return self.shared.put(BatchState::Lost(lost), None);
        }
        if let Some(batch) = self.batch.take() {
            let mut slot = self.shared.slot.lock();
            let answer = slot.answer.take();
            drop(slot);
            self.shared.put(BatchState::Idle(batch), answer);
        }
    }
}
