//! Snapshots: a restored or forked session continues bit-identically, and damaged snapshots are refused.

use crate::harness::{Server, Session, TASK, number, options, text};
use sandgait::service::PROTOCOL;
use sandgait::service::proto::run_session_request::Request;
use sandgait::service::proto::run_session_response::Response;
use sandgait::service::proto::{CreateSessionRequest, Reset, Restore, Save};
use tonic::Code;

pub async fn save(session: &mut Session) -> Vec<u8> {
    match session.ask(Some(Request::Save(Save {}))).await {
        Response::Snapshot(snapshot) => snapshot.data.to_vec(),
        other => panic!("{other:?}"),
    }
}

fn restore(snapshot: &[u8], sources: &[u32]) -> Request {
    let sources = sources.iter().flat_map(|s| s.to_le_bytes()).collect();
    Request::Restore(Restore { snapshot: snapshot.to_vec().into(), sources })
}

async fn of_task(server: &Server, task: &str, envs: u32) -> Session {
    let request = CreateSessionRequest { task_id: task.into(), num_envs: envs, options: None, protocol: PROTOCOL };
    Session::create_by(server.client().await, request).await.unwrap()
}

/// Actions of any task, by step.
fn actions(session: &Session, time: usize) -> Request {
    let count = session.envs * session.task.action.len();
    crate::harness::step(&(0..count).map(|k| ((k * 3 + time) as f32 * 0.37).sin()).collect::<Vec<_>>())
}

/// For every task: a session makes 30 steps over ends of episodes, and another one makes them again from a snapshot.
#[tokio::test]
async fn a_restored_session_goes_on_with_the_same_bits() {
    let server = Server::start(2).await;
    for task in sandgait::env::registry::TASK_IDS {
        let mut one = of_task(&server, task, 5).await;
        one.reset(7).await;
        for time in 0..10 {
            one.batch(actions(&one, time)).await;
        }
        let snapshot = save(&mut one).await;
        let mut other = of_task(&server, task, 5).await;
        let restored = other.batch(restore(&snapshot, &[])).await;
        assert!(restored.rewards.iter().all(|b| *b == 0));
        for time in 10..40 {
            let (a, b) = (one.batch(actions(&one, time)).await, other.batch(actions(&other, time)).await);
            assert_eq!(a, b, "{task}, step {time}");
        }
    }
}

#[tokio::test]
async fn what_resets_changed_and_drew_is_kept() {
    let server = Server::start(1).await;
    let steps = [("max_episode_steps", number(7.0))];
    let mut one = Session::create(server.client().await, 4, &steps).await.unwrap();
    one.reset(1).await;
    let changes = options(&[("leg", text("C")), ("slope_deg", number(5.0))]);
    one.batch(Request::Reset(Reset { seeds: vec![9; 4], mask: vec![0, 1, 1, 0].into(), options: changes })).await;
    one.step(0).await;
    let snapshot = save(&mut one).await;
    let mut other = Session::create(server.client().await, 4, &steps).await.unwrap();
    other.batch(restore(&snapshot, &[])).await;
    for time in 1..20 {
        assert_eq!(one.step(time).await, other.step(time).await, "step {time}");
    }
}

#[tokio::test]
async fn one_environment_is_forked_into_many() {
    let server = Server::start(1).await;
    let mut one = server.session(3).await;
    one.reset(1).await;
    one.step(0).await;
    let snapshot = save(&mut one).await;
    let mut many = server.session(40).await;
    let batch = many.batch(restore(&snapshot, &[2; 40])).await;
    let wide = 4 * many.task.observation.len();
    assert!(batch.observations.chunks(wide).all(|row| row == &batch.observations[..wide]));
    let failure = many.failure(Some(restore(&snapshot, &[3; 40]))).await;
    assert!(failure.message.contains("sources[0]") && failure.message.contains("[0, 3)"), "{}", failure.message);
    let failure = many.failure(Some(restore(&snapshot, &[0; 4]))).await;
    assert!(failure.message.contains("4 entries for 40"), "{}", failure.message);
}

/// A snapshot with any one bit changed is refused, and the server goes on.
#[tokio::test]
async fn a_damaged_snapshot_is_refused() {
    let server = Server::start(1).await;
    let mut session = server.session(2).await;
    let failure = session.failure(Some(Request::Save(Save {}))).await;
    assert_eq!(failure.code, i32::from(Code::FailedPrecondition));
    session.reset(1).await;
    let snapshot = save(&mut session).await;
    let mut undisturbed = server.session(2).await;
    undisturbed.reset(1).await;
    for at in (0..snapshot.len()).step_by(snapshot.len() / 200 + 1).chain([0, 18, 19, 24, 60]) {
        let mut damaged = snapshot.clone();
        damaged[at] ^= 1 << (at % 8);
        let failure = session.failure(Some(restore(&damaged, &[]))).await;
        assert_eq!(failure.code, i32::from(Code::InvalidArgument), "{}", failure.message);
        assert!(failure.message.starts_with("snapshot: "), "{}", failure.message);
        let cut = session.failure(Some(restore(&snapshot[..at], &[]))).await;
        assert_eq!(cut.code, i32::from(Code::InvalidArgument), "{}", cut.message);
    }
    let mut older = snapshot.clone();
    older[19..][..5].copy_from_slice(b"0.0.0");
    let failure = session.failure(Some(restore(&older, &[]))).await;
    assert!(failure.message.contains("0.0.0"), "{}", failure.message);
    let mut legs = of_task(&server, "sandgait/HexapodLegs-v1", 2).await;
    let failure = legs.failure(Some(restore(&snapshot, &[]))).await;
    assert!(failure.message.contains(TASK), "{}", failure.message);
    let mut fine = Session::create(server.client().await, 2, &[("dt", number(5e-4))]).await.unwrap();
    let failure = fine.failure(Some(restore(&snapshot, &[]))).await;
    assert!(failure.message.contains("options"), "{}", failure.message);
    assert_eq!(session.step(0).await, undisturbed.step(0).await);
}
