//! Sessions that continue after a restart of their server.

use crate::harness::{Session, create, step, until, wave};
use crate::long;
use crate::process::{Process, refused, text};
use sandgait::service::proto::run_session_request::Request;
use sandgait::service::proto::run_session_response::Response;
use sandgait::service::proto::{CloseSessionRequest, CreateSessionRequest, ListSessionsRequest, Render};
use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;
use tonic::Code;

struct Place {
    directory: tempfile::TempDir,
    address: String,
}

impl Place {
    fn new() -> Self {
        let directory = tempfile::tempdir().unwrap();
        let address = format!("unix:{}", directory.path().join("sock").display());
        Self { directory, address }
    }

    fn state(&self) -> PathBuf {
        self.directory.path().join("state")
    }

    fn start(&self) -> Process {
        Process::start(&["--listen", &self.address, "--state-dir", text(&self.state())])
    }

    fn files(&self) -> Vec<PathBuf> {
        let mut all: Vec<_> = fs::read_dir(self.state()).unwrap().map(|e| e.unwrap().path()).collect();
        all.retain(|path| !path.ends_with(".lock"));
        all.sort();
        all
    }
}

fn mode(path: &Path) -> u32 {
    fs::metadata(path).unwrap().permissions().mode() & 0o777
}

/// For every task, the server ends during a step, and the client resumes its session as after any broken stream.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_client_goes_on_where_it_was_with_the_same_bits() {
    let (place, elsewhere) = (Place::new(), Place::new());
    let (mut server, undisturbed) = (place.start(), elsewhere.start());
    for task in sandgait::env::registry::TASK_IDS {
        let request = || CreateSessionRequest { task_id: task.into(), ..create(5, &[]) };
        let mut one = Session::create_by(server.client().await, request()).await.unwrap();
        let mut other = Session::create_by(undisturbed.client().await, request()).await.unwrap();
        let actions = |time: usize, width: usize| {
            step(&(0..5 * width).map(|k| ((k * 3 + time) as f32 * 0.37).sin()).collect::<Vec<_>>())
        };
        let width = one.task.action.len();
        assert_eq!(one.reset(7).await, other.reset(7).await);
        for time in 0..24_u64 {
            let expected = other.batch(actions(time as usize, width)).await;
            if time % 8 == 5 {
                let sent = one.send(Some(actions(time as usize, width))).await;
                tokio::time::sleep(Duration::from_micros(900 * (time % 3))).await;
                let id = one.id.clone();
                drop(one);
                let (_, log) = server.end();
                assert!(log.contains("a session was saved"), "{log}");
                let [file] = &place.files()[..] else { panic!("{:?}", place.files()) };
                assert_eq!((mode(file), mode(&place.state())), (0o600, 0o700));
                assert!(!text(file).contains(&id));
                server = place.start();
                let (again, last) = Session::resume(server.client().await, &id, sent - 1).await.unwrap();
                assert!(last == sent || last == sent - 1, "{last} {sent}");
                assert_eq!(place.files(), std::slice::from_ref(file), "the file stays while the session goes on");
                one = again;
            }
            assert_eq!(one.batch(actions(time as usize, width)).await, expected, "{task}, step {time}");
        }
        let close = CloseSessionRequest { session_id: one.id.clone() };
        one.client.close_session(close).await.unwrap();
        assert!(place.files().is_empty(), "the session has ended");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_session_that_was_never_reset_is_kept_too() {
    let place = Place::new();
    let server = place.start();
    let id = server.client().await.create_session(create(3, &[])).await.unwrap().into_inner().session_id;
    server.end();
    let server = place.start();
    let (mut session, last) = Session::resume(server.client().await, &id, 0).await.unwrap();
    assert_eq!(last, 0);
    session.reset(1).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn unreadable_sessions_are_kept_and_logged() {
    let place = Place::new();
    let server = place.start();
    let mut session = Session::create(server.client().await, 3, &[]).await.unwrap();
    session.reset(1).await;
    let id = session.id.clone();
    server.end();
    let [file] = &place.files()[..] else { panic!() };
    let whole = fs::read(file).unwrap();
    fs::write(place.state().join(".unfinished-x"), "half").unwrap();
    let mut changed = whole.clone();
    changed[whole.len() / 2] ^= 1;
    // A file that is cut off exactly before a field can be decoded, as a session without this field.
    let snapshot = whole.windows(17).rposition(|w| w == b"sandgait snapshot").unwrap();
    assert!(
        (128..16_384).contains(&(whole.len() - snapshot)),
        "before it stand the field's number and two bytes of length"
    );
    let [cut, tail, half] = [snapshot - 3, whole.len() - 1, whole.len() / 2].map(|length| &whole[..length]);
    for damaged in [&b"no session"[..], &whole[..20], &changed, cut, tail, half] {
        fs::write(file, damaged).unwrap();
        let (_, log) = place.start().end();
        assert!(log.contains("could not be restored; its file stays") && log.contains(text(file)), "{log}");
        assert_eq!(fs::read(file).unwrap(), damaged);
    }
    assert_eq!(place.files().len(), 1, "what a killed server left is removed");
    fs::write(file, whole).unwrap();
    let server = place.start();
    Session::resume(server.client().await, &id, 1).await.unwrap().0.step(0).await;
}

/// A limit on the size of files has the same effect as a disk that becomes full while a file is written.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_full_disk_is_logged_and_holds_nothing_up() {
    let place = Place::new();
    let mut command = Command::new("sh");
    command.args(["-c", "trap '' XFSZ; ulimit -f 16; exec \"$@\"", "sh", env!("CARGO_BIN_EXE_sandgait"), "serve"]);
    let server = Process::of(command, &["--listen", &place.address, "--state-dir", text(&place.state())]);
    let (mut large, mut small) = (create_in(&server, 500).await, create_in(&server, 1).await);
    for session in [&mut large, &mut small] {
        session.reset(1).await;
        session.step(0).await;
    }
    let (_, log) = server.end_with(1);
    assert!(!log.contains("took too long") && !log.contains("did not end in time"), "{log}");
    let listed = large.client.list_sessions(ListSessionsRequest {}).await;
    assert!(listed.is_err() && log.contains("1 sessions were not saved: "), "{log}");
    assert!(log.contains("a session was lost: it could not be saved") && log.contains("File too large"), "{log}");
    // Sessions that fit are saved, and no file is incomplete.
    assert_eq!(place.files().len(), 1);
    let server = place.start();
    Session::resume(server.client().await, &small.id, 2).await.unwrap().0.step(1).await;
    let gone = Session::resume(server.client().await, &large.id, 2).await.err().unwrap();
    assert_eq!(gone.code(), Code::NotFound);
}

async fn create_in(server: &Process, envs: u32) -> Session {
    Session::create(server.client().await, envs, &[]).await.unwrap()
}

/// The client learns why the stream ended, and later gets the answer to the step that was carried out.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_step_in_flight_is_finished() {
    let place = Place::new();
    let server = place.start();
    let envs = 30_000;
    let mut session = create_in(&server, envs).await;
    session.reset(0).await;
    let before = server.processor_time();
    session.step(0).await;
    let whole = server.processor_time() - before;
    // The server is told to end after it has used a part of the processor time of a step, that is, during the step. On a
    // busy machine this test may notice too late; then it tries the next step.
    let mut time = 0;
    let sent = loop {
        time += 1;
        assert!(time < 20, "no step was seen in its middle");
        let before = server.processor_time();
        let spent = || (server.processor_time() - before) / whole;
        let sent = session.send(Some(step(&wave(0..envs as usize, time)))).await;
        until(async || spent() > 0.3).await;
        server.signal("-STOP");
        if spent() < 0.9 {
            break sent;
        }
        server.signal("-CONT");
        session.receive().await.unwrap();
    };
    server.signal("-TERM");
    server.signal("-CONT");
    let end = tokio::task::spawn_blocking(|| server.end());
    let mut answered = None;
    let status = loop {
        match session.receive().await {
            Ok((sequence, Response::Batch(batch))) => answered = Some((sequence, batch)),
            Ok(other) => panic!("{other:?}"),
            Err(status) => break status,
        }
    };
    assert_eq!((status.code(), status.message()), (Code::Unavailable, "the server is shutting down"));
    let (_, log) = end.await.unwrap();
    assert!(!log.contains("did not end in time"), "{log}");
    let server = place.start();
    let (mut again, last) = Session::resume(server.client().await, &session.id, sent - 1).await.unwrap();
    assert_eq!(last, sent, "it was carried out");
    let batch = again.step(time).await;
    assert_eq!(answered, Some((sent, batch)), "it was answered, and whoever repeats it gets the same answer");
}

/// Sessions are saved, idle or not, beside clients that keep all threads of the server busy with pictures. In an earlier
/// version four such clients kept the server from saving any session, and its exit code was 0.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn all_sessions_are_saved_beside_slow_requests() {
    let place = Place::new();
    let server = place.start();
    let mut idle = create_in(&server, 3).await;
    let first = idle.reset(1).await;
    let mut busy = Vec::new();
    for _ in 0..6 {
        let mut session = create_in(&server, 1).await;
        session.reset(1).await;
        let pictures = Render { indices: vec![0; 4096], width: 90, height: 90, ended: false, camera: None };
        session.send(Some(Request::Render(pictures))).await;
        busy.push(session);
    }
    tokio::time::sleep(Duration::from_millis(300)).await;
    for session in &mut busy {
        let early = tokio::time::timeout(Duration::from_millis(1), session.receive()).await;
        assert!(early.is_err(), "answered early: {early:.300?}");
    }
    let (_, log) = tokio::task::spawn_blocking(|| server.end()).await.unwrap();
    assert_eq!(log.matches("a session was saved").count(), 7, "{log}");
    let server = place.start();
    let (mut again, last) = Session::resume(server.client().await, &idle.id, 1).await.unwrap();
    assert_eq!((last, again.reset(1).await), (1, first));
    for session in &busy {
        // The pictures were not finished, so the client may ask for them again.
        assert_eq!(Session::resume(server.client().await, &session.id, 1).await.unwrap().1, 1);
    }
}

/// A server that is killed at any moment while it restores sessions leaves all of them, also when this happens again and
/// again.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn kills_during_a_restore_lose_nothing() {
    let place = Place::new();
    let mut server = place.start();
    let mut saved = Vec::new();
    for seed in 0..40 {
        let mut session = create_in(&server, 200).await;
        session.reset(seed).await;
        saved.push((session.id.clone(), session.step(0).await));
    }
    server.end();
    let files = place.files();
    assert_eq!(files.len(), saved.len());
    for k in 0..long::either(8, 100) {
        server = place.start();
        // The whole restore takes some seconds at most.
        tokio::time::sleep(Duration::from_millis(rand::random_range(0..1500))).await;
        server.kill();
        assert_eq!(place.files(), files, "kill {k}");
    }
    server = place.start();
    for (id, last) in &saved {
        let (mut session, sequence) = Session::resume(server.client().await, id, 1).await.unwrap();
        assert_eq!((sequence, &session.step(0).await), (2, last));
    }
    // The session that ends has no file, and the one that goes on has its old one: after a kill a client sees its number.
    let close = CloseSessionRequest { session_id: saved[0].0.clone() };
    server.client().await.close_session(close).await.unwrap();
    let (mut session, _) = Session::resume(server.client().await, &saved[1].0, 2).await.unwrap();
    session.step(1).await;
    server.kill();
    assert_eq!(place.files().len(), saved.len() - 1);
    server = place.start();
    assert_eq!(Session::resume(server.client().await, &saved[1].0, 3).await.unwrap().1, 2);
}

/// A second server with the same directory is refused and changes nothing in it.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn one_server_uses_a_directory_at_a_time() {
    let place = Place::new();
    let server = place.start();
    // It has restored its sessions before it answers.
    server.client().await.list_sessions(ListSessionsRequest {}).await.unwrap();
    fs::write(place.state().join(".unfinished-x"), "another server writes this").unwrap();
    let line = refused(&["--listen", "127.0.0.1:0", "--state-dir", text(&place.state())]);
    assert!(line.contains("another server uses this directory"), "{line}");
    assert_eq!(place.files().len(), 1, "the file of the first server is still there");
    server.end();
    place.start().end();
    assert!(place.files().is_empty(), "now nobody writes it");
}
