//! Threads of a pool: turns, lost environments, and the end.

use super::*;
use crate::env::registry::Blueprint;
use serde_json::Value;
use std::sync::mpsc;

fn begun() -> (Batch, Operation) {
    let blueprint = Blueprint::new("sandgait/HexapodGait-v1", Value::Null).unwrap();
    let mut batch = Batch::new(&blueprint, 40).unwrap();
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
