//! Jumps of the system's time of day do not affect sessions and leases.

use crate::harness::{Session, create};
use crate::process::{Process, text};
use sandgait::service::proto::ListSessionsRequest;
use std::fs;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

const YEAR: i64 = 365 * 24 * 3600;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn jumps_end_no_session_and_keep_none() {
    let directory = tempfile::tempdir().unwrap();
    let (library, shift) = (directory.path().join("clock.so"), directory.path().join("shift"));
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/serve/clock.c");
    // A C compiler is available, because Rust needs one to link.
    let mut compiler = Command::new("cc");
    assert!(compiler.args(["-shared", "-fPIC", "-o"]).arg(&library).arg(&source).status().unwrap().success());
    let jump = |years: i64| fs::write(&shift, (years * YEAR).to_string()).unwrap();
    jump(0);
    let mut command = Command::new(env!("CARGO_BIN_EXE_sandgait"));
    command.arg("serve").env("LD_PRELOAD", &library).env("SHIFT", text(&shift));
    let server = Process::of(command, &["--listen", "127.0.0.1:0", "--lease-seconds", "2", "--log-format", "json"]);
    let calm = Process::start(&["--listen", "127.0.0.1:0"]);
    let mut session = Session::create(server.client().await, 3, &[]).await.unwrap();
    let mut undisturbed = Session::create(calm.client().await, 3, &[]).await.unwrap();
    assert_eq!(session.reset(4).await, undisturbed.reset(4).await);
    let mut client = server.client().await;
    for (time, years) in [20, -30, 5, -50, 0].into_iter().enumerate() {
        // A session without a stream: its lease runs while the clock jumps.
        client.create_session(create(1, &[])).await.unwrap();
        jump(years);
        tokio::time::sleep(Duration::from_millis(100)).await;
        assert_eq!(session.step(time).await, undisturbed.step(time).await);
    }
    let all = client.list_sessions(ListSessionsRequest {}).await.unwrap().into_inner().sessions;
    assert_eq!(all.len(), 6, "no lease has run out early");
    let begun = Instant::now();
    while client.list_sessions(ListSessionsRequest {}).await.unwrap().into_inner().sessions.len() > 1 {
        assert!(begun.elapsed() < Duration::from_secs(60), "leases of 2 s have not run out");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    assert_eq!(session.step(9).await, undisturbed.step(9).await);
    let (_, log) = server.end();
    let years: Vec<_> = log.lines().filter_map(|l| l.split_once("\"timestamp\":\"")).map(|(_, t)| &t[..4]).collect();
    let [first, last] = [years.iter().min(), years.iter().max()].map(|y| y.unwrap().parse::<i64>().unwrap());
    assert!(last - first > 30, "the server saw the clock jump: {years:?}");
}
