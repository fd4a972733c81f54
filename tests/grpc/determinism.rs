//! Equal seeds and actions give bit-identical results, for any number of threads and any distribution of environments
//! over sessions.

use crate::harness::{Server, Session, floats, step, text, wave};
use sandgait::service::proto::run_session_request::Request;
use sandgait::service::proto::{Batch, Reset};
use std::ops::Range;

const ENVS: usize = 37;

/// Observations and rewards of all steps, separately for each environment.
async fn histories(server: &Server, engine: &str, steps: usize, envs: Range<usize>) -> Vec<Vec<u32>> {
    let engine = [("engine", text(engine))];
    let mut session = Session::create(server.client().await, envs.len() as u32, &engine).await.unwrap();
    let mut histories = vec![Vec::new(); envs.len()];
    let wide = session.task.observation.len();
    let mut record = |batch: &Batch| {
        let (observations, rewards) = (floats(&batch.observations), floats(&batch.rewards));
        for (i, history) in histories.iter_mut().enumerate() {
            history.extend(observations[i * wide..][..wide].iter().chain([&rewards[i]]).map(|x| x.to_bits()));
        }
    };
    let seeds = envs.clone().map(|i| 1000 + i as u64).collect();
    record(&session.batch(Request::Reset(Reset { seeds, ..Default::default() })).await);
    for time in 0..steps {
        record(&session.batch(step(&wave(envs.clone(), time))).await);
    }
    histories
}

async fn bits_do_not_depend_on_threads_or_sessions(engine: &str, steps: usize) {
    let reference = histories(&Server::start(1).await, engine, steps, 0..ENVS).await;
    assert_ne!(reference[0], reference[1]);
    for threads in [2, 8] {
        let server = Server::start(threads).await;
        assert!(histories(&server, engine, steps, 0..ENVS).await == reference, "{threads} threads");
    }
    let server = Server::start(2).await;
    for split in [vec![0..1, 1..ENVS], vec![0..16, 16..20, 20..ENVS]] {
        let mut parts = Vec::new();
        for envs in split.clone() {
            parts.extend(histories(&server, engine, steps, envs).await);
        }
        assert!(parts == reference, "split {split:?}");
    }
}

#[tokio::test]
async fn of_lanes() {
    bits_do_not_depend_on_threads_or_sessions("lanes", 40).await;
}

#[tokio::test]
async fn of_rapier() {
    bits_do_not_depend_on_threads_or_sessions("rapier", 5).await;
}
