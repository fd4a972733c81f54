//! Large requests wait for their share of the memory or are refused, while other sessions go on.

use crate::harness::{Bearer, Server, Session, client, create, options, step, until, wave};
use sandgait::service::proto::run_session_request::Request;
use sandgait::service::proto::run_session_response::Response;
use sandgait::service::proto::{CloseSessionRequest, Render, Reset, Restore, Rollout, RunSessionRequest, Step};
use sandgait::service::{Address, Limits, Seal, ServerSetup};
use tonic::Code;
use tonic::transport::Endpoint;

const MIB: usize = 1 << 20;

/// The server has 128 MiB. All requests together may take 16 MiB of them, and a single request 8 MiB.
fn limits() -> Limits {
    Limits { memory: 128 * MIB, ..Limits::default() }
}

fn lists(count: usize) -> prost_types::Value {
    let empty = prost_types::value::Kind::ListValue(prost_types::ListValue::default());
    let values = vec![prost_types::Value { kind: Some(empty) }; count];
    prost_types::Value { kind: Some(prost_types::value::Kind::ListValue(prost_types::ListValue { values })) }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn sessions_with_very_many_values_are_refused_unread() {
    let (server, calm) = (Server::with_limits(1, limits()).await, Server::start(1).await);
    let (mut witness, mut undisturbed) = (server.session(3).await, calm.session(3).await);
    assert_eq!(witness.reset(1).await, undisturbed.reset(1).await);
    for (count, code, words) in [
        (500, Code::InvalidArgument, "leg"),
        (20_000, Code::InvalidArgument, "options: too many values"),
        (1_000_000, Code::ResourceExhausted, "bytes are more than this call takes"),
    ] {
        let status = server.client().await.create_session(create(1, &[("leg", lists(count))])).await.unwrap_err();
        assert_eq!(status.code(), code, "{}", status.message());
        assert!(status.message().contains(words), "{}", status.message());
        assert_eq!(witness.step(count).await, undisturbed.step(count).await);
    }
}

/// Each field is refused because of its length, before it is decoded. The session continues bit-identically to one
/// without such requests.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn fields_that_are_too_long_for_the_session() {
    let server = Server::with_limits(1, limits()).await;
    let (mut session, mut undisturbed) = (server.session(3).await, server.session(3).await);
    assert_eq!(session.reset(1).await, undisturbed.reset(1).await);
    let long = || bytes::Bytes::from(vec![7; 4 * MIB]);
    let Request::Step(good) = step(&wave(0..3, 0)) else { unreachable!() };
    let names = Reset { options: options(&[("leg", lists(500))]), ..Default::default() };
    for (request, words) in [
        (Request::Step(Step { held: long(), ..good.clone() }), "held: 4194304 entries for 3"),
        (Request::Step(Step { actions: long(), ..good }), "actions: 1048576 numbers, expected 18"),
        (Request::Reset(Reset { mask: long(), ..Default::default() }), "mask: 4194304 entries for 3"),
        (Request::Reset(Reset { seeds: vec![1; MIB / 2], ..Default::default() }), "seeds: 524288 entries for 3"),
        (Request::Reset(names), "leg"),
        (Request::Restore(Restore { sources: long(), ..Default::default() }), "sources: 1048576 entries for 3"),
        (Request::Restore(Restore { snapshot: long(), ..Default::default() }), "snapshot: this is not one of"),
    ] {
        let failure = session.failure(Some(request)).await;
        assert_eq!(failure.code, i32::from(Code::InvalidArgument), "{}", failure.message);
        assert!(failure.message.contains(words), "{}", failure.message);
    }
    assert_eq!(session.step(1).await, undisturbed.step(1).await);
}

/// These messages end their stream, and the session can be resumed.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn messages_that_end_their_stream() {
    let server = Server::with_limits(1, limits()).await;
    let mut session = server.session(2).await;
    session.reset(1).await;
    let id = session.id.clone();
    let bomb = Reset { options: options(&[("leg", lists(20_000))]), ..Default::default() };
    let far = Step { actions: vec![0; 9 * MIB].into(), ..Default::default() };
    let message = |session_id: &str, request| RunSessionRequest { session_id: session_id.into(), sequence: 0, request };
    for (message, code, words) in [
        (message(&id, Some(Request::Reset(bomb))), Code::InvalidArgument, "options: too many values"),
        (
            message(&id, Some(Request::Step(far))),
            Code::ResourceExhausted,
            "bytes are more than this call takes, 8388608",
        ),
        (message(&"x".repeat(MIB), None), Code::InvalidArgument, "session_id: 1048576 bytes"),
    ] {
        let (broken, _) = Session::resume(server.client().await, &id, 1).await.unwrap();
        let mut broken = broken;
        broken.requests.send(message).await.unwrap();
        let status = broken.receive().await.unwrap_err();
        assert_eq!(status.code(), code, "{}", status.message());
        assert!(status.message().contains(words), "{}", status.message());
    }
    let (mut session, last) = Session::resume(server.client().await, &id, 1).await.unwrap();
    assert_eq!(last, 1);
    session.step(0).await;
}

fn rollout(steps: usize, envs: usize) -> Request {
    let row: Vec<u8> = wave(0..envs, 0).iter().flat_map(|a| a.to_le_bytes()).collect();
    Request::Rollout(Rollout { actions: row.repeat(steps).into(), trajectories: false })
}

/// The largest message takes all memory for requests, so the next one would fail if a share was not released.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn shares_are_given_back() {
    let server = Server::with_limits(1, Limits { memory: 32 * MIB, ..Limits::default() }).await;
    let mut session = server.session(64).await;
    session.reset(1).await;
    let garbage = || Some(Request::Restore(Restore { snapshot: vec![7; 2 * MIB - 256].into(), ..Default::default() }));
    let rollout = || Some(rollout((2 * MIB - 256) / (64 * 6 * 4), 64));
    let mut first = None;
    for _ in 0..3 {
        let Response::Rollout(part) = session.ask(rollout()).await else { panic!("no rollout") };
        assert_eq!(*first.get_or_insert_with(|| part.returns.clone()), part.returns);
        assert!(session.failure(garbage()).await.message.starts_with("snapshot: "));
    }
    for request in [rollout(), garbage()] {
        // The client disconnects while its request is read or carried out.
        let (left, _) = Session::resume(server.client().await, &session.id, 0).await.unwrap();
        left.requests.send(RunSessionRequest { session_id: left.id.clone(), sequence: 0, request }).await.unwrap();
        drop(left);
        let mut other = server.session(1).await;
        assert!(other.failure(garbage()).await.message.starts_with("snapshot: "));
    }
}

#[tokio::test]
async fn pictures_have_their_share_too() {
    let server = Server::with_limits(1, limits()).await;
    let mut session = server.session(1).await;
    session.reset(1).await;
    let render = |count| {
        Request::Render(Render { indices: vec![0; count], width: 1024, height: 1024, ended: false, camera: None })
    };
    let failure = session.failure(Some(render(4))).await;
    assert_eq!(failure.code, i32::from(Code::ResourceExhausted));
    assert!(failure.message.contains("needs about 24 MiB, requests may take 16 MiB"), "{}", failure.message);
    let Response::Pictures(pictures) = session.ask(Some(render(1))).await else { panic!("no pictures") };
    assert_eq!(pictures.pixels.len(), 3 * MIB);
}

#[tokio::test]
async fn only_snapshots_sealed_with_the_servers_key_are_taken() {
    let with = |key: Option<&[u8]>| {
        let seal = key.map_or_else(Seal::default, |k| Seal::new(k).unwrap());
        Server::with(ServerSetup { threads: 1, seal, ..ServerSetup::default() })
    };
    let servers = [with(None).await, with(Some(b"0123456789abcdef")).await, with(Some(b"fedcba9876543210")).await];
    let mut sessions = Vec::new();
    let mut saved = Vec::new();
    for server in &servers {
        let mut session = server.session(2).await;
        session.reset(1).await;
        saved.push(crate::snapshots::save(&mut session).await);
        sessions.push(session);
    }
    for (k, session) in sessions.iter_mut().enumerate() {
        for (source, snapshot) in saved.iter().enumerate() {
            let restore = Request::Restore(Restore { snapshot: snapshot.clone().into(), ..Default::default() });
            match session.ask(Some(restore)).await {
                Response::Batch(_) => assert_eq!(k, source),
                Response::Failure(failure) => {
                    assert_ne!(k, source, "{}", failure.message);
                    let why = match (k, source) {
                        (0, _) => "snapshot: it is damaged, or sealed with a key that this server does not have",
                        (_, 0) => "snapshot: it has no seal",
                        _ => "snapshot: its seal is wrong",
                    };
                    assert!(failure.message.starts_with(why), "{}", failure.message);
                }
                other => panic!("{other:?}"),
            }
        }
    }
}

/// A picture of 1.5 MiB, which takes 5 MiB of the memory for requests while it is drawn.
fn picture() -> Option<Request> {
    Some(Request::Render(Render { indices: vec![0], width: 1024, height: 512, ..Default::default() }))
}

/// A client that does not read a large answer loses its connection, and the answer's memory is free again; its session
/// stays. In an earlier version the memory was free before the answer had been sent, and the answer stayed in the server.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn memory_of_answers_that_nobody_reads_is_freed() {
    let stall = std::time::Duration::from_millis(300);
    // All requests together may take 8 MiB. A picture takes 5 MiB, so the second one waits for the first one's memory.
    let server = Server::with_limits(1, Limits { stall, memory: 64 * MIB, ..Limits::default() }).await;
    let Address::Unix(path) = &server.address else { unreachable!() };
    let endpoint = Endpoint::from_shared(format!("unix://{}", path.display())).unwrap();
    // The window is so small that most of the answer stays in the server.
    let channel = endpoint.initial_stream_window_size(65_535).connect().await.unwrap();
    let mut slow = Session::create(client(channel, Bearer::default()), 1, &[]).await.unwrap();
    let mut other = server.session(1).await;
    slow.reset(1).await;
    other.reset(1).await;
    let begun = std::time::Instant::now();
    slow.send(picture()).await;
    tokio::time::sleep(stall).await;
    // The second time shows that an answer that was read has returned its memory.
    for _ in 0..2 {
        let Response::Pictures(pictures) = other.ask(picture()).await else { panic!("no pictures") };
        assert_eq!(pictures.pixels.len(), 3 * MIB / 2);
        // The first answer has 300 ms, and a second for its transfer.
        assert!(begun.elapsed() > stall + std::time::Duration::from_secs(1), "the memory was free too early");
    }
    assert!(slow.receive().await.is_err(), "the connection was not closed");
    let (mut slow, last) = Session::resume(server.client().await, &slow.id, 2).await.unwrap();
    assert_eq!(last, 2);
    slow.step(0).await;
}

/// A client that sends ahead and reads 1.5 MiB a second keeps its connection: the answer before is still in the queue when
/// the next one is made.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_client_that_reads_slowly_but_steadily_keeps_its_connection() {
    let second = std::time::Duration::from_secs(1);
    let limits = Limits { stall: second / 2, ..limits() };
    let server = Server::tcp(ServerSetup { threads: 1, limits, ..ServerSetup::default() }).await;
    let Address::Tcp(address) = &server.address else { unreachable!() };
    let endpoint = Endpoint::from_shared(format!("http://{address}")).unwrap();
    let channel = endpoint.initial_stream_window_size(65_535).connect().await.unwrap();
    let mut slow = Session::create(client(channel, Bearer::default()), 1, &[]).await.unwrap();
    slow.reset(1).await;
    for _ in 0..4 {
        slow.send(picture()).await;
    }
    for k in 0..4 {
        tokio::time::sleep(second).await;
        assert_eq!(slow.receive().await.unwrap().0, 2 + k);
    }
}

/// Each environment gets a model of its own, by a reset of it alone: the models are part of the session's memory. In an
/// earlier version they were not counted.
#[tokio::test]
async fn models_made_by_resets_are_counted() {
    let server = Server::with_limits(1, Limits { memory: 16 * MIB, ..Limits::default() }).await;
    let envs = 780;
    let mut session = server.session(envs).await;
    session.reset(0).await;
    let reset = |mask: Vec<u8>, slope: f64| {
        let options = options(&[("slope_deg", crate::harness::number(slope))]);
        Some(Request::Reset(Reset { mask: mask.into(), options, ..Default::default() }))
    };
    let one = |k: u32| {
        let mask = (0..envs).map(|i| u8::from(i == k)).collect();
        reset(mask, f64::from(k) * 0.01)
    };
    let mut made = 0;
    let refused = loop {
        match session.ask(one(made)).await {
            Response::Batch(_) => made += 1,
            Response::Failure(failure) => break failure,
            other => panic!("{other:?}"),
        }
        assert!(made < envs, "{made} models were not counted");
    };
    println!("{made} models of {envs} environments in 16 MiB");
    assert_eq!(refused.code, i32::from(Code::ResourceExhausted));
    assert!(refused.message.contains("slope_deg: needs about"), "{}", refused.message);
    session.step(0).await;
    // The memory is free again soon after the session's end: the server drops environments on another thread.
    let close = CloseSessionRequest { session_id: session.id.clone() };
    session.client.close_session(close).await.unwrap();
    let mut next = None;
    until(async || {
        next = Session::create(server.client().await, envs, &[]).await.ok();
        next.is_some()
    })
    .await;
    next.unwrap().reset(0).await;
}
