//! Worker threads and the queue that feeds them.

use super::batch::{Batch, Stop};
use super::operation::Operation;
use crate::env::Shard;
use crate::error::{Error, Result};
use crate::parallel::processors;
use parking_lot::{Condvar, Mutex, MutexGuard};
use std::collections::VecDeque;
use std::hint::spin_loop;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::TryRecvError;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Called on the thread that finishes the last shard of a batch; not called if the pool ends earlier.
type Done = Box<dyn FnOnce(Result<Batch>) + Send>;

/// A worker without work looks for new work for this time before it sleeps. Our choice: about as long as a sleeping
/// thread needs to wake up on a virtual machine (30 to 50 µs were measured), and longer than Python needs between two
/// steps.
const WATCH: Duration = Duration::from_micros(100);

/// A shard that waits for a worker.
struct QueuedShard {
    /// Index of its first environment in the batch.
    start: usize,
    shard: Shard,
    /// Has a worker worked on it?
    begun: bool,
    /// Finished control steps of a rollout.
    done: usize,
    /// Time that workers have worked on it.
    spent: Duration,
}

/// An operation on a batch.
struct PoolWork {
    operation: Operation,
    /// Says whether nobody waits for the operation any more.
    stop: Option<Stop>,
    /// Do shards keep copies of their environments, so that the operation can be undone?
    keeps: bool,
    /// Has the operation ended before it was done?
    stopped: AtomicBool,
}

impl PoolWork {
    /// Must the operation end? An operation that cannot be undone goes on, except a rollout, whose caller restores the
    /// environments.
    fn must_end(&self) -> bool {
        let can_end = self.keeps || matches!(self.operation, Operation::Roll(_));
        if can_end && self.stop.as_ref().is_some_and(|stop| stop()) {
            self.stopped.store(true, Ordering::Relaxed);
        }
        self.stopped.load(Ordering::Relaxed)
    }
}

/// A batch whose shards wait for workers.
struct Job {
    work: Arc<PoolWork>,
    /// Shards on which no worker works now; the last shard is taken first.
    waiting: Vec<QueuedShard>,
    id: u64,
    /// Time that workers have worked on it, and [`Queue::floor`] when it came. The job with the smallest value is next, so
    /// a short job waits for one part of a long job, and not for one part of every long job (start-time fair queueing;
    /// Goyal, Vin & Cheng 1997).
    used: Duration,
}

/// The batch of a [`Job`], to which its finished shards return.
struct Pending {
    id: u64,
    /// The batch without its shards.
    batch: Batch,
    finished: Vec<(usize, Shard)>,
    expected: usize,
    panicked: bool,
    /// The kind of the operation, and the time that workers have worked on it.
    kind: usize,
    spent: Duration,
    done: Done,
}

/// A shard that a worker has taken from its job.
struct TakenShard {
    id: u64,
    work: Arc<PoolWork>,
    queued: QueuedShard,
    /// [`Job::used`] of its job when it was taken.
    used: Duration,
}

#[derive(Default)]
struct Queue {
    jobs: VecDeque<Job>,
    /// Largest [`Job::used`] of the jobs that were next so far; a new job begins with it.
    floor: Duration,
    pending: Vec<Pending>,
    next_id: u64,
    /// Number of threads that now work on a shard.
    active: usize,
    /// Number of workers that now watch for new work. Each change of `news` sets it to 0, because all watching workers
    /// see the change.
    watching: usize,
    asleep: usize,
    closed: bool,
}

struct PoolState {
    queue: Mutex<Queue>,
    work: Condvar,
    /// Number of changes of the queue that watching workers must see.
    news: AtomicU64,
    /// Largest number of workers that watch at the same time: one processor is left for the caller.
    most_watching: usize,
}

/// Worker threads shared by all sessions of a process.
pub struct Pool {
    shared: Arc<PoolState>,
    workers: Vec<JoinHandle<()>>,
    /// Callers do not assist while this many threads are active.
    most_active: usize,
}

impl PoolState {
    /// Makes the workers that watch look into the queue.
    fn wake_watching(&self, queue: &mut Queue) {
        queue.watching = 0;
        self.news.fetch_add(1, Ordering::Release);
    }
}

impl Pool {
    /// A pool of `threads` workers; 0: one worker for each processor.
    pub fn new(threads: usize) -> Self {
        let threads = if threads == 0 { processors() } else { threads };
        let most_watching = processors() - 1;
        let shared = Arc::new(PoolState {
            queue: Mutex::default(),
            work: Condvar::new(),
            news: AtomicU64::new(0),
            most_watching,
        });
        let workers = (0..threads)
            .map(|_| {
                let shared = shared.clone();
                std::thread::spawn(move || worker(&shared))
            })
            .collect();
        let most_active = if threads < processors() { threads } else { usize::MAX };
        Self { shared, workers, most_active }
    }

    pub fn threads(&self) -> usize {
        self.workers.len()
    }

    /// Runs `operation` on every shard, then calls `done` with the batch. If a shard panics, the batch is lost and
    /// `done` gets an error; other batches go on.
    pub fn run(&self, batch: Batch, operation: Operation, done: impl FnOnce(Result<Batch>) + Send + 'static) {
        self.enqueue(batch, operation, 0, done);
    }

    /// Returns the number of the job. `helpers` is the number of threads outside the pool that will work on it.
    fn enqueue(
        &self,
        mut batch: Batch,
        operation: Operation,
        helpers: usize,
        done: impl FnOnce(Result<Batch>) + Send + 'static,
    ) -> u64 {
        let (keeps, stop, kind) = (batch.keeps(&operation), batch.stop.clone(), operation.kind());
        batch.begin(&operation);
        let work = Arc::new(PoolWork { operation, stop, keeps, stopped: AtomicBool::new(false) });
        let mut start = 0;
        let mut waiting: Vec<QueuedShard> = Vec::with_capacity(batch.shards.len());
        for shard in batch.shards.drain(..) {
            let envs = shard.envs();
            waiting.push(QueuedShard { start, shard, begun: false, done: 0, spent: Duration::ZERO });
            start += envs;
        }
        waiting.reverse();
        let expected = waiting.len();
        let mut queue = self.shared.queue.lock();
        let id = queue.next_id;
        queue.next_id += 1;
        let finished = Vec::with_capacity(expected);
        let (panicked, spent, done) = (false, Duration::ZERO, Box::new(done));
        queue.pending.push(Pending { id, batch, finished, expected, panicked, kind, spent, done });
        let used = queue.floor;
        queue.jobs.push_back(Job { work, waiting, id, used });
        let wanted = expected.min(self.workers.len()).saturating_sub(helpers + queue.watching);
        let woken = wanted.min(queue.asleep);
        self.shared.wake_watching(&mut queue);
        drop(queue);
        for _ in 0..woken {
            self.shared.work.notify_one();
        }
        id
    }

    /// The same as [`Pool::wait`], but the caller's thread also works, in place of one of the pool's threads. For a
    /// single shard no other thread is woken.
    pub fn help(&self, batch: Batch, operation: Operation) -> Result<Batch> {
        let (sender, receiver) = std::sync::mpsc::sync_channel(1);
        let id = self.enqueue(batch, operation, 1, move |batch| {
            let _ = sender.send(batch);
        });
        let mut queue = self.shared.queue.lock();
        while let Some(place) = queue.jobs.iter().position(|job| job.id == id) {
            let Some(taken) = take(&mut queue, place) else { break };
            drop(queue);
            queue = carry_out(&self.shared, taken);
        }
        drop(queue);
        // The last shards are nearly done. Waking up takes longer than they do, so this thread watches for them, as a
        // worker watches for work; with one processor it would take the processor from them.
        let start = Instant::now();
        while self.shared.most_watching > 0 && start.elapsed() < WATCH {
            match receiver.try_recv() {
                Ok(batch) => return batch,
                Err(TryRecvError::Empty) => spin_loop(),
                Err(TryRecvError::Disconnected) => break,
            }
        }
        receiver.recv().unwrap_or_else(|_| Err(Error::Exhausted("the worker pool was closed".into())))
    }

    /// Works on shards that wait for a worker, on the thread of a caller that has nothing else to do. It ends if no
    /// shard waits, or after `time`. In a pool with fewer threads than processors it also ends when that many threads
    /// are working. In a larger pool workers may share a processor while the caller's processor is free, so there the
    /// caller assists even then. Rollouts are left to the workers, because they may take long.
    pub fn assist(&self, time: Duration) {
        let start = Instant::now();
        let mut queue = self.shared.queue.lock();
        while queue.active < self.most_active && start.elapsed() < time {
            let is_short = |job: &Job| !matches!(job.work.operation, Operation::Roll(_));
            let Some(taken) = take_next(&mut queue, is_short) else { break };
            drop(queue);
            queue = carry_out(&self.shared, taken);
        }
    }

    /// The same as [`Pool::run`], but waits for the result.
    pub fn wait(&self, batch: Batch, operation: Operation) -> Result<Batch> {
        let (sender, receiver) = std::sync::mpsc::sync_channel(1);
        self.run(batch, operation, move |batch| {
            // The receiver below lives until this closure has sent.
            let _ = sender.send(batch);
        });
        receiver.recv().unwrap_or_else(|_| Err(Error::Exhausted("the worker pool was closed".into())))
    }
}

impl Drop for Pool {
    /// Waits for the shards that are running. Shards in the queue are dropped, and their `done` is not called.
    fn drop(&mut self) {
        let mut queue = self.shared.queue.lock();
        queue.closed = true;
        let abandoned = (std::mem::take(&mut queue.jobs), std::mem::take(&mut queue.pending));
        self.shared.wake_watching(&mut queue);
        drop(queue);
        drop(abandoned);
        self.shared.work.notify_all();
        for worker in self.workers.drain(..) {
            // A worker catches panics of its work, so joining it cannot fail.
            let _ = worker.join();
        }
    }
}

/// Takes one shard of the job that is next among those that `may` be; of equal jobs the first in the queue.
fn take_next(queue: &mut Queue, may: impl Fn(&Job) -> bool) -> Option<TakenShard> {
    let places = (0..queue.jobs.len()).filter(|place| may(&queue.jobs[*place]));
    let taken = take(queue, places.min_by_key(|place| queue.jobs[*place].used)?)?;
    queue.floor = queue.floor.max(taken.used);
    Some(taken)
}

/// Takes one shard of the job at `place`, and puts the job behind all others.
fn take(queue: &mut Queue, place: usize) -> Option<TakenShard> {
    let mut job = queue.jobs.remove(place)?;
    let queued = job.waiting.pop()?;
    let (id, work, used) = (job.id, job.work.clone(), job.used);
    if !job.waiting.is_empty() {
        queue.jobs.push_back(job);
    }
    queue.active += 1;
    Some(TakenShard { id, work, queued, used })
}

/// Puts an unfinished shard back into the queue: behind the other waiting shards of its job or, if there are none,
/// behind all other jobs.
fn put_back(queue: &mut Queue, TakenShard { id, work, queued, used }: TakenShard, time: Duration) {
    match queue.jobs.iter_mut().find(|job| job.id == id) {
        Some(job) => {
            job.waiting.insert(0, queued);
            job.used += time;
        }
        None => queue.jobs.push_back(Job { work, waiting: vec![queued], id, used: used + time }),
    }
}

fn worker(shared: &PoolState) {
    let mut queue = shared.queue.lock();
    loop {
        if let Some(taken) = take_next(&mut queue, |_| true) {
            drop(queue);
            queue = carry_out(shared, taken);
        } else if queue.closed {
            return;
        } else {
            queue = rest(shared, queue);
        }
    }
}

/// Returns when there may be work.
fn rest<'a>(shared: &'a PoolState, mut queue: MutexGuard<'a, Queue>) -> MutexGuard<'a, Queue> {
    if queue.watching < shared.most_watching {
        let known = shared.news.load(Ordering::Acquire);
        queue.watching += 1;
        drop(queue);
        let start = Instant::now();
        while shared.news.load(Ordering::Acquire) == known && start.elapsed() < WATCH {
            spin_loop();
        }
        queue = shared.queue.lock();
        if shared.news.load(Ordering::Acquire) != known {
            return queue;
        }
        queue.watching -= 1;
    }
    queue.asleep += 1;
    shared.work.wait(&mut queue);
    queue.asleep -= 1;
    queue
}

/// Works on a shard and returns it to its batch or to the queue.
fn carry_out(shared: &PoolState, mut taken: TakenShard) -> MutexGuard<'_, Queue> {
    let begun = Instant::now();
    let outcome = catch_unwind(AssertUnwindSafe(|| compute(shared, taken.id, &taken.work, &mut taken.queued)));
    let time = begun.elapsed();
    taken.queued.spent += time;
    if matches!(outcome, Ok(false)) {
        let mut queue = shared.queue.lock();
        queue.active -= 1;
        if !queue.closed {
            put_back(&mut queue, taken, time);
        }
        return queue;
    }
    give_back(shared, taken, time, outcome.is_err())
}

/// Works on a shard until its operation is done or must end, and then returns true. If another session waits, it stops
/// earlier, after at least one part. So long operations do not delay the steps of other sessions, and an operation
/// without other sessions does not return to the queue.
fn compute(shared: &PoolState, id: u64, work: &PoolWork, queued: &mut QueuedShard) -> bool {
    loop {
        if work.must_end() {
            return true;
        }
        if work.keeps && !queued.begun {
            queued.shard.keep_all();
        }
        queued.begun = true;
        if work.operation.run(&mut queued.shard, queued.start, &mut queued.done) {
            return true;
        }
        let queue = shared.queue.lock();
        if queue.closed || queue.jobs.iter().any(|job| job.id != id) {
            return false;
        }
    }
}

/// Returns a shard to its batch; the last shard completes the batch. `time`: of the work on this shard since it was taken.
fn give_back(shared: &PoolState, taken: TakenShard, time: Duration, panicked: bool) -> MutexGuard<'_, Queue> {
    let TakenShard { id, work, queued: QueuedShard { start, shard, spent, .. }, .. } = taken;
    let mut queue = shared.queue.lock();
    queue.active -= 1;
    if let Some(job) = queue.jobs.iter_mut().find(|job| job.id == id) {
        job.used += time;
    }
    let Some(index) = queue.pending.iter().position(|p| p.id == id) else { return queue };
    let pending = &mut queue.pending[index];
    pending.panicked |= panicked;
    pending.spent += spent;
    pending.finished.push((start, shard));
    if pending.finished.len() < pending.expected {
        return queue;
    }
    let mut pending = queue.pending.swap_remove(index);
    drop(queue);
    let stopped = work.stopped.load(Ordering::Relaxed);
    drop(work);
    pending.finished.sort_unstable_by_key(|f| f.0);
    pending.batch.shards.extend(pending.finished.into_iter().map(|f| f.1));
    let lost = || Error::Internal("the simulation of this session failed".into());
    let Pending { mut batch, mut panicked, kind, spent, done, .. } = pending;
    if !panicked {
        panicked = catch_unwind(AssertUnwindSafe(|| batch.end(kind, stopped, spent))).is_err();
    }
    // If `done` panics, the values that it holds are dropped, and whoever waits for them notices this. This thread goes
    // on with the work of other sessions.
    drop(catch_unwind(AssertUnwindSafe(|| done(if panicked { Err(lost()) } else { Ok(batch) }))));
    shared.queue.lock()
}

#[cfg(test)]
mod tests;
