//! Peers that connect and send nothing, or begin calls without the token, do not affect others, and the log stays short.

use crate::harness::{Bearer, Session, client, until};
use crate::process::{Process, text};
use crate::security::{Authority, VALID, write};
use sandgait::service::proto::DescribeRequest;
use std::io::ErrorKind;
use std::process::Command;
use std::time::{Duration, Instant};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tonic::transport::Endpoint;

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
    let server = Process::start(&[&["--listen", PORT], &encrypted[..]].concat());
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
    let lines = log.matches("a connection was closed").count();
    assert!((1..=2 + seconds).contains(&lines), "{lines} lines in {seconds} s: {log}");
}

/// Calls that need no token neither keep a connection open nor keep others out. In an earlier version 1,024 unfinished
/// calls for the server's health locked every client out until they left.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn calls_without_the_token_lock_nobody_out() {
    let directory = tempfile::tempdir().unwrap();
    let token = write(directory.path(), "token", "open-sesame");
    let server = Process::start(&["--listen", PORT, "--token-file", text(&token), "--max-connections", "32"]);
    let connect = async || {
        let channel = Endpoint::from_shared(format!("http://{}", server.address)).unwrap().connect().await.unwrap();
        client(channel, Bearer(Some("open-sesame".into())))
    };
    let mut session = Session::create(connect().await, 3, &[]).await.unwrap();
    let first = session.reset(1).await;
    let mut calls = Vec::new();
    for _ in 0..64 {
        let stream = TcpStream::connect(&server.address).await.unwrap();
        // The server may already have closed it to make room.
        let Ok((client, connection)) = h2::client::handshake(stream).await else { continue };
        tokio::spawn(connection);
        let Ok(mut client) = client.ready().await else { continue };
        let request = http::Request::post("http://localhost/grpc.health.v1.Health/Check");
        let request = request.header("content-type", "application/grpc").body(()).unwrap();
        calls.extend(client.send_request(request, false).ok().map(|call| (client, call)));
    }
    assert!(calls.len() >= 32, "{}", calls.len());
    tokio::time::sleep(Duration::from_millis(200)).await;
    let begun = Instant::now();
    let mut other = Session::create(connect().await, 3, &[]).await.unwrap();
    assert_eq!(other.reset(1).await, first);
    assert!(begun.elapsed() < Duration::from_secs(5), "{:?}", begun.elapsed());
    assert_eq!(session.step(0).await, other.step(0).await);
}

/// Connections with calls are not closed for others.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn connections_are_limited() {
    let server = Process::start(&["--listen", PORT, "--max-connections", "3"]);
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
    // The server may have closed it already.
    let _ = fourth.write_all(PREFACE).await;
    let closed = tokio::time::timeout(Duration::from_secs(5), fourth.read_to_end(&mut Vec::new())).await;
    assert!(closed.is_ok(), "all three connections have calls");
    for session in &mut sessions {
        session.step(0).await;
    }
    drop(sessions.pop());
    until(async || {
        let Ok(channel) = Endpoint::from_shared(format!("http://{}", server.address)).unwrap().connect().await else {
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
    // All at the same time, because each waits for the server's limit.
    let peers = [&b""[..], &PREFACE[..20], b"GET / HTTP/1.1\r\n\r\n"].map(async |begun| {
        let mut stream = TcpStream::connect(&server.address).await.unwrap();
        stream.write_all(begun).await.unwrap();
        let closed = tokio::time::timeout(Duration::from_secs(60), stream.read_to_end(&mut Vec::new())).await;
        assert!(closed.is_ok(), "{begun:?}: still open");
    });
    futures_util::future::join_all(peers).await;
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
