//! What the server reserves for environments is what they take: the reserved memory that the metrics tell is compared
//! with the resident memory of the process, after all episodes have ended once, which is when most is in use.

use crate::harness::{Session, create, number, step, text};
use crate::process::Process;
use crate::{ALONE, resident, table};
use prost_types::Value;
use prost_types::value::Kind;
use sandgait::service::proto::CreateSessionRequest;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;

/// Bounds of reserved memory relative to resident memory. The upper one is larger where an episode may take more than
/// it takes here: 512 footprints in place of a hundred; all points of a robot on hard ground at once; contacts with
/// rocks become more for hundreds of steps.
const WITHIN: [f64; 2] = [0.8, 1.25];
const MAY_GROW: f64 = 1.75;

/// Largest action of joints with which sandcat stands: our choice.
const STANDING: f32 = 0.2;

/// The memory that the server has reserved [MiB].
async fn reserved(metrics: &str) -> f64 {
    let mut stream = TcpStream::connect(metrics).await.unwrap();
    stream.write_all(b"GET /metrics HTTP/1.1\r\nhost: x\r\nconnection: close\r\n\r\n").await.unwrap();
    let mut page = String::new();
    stream.read_to_string(&mut page).await.unwrap();
    let bytes = page.lines().find_map(|l| l.strip_prefix("sandgait_memory_reserved_bytes ")).unwrap();
    bytes.parse::<f64>().unwrap() / f64::from(1 << 20)
}

/// Makes a session step until its episodes have ended; returns what was reserved and what was taken [MiB].
async fn measured(task: &str, envs: u32, fields: &[(&str, Value)], steps: usize) -> [f64; 2] {
    let server = Process::start(&[
        "--listen",
        "127.0.0.1:0",
        "--metrics",
        "127.0.0.1:0",
        "--max-memory-mib",
        "2000",
        "--max-envs",
        "10000",
    ]);
    let metrics = server.address_of("metrics are at /metrics");
    let request = |envs| CreateSessionRequest { task_id: format!("sandgait/{task}"), ..create(envs, fields) };
    // A small session starts the threads.
    let mut small = Session::create_by(server.client().await, request(2)).await.unwrap();
    small.reset(0).await;
    let before = [reserved(&metrics).await, resident(server.id())];
    let mut session = Session::create_by(server.client().await, request(envs)).await.unwrap();
    session.reset(0).await;
    let width = session.task.action.len();
    let sway = if fields.iter().any(|(name, _)| *name == "history") { STANDING } else { 1.0 };
    let mut most = [0.0_f64; 2];
    for time in 0..steps {
        // Two tripods of legs turn as fast as they can; other joints turn to and fro. With a history the last observations of
        // episodes are large, and most is in use if all episodes end in the same step; so no robot may fall.
        let hip = |leg: usize| if time < 3 && leg % 2 == 1 { 0.0 } else { 1.0 };
        let action = |k: usize| if width == 6 { hip(k % 6) } else { sway * ((k * 3 + time) as f32 * 0.37).sin() };
        session.batch(step(&(0..width * envs as usize).map(action).collect::<Vec<_>>())).await;
        if time % 10 == 0 || time + 2 > steps {
            let now = [reserved(&metrics).await, resident(server.id())];
            most = std::array::from_fn(|k| most[k].max(now[k] - before[k]));
        }
    }
    most
}

/// A task, the number of environments, options and steps.
type Case<'a> = (&'a str, u32, &'a [(&'a str, Value)], usize);

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn environments_take_what_is_reserved() {
    let _alone = ALONE.lock().await;
    let short = ("max_episode_steps", number(40.0));
    let history = ("history", number(64.0));
    let (rapier, memory) = (("engine", text("rapier")), ("memory", Value { kind: Some(Kind::BoolValue(true)) }));
    let rocks = |count| ("rocks", table(&[("count", number(count))]));
    let cases: [Case; 15] = [
        ("HexapodGait-v1", 1024, std::slice::from_ref(&short), 60),
        ("HexapodLegs-v2", 1024, std::slice::from_ref(&short), 60),
        ("HexapodTerrain-v1", 256, &[], 510),
        ("LegStroke-v0", 1024, &[], 120),
        ("LeggedVelocity-v1", 512, std::slice::from_ref(&short), 60),
        ("LeggedVelocity-v1", 512, &[short.clone(), ("ground", text("rigid"))], 60),
        ("HexapodRocks-v1", 32, std::slice::from_ref(&short), 60),
        ("HexapodRocks-v1", 16, &[short.clone(), rocks(64.0)], 60),
        ("HexapodRocks-v1", 128, &[short.clone(), rocks(1.0)], 60),
        ("HexapodGait-v1", 96, &[short.clone(), rapier.clone()], 60),
        ("HexapodLegs-v2", 96, &[short.clone(), rapier.clone()], 60),
        ("HexapodGait-v1", 256, &[short.clone(), history.clone()], 60),
        ("LeggedVelocity-v1", 256, &[short.clone(), history.clone()], 60),
        ("HexapodGait-v1", 256, &[short.clone(), memory.clone()], 60),
        ("LeggedVelocity-v1", 256, &[short.clone(), memory.clone()], 60),
    ];
    let mut wrong = Vec::new();
    for (task, envs, fields, steps) in cases {
        let [reserved, taken] = measured(task, envs, fields, steps).await;
        let names: Vec<_> = fields.iter().map(|(name, _)| *name).collect();
        let line = format!(
            "{task} {names:?}: {:.1} KiB an environment reserved, {:.1} taken, {:.2}",
            reserved * 1024.0 / f64::from(envs),
            taken * 1024.0 / f64::from(envs),
            reserved / taken
        );
        println!("{line}");
        let may_grow = task.contains("Terrain") || names.iter().any(|name| ["ground", "rocks"].contains(name));
        let most = if may_grow { MAY_GROW } else { WITHIN[1] };
        if !(WITHIN[0]..=most).contains(&(reserved / taken)) {
            wrong.push(line);
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
