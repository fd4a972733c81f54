//! Wrong requests of every kind: the answer names field, index and range, and the session goes on unchanged.

use crate::harness::{Server, Session, create, number, options, step, text, wave};
use sandgait::service::proto::run_session_request::Request;
use sandgait::service::proto::{CloseSessionRequest, CreateSessionRequest, Failure, Reset, RunSessionRequest, Step};
use sandgait::service::{Limits, PROTOCOL};
use tonic::Code;

fn check(failure: &Failure, code: Code, words: &[&str]) {
    assert_eq!(failure.code, i32::from(code), "{}", failure.message);
    for word in words {
        assert!(failure.message.contains(word), "{:?} lacks {word:?}", failure.message);
    }
}

/// Of two equal sessions one gets the request `bad` between a reset and a step. Afterwards the answers of both must be
/// bit-identical.
async fn refused(bad: Option<Request>, code: Code, words: &[&str]) {
    let server = Server::start(1).await;
    let (mut session, mut undisturbed) = (server.session(3).await, server.session(3).await);
    assert_eq!(session.reset(1).await, undisturbed.reset(1).await);
    assert_eq!(session.step(0).await, undisturbed.step(0).await);
    check(&session.failure(bad).await, code, words);
    assert_eq!(session.step(1).await, undisturbed.step(1).await);
}

fn spoiled(value: f32) -> Option<Request> {
    let mut actions = wave(0..3, 0);
    actions[2 * 6 + 4] = value;
    Some(step(&actions))
}

fn reset_with(fields: &[(&str, prost_types::Value)]) -> Option<Request> {
    Some(Request::Reset(Reset { options: options(fields), ..Default::default() }))
}

#[tokio::test]
async fn wrong_actions() {
    let invalid = Code::InvalidArgument;
    refused(Some(step(&wave(0..4, 0))), invalid, &["actions", "24 numbers", "18", "[3, 6]"]).await;
    refused(Some(step(&[])), invalid, &["actions", "0 numbers"]).await;
    refused(
        Some(Request::Step(Step { actions: vec![0; 70].into(), ..Default::default() })),
        invalid,
        &["actions", "70 bytes"],
    )
    .await;
    let held = |held: &[u8]| match step(&wave(0..3, 0)) {
        Request::Step(step) => Some(Request::Step(Step { held: held.to_vec().into(), ..step })),
        other => Some(other),
    };
    refused(held(&[1, 0]), invalid, &["held", "2 entries for 3"]).await;
    refused(held(&[1, 0, 2]), invalid, &["held[2]", "2 is neither 0 nor 1"]).await;
    for (value, name) in [(f32::NAN, "NaN"), (1.5, "1.5"), (-1.001, "-1.001"), (f32::INFINITY, "inf")] {
        refused(spoiled(value), invalid, &["actions[2][4]", name, "left-middle", "[-1, 1]"]).await;
    }
}

#[tokio::test]
async fn wrong_resets() {
    let invalid = Code::InvalidArgument;
    let reset = |seeds: &[u64], mask: &[u8]| {
        let mask = mask.to_vec().into();
        Some(Request::Reset(Reset { seeds: seeds.to_vec(), mask, options: None }))
    };
    refused(reset(&[1, 2], &[]), invalid, &["seeds", "2 entries for 3"]).await;
    refused(reset(&[], &[1, 1, 1, 1]), invalid, &["mask", "4 entries for 3"]).await;
    refused(reset(&[], &[1, 7, 0]), invalid, &["mask[1]", "7"]).await;
    refused(None, invalid, &["neither reset, step"]).await;
}

#[tokio::test]
async fn wrong_options_at_reset() {
    let invalid = Code::InvalidArgument;
    refused(reset_with(&[("gravity", number(1.0))]), invalid, &["gravity", "slope_deg"]).await;
    refused(reset_with(&[("dt", number(1e-3))]), invalid, &["dt"]).await;
    refused(reset_with(&[("medium", text("moon"))]), invalid, &["moon", "poppy-loose"]).await;
    refused(reset_with(&[("leg", text("Q"))]), invalid, &["Q", "revL"]).await;
    refused(reset_with(&[("slope_deg", number(80.0))]), invalid, &["slope_deg", "80", "[-35, 35]"]).await;
    refused(reset_with(&[("slope_deg", text("steep"))]), invalid, &["slope_deg", "steep"]).await;
    refused(reset_with(&[("payload", number(f64::NAN))]), invalid, &["payload", "NaN"]).await;
}

#[tokio::test]
async fn a_step_before_any_reset() {
    let server = Server::start(1).await;
    let mut session = server.session(3).await;
    let out_of_order = Code::FailedPrecondition;
    check(&session.failure(Some(step(&wave(0..3, 0)))).await, out_of_order, &["before reset", "environment 0"]);
    let some = Reset { mask: vec![1, 0, 1].into(), ..Default::default() };
    session.batch(Request::Reset(some)).await;
    check(&session.failure(Some(step(&wave(0..3, 0)))).await, out_of_order, &["before reset", "environment 1"]);
    session.reset(0).await;
    session.step(0).await;
}

#[tokio::test]
async fn another_sessions_name_inside_a_stream() {
    let server = Server::start(1).await;
    let mut session = server.session(1).await;
    session.reset(0).await;
    let request = Some(Request::Reset(Reset::default()));
    let message = RunSessionRequest { session_id: "other".into(), sequence: 9, request };
    session.requests.send(message).await.unwrap();
    let (sequence, response) = session.receive().await.unwrap();
    let sandgait::service::proto::run_session_response::Response::Failure(failure) = response else { panic!() };
    assert_eq!(sequence, 9);
    check(&failure, Code::InvalidArgument, &["session_id", "other"]);
    session.step(0).await;
}

async fn not_created(request: CreateSessionRequest, code: Code, words: &[&str]) {
    let server =
        Server::with_limits(1, Limits { sessions: 2, environments: 100, memory: 1 << 18, ..Default::default() });
    let status = server.await.client().await.create_session(request).await.unwrap_err();
    check(&Failure { code: status.code().into(), message: status.message().into() }, code, words);
}

#[tokio::test]
async fn impossible_sessions_are_refused() {
    let invalid = Code::InvalidArgument;
    let task_id = "sandgait/Swim-v0".to_owned();
    not_created(CreateSessionRequest { task_id, ..create(1, &[]) }, invalid, &["Swim", "HexapodGait-v1"]).await;
    let protocol = PROTOCOL + 1;
    not_created(CreateSessionRequest { protocol, ..create(1, &[]) }, invalid, &["protocol", "update the server"]).await;
    not_created(CreateSessionRequest { protocol: 0, ..create(1, &[]) }, invalid, &["update the client"]).await;
    not_created(create(0, &[]), invalid, &["num_envs", "0", "[1, 100]"]).await;
    not_created(create(101, &[]), Code::ResourceExhausted, &["num_envs", "101", "[1, 100]"]).await;
    not_created(create(100, &[]), Code::ResourceExhausted, &["num_envs", "MiB"]).await;
    not_created(create(1, &[("legs", text("L"))]), invalid, &["legs", "medium"]).await;
    not_created(create(1, &[("engine", text("warp"))]), invalid, &["engine", "warp", "lanes"]).await;
    not_created(create(1, &[("robot", text("/etc/passwd"))]), invalid, &["robot", "xplorer"]).await;
    not_created(create(1, &[("robot", text("mine.toml"))]), invalid, &["robot", "xplorer"]).await;
    not_created(create(1, &[("dt", number(-1.0))]), invalid, &["dt", "-1"]).await;
    not_created(create(1, &[("dt", number(0.003))]), invalid, &["dt", "0.003", "control period"]).await;
    not_created(create(1, &[("max_episode_steps", number(2.5))]), invalid, &["max_episode_steps", "2.5"]).await;
    not_created(create(1, &[("max_episode_steps", number(0.0))]), invalid, &["max_episode_steps", "0"]).await;
}

#[tokio::test]
async fn unknown_sessions_are_refused() {
    let server = Server::start(1).await;
    let mut client = server.client().await;
    let close = CloseSessionRequest { session_id: "x".into() };
    assert_eq!(client.close_session(close).await.unwrap_err().code(), Code::NotFound);
    let mut session = server.session(1).await;
    session.id = "x".into();
    session.send(Some(Request::Reset(Reset::default()))).await;
    let status = session.receive().await.unwrap_err();
    assert_eq!(status.code(), Code::NotFound);
    assert!(status.message().contains("\"x\""));
}

#[tokio::test]
async fn sessions_are_returned_to_the_limit() {
    let server = Server::with_limits(
        1,
        Limits { sessions: 2, lease: std::time::Duration::from_millis(1000), ..Default::default() },
    )
    .await;
    let (_a, mut b) = (server.session(1).await, server.session(1).await);
    b.reset(0).await;
    let full = Session::create(server.client().await, 1, &[]).await.err().unwrap();
    assert_eq!(full.code(), Code::ResourceExhausted);
    assert!(full.message().contains("all 2 sessions"));
    drop(b);
    crate::harness::until(async || Session::create(server.client().await, 1, &[]).await.is_ok()).await;
}
