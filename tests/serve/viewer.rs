//! The live page: what browsers get, and what they must not get.

use crate::harness::{ACTIONS, Session, step};
use crate::process::{Process, refused};
use sandgait::view::recording::{RecordingWriter, Section};
use std::time::Duration;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;

const PORT: &str = "127.0.0.1:0";

/// A server with a live page, and the page's address from its log.
fn server(options: &[&str]) -> (Process, String) {
    let process = Process::start(&[&["--listen", PORT, "--viewer", PORT], options].concat());
    let address = process.address_of("browsers see the sessions");
    (process, address)
}

async fn ask(address: &str, path: &str, host: &str) -> TcpStream {
    let mut stream = TcpStream::connect(address).await.unwrap();
    let request = format!("GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n");
    stream.write_all(request.as_bytes()).await.unwrap();
    stream
}

async fn get(address: &str, path: &str) -> String {
    let mut answer = String::new();
    ask(address, path, address).await.read_to_string(&mut answer).await.unwrap();
    answer
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_page_and_the_sessions_are_shown_without_their_ids() {
    let (process, address) = server(&[]);
    let page = get(&address, "/").await;
    assert!(page.starts_with("HTTP/1.1 200") && page.contains("content-security-policy") && page.contains("</html>"));
    let mut session = Session::create(process.client().await, 2, &[]).await.unwrap();
    session.reset(1).await;
    let list = get(&address, "/sessions").await;
    assert!(list.contains("\"envs\":2") && list.contains("HexapodGait") && !list.contains(&session.id), "{list}");
    let name = list.split("\"name\":\"").nth(1).unwrap()[..8].to_owned();
    for (path, words) in [
        (format!("/watch/{}/0", session.id), "none of this server's"),
        (format!("/watch/{name}/2"), "index: 2 is outside [0, 2)"),
        ("/watch/x".into(), ""),
        ("/metrics".into(), ""),
    ] {
        let answer = get(&address, &path).await;
        assert!(answer.starts_with("HTTP/1.1 404") && answer.contains(words), "{path}: {answer}");
    }
    // A name that was made to point here by someone else.
    let mut answer = String::new();
    ask(&address, "/sessions", "evil.example:80").await.read_to_string(&mut answer).await.unwrap();
    assert!(answer.starts_with("HTTP/1.1 403") && !answer.contains(&name), "{answer}");
}

/// Reads the stream until `rows` rows have arrived.
async fn watched(mut stream: TcpStream, rows: usize) -> Vec<Section> {
    let mut bytes = Vec::new();
    loop {
        let mut part = vec![0; 1 << 16];
        let n = tokio::time::timeout(Duration::from_secs(20), stream.read(&mut part)).await.unwrap().unwrap();
        bytes.extend_from_slice(&part[..n]);
        let sections = unpacked(&bytes);
        if n == 0 || sections.iter().map(Section::len).sum::<usize>() >= rows {
            return sections;
        }
    }
}

/// The sections in the complete chunks of an answer.
fn unpacked(answer: &[u8]) -> Vec<Section> {
    let Some(at) = answer.windows(4).position(|w| w == b"\r\n\r\n") else { return Vec::new() };
    let (mut rest, mut blocks) = (&answer[at + 4..], Vec::new());
    while let Some(end) = rest.windows(2).position(|w| w == b"\r\n") {
        let length = usize::from_str_radix(std::str::from_utf8(&rest[..end]).unwrap(), 16).unwrap();
        let Some(chunk) = rest.get(end + 2..end + 2 + length) else { break };
        blocks.extend_from_slice(chunk);
        rest = rest.get(end + 4 + length..).unwrap_or_default();
    }
    let (mut sections, mut at): (Vec<Section>, _) = (Vec::new(), 0);
    while at + 8 <= blocks.len() {
        let length = u32::from_le_bytes(blocks[at + 4..at + 8].try_into().unwrap()) as usize;
        let content = &blocks[at + 8..at + 8 + length];
        if &blocks[at..at + 4] == b"HEAD" {
            let file =
                RecordingWriter::new(Vec::new(), std::str::from_utf8(content).unwrap()).unwrap().finish().unwrap();
            sections.extend(sandgait::view::read(&file).unwrap());
        } else {
            let numbers = content.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b));
            sections.last_mut().unwrap().rows.extend(numbers);
        }
        at += 8 + length;
    }
    sections
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn steps_are_streamed_to_viewers() {
    let (process, address) = server(&[]);
    let mut session = Session::create(process.client().await, 3, &[]).await.unwrap();
    session.reset(1).await;
    let name = only(&address).await;
    let stream = ask(&address, &format!("/watch/{name}/2"), &address).await;
    let reader = tokio::spawn(watched(stream, 12));
    tokio::time::sleep(Duration::from_millis(300)).await;
    let mut actions = vec![0.0; 3 * ACTIONS];
    actions[2 * ACTIONS..].fill(0.5);
    for _ in 0..15 {
        session.batch(step(&actions)).await;
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    let sections = reader.await.unwrap();
    assert_eq!(sections.len(), 1, "one header for an episode");
    let seen = &sections[0];
    assert_eq!((seen.header.seed, seen.at("action", 0).unwrap()), (Some(3), &[0.5; ACTIONS][..]));
    for k in 1..seen.len() {
        assert!(seen.at("time", k).unwrap()[0] > seen.at("time", k - 1).unwrap()[0]);
    }
    // When the server ends, the stream ends at once.
    let late = ask(&address, &format!("/watch/{name}/0"), &address).await;
    let end = tokio::spawn(watched(late, 1000));
    tokio::time::sleep(Duration::from_millis(200)).await;
    let (_, log) = tokio::task::spawn_blocking(|| process.end()).await.unwrap();
    assert!(!log.contains("did not end in time"), "{log}");
    assert!(end.await.unwrap().is_empty());
}

/// The name of the server's only session.
async fn only(address: &str) -> String {
    get(address, "/sessions").await.split("\"name\":\"").nth(1).unwrap()[..8].to_owned()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn viewers_are_limited() {
    let (process, address) = server(&["--max-watchers", "3"]);
    let mut session = Session::create(process.client().await, 2, &[]).await.unwrap();
    session.reset(1).await;
    let path = format!("/watch/{}/0", only(&address).await);
    let mut watching = Vec::new();
    for _ in 0..3 {
        let mut stream = ask(&address, &path, &address).await;
        let mut head = [0; 15];
        stream.read_exact(&mut head).await.unwrap();
        assert_eq!(&head, b"HTTP/1.1 200 OK");
        watching.push(stream);
    }
    let refused = get(&address, &path).await;
    assert!(refused.starts_with("HTTP/1.1 503") && refused.contains("3 watch this server already"), "{refused}");
    // A viewer that leaves makes room as soon as the server notices it, which is when it sends something.
    watching.pop();
    let mut time = 0;
    crate::harness::until(async || {
        time += 1;
        session.step(time).await;
        let mut stream = ask(&address, &path, &address).await;
        let mut head = [0; 15];
        stream.read_exact(&mut head).await.unwrap();
        &head == b"HTTP/1.1 200 OK"
    })
    .await;
    // When the session ends, the streams of its viewers end.
    let ended = tokio::spawn(watched(watching.pop().unwrap(), usize::MAX));
    let close = sandgait::service::proto::CloseSessionRequest { session_id: session.id.clone() };
    session.client.close_session(close).await.unwrap();
    ended.await.unwrap();
    let (_, log) = process.end();
    assert!(log.contains("a watcher was refused"), "{log}");
}

/// Connections that send nothing, or only a part of a request, are closed.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn connections_without_a_whole_request_are_closed() {
    let (_process, address) = server(&[]);
    let mut streams = Vec::new();
    for begun in ["", "GET / HTTP/1.1\r\nHost: "] {
        let mut stream = TcpStream::connect(&address).await.unwrap();
        stream.write_all(begun.as_bytes()).await.unwrap();
        streams.push(stream);
    }
    for mut stream in streams {
        let mut answer = Vec::new();
        // Closed or reset, with or without an answer.
        let closed = tokio::time::timeout(Duration::from_secs(60), stream.read_to_end(&mut answer)).await;
        assert!(closed.is_ok(), "still open");
    }
}

#[test]
fn the_page_is_for_this_machine_only() {
    for (address, words) in [
        ("0.0.0.0:8080", "--viewer: 0.0.0.0:8080 can be reached from other machines"),
        ("0.0.0.0:8080", "add --viewer-insecure"),
        ("unix:/tmp/x", "--viewer: unix:/tmp/x is not HOST:PORT"),
    ] {
        // The option that allows other addresses for gRPC does not allow them for the page.
        let line = refused(&["--listen", PORT, "--insecure", "--metrics-insecure", "--viewer", address]);
        assert!(line.contains(words), "{line}");
    }
}
