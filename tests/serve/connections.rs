//! Peers that connect and send nothing, or connect too often, do not affect others, and the log stays short.

use crate::harness::{Bearer, Session, client, until};
use crate::process::{Process, text};
use crate::security::{Authority, VALID, write};
use sandgait::service::proto::{CloseSessionRequest, DescribeRequest};
use std::io::ErrorKind;
use std::process::Command;
use std::time::{Duration, Instant};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tonic::Code;

const PORT: &str = "127.0.0.1:0";

/// The first bytes of an HTTP/2 connection.
const PREFACE: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n";

async fn silent(server: &Process, count: usize) -> Vec<TcpStream> {
    let mut all = Vec::new();
    for _ in 0..count {
        all.push(TcpStream::connect(&server.address).await.unwrap());
    }
    all
}

/// Number of connections that the server has not closed, as seen from here.
fn open(streams: &[TcpStream]) -> usize {
    let is_open = |s: &&TcpStream| s.try_read(&mut [0; 64]).is_err_and(|e| e.kind() == ErrorKind::WouldBlock);
    streams.iter().filter(is_open).count()
}

/// In an earlier version, 256 silent connections blocked the next handshake until the first of them timed out.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn silent_tls_connections_hold_up_no_handshake() {
    let (directory, authority) = (tempfile::tempdir().unwrap(), Authority::new("ours"));
    let (certificate, key) = authority.issue(VALID);
    let [certificate, key] =
        [("cert.pem", certificate), ("key.pem", key)].map(|(name, pem)| write(directory.path(), name, &pem));
    let encrypted = ["--tls-cert", text(&certificate), "--tls-key", text(&key)];
    let many = ["--max-connections", "2000", "--max-connections-per-peer", "2000"];
    let server = Process::start(&[&["--listen", PORT], &encrypted[..], &many].concat());
    let mut silent = silent(&server, 300).await;
    let channel = server.encrypted(&authority.pem, None).await.unwrap();
    client(channel, Bearer::default()).describe(DescribeRequest {}).await.unwrap();
    assert_eq!(open(&silent), 300, "the handshake came after some of the silent ones had run out of time");
    for stream in &mut silent {
        let closed = tokio::time::timeout(Duration::from_secs(60), stream.read(&mut [0])).await;
        assert!(closed.is_ok(), "a silent connection stays");
    }
    let (_, log) = server.end();
    assert!(log.matches("a TLS handshake failed").count() <= 5 && log.contains("not done within"), "{log}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn silent_connections_make_room_and_the_log_stays_short() {
    let server = Process::start(&["--listen", PORT, "--max-connections", "32"]);
    let mut session = Session::create(server.client().await, 3, &[]).await.unwrap();
    let first = session.reset(1).await;
    let begun = Instant::now();
    let silent = silent(&server, 200).await;
    let mut other = Session::create(server.client().await, 3, &[]).await.unwrap();
    assert_eq!(other.reset(1).await, first);
    until(async || open(&silent) <= 31).await;
    for time in 0..5 {
        assert_eq!(session.step(time).await, other.step(time).await);
    }
    let seconds = begun.elapsed().as_secs() as usize;
    let (_, log) = server.end();
    let lines = log.matches("a connection was closed: the limit is reached").count();
    assert!((1..=2 + seconds).contains(&lines), "{lines} lines in {seconds} s: {log}");
}

/// If a peer has too many connections, the server closes those without a call, even after HTTP/2 has begun. It keeps those with calls.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn connections_of_a_peer_are_limited() {
    let server = Process::start(&["--listen", PORT, "--max-connections-per-peer", "3"]);
    let mut sessions = Vec::new();
    for k in 0..3 {
        let mut idle = TcpStream::connect(&server.address).await.unwrap();
        idle.write_all(PREFACE).await.unwrap();
        let mut session = Session::create(server.client().await, 2, &[]).await.unwrap();
        session.reset(k).await;
        sessions.push(session);
        if k == 2 {
            until(async || open(std::slice::from_ref(&idle)) == 0).await;
        }
    }
    let mut fourth = TcpStream::connect(&server.address).await.unwrap();
    fourth.write_all(PREFACE).await.unwrap();
    let closed = tokio::time::timeout(Duration::from_secs(5), fourth.read_to_end(&mut Vec::new())).await;
    assert!(closed.is_ok(), "all three connections have calls");
    for session in &mut sessions {
        session.step(0).await;
    }
    drop(sessions.pop());
    until(async || {
        let Ok(channel) =
            tonic::transport::Endpoint::from_shared(format!("http://{}", server.address)).unwrap().connect().await
        else {
            return false;
        };
        client(channel, Bearer::default()).describe(DescribeRequest {}).await.is_ok()
    })
    .await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn connections_without_http2_are_closed() {
    let server = Process::start(&["--listen", PORT]);
    let mut session = Session::create(server.client().await, 2, &[]).await.unwrap();
    session.reset(1).await;
    for begun in [&b""[..], &PREFACE[..20], b"GET / HTTP/1.1\r\n\r\n"] {
        let mut stream = TcpStream::connect(&server.address).await.unwrap();
        stream.write_all(begun).await.unwrap();
        let closed = tokio::time::timeout(Duration::from_secs(60), stream.read_to_end(&mut Vec::new())).await;
        assert!(closed.is_ok(), "{begun:?}: still open");
    }
    // This connection has a call and was silent for the same time.
    session.step(0).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn calls_of_a_connection_are_limited() {
    let server = Process::start(&["--listen", PORT, "--max-streams", "3"]);
    let stream = TcpStream::connect(&server.address).await.unwrap();
    let (client, connection) = h2::client::handshake(stream).await.unwrap();
    tokio::spawn(connection);
    let client = client.ready().await.unwrap();
    until(async || client.current_max_send_streams() == 3).await;
}

/// If the system allows few file descriptors, the server accepts fewer connections and never runs out of descriptors.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn descriptors_do_not_run_out() {
    let mut command = Command::new("sh");
    command.args(["-c", "ulimit -n 96; exec \"$@\"", "sh", env!("CARGO_BIN_EXE_sandgait"), "serve"]);
    let server = Process::of(command, &["--listen", PORT]);
    let mut session = Session::create(server.client().await, 2, &[]).await.unwrap();
    session.reset(1).await;
    let mut idle = silent(&server, 300).await;
    for stream in &mut idle {
        // The server may have closed some of them already.
        let _ = stream.write_all(PREFACE).await;
    }
    Session::create(server.client().await, 2, &[]).await.unwrap().reset(1).await;
    session.step(0).await;
    let (_, log) = server.end();
    assert!(log.contains("descriptors are the limit") && !log.contains("cannot accept"), "{log}");
}

/// A peer does not get more requests a second by connecting again. The test checks lower bounds on times, so a slow machine does not
/// make it fail.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn requests_a_second_are_limited_for_each_peer() {
    let server = Process::start(&["--listen", PORT, "--max-requests-per-second", "10", "--dm-env-rpc"]);
    let begun = Instant::now();
    for _ in 0..9 {
        server.client().await.describe(DescribeRequest {}).await.unwrap();
    }
    assert!(begun.elapsed() > Duration::from_millis(700), "{:?}", begun.elapsed());
    // All sessions of a peer share the limit, and each message counts.
    let begun = Instant::now();
    let mut one = Session::create(server.client().await, 1, &[]).await.unwrap();
    let mut other = Session::create(server.client().await, 1, &[]).await.unwrap();
    for session in [&mut one, &mut other] {
        session.reset(0).await;
        session.step(0).await;
        session.step(1).await;
    }
    // For each of two sessions: create it, open a stream with the first message, and send two more messages.
    assert!(begun.elapsed() > Duration::from_millis(600), "{:?}", begun.elapsed());
    let wrong = one.client.close_session(CloseSessionRequest::default()).await.unwrap_err();
    assert_eq!(wrong.code(), Code::NotFound);
}
