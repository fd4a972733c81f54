//! Operation of a server: health, reflection, metrics, log and shutdown.

use crate::harness::{ACTIONS, Bearer, Session, client, create, number, step, wave};
use crate::process::{Process, text};
use sandgait::service::proto::environment_service_client::EnvironmentServiceClient;
use sandgait::service::proto::run_session_request::Request;
use sandgait::service::proto::{ListSessionsRequest, Rollout};
use std::collections::HashMap;
use std::time::{Duration, Instant};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tonic::Code;
use tonic::transport::{Channel, Endpoint};
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::health_client::HealthClient;

async fn channel(server: &Process) -> Channel {
    Endpoint::from_shared(format!("http://{}", server.address)).unwrap().connect().await.unwrap()
}

/// A server on TCP that requires a token.
fn with_token() -> (tempfile::TempDir, Process) {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("token");
    std::fs::write(&file, "open-sesame\n").unwrap();
    let server = Process::start(&["--listen", "127.0.0.1:0", "--token-file", text(&file)]);
    (directory, server)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn health_needs_no_token_and_is_answered_until_the_end() {
    let (_directory, server) = with_token();
    let mut health = HealthClient::new(channel(&server).await);
    for service in ["", "sandgait.v1.EnvironmentService", "sandgait.v1.StudyService"] {
        let asked = HealthCheckRequest { service: service.into() };
        assert_eq!(health.check(asked).await.unwrap().into_inner().status(), ServingStatus::Serving, "{service}");
    }
    let unknown = HealthCheckRequest { service: "nothing".into() };
    assert_eq!(health.check(unknown).await.unwrap_err().code(), Code::NotFound);
    let mut watched = health.watch(HealthCheckRequest::default()).await.unwrap().into_inner();
    assert_eq!(watched.message().await.unwrap().unwrap().status(), ServingStatus::Serving);
    let end = tokio::task::spawn_blocking(|| server.end());
    assert_eq!(watched.message().await.unwrap().unwrap().status(), ServingStatus::NotServing);
    assert!(watched.message().await.is_ok_and(|m| m.is_none()), "the stream ends, so that the server can");
    let (_, log) = end.await.unwrap();
    assert!(!log.contains("did not end in time"), "{log}");
}

/// The services that both versions of the reflection protocol list.
async fn reflected(channel: Channel, token: &str) -> [Vec<String>; 2] {
    use tonic_reflection::pb::{v1, v1alpha};
    let mut asks = Bearer(Some(token.into()));
    let one = v1::ServerReflectionRequest {
        host: String::new(),
        message_request: Some(v1::server_reflection_request::MessageRequest::ListServices(String::new())),
    };
    let other = v1alpha::ServerReflectionRequest {
        host: String::new(),
        message_request: Some(v1alpha::server_reflection_request::MessageRequest::ListServices(String::new())),
    };
    let mut client =
        v1::server_reflection_client::ServerReflectionClient::with_interceptor(channel.clone(), asks.clone());
    let answer = client.server_reflection_info(tokio_stream::once(one)).await.unwrap().into_inner().message().await;
    let Some(v1::server_reflection_response::MessageResponse::ListServicesResponse(list)) =
        answer.unwrap().unwrap().message_response
    else {
        panic!("no list")
    };
    let first = list.service.into_iter().map(|s| s.name).collect();
    asks.0 = Some(token.into());
    let mut client = v1alpha::server_reflection_client::ServerReflectionClient::with_interceptor(channel, asks);
    let answer = client.server_reflection_info(tokio_stream::once(other)).await.unwrap().into_inner().message().await;
    let Some(v1alpha::server_reflection_response::MessageResponse::ListServicesResponse(list)) =
        answer.unwrap().unwrap().message_response
    else {
        panic!("no list")
    };
    [first, list.service.into_iter().map(|s| s.name).collect()]
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn reflection_lists_every_service() {
    let (_directory, server) = with_token();
    for mut services in reflected(channel(&server).await, "open-sesame").await {
        services.retain(|name| !name.starts_with("grpc.reflection"));
        services.sort();
        let expected = ["grpc.health.v1.Health", "sandgait.v1.EnvironmentService", "sandgait.v1.StudyService"];
        assert!(expected.iter().all(|name| services.iter().any(|s| s == name)), "{services:?}");
    }
}

/// The numbers on the metrics page, by name and labels.
async fn scrape(address: &str) -> HashMap<String, f64> {
    let mut stream = TcpStream::connect(address).await.unwrap();
    stream.write_all(b"GET /metrics HTTP/1.1\r\nhost: x\r\nconnection: close\r\n\r\n").await.unwrap();
    let mut page = String::new();
    stream.read_to_string(&mut page).await.unwrap();
    assert!(page.starts_with("HTTP/1.1 200 OK") && page.contains("application/openmetrics-text"), "{page}");
    let numbers = page.lines().filter(|l| l.starts_with("sandgait_"));
    numbers.map(|l| l.rsplit_once(' ').unwrap()).map(|(name, n)| (name.into(), n.parse().unwrap())).collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn metrics_count_what_was_done() {
    let server = Process::start(&["--listen", "127.0.0.1:0", "--metrics", "127.0.0.1:0"]);
    let address = server.address_of("metrics are at /metrics");
    let limit = [("max_episode_steps", number(4.0))];
    let mut session = Session::create(server.client().await, 20, &limit).await.unwrap();
    session.reset(0).await;
    for time in 0..10 {
        session.step(time).await;
    }
    let actions: Vec<u8> = [wave(0..20, 0), wave(0..20, 1)].concat().iter().flat_map(|a| a.to_le_bytes()).collect();
    session.ask(Some(Request::Rollout(Rollout { actions: actions.into(), trajectories: false }))).await;
    session.failure(Some(step(&[9.0; 20 * ACTIONS]))).await;
    session.client.create_session(create(0, &[])).await.unwrap_err();
    let page = scrape(&address).await;
    let expected = [
        ("sandgait_environment_steps_total", 20.0 * (10.0 + 2.0)),
        ("sandgait_autoresets_total", 20.0 * 2.0),
        ("sandgait_divergences_total", 0.0),
        ("sandgait_batch_seconds_count{operation=\"reset\"}", 1.0),
        ("sandgait_batch_seconds_count{operation=\"step\"}", 10.0),
        ("sandgait_batch_seconds_count{operation=\"rollout\"}", 1.0),
        ("sandgait_failures_total{code=\"InvalidArgument\"}", 2.0),
        ("sandgait_sessions", 1.0),
        ("sandgait_environments", 20.0),
    ];
    for (name, value) in expected {
        assert_eq!(page.get(name), Some(&value), "{name} in {page:#?}");
    }
    assert!(page["sandgait_memory_reserved_bytes"] > 20.0 * 1000.0);
    let seconds = page["sandgait_batch_seconds_sum{operation=\"step\"}"];
    assert!(seconds > 0.0 && seconds < 10.0, "{seconds}");
    drop(session);
    let (_, log) = server.end();
    assert!(log.contains("metrics are at /metrics"), "{log}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_log_can_be_read_by_programs() {
    let directory = tempfile::tempdir().unwrap();
    let address = format!("unix:{}", directory.path().join("sock").display());
    let server = Process::start(&["--listen", &address, "--log-format", "json"]);
    let mut session = Session::create(server.client().await, 2, &[]).await.unwrap();
    let listed = session.client.list_sessions(ListSessionsRequest {}).await.unwrap().into_inner().sessions;
    let name = listed[0].name.clone();
    let id = session.id.clone();
    session.reset(0).await;
    let (_, log) = server.end();
    let lines: Vec<serde_json::Value> = log.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let created = lines.iter().find(|l| l["fields"]["message"] == "a session was created").unwrap();
    assert_eq!((&created["fields"]["session"], &created["fields"]["envs"]), (&name.into(), &2.into()));
    assert!(!log.contains(&id), "an id is the right to use a session");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_call_past_its_deadline_leaves_nothing_behind() {
    let server = Process::start(&["--listen", "127.0.0.1:0"]);
    let mut plain = EnvironmentServiceClient::new(channel(&server).await);
    let mut call = tonic::Request::new(create(65_536, &[]));
    call.set_timeout(Duration::from_millis(2));
    let status = plain.create_session(call).await.unwrap_err();
    assert!(matches!(status.code(), Code::DeadlineExceeded | Code::Cancelled), "{status:?}");
    // A session that was created for a client that no longer waits is freed at once, not at the end of its lease.
    let begun = Instant::now();
    tokio::time::sleep(Duration::from_millis(300)).await;
    while !plain.list_sessions(ListSessionsRequest {}).await.unwrap().into_inner().sessions.is_empty() {
        assert!(begun.elapsed() < Duration::from_secs(60), "the session is still there, and it is no lease");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    let (_, log) = tokio::task::spawn_blocking(|| server.end()).await.unwrap();
    assert!(!log.contains("a session was created"), "making 65,536 environments was not broken off: {log}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn open_calls_do_not_delay_the_shutdown() {
    let server = Process::start(&["--listen", "127.0.0.1:0"]);
    // A rollout that takes minutes, and another one whose client reads nothing.
    let client = client(channel(&server).await, Bearer::default());
    let mut sessions = Vec::new();
    for trajectories in [false, true] {
        let mut session = Session::create(client.clone(), 256, &[]).await.unwrap();
        session.reset(0).await;
        let actions: Vec<u8> = wave(0..256, 0).repeat(20_000).iter().flat_map(|a| a.to_le_bytes()).collect();
        session.send(Some(Request::Rollout(Rollout { actions: actions.into(), trajectories }))).await;
        sessions.push(session);
    }
    tokio::time::sleep(Duration::from_millis(500)).await;
    let (time, log) = tokio::task::spawn_blocking(|| server.end()).await.unwrap();
    assert!(time < Duration::from_secs(60), "the rollouts take minutes; {time:?}: {log}");
}
