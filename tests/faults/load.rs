//! 24 clients use all functions of sessions as fast as they can. Their numbers equal those of a server without load, and the
//! server's memory does not grow.
//!
//! The test takes 6 s, in `make test-long` 20 s; `make study-load` sets `SANDGAIT_LOAD_SECONDS=300`. The number of sessions that wait for the end of their
//! lease depends on the speed of the machine, so memory may grow in one window. A leak grows in every window. So the test
//! measures again after a growth, and fails after [`WINDOWS`] windows with growth.

use crate::harness::{Client, Session, create, number, step, wave};
use crate::process::Process;
use crate::{ALONE, long, rollout};
use prost::Message as _;
use sandgait::service::proto::run_session_request::Request;
use sandgait::service::proto::run_session_response::Response;
use sandgait::service::proto::{CloseSessionRequest, ListSessionsRequest, Restore, Save};
use std::hash::{DefaultHasher, Hasher as _};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

const CLIENTS: usize = 24;

/// Environments of the sessions, in turn: less than a shard, several shards, and numbers that do not fill all lanes.
const SIZES: [u32; 4] = [1, 8, 17, 40];

/// Growth of memory that is accepted: our choice, a share of the mean, and the size of a few sessions [MiB].
const FLAT: (f64, f64) = (0.05, 2.0);

/// Share of the time after which memory is measured, so that the first leases have ended: our choice.
const WARM: f64 = 0.5;

/// Growth in this number of consecutive windows counts as a leak: our choice, because without a leak the memory seldom grows so often
/// in a row.
const WINDOWS: usize = 4;

/// Creates a session and uses it; returns it with a hash of all its answers.
async fn life(client: Client, kind: usize) -> (Session, u64) {
    let mut session = Session::create(client, SIZES[kind], &[("max_episode_steps", number(12.0))]).await.unwrap();
    let mut digest = DefaultHasher::new();
    digest.write(&session.reset(100 * kind as u64).await.encode_to_vec());
    for time in 0..8 {
        digest.write(&session.step(time).await.encode_to_vec());
    }
    let Response::Snapshot(saved) = session.ask(Some(Request::Save(Save {}))).await else { panic!("no snapshot") };
    digest.write(&saved.data);
    let mut ways = [vec![], vec![]];
    for way in &mut ways {
        for time in 8..20 {
            way.push(session.step(time).await.encode_to_vec());
        }
        let restore = Restore { snapshot: saved.data.clone(), ..Default::default() };
        digest.write(&session.batch(Request::Restore(restore)).await.encode_to_vec());
    }
    assert_eq!(ways[0], ways[1], "a restored session goes on with the same bits");
    ways[0].iter().for_each(|answer| digest.write(answer));
    session.failure(Some(step(&[2.0]))).await;
    session.send(Some(rollout(session.envs, 15, kind.is_multiple_of(2)))).await;
    // The server cuts a rollout into parts by time, so only their joined content is reproducible.
    let (mut rows, mut rewards, mut returns) = (vec![], vec![], bytes::Bytes::new());
    while returns.is_empty() {
        let (_, Response::Rollout(part)) = session.receive().await.unwrap() else { panic!("no rollout") };
        rows.extend_from_slice(&part.observations);
        rewards.extend_from_slice(&part.rewards);
        returns = part.returns;
    }
    [&rows[..], &rewards, &returns].iter().for_each(|column| digest.write(column));
    digest.write(&session.batch(step_at(session.envs, 3)).await.encode_to_vec());
    (session, digest.finish())
}

fn step_at(envs: usize, time: usize) -> Request {
    step(&wave(0..envs, time))
}

/// Uses one session after the other until `done`, and compares each with the answers of a server without load. Every third session
/// is not closed, so its lease runs out. Before every tenth, a further session is created and not used.
async fn hammer(client: Client, number: usize, calm: &[u64], done: &AtomicBool, lives: &AtomicUsize) {
    for round in number.. {
        if done.load(Ordering::Relaxed) {
            return;
        }
        if round % 10 == 0 {
            client.clone().create_session(create(16, &[])).await.unwrap();
        }
        let kind = round % SIZES.len();
        let (mut session, digest) = life(client.clone(), kind).await;
        assert_eq!(digest, calm[kind], "client {number}, round {round}");
        if round % 3 != 0 {
            let close = CloseSessionRequest { session_id: session.id.clone() };
            session.client.close_session(close).await.unwrap();
        }
        lives.fetch_add(1, Ordering::Relaxed);
    }
}

/// Slope of a straight line through `points` (time [s], memory [MiB]), and their mean.
fn line(points: &[(f64, f64)]) -> (f64, f64) {
    let n = points.len() as f64;
    let (t, m) = points.iter().fold((0.0, 0.0), |(t, m), p| (t + p.0 / n, m + p.1 / n));
    let (above, below) = points.iter().fold((0.0, 0.0), |(a, b), p| (a + (p.0 - t) * (p.1 - m), b + (p.0 - t).powi(2)));
    (above / below, m)
}

/// Memory of a process for some seconds: (time [s], memory [MiB]).
fn watch(process: u32, seconds: f64) -> Vec<(f64, f64)> {
    let (begun, mut points) = (Instant::now(), Vec::new());
    while begun.elapsed().as_secs_f64() < seconds {
        points.push((begun.elapsed().as_secs_f64(), crate::resident(process)));
        std::thread::sleep(Duration::from_millis(100));
    }
    points
}

/// The memory in one window.
#[derive(Debug)]
struct Window {
    /// Mean [MiB].
    mean: f64,
    /// Growth of a straight line through the measurements [MiB].
    growth: f64,
}

impl Window {
    fn of(points: &[(f64, f64)]) -> Self {
        let (slope, mean) = line(points);
        Self { mean, growth: slope * (points.last().unwrap().0 - points[0].0) }
    }

    fn grew(&self) -> bool {
        self.growth > FLAT.0 * self.mean + FLAT.1
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn memory_stays_flat_and_numbers_equal_under_load() {
    let _alone = ALONE.lock().await;
    let seconds = std::env::var("SANDGAIT_LOAD_SECONDS").map_or(long::either(6.0, 20.0), |s| s.parse::<f64>().unwrap());
    let server = Process::start(&["--listen", "127.0.0.1:0", "--lease-seconds", long::either("1", "4")]);
    let mut calm = Vec::new();
    for kind in 0..SIZES.len() {
        calm.push(life(server.client().await, kind).await.1);
    }
    let (lives, done) = (AtomicUsize::new(0), AtomicBool::new(false));
    let (first, window) = (WARM * seconds, (1.0 - WARM) * seconds);
    let windows = std::thread::scope(|threads| {
        for number in 0..CLIENTS {
            let (server, calm, lives, done) = (&server, &calm, &lives, &done);
            threads.spawn(move || {
                let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
                runtime.block_on(async {
                    hammer(server.client().await, number, calm, done, lives).await;
                });
            });
        }
        watch(server.id(), first);
        let mut windows = Vec::new();
        while windows.len() < WINDOWS && windows.last().is_none_or(|w: &Window| w.grew()) {
            windows.push(Window::of(&watch(server.id(), window)));
        }
        done.store(true, Ordering::Relaxed);
        windows
    });
    println!("{} sessions of {CLIENTS} clients; memory of the server: {windows:.1?}", lives.load(Ordering::Relaxed));
    assert!(lives.load(Ordering::Relaxed) > CLIENTS, "every client came round");
    assert!(windows.last().is_some_and(|w| !w.grew()), "memory grew in {WINDOWS} windows in a row: {windows:.1?}");
    let mut client = server.client().await;
    crate::harness::until(async || {
        client.list_sessions(ListSessionsRequest {}).await.unwrap().into_inner().sessions.is_empty()
    })
    .await;
}
