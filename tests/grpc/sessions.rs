//! Which session environments belong to, and when sessions end.

use crate::harness::{Server, Session, create, step, until, wave};
use sandgait::service::Limits;
use sandgait::service::proto::run_session_response::Response;
use sandgait::service::proto::{CloseSessionRequest, DescribeSessionRequest, ListSessionsRequest, RunSessionRequest};
use std::time::{Duration, Instant};
use tonic::Code;

/// Does the session still exist?
async fn is_known(server: &Server, id: &str) -> bool {
    let close = CloseSessionRequest { session_id: id.into() };
    server.client().await.close_session(close).await.is_ok()
}

#[tokio::test]
async fn two_sessions_do_not_see_each_other() {
    let server = Server::start(2).await;
    let mut alone = server.session(4).await;
    alone.reset(5).await;
    let mut expected = Vec::new();
    for time in 0..10 {
        expected.push(alone.step(time).await);
    }
    let (mut one, mut other) = (server.session(4).await, server.session(33).await);
    assert_ne!(one.id, other.id);
    one.reset(5).await;
    other.reset(99).await;
    for (time, batch) in expected.into_iter().enumerate() {
        let (step, _) = tokio::join!(one.step(time), other.step(time + 1));
        assert_eq!(step, batch);
    }
}

/// The client dies during a step. The server finishes the step, and then the session's lease runs out.
#[tokio::test]
async fn a_client_that_dies_in_mid_step_leaves_no_trace() {
    const ENVS: usize = 32_768;
    let limits = Limits { sessions: 1, lease: Duration::from_secs(1), ..Default::default() };
    let server = Server::with_limits(1, limits).await;
    let mut looks = server.client().await;
    let mut list = async || looks.list_sessions(ListSessionsRequest {}).await.unwrap().into_inner().sessions;
    for _ in 0..2 {
        // A step of all these environments takes some 300 ms.
        let mut session = None;
        until(async || {
            session = Session::create(server.client().await, ENVS as u32, &[]).await.ok();
            session.is_some()
        })
        .await;
        let mut session = session.unwrap();
        session.reset(0).await;
        let begun = Instant::now();
        session.step(0).await;
        let whole = begun.elapsed();
        let sent = session.send(Some(step(&wave(0..ENVS, 1)))).await;
        // Long enough for the request to arrive on a loaded machine, and shorter than its step.
        tokio::time::sleep(whole / 4).await;
        drop(session);
        let [summary] = &list().await[..] else { panic!("one session") };
        assert_eq!(summary.sequence, sent - 1, "the step has ended already");
        until(async || list().await.first().is_none_or(|s| s.sequence == sent)).await;
        assert_eq!(list().await.len(), 1, "the step was not carried out");
        until(async || list().await.is_empty()).await;
    }
}

#[tokio::test]
async fn the_newest_stream_has_the_session() {
    let server = Server::start(1).await;
    let mut first = server.session(1).await;
    first.reset(0).await;
    let (mut second, last) = Session::resume(server.client().await, &first.id, 1).await.unwrap();
    assert_eq!(last, 1);
    let status = first.receive().await.unwrap_err();
    assert_eq!(status.code(), Code::Aborted);
    assert!(status.message().contains("another stream has taken"), "{}", status.message());
    second.step(0).await;
}

/// A client that lost its stream resumes the session, whether or not its last request was carried out.
#[tokio::test]
async fn a_lost_stream_neither_loses_nor_repeats_a_step() {
    let server = Server::start(2).await;
    let (mut session, mut undisturbed) = (server.session(20).await, server.session(20).await);
    assert_eq!(session.reset(3).await, undisturbed.reset(3).await);
    for time in 0..30_u64 {
        let expected = undisturbed.step(time as usize).await;
        if time % 3 == 0 {
            let sent = session.send(Some(step(&wave(0..20, time as usize)))).await;
            tokio::time::sleep(Duration::from_micros(400 * (time % 7))).await;
            let id = session.id.clone();
            drop(session); // before, during or after the step
            let (again, last) = Session::resume(server.client().await, &id, sent - 1).await.unwrap();
            assert!(last == sent || last == sent - 1, "{last} {sent}");
            session = again;
        }
        assert_eq!(session.step(time as usize).await, expected, "step {time}");
    }
}

#[tokio::test]
async fn a_wrong_sequence_number_is_refused_and_changes_nothing() {
    let server = Server::start(1).await;
    let (mut session, mut undisturbed) = (server.session(2).await, server.session(2).await);
    assert_eq!(session.reset(3).await, undisturbed.reset(3).await);
    for wrong in [3, 9, u64::MAX] {
        let message = RunSessionRequest { sequence: wrong, request: Some(step(&wave(0..2, 0))), ..Default::default() };
        session.requests.send(message).await.unwrap();
        let (sequence, response) = session.receive().await.unwrap();
        let Response::Failure(failure) = response else { panic!("{response:?}") };
        assert_eq!((sequence, failure.code), (wrong, Code::FailedPrecondition.into()));
        assert!(failure.message.contains("2 is next"), "{}", failure.message);
    }
    assert_eq!(session.step(1).await, undisturbed.step(1).await);
}

#[tokio::test]
async fn lists_of_sessions_do_not_reveal_their_ids() {
    let server = Server::start(1).await;
    let mut session = server.session(3).await;
    session.reset(0).await;
    let mut client = server.client().await;
    let list = client.list_sessions(ListSessionsRequest {}).await.unwrap().into_inner().sessions;
    let [summary] = &list[..] else { panic!("{list:?}") };
    assert_eq!((summary.num_envs, summary.attached, summary.sequence), (3, true, 1));
    assert!(!session.id.starts_with(&summary.name));
    let described = client.describe_session(DescribeSessionRequest { session_id: session.id.clone() }).await.unwrap();
    let described = described.into_inner();
    assert_eq!((described.task.as_ref(), described.summary.as_ref()), (Some(&session.task), Some(summary)));
    let status = client.describe_session(DescribeSessionRequest { session_id: "x".into() }).await.unwrap_err();
    assert_eq!(status.code(), Code::NotFound);
}

#[tokio::test]
async fn closing_ends_the_stream() {
    let server = Server::start(1).await;
    let mut session = server.session(1).await;
    session.reset(0).await;
    let close = CloseSessionRequest { session_id: session.id.clone() };
    session.client.close_session(close).await.unwrap();
    assert_eq!(session.receive().await.unwrap_err().code(), Code::Cancelled);
    assert!(!is_known(&server, &session.id).await);
}

#[tokio::test]
async fn only_the_first_message_names_the_session() {
    let server = Server::start(1).await;
    let mut session = server.session(1).await;
    session.reset(0).await;
    let request = Some(step(&wave(0..1, 0)));
    session.requests.send(RunSessionRequest { session_id: String::new(), sequence: 2, request }).await.unwrap();
    assert_eq!(session.receive().await.unwrap().0, 2);
}

/// A first message without a request gives an error, but opens the session's stream. A first message without a session ends the
/// stream.
#[tokio::test]
async fn a_first_message_without_a_request_or_a_session() {
    let server = Server::start(1).await;
    let mut session = server.session(2).await;
    let failure = session.failure(None).await;
    assert_eq!(failure.code, i32::from(Code::InvalidArgument));
    assert_eq!(
        failure.message,
        "request: neither reset, step, attach, save, restore, rollout, policy_rollout, render, observe nor set_command"
    );
    session.reset(0).await;
    for request in [None, Some(step(&wave(0..2, 0)))] {
        let mut nameless = server.session(2).await;
        let message = RunSessionRequest { session_id: String::new(), sequence: 1, request };
        nameless.requests.send(message).await.unwrap();
        let status = nameless.receive().await.unwrap_err();
        assert_eq!(status.code(), Code::InvalidArgument);
        assert_eq!(status.message(), "session_id: missing; a stream's first message names its session");
    }
    session.step(0).await;
}

#[tokio::test]
async fn a_session_without_a_stream_expires() {
    let limits = Limits { lease: Duration::from_millis(50), ..Default::default() };
    let server = Server::with_limits(1, limits).await;
    let mut attached = server.session(1).await;
    attached.reset(0).await;
    let created = server.client().await.create_session(create(1, &[])).await.unwrap().into_inner();
    tokio::time::sleep(Duration::from_millis(300)).await;
    assert!(!is_known(&server, &created.session_id).await);
    attached.step(0).await;
}

/// A server that is stopped during a step finishes the step and answers it. Then the stream ends with a status that states the
/// reason. On a slow machine the server may stop before it has read the request; then the test tries again.
#[tokio::test]
async fn shutdown_answers_the_step_in_flight() {
    let mut answered = 0;
    for _ in 0..10 {
        let mut server = Server::start(1).await;
        let mut session = server.session(1024).await;
        session.reset(0).await;
        let begun = std::time::Instant::now();
        session.step(0).await;
        let alone = begun.elapsed();
        session.send(Some(step(&wave(0..1024, 1)))).await;
        tokio::time::sleep(alone / 4).await;
        server.stop.cancel();
        let mut last = session.receive().await;
        if last.is_ok() {
            answered += 1;
            last = session.receive().await;
        }
        let status = last.unwrap_err();
        assert_eq!(status.code(), Code::Unavailable);
        assert!(status.message().contains("shutting down"));
        server.done.take().unwrap().await.unwrap().unwrap();
        if answered > 0 {
            return;
        }
    }
    panic!("no step in flight was answered");
}
