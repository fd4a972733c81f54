//! Threads of a pool: turns, lost environments, and the end.

use super::*;
use crate::env::registry::Blueprint;
use serde_json::Value;
use std::sync::mpsc;

fn begun() -> (Batch, Operation) {
    let blueprint = Blueprint::new("sandgait/HexapodGait-v1", Value::Null).unwrap();
    let batch = Batch::new(&blueprint, 40).unwrap();
    let reset = batch.reset(None, None, Default::default()).unwrap();
    (batch, reset)
}

/// The only worker is busy, so the shards of a batch wait. The thread that waits for the batch computes them, but not
/// while as many threads work as the pool has threads.
#[test]
fn who_waits_computes() {
    let mut pool = Pool::new(1);
    pool.most_active = 1;
    let (busy, released) = mpsc::channel::<()>();
    let (told, worker_is_busy) = mpsc::channel();
    let (batch, reset) = begun();
    pool.run(batch, reset, move |_| {
        told.send(()).unwrap();
        let _ = released.recv();
    });
    worker_is_busy.recv().unwrap();
    let (sender, finished) = mpsc::channel();
    let (batch, reset) = begun();
    pool.run(batch, reset, move |batch| sender.send(batch.unwrap().envs()).unwrap());
    pool.shared.queue.lock().active = 1;
    pool.assist(Duration::MAX);
    assert!(finished.try_recv().is_err());
    pool.shared.queue.lock().active = 0;
    pool.assist(Duration::MAX);
    assert_eq!(finished.try_recv(), Ok(40));
    assert_eq!(pool.shared.queue.lock().active, 0);
    drop(busy);
}

/// Ten long jobs have had a turn of some 10 ms each. From then on a new job waits for one turn at most, and each long job
/// goes on even while new jobs come all the time.
#[test]
fn a_short_job_waits_for_one_turn_of_ten_long_ones() {
    let time = |index: usize| Duration::from_micros(10_000 + 7 * index as u64);
    let mut queue = Queue::default();
    let add = |queue: &mut Queue| {
        let (mut batch, operation) = begun();
        let work = Arc::new(PoolWork { operation, stop: None, keeps: false, stopped: AtomicBool::new(false) });
        let shard = batch.shards.remove(0);
        let waiting = vec![QueuedShard { start: 0, shard, begun: false, done: 0, spent: Duration::ZERO }];
        queue.next_id += 1;
        queue.jobs.push_back(Job { work, waiting, id: queue.next_id, used: queue.floor });
        queue.next_id
    };
    let long: Vec<u64> = (0..10).map(|_| add(&mut queue)).collect();
    let mut turns = [0; 10];
    // The job that had a turn. A long one goes on, a short one has ended.
    let mut turn = |queue: &mut Queue| {
        let taken = take_next(queue, |_| true).unwrap();
        let id = taken.id;
        if let Some(index) = long.iter().position(|long| *long == id) {
            put_back(queue, taken, time(index));
            turns[index] += 1;
        }
        id
    };
    for round in 0..300 {
        turn(&mut queue);
        if round > 10 && round % 3 == 2 {
            let new = add(&mut queue);
            let waited = (0..3).take_while(|_| turn(&mut queue) != new).count();
            assert!(waited <= 1, "round {round}: {waited} turns");
        }
    }
    assert!(turns.iter().all(|n| *n >= 25), "{turns:?}");
}

/// `done` of a batch panics: the only worker goes on with other batches, and the values that `done` held are
/// dropped.
#[test]
fn a_panic_of_who_is_told_costs_no_worker() {
    let pool = Pool::new(1);
    for _ in 0..3 {
        let (batch, reset) = begun();
        let (sender, dropped) = mpsc::channel::<()>();
        pool.run(batch, reset, move |_| {
            let _sender = sender;
            panic!("on purpose");
        });
        assert!(dropped.recv().is_err());
    }
    let (batch, reset) = begun();
    assert_eq!(pool.wait(batch, reset).unwrap().envs(), 40);
}

/// Jobs come when the workers are in any state: at work, watching, falling asleep or asleep. Each job is finished, even
/// if no later job comes.
#[test]
fn no_job_is_forgotten() {
    for threads in [1, 2] {
        let pool = Pool::new(threads);
        let (mut batch, mut reset) = begun();
        for round in 0..200 {
            let (sender, finished) = mpsc::channel();
            pool.run(batch, reset, move |batch| sender.send(batch.unwrap()).unwrap());
            batch = finished.recv_timeout(Duration::from_secs(20)).expect("a job was forgotten");
            let pause = WATCH * (round % 20) / 10;
            let start = Instant::now();
            while start.elapsed() < pause {
                spin_loop();
            }
            reset = batch.reset(None, None, Default::default()).unwrap();
        }
    }
}

/// Nobody waits for a step any more: it ends on all shards, those that have made it go back, and the step can be made
/// again with the same bits. A first reset that ends leaves environments that need one.
#[test]
fn an_operation_that_nobody_waits_for_is_undone() {
    const ENVS: usize = 40;
    let blueprint = Blueprint::new("sandgait/HexapodGait-v1", serde_json::json!({"dt": 2e-6})).unwrap();
    let pool = Pool::new(1);
    let stop_after = |looks: usize| -> Option<Stop> {
        let seen = std::sync::atomic::AtomicUsize::new(0);
        Some(Arc::new(move || seen.fetch_add(1, Ordering::Relaxed) >= looks))
    };
    let reset = |batch: &Batch| batch.reset(None, Some((0..ENVS as u64).collect()), Default::default()).unwrap();
    let begun = || {
        let mut batch = Batch::new(&blueprint, ENVS).unwrap();
        batch.set_stop(stop_after(1));
        let first = reset(&batch);
        batch = pool.wait(batch, first).unwrap();
        assert!(batch.was_stopped() && batch.is_untouched());
        batch.set_stop(None);
        let again = reset(&batch);
        pool.wait(batch, again).unwrap()
    };
    let (mut batch, mut calm) = (begun(), begun());
    let before = batch.save().unwrap();
    let actions = vec![0.3; ENVS * batch.spec().action.len()];
    for looks in [0, 1, 4] {
        batch.set_stop(stop_after(looks));
        let step = batch.step(actions.clone()).unwrap();
        batch = pool.wait(batch, step).unwrap();
        assert!(batch.was_stopped() && batch.save().unwrap() == before, "{looks}");
    }
    batch.set_stop(stop_after(usize::MAX));
    for _ in 0..3 {
        let [own, other] = [&batch, &calm].map(|batch| batch.step(actions.clone()).unwrap());
        (batch, calm) = (pool.wait(batch, own).unwrap(), pool.wait(calm, other).unwrap());
        assert!(!batch.was_stopped());
        assert!(batch.shards().iter().zip(calm.shards()).all(|(a, b)| a.rows == b.rows));
    }
}
