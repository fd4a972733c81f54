//! Faults of an earlier version that must not return.

use crate::harness::Server;
use sandgait::service::proto::ListSessionsRequest;
use sandgait::service::{Address, ServerSetup};
use std::os::unix::fs::PermissionsExt as _;
use std::time::Instant;

/// Nagle's algorithm must be off: with it, a small call over TCP takes 44 ms, many times as long as over a Unix socket.
#[tokio::test]
async fn a_unary_call_over_tcp_is_not_delayed() {
    let setup = || ServerSetup { threads: 1, ..ServerSetup::default() };
    let (tcp, unix) = (Server::tcp(setup()).await, Server::with(setup()).await);
    let (mut clients, mut times) = ([tcp.client().await, unix.client().await], [vec![], vec![]]);
    for _ in 0..21 {
        for (client, times) in clients.iter_mut().zip(&mut times) {
            let start = Instant::now();
            client.list_sessions(ListSessionsRequest {}).await.unwrap();
            times.push(start.elapsed());
        }
    }
    let [tcp, unix] = times.map(|mut times| {
        times.sort();
        times[10]
    });
    assert!(tcp < 8 * unix, "medians {tcp:?}, {unix:?}");
}

/// gRPC limits messages to 4 MiB by default; the server allows more.
#[tokio::test]
async fn messages_beyond_4_mib() {
    let server = Server::start(2).await;
    let mut session = server.session(30_000).await;
    let first = session.reset(0).await;
    assert!(first.observations.len() > 4 << 20);
}

#[tokio::test]
async fn requests_beyond_4_mib() {
    let server = Server::start(1).await;
    let mut session = server.session(2).await;
    session.reset(0).await;
    // The server has read and refused it; the transport did not cut it off.
    let failure = session.failure(Some(crate::harness::step(&vec![0.0; (5 << 20) / 4]))).await;
    assert!(failure.message.contains("numbers"), "{}", failure.message);
    session.step(0).await;
}

#[tokio::test]
async fn only_the_owner_may_use_the_socket() {
    let server = Server::start(1).await;
    let Address::Unix(path) = &server.address else { panic!() };
    assert_eq!(std::fs::metadata(path).unwrap().permissions().mode() & 0o777, 0o600);
}
