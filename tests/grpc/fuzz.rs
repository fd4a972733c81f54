//! Randomly changed messages over a real connection: the numbers of another session equal those of an undisturbed run.

use crate::harness::{Server, Session, create, number, options, step, text, wave};
use crate::mutate::mutated;
use bytes::Bytes;
use h2::client::SendRequest;
use prost::Message as _;
use rand::{Rng as _, SeedableRng as _};
use rand_xoshiro::Xoshiro256PlusPlus;
use sandgait::service::Address;
use sandgait::service::proto::run_session_request::Request;
use sandgait::service::proto::run_session_response::Response;
use sandgait::service::proto::{Attach, Reset, Restore, Rollout, RunSessionRequest, Save};
use std::time::{Duration, Instant};
use tokio::net::UnixStream;

/// Number of messages.
const COUNT: usize = 3_000;

async fn connect(server: &Server) -> SendRequest<Bytes> {
    let Address::Unix(path) = &server.address else { panic!("a Unix socket") };
    let (client, connection) = h2::client::handshake(UnixStream::connect(path).await.unwrap()).await.unwrap();
    tokio::spawn(connection);
    client.ready().await.unwrap()
}

/// Makes a call whose only content is `frames`, and waits until the server has ended it.
async fn send(client: &SendRequest<Bytes>, method: &str, frames: Vec<u8>) {
    let mut client = client.clone().ready().await.unwrap();
    let uri = format!("http://localhost/sandgait.v1.EnvironmentService/{method}");
    let request = http::Request::post(uri).header("content-type", "application/grpc").header("te", "trailers");
    let (response, mut sender) = client.send_request(request.body(()).unwrap(), false).unwrap();
    sender.send_data(frames.into(), true).unwrap();
    let mut body = response.await.unwrap().into_body();
    while let Some(data) = body.data().await {
        body.flow_control().release_capacity(data.unwrap().len()).unwrap();
    }
}

fn frame(message: &[u8]) -> Vec<u8> {
    [&[0][..], &(message.len() as u32).to_be_bytes(), message].concat()
}

/// Valid messages of a session.
fn messages(id: &str, snapshot: &Bytes) -> Vec<Vec<u8>> {
    let changes = options(&[("leg", text("C")), ("slope_deg", number(2.0))]);
    let all = [
        Request::Attach(Attach {}),
        Request::Reset(Reset { seeds: vec![1, 2], mask: vec![1, 0].into(), options: None }),
        Request::Reset(Reset { options: changes, ..Default::default() }),
        step(&wave(0..2, 0)),
        Request::Save(Save {}),
        Request::Restore(Restore { snapshot: snapshot.clone(), sources: vec![0; 8].into() }),
        Request::Rollout(Rollout {
            actions: [wave(0..2, 0), wave(0..2, 1)].concat().iter().flat_map(|a| a.to_le_bytes()).collect(),
            trajectories: true,
        }),
    ];
    let message = |request| RunSessionRequest { session_id: id.into(), sequence: 0, request: Some(request) };
    all.into_iter().map(|request| message(request).encode_to_vec()).collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn wrong_messages_disturb_nobody_else() {
    let (server, calm) = (Server::start(1).await, Server::start(1).await);
    let (mut witness, mut undisturbed) = (server.session(5).await, calm.session(5).await);
    assert_eq!(witness.reset(1).await, undisturbed.reset(1).await);
    let mut victim: Session = server.session(2).await;
    victim.reset(7).await;
    let Response::Snapshot(saved) = victim.ask(Some(Request::Save(Save {}))).await else { panic!("no snapshot") };
    let (valid, creation) = (messages(&victim.id, &saved.data), create(2, &[("leg", text("C"))]).encode_to_vec());
    let mut random = Xoshiro256PlusPlus::seed_from_u64(22);
    let client = connect(&server).await;
    let begun = Instant::now();
    for k in 0..COUNT {
        if k % 8 == 0 {
            send(&client, "CreateSession", frame(&mutated(&mut random, &creation, &valid[1]))).await;
        } else {
            // The first message is valid, so that the others reach the session.
            let mut frames = frame(&valid[random.random_range(0..valid.len())]);
            for _ in 0..random.random_range(1..4) {
                let [one, other] = [(); 2].map(|()| &valid[random.random_range(0..valid.len())]);
                frames.extend(frame(&mutated(&mut random, one, other)));
            }
            send(&client, "RunSession", frames).await;
        }
        if k % 10 == 0 {
            assert_eq!(witness.step(k).await, undisturbed.step(k).await, "after {k} messages");
        }
    }
    assert!(begun.elapsed() < Duration::from_secs(20), "{:?}", begun.elapsed());
    // The session that received all the messages still exists.
    let (mut again, _) = Session::resume(server.client().await, &victim.id, 0).await.unwrap();
    again
        .requests
        .send(RunSessionRequest { request: Some(Request::Reset(Reset::default())), ..Default::default() })
        .await
        .unwrap();
    again.receive().await.unwrap();
}
