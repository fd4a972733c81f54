//! The service as documented in `proto/sandgait/v1/`, over a real socket.

mod bad_input;
mod determinism;
mod fuzz;
mod harness;
mod large;
#[path = "../testbed/long.rs"]
mod long;
mod mutate;
mod policies;
mod raw;
mod rollouts;
mod seeing;
mod sessions;
mod snapshots;
mod studies;
#[expect(dead_code, reason = "the clean log is for other tests")]
#[path = "../testbed/mod.rs"]
mod testbed;
mod traps;

use harness::{ACTIONS, Server, Session, TASK, floats, number, options, text};
use sandgait::service::PROTOCOL;
use sandgait::service::proto::run_session_request::Request;
use sandgait::service::proto::{DescribeRequest, Reset};

#[tokio::test]
async fn describe_names_every_number() {
    let server = Server::start(1).await;
    let description = server.client().await.describe(DescribeRequest {}).await.unwrap().into_inner();
    assert_eq!((description.version.as_str(), description.protocol), (env!("CARGO_PKG_VERSION"), PROTOCOL));
    let task = description.tasks.iter().find(|t| t.id == TASK).unwrap();
    assert_eq!((task.action.len(), task.observation.len()), (ACTIONS, 3 * 3 + 5 * ACTIONS + 2));
    let tables = [&task.observation, &task.action, &task.info];
    assert!(tables.into_iter().flatten().all(|c| !c.name.is_empty() && !c.unit.is_empty() && c.low < c.high));
    assert!(task.reward_terms > 0 && (task.reward_terms as usize) < task.info.len());
    assert!(task.options.iter().all(|o| !o.summary.is_empty() && o.default_value.is_some()));
    assert!(task.options.iter().any(|o| o.name == "leg" && o.at_reset));
}

#[tokio::test]
async fn an_episode_from_reset_to_truncation() {
    let server = Server::start(2).await;
    let steps = 5;
    let limit = [("max_episode_steps", number(f64::from(steps)))];
    let mut session = Session::create(server.client().await, 3, &limit).await.unwrap();
    let (wide, info) = (session.task.observation.len(), session.task.info.len());
    assert_eq!(session.task.max_episode_steps, steps);
    let first = session.reset(11).await;
    assert_eq!((first.observations.len(), first.rewards.len()), (4 * 3 * wide, 4 * 3));
    assert!(first.final_indices.is_empty() && first.infos.iter().all(|b| *b == 0));
    for time in 1..=steps as usize {
        let batch = session.step(time).await;
        assert_eq!((batch.infos.len(), batch.terminated.len()), (4 * 3 * info, 3));
        let (rewards, infos) = (floats(&batch.rewards), floats(&batch.infos));
        for (reward, row) in rewards.iter().zip(infos.chunks_exact(info)) {
            assert!(reward.is_finite());
            assert_eq!(*reward, row[..session.task.reward_terms as usize].iter().sum::<f32>());
        }
        let last = time == steps as usize;
        assert_eq!(batch.truncated.as_ref(), [u8::from(last); 3]);
        assert_eq!(batch.terminated.as_ref(), [0; 3]);
        // In SAME_STEP the next episode has begun, and the answer also has the last row of the old episode.
        assert_eq!(batch.final_observations.len(), if last { 4 * 3 * wide } else { 0 });
        assert_eq!(batch.final_indices.len(), if last { 4 * 3 } else { 0 });
        if last {
            assert_ne!(batch.observations, batch.final_observations);
        }
    }
}

#[tokio::test]
async fn a_masked_reset_leaves_the_others_alone() {
    let server = Server::start(1).await;
    let mut session = server.session(3).await;
    session.reset(0).await;
    let before = floats(&session.step(1).await.observations);
    let reset = Reset { seeds: vec![5, 6, 7], mask: vec![0, 1, 0].into(), options: None };
    let after = floats(&session.batch(Request::Reset(reset)).await.observations);
    let wide = session.task.observation.len();
    let row = |rows: &[f32], i: usize| rows[i * wide..][..wide].to_vec();
    assert_eq!((row(&before, 0), row(&before, 2)), (row(&after, 0), row(&after, 2)));
    assert_ne!(row(&before, 1), row(&after, 1));
}

/// A reset with options changes the chosen environment only. It then equals an environment of a session that was made
/// with these options, also after a further reset without options. The other environment equals one of a session that
/// was made without options.
#[tokio::test]
async fn options_change_at_reset_and_hold() {
    let server = Server::start(1).await;
    let command = prost_types::ListValue { values: vec![number(0.25), number(0.25)] };
    let command = prost_types::Value { kind: Some(prost_types::value::Kind::ListValue(command)) };
    let changes = [("leg", text("C")), ("medium", text("poppy-close")), ("command", command)];
    let mut session = server.session(2).await;
    let mut plain = server.session(2).await;
    let mut made = Session::create(server.client().await, 2, &changes).await.unwrap();
    let wide = session.task.observation.len();
    session.reset(3).await;
    for round in 0..2 {
        let mask = if round == 0 { vec![1, 0] } else { Vec::new() };
        let options = if round == 0 { options(&changes) } else { None };
        session.batch(Request::Reset(Reset { seeds: vec![3, 4], mask: mask.into(), options })).await;
        plain.reset(3).await;
        made.reset(3).await;
        for time in 0..20 {
            let [changed, plain, made] = [&mut session, &mut plain, &mut made];
            let (changed, plain, made) = (changed.step(time).await, plain.step(time).await, made.step(time).await);
            let [changed, plain, made] = [changed, plain, made].map(|batch| floats(&batch.observations));
            assert_eq!(changed[..wide], made[..wide], "round {round}, step {time}");
            assert_eq!(changed[wide..], plain[wide..], "round {round}, step {time}");
            assert_ne!(changed[..wide], plain[..wide], "round {round}, step {time}");
        }
    }
}

#[tokio::test]
async fn requests_sent_ahead_are_answered_in_order() {
    let server = Server::start(2).await;
    let (mut ahead, mut turn_by_turn) = (server.session(5).await, server.session(5).await);
    let first = turn_by_turn.reset(1).await;
    let mut expected = vec![first];
    for time in 0..6 {
        expected.push(turn_by_turn.step(time).await);
    }
    let seeds = (1..=5).collect();
    ahead.send(Some(Request::Reset(Reset { seeds, ..Default::default() }))).await;
    for time in 0..6 {
        ahead.send(Some(harness::step(&harness::wave(0..5, time)))).await;
    }
    for (i, batch) in expected.into_iter().enumerate() {
        let (sequence, response) = ahead.receive().await.unwrap();
        assert_eq!(sequence, i as u64 + 1);
        assert_eq!(response, sandgait::service::proto::run_session_response::Response::Batch(batch));
    }
}
