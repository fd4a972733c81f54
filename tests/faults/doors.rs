//! Makes all the requests that once stopped a server, filled its memory or kept others out, at the same time. The
//! server's memory stays bounded, and another client gets quick answers, bit-identical to those of an idle server.

use crate::harness::{Bearer, Client, Session, client, create, number, options, step, text, wave};
use crate::process::{self, Process};
use crate::robots::{long_chain, many_shapes, robot};
use crate::{ALONE, long, onnx, resident, rollout};
use prost::Message as _;
use sandgait::service::proto::run_session_request::Request;
use sandgait::service::proto::run_session_response::Response;
use sandgait::service::proto::study_input::Form;
use sandgait::service::proto::study_service_client::StudyServiceClient;
use sandgait::service::proto::{
    CloseSessionRequest, CreateSessionRequest, PolicyRollout, Render, Reset, StudyInput, StudyRequest,
};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};
use tokio::net::TcpSocket;
use tonic::transport::Endpoint;
use tonic::{Code, Status};

/// Memory for environments and requests, and the bound of the whole server [MiB].
const LIMIT: &str = "64";
const MOST: f64 = 160.0;

/// Bound of what another client waits for an answer [ms].
const WAIT: f64 = 100.0;

/// How long the requests go on, at least [s]: in `make test`, and in `make test-long`.
const TIME: [u64; 2] = [4, 15];

const TOKEN: &str = "open-sesame";

/// The server, the sign to stop, and how often each kind was answered as it should be.
#[derive(Clone)]
struct Target {
    address: String,
    stop: Arc<AtomicBool>,
    done: Arc<[AtomicUsize; KINDS.len()]>,
}

const KINDS: [&str; 8] =
    ["networks", "robots", "logs", "pictures", "connections", "evaluations", "unread answers", "seeds"];

impl Target {
    fn goes_on(&self) -> bool {
        !self.stop.load(Ordering::Relaxed)
    }

    fn count(&self, kind: usize) {
        self.done[kind].fetch_add(1, Ordering::Relaxed);
    }

    async fn endpoint(&self) -> Result<tonic::transport::Channel, tonic::transport::Error> {
        Endpoint::from_shared(format!("http://{}", self.address)).unwrap().connect().await
    }

    async fn client(&self) -> Client {
        client(self.endpoint().await.unwrap(), Bearer(Some(TOKEN.into())))
    }

    /// A session that has been reset; None if others have the memory for it.
    async fn session(&self, envs: u32) -> Option<Session> {
        let Ok(mut session) = Session::create(self.client().await, envs, &[]).await else {
            tokio::time::sleep(Duration::from_millis(50)).await;
            return None;
        };
        session.reset(0).await;
        Some(session)
    }

    async fn studies(
        &self,
    ) -> StudyServiceClient<tonic::service::interceptor::InterceptedService<tonic::transport::Channel, Bearer>> {
        StudyServiceClient::with_interceptor(self.endpoint().await.unwrap(), Bearer(Some(TOKEN.into())))
    }

    /// Sends a request that must be refused with these words. Returns whether the session goes on: a large request that
    /// waits too long for others' memory ends it.
    async fn refuses(&self, kind: usize, words: &str, session: &mut Session, request: Request) -> bool {
        session.send(Some(request)).await;
        match session.receive().await {
            Ok((_, Response::Failure(failure))) => {
                self.refused(kind, words, Code::from_i32(failure.code), &failure.message);
                true
            }
            Ok(other) => panic!("{}: {other:?}", KINDS[kind]),
            Err(status) => {
                self.refused(kind, words, status.code(), status.message());
                false
            }
        }
    }

    /// Counts a refusal with these words. Any other refusal may only say that others have the memory or the turn.
    fn refused(&self, kind: usize, words: &str, code: Code, message: &str) {
        match code {
            Code::ResourceExhausted if !message.contains(words) => {}
            _ => {
                assert!(message.contains(words), "{}: {message}", KINDS[kind]);
                self.count(kind);
            }
        }
    }
}

/// Networks of very many steps and of very many empty attributes.
async fn networks(target: Target) {
    while target.goes_on() {
        let Some(mut session) = target.session(4).await else { continue };
        let sizes = [session.task.observation.len(), session.task.action.len()].map(|n| n as u64);
        let max = onnx::node("Max", &["x"; 10_000], "y");
        let empty = [onnx::node("Relu", &["x"], "y"), onnx::field(5, b"").repeat(1_500_000)].concat();
        for (node, words) in [(max, "65536 numbers"), (empty, "more than 16384 fields")] {
            let onnx = onnx::file(&[node], &[], sizes).into();
            let request = PolicyRollout { onnx, steps: 10, trajectories: false };
            if !target.refuses(0, words, &mut session, Request::PolicyRollout(request)).await {
                break;
            }
        }
    }
}

/// Robots with very many shapes, and with a very long chain of bodies.
async fn robots(target: Target) {
    let crafted = [(robot(many_shapes), "number of shapes"), (robot(long_chain), "has no legs")];
    while target.goes_on() {
        for (robot, words) in &crafted {
            let fields = [("robot", text(robot)), ("ground", text("rigid"))];
            let task_id = "sandgait/LeggedVelocity-v1".into();
            let request = CreateSessionRequest { task_id, options: options(&fields), ..create(200, &[]) };
            let refused = target.client().await.create_session(request).await.unwrap_err();
            target.refused(1, words, refused.code(), refused.message());
        }
    }
}

/// Logs in a format that servers do not read, with very many columns, and with very many rows. Their client leaves.
async fn logs(target: Target) {
    let parquet = [b"PAR1".to_vec(), vec![0xff; 20_000], b"PAR1".to_vec()].concat();
    let columns = (0..200_000).map(|k| format!("c{k},")).collect::<String>() + "z\n";
    let rows = "depth,Fz\n".to_owned() + &"0.01,1.5\n".repeat(300_000);
    while target.goes_on() {
        for content in [parquet.clone(), columns.clone().into_bytes(), rows.clone().into_bytes()] {
            let form = Some(Form::Content(content.into()));
            let experiment = Some(Form::Content("kind = \"intruder\"\nmedium = \"poppy-loose\"\n".into()));
            let file = |name: &str, form| StudyInput { name: name.into(), form };
            let arguments = ["--experiment=e.toml", "--", "log.csv"].map(str::to_owned).to_vec();
            let files = vec![file("log.csv", form), file("e.toml", experiment)];
            let request = StudyRequest { name: "diagnose".into(), arguments, files };
            let mut studies = target.studies().await;
            let asked = async { studies.study(request).await?.into_inner().message().await };
            if let Ok(Err(refused)) = tokio::time::timeout(Duration::from_millis(500), asked).await {
                assert!(!refused.message().contains("panic"), "{refused}");
                target.count(2);
            }
        }
    }
}

/// Very many small pictures, whose client leaves.
async fn pictures(target: Target) {
    while target.goes_on() {
        let Some(mut session) = target.session(1).await else { continue };
        let ask = |count| Render { indices: vec![0; count], width: 18, height: 18, ended: false, camera: None };
        if !target.refuses(3, "more than 4096", &mut session, Request::Render(ask(131_072))).await {
            continue;
        }
        session.send(Some(Request::Render(ask(4096)))).await;
        tokio::time::sleep(Duration::from_millis(300)).await;
    }
}

/// 256 connections from each of four addresses, each with a call for the server's health that never ends.
async fn connections(target: Target) {
    while target.goes_on() {
        let mut calls = Vec::new();
        for k in 0..1024 {
            let socket = TcpSocket::new_v4().unwrap();
            socket.bind(format!("127.0.0.{}:0", 2 + k % 4).parse().unwrap()).unwrap();
            // The server may already have closed it to make room.
            let Ok(stream) = socket.connect(target.address.parse().unwrap()).await else { continue };
            let Ok((client, connection)) = h2::client::handshake(stream).await else { continue };
            tokio::spawn(connection);
            let Ok(mut client) = client.ready().await else { continue };
            let request = http::Request::post("http://localhost/grpc.health.v1.Health/Check");
            let request = request.header("content-type", "application/grpc").body(()).unwrap();
            if let Ok(call) = client.send_request(request, false) {
                calls.push((client, call));
                target.count(4);
            }
        }
        tokio::time::sleep(Duration::from_secs(3)).await;
    }
}

/// Evaluations of 10⁹ episodes.
async fn evaluations(target: Target) {
    while target.goes_on() {
        let slopes = (0..1000).map(|k| (f64::from(k) * 1e-3).to_string()).collect::<Vec<_>>().join(",");
        let words = ["--seeds=1000000".to_owned(), format!("--slopes={slopes}"), "--".into(), "tripod:2".into()];
        let request = StudyRequest { name: "evaluate".into(), arguments: words.to_vec(), ..Default::default() };
        let mut studies = target.studies().await;
        let asked: Result<_, Status> = async { studies.study(request).await?.into_inner().message().await }.await;
        let refused = asked.unwrap_err();
        target.refused(5, "seeds", refused.code(), refused.message());
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
}

/// Large answers that nobody reads.
async fn unread_answers(target: Target) {
    while target.goes_on() {
        let Some(mut session) = target.session(500).await else { continue };
        for time in 0..4 {
            session.send(Some(step(&wave(0..500, time)))).await;
            session.send(Some(rollout(500, 40, true))).await;
        }
        tokio::time::sleep(Duration::from_secs(2)).await;
        target.count(6);
    }
}

/// Millions of seeds for four environments, and models of their own for single environments.
async fn seeds(target: Target) {
    while target.goes_on() {
        let Some(mut session) = target.session(4).await else { continue };
        let reset = Reset { seeds: vec![1; 300_000], ..Default::default() };
        if !target.refuses(7, "seeds", &mut session, Request::Reset(reset)).await {
            continue;
        }
        for k in 0..50_u8 {
            let changes = options(&[("slope_deg", number(f64::from(k) * 0.1))]);
            let mask = vec![u8::from(k % 4 == 0), u8::from(k % 4 == 1), u8::from(k % 4 == 2), u8::from(k % 4 == 3)];
            let reset = Reset { mask: mask.into(), options: changes, ..Default::default() };
            session.ask(Some(Request::Reset(reset))).await;
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn no_door_is_open_to_all_at_once() {
    let _alone = ALONE.lock().await;
    let directory = tempfile::tempdir().unwrap();
    let token = directory.path().join("token");
    std::fs::write(&token, TOKEN).unwrap();
    let server = Process::start(&[
        "--listen",
        "127.0.0.1:0",
        "--max-memory-mib",
        LIMIT,
        "--lease-seconds",
        "1",
        "--token-file",
        process::text(&token),
    ]);
    let target = Target { address: server.address.clone(), stop: Arc::default(), done: Arc::default() };
    let mut witness = target.session(8).await.unwrap();
    let mut expected = vec![];
    let mut undisturbed = target.session(8).await.unwrap();
    for time in 0..2000 {
        expected.push(undisturbed.step(time).await.encode_to_vec());
    }
    let mut all = vec![
        tokio::spawn(networks(target.clone())),
        tokio::spawn(robots(target.clone())),
        tokio::spawn(logs(target.clone())),
        tokio::spawn(connections(target.clone())),
        tokio::spawn(evaluations(target.clone())),
        tokio::spawn(unread_answers(target.clone())),
        tokio::spawn(seeds(target.clone())),
    ];
    all.extend((0..4).map(|_| tokio::spawn(pictures(target.clone()))));
    let at_least = Duration::from_secs(long::either(TIME[0], TIME[1]));
    let (begun, mut most, mut steps, mut created) = (Instant::now(), 0.0_f64, vec![], vec![]);
    for (time, expected) in expected.iter().enumerate() {
        let finished = target.done.iter().all(|n| n.load(Ordering::Relaxed) > 0);
        if begun.elapsed() > at_least && finished {
            break;
        }
        let start = Instant::now();
        assert_eq!(&witness.step(time).await.encode_to_vec(), expected, "step {time}");
        steps.push(start.elapsed().as_secs_f64() * 1e3);
        most = most.max(resident(server.id()));
        if time % 10 == 0 {
            let start = Instant::now();
            let mut client = target.client().await;
            // Others may have the memory for environments, but they get no priority.
            if let Ok(session) = client.create_session(create(1, &[])).await {
                created.push(start.elapsed().as_secs_f64() * 1e3);
                let session_id = session.into_inner().session_id;
                client.close_session(CloseSessionRequest { session_id }).await.unwrap();
            }
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    target.stop.store(true, Ordering::Relaxed);
    for client in all {
        client.await.unwrap();
    }
    let late = |times: &mut Vec<f64>| {
        times.sort_by(f64::total_cmp);
        [50, 95, 100].map(|part| times[(times.len() * part / 100).min(times.len() - 1)])
    };
    let done: Vec<_> = KINDS.iter().zip(target.done.iter().map(|n| n.load(Ordering::Relaxed))).collect();
    let [[.., step, longest], [_, creation, _]] = [late(&mut steps), late(&mut created)];
    println!(
        "{done:?}; memory at most {most:.0} MiB; {} steps, 95 % within {step:.1} ms, longest {longest:.1}",
        steps.len()
    );
    println!("{} new sessions, 95 % within {creation:.1} ms", created.len());
    assert!(most < MOST, "{most} MiB");
    assert!(step < WAIT && creation < WAIT, "{step} {creation} ms");
    assert!(done.iter().all(|(_, n)| *n > 0), "{done:?}");
}
