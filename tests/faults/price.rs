//! The most expensive valid requests of each kind, all at the same time and again and again, by clients that sometimes
//! leave in the middle: the server's memory stays bounded, and another session steps quickly, with bit-identical
//! results.

use crate::harness::{Bearer, Client, Session, create, number, options, wave};
use crate::process::Process;
use crate::{ALONE, long, resident};
use rand::{Rng as _, SeedableRng as _};
use rand_xoshiro::Xoshiro256PlusPlus;
use sandgait::service::proto::run_session_request::Request;
use sandgait::service::proto::run_session_response::Response;
use sandgait::service::proto::study_input::Form;
use sandgait::service::proto::study_service_client::StudyServiceClient;
use sandgait::service::proto::{
    CreateSessionRequest, Observe, PolicyRollout, Render, Reset, Restore, Rollout, Save, Series, StudyInput,
    StudyRequest, Table,
};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};
use tonic::Code;
use tonic::transport::{Channel, Endpoint};

/// Memory for environments and requests, and all that the server may need besides [MiB].
const LIMIT: f64 = 64.0;
const BESIDE: f64 = 64.0;

/// Longest message under this limit [bytes].
const MESSAGE: usize = 4 << 20;

/// Bound of a step of the other session [ms].
const STEP: f64 = 50.0;

/// A policy for HexapodGait.
const PPO: &[u8] = include_bytes!("../data/policy_ppo.onnx");

/// The other session makes 20 steps a second until each kind of request was answered, and at least this number of
/// steps: in `make test`, and in `make test-long`.
const LEAST: [usize; 2] = [60, 200];
const MOST: usize = 1200;

/// After this number of steps only those kinds are asked for that were not answered yet: the memory for large requests can be taken
/// by others' requests for very long.
const LATE: usize = 500;

/// Kinds of requests to a session; one needs a snapshot, which another has made.
const KINDS: usize = 8;
const RESTORE: usize = 5;

/// Numbers of answers: one for each kind, then trials and sweeps that have begun.
type Answered = [AtomicUsize; KINDS + 2];

/// The most expensive request of a kind that the limits accept. [`RESTORE`] needs a snapshot.
fn dearest(
    kind: usize,
    session: &Session,
    snapshot: &Option<bytes::Bytes>,
    random: &mut Xoshiro256PlusPlus,
) -> Request {
    let envs = session.envs;
    let row: Vec<u8> = wave(0..envs, 0).iter().flat_map(|a| a.to_le_bytes()).collect();
    // All pictures may have 1.3 million pixels, 6 bytes each, in the memory for requests; one picture 0.8 million.
    let render = |count: usize, side| {
        Request::Render(Render { indices: vec![0; count], width: side, height: side, ended: false, camera: None })
    };
    match kind {
        0 => render(4096, 18),
        1 => render(1, 910),
        2 => {
            // Six parts of 0.5 MiB take the rest of the memory for requests.
            let actions = row.repeat((MESSAGE - (3 << 19) - 4096) / row.len()).into();
            Request::Rollout(Rollout { actions, trajectories: true })
        }
        3 => Request::PolicyRollout(PolicyRollout { onnx: PPO.into(), steps: 500, trajectories: true }),
        4 => Request::Save(Save {}),
        RESTORE => Request::Restore(Restore { snapshot: snapshot.clone().unwrap_or_default(), ..Default::default() }),
        6 => {
            // A model of its own for one environment.
            let mut mask = vec![0; envs];
            mask[random.random_range(0..envs)] = 1;
            let changes = options(&[("slope_deg", number(random.random_range(-5.0..5.0)))]);
            Request::Reset(Reset { mask: mask.into(), options: changes, ..Default::default() })
        }
        _ => Request::Observe(Observe { index: 0, ended: true }),
    }
}

async fn connect(address: &str) -> Client {
    let endpoint = Endpoint::from_shared(format!("http://{address}")).unwrap();
    crate::harness::client(endpoint.connect().await.unwrap(), Bearer::default())
}

/// The last answer to the present request; None if the session has ended.
async fn answer(session: &mut Session) -> Option<Response> {
    loop {
        match session.receive().await.ok()?.1 {
            Response::Rollout(part) if part.returns.is_empty() => {}
            last => return Some(last),
        }
    }
}

/// Makes requests of all kinds in a session of `envs` environments, and sometimes leaves without the answer.
async fn use_session(address: &str, seed: u64, envs: u32, [stop, late]: [&AtomicBool; 2], done: &Answered) {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut first = seed as usize;
    while !stop.load(Ordering::Relaxed) {
        // The memory of the other sessions may be in use.
        let Ok(mut session) = Session::create(connect(address).await, envs, &[]).await else {
            tokio::time::sleep(Duration::from_millis(50)).await;
            continue;
        };
        session.reset(seed).await;
        let mut snapshot = None;
        'kinds: for kind in (0..KINDS).map(|k| (first + k) % KINDS) {
            let wanted = done[kind].load(Ordering::Relaxed) == 0
                || (kind + 1 == RESTORE && done[RESTORE].load(Ordering::Relaxed) == 0);
            if kind == RESTORE && snapshot.is_none() || late.load(Ordering::Relaxed) && !wanted {
                tokio::time::sleep(Duration::from_millis(5)).await;
                continue;
            }
            // A request that others' requests leave no memory for may be made again.
            for _ in 0..100 {
                session.send(Some(dearest(kind, &session, &snapshot, &mut random))).await;
                if random.random_bool(0.1) {
                    break 'kinds;
                }
                match answer(&mut session).await {
                    Some(Response::Failure(refused)) if refused.code == Code::ResourceExhausted as i32 => {
                        tokio::time::sleep(Duration::from_millis(20)).await;
                        continue;
                    }
                    Some(Response::Failure(refused)) => panic!("kind {kind}: {}", refused.message),
                    Some(Response::Snapshot(saved)) => snapshot = Some(saved.data),
                    Some(_) => {}
                    // A message waited too long for its memory.
                    None => break 'kinds,
                }
                done[kind].fetch_add(1, Ordering::Relaxed);
                break;
            }
        }
        first += 1;
    }
}

/// Studies that take long, left after a while.
async fn use_studies(channel: Channel, stop: &AtomicBool, done: &Answered) {
    let mut client = StudyServiceClient::new(channel);
    while !stop.load(Ordering::Relaxed) {
        // The memory of trials is ten times their message and what their work says, of which a quarter of the 8 MiB is reserved that
        // requests may take.
        let rows = (MESSAGE / 5 * 3 / 4 - 4096) / 32;
        let column = |name: &str, x: f64| Series {
            name: name.into(),
            numbers: x.to_le_bytes().repeat(rows).into(),
            ..Default::default()
        };
        let columns = [("vx", 0.1), ("vy", 0.1), ("vz", 0.1), ("depth", 0.02)].map(|(name, x)| column(name, x));
        let form = Some(Form::Table(Table { columns: columns.to_vec(), ..Default::default() }));
        let arguments = ["--body=sphere:radius=0.05", "--trials=rows"].map(str::to_owned).to_vec();
        let files = vec![StudyInput { name: "rows".into(), form }];
        let trials = StudyRequest { name: "intrude".into(), arguments, files };
        if let Ok(answers) = client.study(trials).await {
            let answer = tokio::time::timeout(Duration::from_secs(2), answers.into_inner().message()).await;
            done[KINDS].fetch_add(usize::from(matches!(answer, Ok(Ok(_)))), Ordering::Relaxed);
        }
        // Others' large requests have their turns, too.
        tokio::time::sleep(Duration::from_millis(300)).await;
        let arguments = vec!["--vary=frequency=0.5:1.49:100".to_owned()];
        let sweep = StudyRequest { name: "sweep".into(), arguments, ..Default::default() };
        if let Ok(answers) = client.study(sweep).await {
            let answer = tokio::time::timeout(Duration::from_secs(2), answers.into_inner().message()).await;
            done[KINDS + 1].fetch_add(usize::from(matches!(answer, Ok(Ok(_)))), Ordering::Relaxed);
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_dearest_requests_keep_within_memory_and_delay_nobody() {
    let _alone = ALONE.lock().await;
    let server = Process::start(&["--listen", "127.0.0.1:0", "--max-memory-mib", "64", "--lease-seconds", "1"]);
    let mut sessions = Vec::new();
    for _ in 0..2 {
        let mut session = Session::create(server.client().await, 8, &[]).await.unwrap();
        session.reset(1).await;
        sessions.push(session);
    }
    let [mut witness, mut undisturbed] = <[Session; 2]>::try_from(sessions).ok().unwrap();
    let expected = {
        let mut all = Vec::new();
        for time in 0..MOST {
            all.push(undisturbed.step(time).await);
        }
        all
    };
    let (stop, late, done) = (Arc::<AtomicBool>::default(), Arc::<AtomicBool>::default(), Arc::<Answered>::default());
    let mut clients = Vec::new();
    let address = server.address.clone();
    for seed in 0..5 {
        let (stop, late, done, address) = (stop.clone(), late.clone(), done.clone(), address.clone());
        clients.push(tokio::spawn(async move {
            use_session(&address, seed, 600, [&stop, &late], &done).await;
        }));
    }
    let channel = Endpoint::from_shared(format!("http://{address}")).unwrap().connect().await.unwrap();
    let own = (stop.clone(), done.clone());
    clients.push(tokio::spawn(async move { use_studies(channel, &own.0, &own.1).await }));
    let (mut most, mut times, least) = (0.0_f64, Vec::new(), long::either(LEAST[0], LEAST[1]));
    for (time, expected) in expected.iter().enumerate() {
        // Large requests wait for each other's memory, so it takes a while until each kind has been answered.
        let all = done.iter().all(|n| n.load(Ordering::Relaxed) > 0);
        if all && time >= least {
            break;
        }
        late.store(time >= LATE, Ordering::Relaxed);
        let begun = Instant::now();
        assert_eq!(&witness.step(time).await, expected, "step {time}");
        times.push(begun.elapsed().as_secs_f64() * 1e3);
        most = most.max(resident(server.id()));
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    let begun = Instant::now();
    let other = CreateSessionRequest { num_envs: 1, ..create(1, &[]) };
    let created = Session::create_by(server.client().await, other).await;
    let created = (created.is_ok(), begun.elapsed());
    stop.store(true, Ordering::Relaxed);
    for client in clients {
        client.await.unwrap_or_else(|error| panic!("{error}; {}", server.log()));
    }
    times.sort_by(f64::total_cmp);
    let [median, late, last] = [50, 95, 100].map(|part| times[(times.len() * part / 100).min(times.len() - 1)]);
    let done: Vec<usize> = done.iter().map(|n| n.load(Ordering::Relaxed)).collect();
    println!(
        "{done:?} answers in {} steps; memory at most {most:.0} MiB; steps of another session [ms]: median {median:.1}, 95 % {late:.1}, \
         longest {last:.1}; a new session {created:?}",
        times.len()
    );
    assert!(most < LIMIT + BESIDE, "{most} MiB");
    // Other programs may run on the machine, so the longest step is printed only.
    assert!(late < STEP, "{late} ms");
    // Each kind was answered at least once, and not only refused.
    assert!(!done.contains(&0), "{done:?}");
}
