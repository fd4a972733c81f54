//! Rollouts give the same numbers as single steps and do not change the session.

use crate::harness::{ACTIONS, Server, Session, floats, number, wave};
use sandgait::service::proto::run_session_request::Request;
use sandgait::service::proto::run_session_response::Response;
use sandgait::service::proto::{Rollout, RolloutPart};
use std::time::{Duration, Instant};

fn rollout(envs: usize, steps: usize, trajectories: bool) -> Request {
    let actions: Vec<f32> = (0..steps).flat_map(|time| wave(0..envs, time)).collect();
    Request::Rollout(Rollout { actions: actions.iter().flat_map(|a| a.to_le_bytes()).collect(), trajectories })
}

pub async fn parts(session: &mut Session, request: Request) -> Vec<RolloutPart> {
    session.send(Some(request)).await;
    let mut parts: Vec<RolloutPart> = Vec::new();
    while parts.last().is_none_or(|p| p.returns.is_empty()) {
        match session.receive().await.unwrap().1 {
            Response::Rollout(part) => parts.push(part),
            other => panic!("{other:?}"),
        }
    }
    parts
}

#[tokio::test]
async fn a_rollout_equals_its_steps_and_changes_nothing() {
    let server = Server::start(2).await;
    let (envs, steps) = (20, 50);
    let limit = [("max_episode_steps", number(37.0))];
    let mut session = Session::create(server.client().await, envs as u32, &limit).await.unwrap();
    let mut stepped = Session::create(server.client().await, envs as u32, &limit).await.unwrap();
    assert_eq!(session.reset(3).await, stepped.reset(3).await);
    let parts = parts(&mut session, rollout(envs, steps, true)).await;
    assert!(parts.len() > 2);
    let wide = session.task.observation.len();
    let (mut returns, mut lengths) = (vec![0.0; envs], vec![0; envs]);
    let mut next = 0;
    for part in &parts {
        assert_eq!(part.first_step, next);
        next += part.steps;
        let (observations, rewards) = (floats(&part.observations), floats(&part.rewards));
        for step in 0..part.steps as usize {
            let batch = stepped.step(part.first_step as usize + step).await;
            let mut rows = floats(&batch.observations);
            for (k, i) in batch.final_indices.chunks_exact(4).enumerate() {
                let i = u32::from_le_bytes(i.try_into().unwrap()) as usize;
                rows[i * wide..][..wide].copy_from_slice(&floats(&batch.final_observations)[k * wide..][..wide]);
            }
            for i in 0..envs {
                let (row, reward) = (&observations[(step * envs + i) * wide..][..wide], rewards[step * envs + i]);
                if lengths[i] == 37 {
                    assert!(row.iter().all(|x| *x == 0.0) && reward == 0.0);
                    continue;
                }
                assert_eq!((row, reward), (&rows[i * wide..][..wide], floats(&batch.rewards)[i]));
                returns[i] += f64::from(reward);
                lengths[i] += 1;
            }
        }
    }
    assert_eq!(next as usize, steps);
    let last = parts.last().unwrap();
    let got: Vec<f64> = last.returns.chunks_exact(8).map(|b| f64::from_le_bytes(b.try_into().unwrap())).collect();
    assert_eq!(got, returns);
    assert_eq!(last.lengths, lengths.iter().flat_map(|n: &u32| n.to_le_bytes()).collect::<Vec<_>>());
    assert_eq!((last.truncated.as_ref(), last.terminated.as_ref()), (&[1; 20][..], &[0; 20][..]));
    // The environments are unchanged, so the same rollout with returns only gives the same returns.
    let short = self::parts(&mut session, rollout(envs, steps, false)).await;
    let [only] = &short[..] else { panic!() };
    assert_eq!((&only.returns, only.first_step, only.steps), (&last.returns, 0, steps as u32));
    let mut fresh = Session::create(server.client().await, envs as u32, &limit).await.unwrap();
    fresh.reset(3).await;
    assert_eq!(session.step(5).await, fresh.step(5).await);
}

#[tokio::test]
async fn wrong_rollouts_are_refused() {
    let server = Server::start(1).await;
    let mut session = server.session(2).await;
    let failure = session.failure(Some(rollout(2, 3, false))).await;
    assert!(failure.message.contains("rollout before reset"), "{}", failure.message);
    session.reset(0).await;
    for (numbers, word) in [(0, "0 numbers"), (13, "13 numbers")] {
        let actions = vec![0; 4 * numbers].into();
        let failure = session.failure(Some(Request::Rollout(Rollout { actions, trajectories: false }))).await;
        assert!(failure.message.contains(word), "{}", failure.message);
    }
    let mut actions = [0.0_f32; 2 * 2 * ACTIONS];
    actions[ACTIONS * 3 + 4] = 2.0;
    let actions = actions.iter().flat_map(|a| a.to_le_bytes()).collect();
    let failure = session.failure(Some(Request::Rollout(Rollout { actions, trajectories: false }))).await;
    assert!(failure.message.contains("actions[1][1][4]: 2"), "{}", failure.message);
    session.step(0).await;
}

/// If a client leaves during a rollout, the session keeps the state from before it.
#[tokio::test]
async fn a_cancelled_rollout_restores_the_state() {
    let server = Server::start(1).await;
    let (mut session, mut undisturbed) = (server.session(16).await, server.session(16).await);
    assert_eq!(session.reset(2).await, undisturbed.reset(2).await);
    let sent = session.send(Some(rollout(16, 2000, true))).await;
    session.receive().await.unwrap();
    let id = session.id.clone();
    drop(session);
    let (mut session, last) = Session::resume(server.client().await, &id, sent - 1).await.unwrap();
    assert_eq!(last, sent - 1);
    assert_eq!(session.step(0).await, undisturbed.step(0).await);
}

/// The same at moments when some parts of the batch have made steps that others have not. In an earlier version the answer, which
/// nobody waited for, was made of both, and the session was lost.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_rollout_may_be_cancelled_at_any_moment() {
    const ENVS: usize = 100;
    let server = Server::start(2).await;
    let mut session = server.session(ENVS as u32).await;
    session.reset(2).await;
    let mut undisturbed = server.session(ENVS as u32).await;
    undisturbed.reset(2).await;
    for k in 0..12 {
        let sent = session.send(Some(rollout(ENVS, 200, true))).await;
        tokio::time::sleep(Duration::from_millis(4 + 6 * k)).await;
        let id = session.id.clone();
        drop(session);
        session = Session::resume(server.client().await, &id, sent - 1).await.unwrap().0;
        assert_eq!(session.step(0).await, undisturbed.step(0).await, "after {k} rollouts");
    }
}

/// The client of a rollout reads nothing, and its connection lives. A new stream of the same session does not wait for
/// it, nor does CloseSession leave it running. In an earlier version the new stream waited for ever.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_rollout_that_nobody_reads_keeps_no_session() {
    let server = Server::start(1).await;
    let (mut session, mut undisturbed) = (server.session(256).await, server.session(256).await);
    assert_eq!(session.reset(2).await, undisturbed.reset(2).await);
    let sent = session.send(Some(rollout(256, 2000, true))).await;
    // The windows of HTTP/2 are full by then.
    tokio::time::sleep(Duration::from_secs(2)).await;
    let begun = Instant::now();
    let (mut again, last) = Session::resume(server.client().await, &session.id, sent - 1).await.unwrap();
    assert!(begun.elapsed() < Duration::from_secs(1), "{:?}", begun.elapsed());
    assert_eq!(last, sent - 1);
    assert_eq!(again.step(0).await, undisturbed.step(0).await);
}
