//! What once filled a server's memory or kept it busy, though each single request is allowed: many rocks, many open calls
//! without the token, answers that nobody reads, options that each environment has for itself, and steps of very many
//! time steps. All at once, memory stays bounded, another client steps quickly, and nothing is lost at the end.

use crate::harness::{Bearer, Client, Session, client, create, number, options, step, text, wave};
use crate::process::{self, Process};
use crate::{ALONE, resident, table};
use prost::Message as _;
use sandgait::service::proto::run_session_request::Request;
use sandgait::service::proto::run_session_response::Response;
use sandgait::service::proto::study_service_client::StudyServiceClient;
use sandgait::service::proto::{CreateSessionRequest, DescribeSessionRequest, Reset, StudyRequest};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};
use tokio::net::TcpStream;
use tonic::Code;
use tonic::transport::{Channel, Endpoint};

/// Bounds as in `doors.rs`.
const LIMIT: &str = "64";
const MOST: f64 = 160.0;
const WAIT: f64 = 100.0;

const TOKEN: &str = "open-sesame";
const KINDS: [&str; 6] = ["rocks", "strangers", "unread descriptions", "columns", "evaluations", "time steps"];
const ROCKS: &str = "sandgait/HexapodRocks-v1";

/// How long each kind is asked for, at least [s].
const TIME: u64 = 6;

#[derive(Clone)]
struct Target {
    address: String,
    stop: Arc<AtomicBool>,
    done: Arc<[AtomicUsize; KINDS.len()]>,
}

impl Target {
    fn goes_on(&self) -> bool {
        !self.stop.load(Ordering::Relaxed)
    }

    fn count(&self, kind: usize) {
        self.done[kind].fetch_add(1, Ordering::Relaxed);
    }

    async fn channel(&self) -> Channel {
        Endpoint::from_shared(format!("http://{}", self.address)).unwrap().connect().await.unwrap()
    }

    async fn client(&self) -> Client {
        client(self.channel().await, Bearer(Some(TOKEN.into())))
    }

    /// A session that has been reset; None if others have the memory for it.
    async fn session(&self, request: CreateSessionRequest) -> Option<Session> {
        let Ok(mut session) = Session::create_by(self.client().await, request).await else {
            tokio::time::sleep(Duration::from_millis(50)).await;
            return None;
        };
        session.reset(0).await;
        Some(session)
    }

    /// A connection without TLS, below tonic. `window`: bytes that the server may send on a stream before they are read.
    async fn raw(&self, window: u32) -> Option<h2::client::SendRequest<bytes::Bytes>> {
        let stream = TcpStream::connect(&self.address).await.ok()?;
        let mut builder = h2::client::Builder::new();
        let (client, connection) = builder.initial_window_size(window).handshake(stream).await.ok()?;
        tokio::spawn(connection);
        client.ready().await.ok()
    }
}

fn rocks(count: f64) -> prost_types::Value {
    table(&[("count", number(count))])
}

/// Environments of one rock that a reset gives 64 rocks, and environments that begin with 64.
async fn many_rocks(target: Target) {
    while target.goes_on() {
        let request = |envs, count| {
            let fields = [("rocks", rocks(count))];
            CreateSessionRequest { task_id: ROCKS.into(), options: options(&fields), ..create(envs, &[]) }
        };
        let refused = Session::create_by(target.client().await, request(700, 64.0)).await;
        assert_eq!(refused.err().map(|status| status.code()), Some(Code::ResourceExhausted));
        let Some(mut session) = target.session(request(100, 1.0)).await else { continue };
        let reset = Reset { options: options(&[("rocks", rocks(64.0))]), ..Default::default() };
        match session.ask(Some(Request::Reset(reset))).await {
            Response::Failure(failure) => assert_eq!(failure.code, Code::ResourceExhausted as i32),
            other => panic!("{other:?}"),
        }
        target.count(0);
    }
}

/// The head of a call below tonic.
fn head(path: &str, token: bool) -> http::Request<()> {
    let request = http::Request::post(format!("http://localhost/{path}")).header("content-type", "application/grpc");
    let request = if token { request.header("authorization", format!("Bearer {TOKEN}")) } else { request };
    request.body(()).unwrap()
}

/// A message with its length before it.
fn framed(message: &[u8]) -> bytes::Bytes {
    [&[0][..], &(message.len() as u32).to_be_bytes(), message].concat().into()
}

/// A thousand streams of the server's health on each of 20 connections, without the token.
async fn strangers(target: Target) {
    while target.goes_on() {
        let mut calls = Vec::new();
        for _ in 0..20 {
            let Some(mut client) = target.raw(65_535).await else { continue };
            for _ in 0..1000 {
                let Ok(ready) = client.ready().await else { break };
                client = ready;
                let Ok((answer, mut body)) = client.send_request(head("grpc.health.v1.Health/Watch", false), false)
                else {
                    break;
                };
                if body.send_data(framed(&[]), true).is_ok() {
                    calls.push((answer, body));
                }
            }
            target.count(1);
        }
        tokio::time::sleep(Duration::from_millis(500)).await;
    }
}

/// Descriptions of a session with many columns, on connections whose window is closed.
async fn unread_descriptions(target: Target) {
    while target.goes_on() {
        let wide = create(2, &[("history", number(64.0))]);
        let Some(session) = target.session(wide).await else { continue };
        let message = DescribeSessionRequest { session_id: session.id.clone() }.encode_to_vec();
        let mut calls = Vec::new();
        for _ in 0..2 {
            let Some(mut client) = target.raw(0).await else { continue };
            for _ in 0..1000 {
                let Ok(ready) = client.ready().await else { break };
                client = ready;
                let path = "sandgait.v1.EnvironmentService/DescribeSession";
                let Ok((answer, mut body)) = client.send_request(head(path, true), false) else { break };
                if body.send_data(framed(&message), true).is_ok() {
                    calls.push((answer, body));
                }
            }
        }
        target.count(2);
        tokio::time::sleep(Duration::from_secs(1)).await;
    }
}

/// Each environment has options of its own, and with them a table of many columns.
async fn columns(target: Target) {
    while target.goes_on() {
        let Some(mut session) = target.session(create(64, &[("history", number(64.0))])).await else { continue };
        for env in 0..64 {
            let mut mask = vec![0; 64];
            mask[env] = 1;
            let long = format!("zeta={}", 0.5 + env as f64 * 1e-3);
            let fields = [("slope_deg", number(env as f64 * 0.01)), ("medium", text(&long))];
            let reset = Reset { mask: mask.into(), options: options(&fields), ..Default::default() };
            match session.ask(Some(Request::Reset(reset))).await {
                Response::Batch(_) => target.count(3),
                Response::Failure(failure) => assert_eq!(failure.code, Code::ResourceExhausted as i32),
                other => panic!("{other:?}"),
            }
        }
    }
}

/// An evaluation on hundreds of slopes of a task with many columns; its client leaves after a while. Evaluations begin when
/// all others have gone on for a time.
async fn evaluations(target: Target) {
    tokio::time::sleep(Duration::from_secs(TIME)).await;
    while target.goes_on() {
        let channel = target.channel().await;
        let mut studies = StudyServiceClient::with_interceptor(channel, Bearer(Some(TOKEN.into())));
        let slopes = (0..300).map(|k| (f64::from(k) * 0.01).to_string()).collect::<Vec<_>>().join(",");
        let words = ["--option=history=64".to_owned(), format!("--slopes={slopes}"), "--seeds=2".into()];
        let arguments = words.into_iter().chain(["--".into(), "tripod:2".into()]).collect();
        let request = StudyRequest { name: "evaluate".into(), arguments, ..Default::default() };
        if let Ok(answers) = studies.study(request).await {
            let mut answers = answers.into_inner();
            let first = tokio::time::timeout(Duration::from_secs(2), answers.message()).await;
            if matches!(first, Ok(Ok(_))) {
                tokio::time::sleep(Duration::from_millis(1500)).await;
                target.count(4);
            }
        }
    }
}

/// Steps of 20,000 time steps of 256 environments. Their client leaves in the middle.
async fn time_steps(target: Target) {
    while target.goes_on() {
        let Some(mut session) = target.session(create(256, &[("dt", number(1e-6))])).await else { continue };
        session.send(Some(step(&wave(0..256, 0)))).await;
        tokio::time::sleep(Duration::from_millis(400)).await;
        target.count(5);
    }
}

fn server(state: &tempfile::TempDir) -> Process {
    let token = state.path().join("token");
    std::fs::write(&token, TOKEN).unwrap();
    let kept = state.path().join("kept");
    let (token, kept) = (process::text(&token), process::text(&kept));
    let common = ["--listen", "127.0.0.1:0", "--max-memory-mib", LIMIT, "--lease-seconds", "1"];
    Process::start(&[&common[..], &["--token-file", token, "--state-dir", kept]].concat())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn dear_requests_keep_within_memory_all_at_once() {
    let _alone = ALONE.lock().await;
    let state = tempfile::tempdir().unwrap();
    let server = server(&state);
    let target = Target { address: server.address.clone(), stop: Arc::default(), done: Arc::default() };
    let mut witness = target.session(create(8, &[])).await.unwrap();
    let mut undisturbed = target.session(create(8, &[])).await.unwrap();
    let mut expected = Vec::new();
    for time in 0..1500 {
        expected.push(undisturbed.step(time).await.encode_to_vec());
    }
    drop(undisturbed);
    // The threads of these clients are not those of the client whose steps are measured.
    let others = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
    let all = [
        others.spawn(many_rocks(target.clone())),
        others.spawn(strangers(target.clone())),
        others.spawn(unread_descriptions(target.clone())),
        others.spawn(columns(target.clone())),
        others.spawn(evaluations(target.clone())),
        others.spawn(time_steps(target.clone())),
    ];
    // Steps before the evaluations, and beside them.
    let (begun, mut most, mut times) = (Instant::now(), 0.0_f64, [Vec::new(), Vec::new()]);
    let mut steps = 0;
    for (time, expected) in expected[..1400].iter().enumerate() {
        let finished = target.done.iter().all(|n| n.load(Ordering::Relaxed) > 0);
        if begun.elapsed().as_secs() >= TIME && finished {
            break;
        }
        let start = Instant::now();
        assert_eq!(&witness.step(time).await.encode_to_vec(), expected, "step {time}");
        times[usize::from(begun.elapsed().as_secs() >= TIME)].push(start.elapsed().as_secs_f64() * 1e3);
        most = most.max(resident(server.id()));
        steps = time + 1;
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    target.stop.store(true, Ordering::Relaxed);
    for client in all {
        client.await.unwrap();
    }
    others.shutdown_background();
    let [before, beside] = times.map(|mut times| {
        times.sort_by(f64::total_cmp);
        [50, 95, 100].map(|part| times[(times.len() * part / 100).min(times.len() - 1)])
    });
    let done: Vec<_> = KINDS.iter().zip(target.done.iter().map(|n| n.load(Ordering::Relaxed))).collect();
    println!(
        "{done:?}; memory at most {most:.0} MiB; {steps} steps, median, 95 % and longest [ms]: {before:.1?}, beside evaluations {beside:.1?}"
    );
    assert!(most < MOST, "{most} MiB");
    assert!(before[1] < WAIT, "{before:?} ms");
    assert!(beside[1] < WAIT, "{beside:?} ms");
    assert!(done.iter().all(|(_, n)| *n > 0), "{done:?}");
    let id = witness.id.clone();
    let (ended, log) = server.end();
    assert!(ended < Duration::from_secs(5) && log.contains("a session was saved"), "{ended:?} {log}");
    let server = self::server(&state);
    let again = Target { address: server.address.clone(), ..target };
    let (mut witness, _) = Session::resume(again.client().await, &id, steps as u64 + 1).await.unwrap();
    for (time, expected) in expected.iter().enumerate().skip(steps).take(20) {
        assert_eq!(&witness.step(time).await.encode_to_vec(), expected, "step {time} after the restart");
    }
}

/// A step that takes seconds ends soon after its client has left, and when the server stops. Then the session is saved as
/// it was before the step, and the step has the same bits later.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_long_step_ends_with_its_client_and_with_the_server() {
    const ENVS: u32 = 384;
    let _alone = ALONE.lock().await;
    let state = tempfile::tempdir().unwrap();
    let server = server(&state);
    let target = Target { address: server.address.clone(), stop: Arc::default(), done: Arc::default() };
    let request = || create(ENVS, &[("dt", number(1e-6))]);
    let mut session = target.session(request()).await.unwrap();
    let mut other = target.session(create(8, &[])).await.unwrap();
    let actions = wave(0..ENVS as usize, 0);
    session.send(Some(step(&actions))).await;
    let mut times = Vec::new();
    for time in 0..20 {
        let start = Instant::now();
        other.step(time).await;
        times.push(start.elapsed().as_secs_f64() * 1e3);
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    times.sort_by(f64::total_cmp);
    println!("steps of another client beside a long one [ms]: median {:.1}, longest {:.1}", times[10], times[19]);
    assert!(times[18] < WAIT, "{times:?}");
    // The client leaves.
    let id = session.id.clone();
    drop(session);
    tokio::time::sleep(Duration::from_millis(300)).await;
    let before = server.processor_time();
    tokio::time::sleep(Duration::from_millis(500)).await;
    let spent = server.processor_time() - before;
    assert!(spent < 0.15, "{spent} s of work for nobody");
    // The server stops in the middle of the step.
    let (mut session, last) = Session::resume(target.client().await, &id, 1).await.unwrap();
    assert_eq!(last, 1, "the step was not made");
    session.send(Some(step(&actions))).await;
    tokio::time::sleep(Duration::from_millis(300)).await;
    let (ended, log) = server.end();
    assert!(ended < Duration::from_secs(5) && log.contains("a session was saved"), "{ended:?} {log}");
    let server = self::server(&state);
    let again = Target { address: server.address.clone(), ..target };
    let (mut session, last) = Session::resume(again.client().await, &id, 1).await.unwrap();
    assert_eq!(last, 1);
    let interrupted = session.batch(step(&actions)).await;
    drop(session);
    let mut fresh = again.session(request()).await.unwrap();
    assert_eq!(fresh.batch(step(&actions)).await, interrupted);
}
