//! Whose environments are whose, and when they end.

use crate::harness::{Server, Session, create, step, wave};
use sandgait::service::Limits;
use sandgait::service::proto::run_session_request::Request;
use sandgait::service::proto::{CloseSessionRequest, Reset, RunSessionRequest};
use std::time::Duration;
use tonic::Code;

/// Waits until `ready`, as long as a slow machine may take.
pub async fn until(mut ready: impl AsyncFnMut() -> bool) {
    for _ in 0..500 {
        if ready().await {
            return;
        }
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    panic!("not within 5 s");
}

/// Does the server still know this session?
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

#[tokio::test]
async fn a_session_ends_with_its_stream() {
    let server = Server::start(1).await;
    let mut session = server.session(2).await;
    session.reset(0).await;
    let id = session.id.clone();
    drop(session);
    // A dropped client closes its connection; the server hears of it a moment later.
    tokio::time::sleep(Duration::from_millis(200)).await;
    assert!(!is_known(&server, &id).await);
}

#[tokio::test]
async fn a_client_that_dies_in_mid_step_leaves_no_trace() {
    let limits = Limits { sessions: 1, ..Default::default() };
    let server = Server::with_limits(1, limits).await;
    for _ in 0..5 {
        let mut session = None;
        until(async || {
            session = Session::create(server.client().await, 64, &[]).await.ok();
            session.is_some()
        })
        .await;
        let mut session = session.unwrap();
        session.reset(0).await;
        session.send(Some(step(&wave(0..64, 0)))).await;
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
}

#[tokio::test]
async fn one_stream_a_session() {
    let server = Server::start(1).await;
    let (mut first, mut second) = (server.session(1).await, server.session(1).await);
    first.reset(0).await;
    second.id = first.id.clone();
    second.send(Some(Request::Reset(Reset::default()))).await;
    let status = second.receive().await.unwrap_err();
    assert_eq!(status.code(), Code::FailedPrecondition);
    assert!(status.message().contains("already has a stream"));
    first.step(0).await;
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
    session.requests.send(RunSessionRequest { session_id: String::new(), sequence: 7, request }).await.unwrap();
    assert_eq!(session.receive().await.unwrap().0, 7);
}

#[tokio::test]
async fn a_session_without_a_stream_expires() {
    let limits = Limits { unattached: Duration::from_millis(50), ..Default::default() };
    let server = Server::with_limits(1, limits).await;
    let mut attached = server.session(1).await;
    attached.reset(0).await;
    let created = server.client().await.create_session(create(1, &[])).await.unwrap().into_inner();
    tokio::time::sleep(Duration::from_millis(300)).await;
    assert!(!is_known(&server, &created.session_id).await);
    attached.step(0).await;
}

#[tokio::test]
async fn shutdown_answers_the_step_in_flight() {
    let mut server = Server::start(1).await;
    let mut session = server.session(256).await;
    session.reset(0).await;
    session.send(Some(step(&wave(0..256, 0)))).await;
    tokio::time::sleep(Duration::from_millis(2)).await;
    server.stop.cancel();
    // Whether the step was read before the stop or not, the stream ends with a status that says why.
    let mut last = session.receive().await;
    if last.is_ok() {
        last = session.receive().await;
    }
    let status = last.unwrap_err();
    assert_eq!(status.code(), Code::Unavailable);
    assert!(status.message().contains("shutting down"));
    let done = tokio::time::timeout(Duration::from_secs(5), server.done.take().unwrap()).await;
    done.unwrap().unwrap().unwrap();
}
