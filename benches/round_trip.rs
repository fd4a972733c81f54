//! What the service costs: one batched step in process beside the same step over gRPC, one line a batch size.
//!
//! `cargo bench --bench round_trip`. Client and server share the machine, so the client's cost is included.

use sandgait::env::task::{Blueprint, TASK_IDS};
use sandgait::pool::{Batch, Pool};
use sandgait::service::proto::environment_service_client::EnvironmentServiceClient;
use sandgait::service::proto::run_session_request::Request;
use sandgait::service::proto::{CreateSessionRequest, Reset, RunSessionRequest, Step};
use sandgait::service::{Address, Limits, Listener, PROTOCOL, serve};
use std::time::{Duration, Instant};
use tokio_stream::wrappers::ReceiverStream;
use tokio_util::sync::CancellationToken;
use tonic::transport::Endpoint;

/// Rounds of each kind; they alternate, so that a busy moment of the machine hits both.
const ROUNDS: usize = 20;
const STEPS: usize = 50;

fn main() {
    let threads = std::thread::available_parallelism().map_or(1, |n| n.get());
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().expect("a runtime");
    println!("{threads} threads; a step in process, over a Unix socket, the difference [µs], throughput kept");
    for envs in [1, 32, 256, 4096] {
        let (inside, outside) = runtime.block_on(measure(threads, envs));
        let micro = |d: Duration| d.as_secs_f64() * 1e6;
        let kept = 100.0 * micro(inside) / micro(outside);
        let cost = micro(outside) - micro(inside);
        println!("{envs:5} environments {:9.1} {:9.1} {cost:9.1}  {kept:.0} %", micro(inside), micro(outside));
    }
}

fn median(mut times: Vec<Duration>) -> Duration {
    times.sort();
    times[times.len() / 2]
}

async fn measure(threads: usize, envs: usize) -> (Duration, Duration) {
    let directory = tempfile::tempdir().expect("a directory");
    let address = Address::Unix(directory.path().join("sock"));
    let (listener, stop) = (Listener::bind(&address).await.expect("a socket"), CancellationToken::new());
    let server = tokio::spawn(serve(listener, threads, Limits::default(), stop.clone()));
    let path = format!("unix://{}", directory.path().join("sock").display());
    let channel = Endpoint::from_shared(path).expect("an address").connect().await.expect("a server");
    let mut client = EnvironmentServiceClient::new(channel).max_decoding_message_size(usize::MAX);
    let create = CreateSessionRequest {
        task_id: TASK_IDS[0].into(),
        num_envs: envs as u32,
        options: None,
        protocol: PROTOCOL,
    };
    let session_id = client.create_session(create).await.expect("a session").into_inner().session_id;
    let (requests, receiver) = tokio::sync::mpsc::channel(1);
    let mut answers = client.run_session(ReceiverStream::new(receiver)).await.expect("a stream").into_inner();
    let mut ask = async |request| {
        let message = RunSessionRequest { session_id: session_id.clone(), sequence: 0, request: Some(request) };
        requests.send(message).await.expect("an open stream");
        answers.message().await.expect("an answer").expect("an open stream")
    };
    ask(Request::Reset(Reset { seeds: (0..envs as u64).collect(), ..Default::default() })).await;

    let pool = Pool::new(threads);
    let blueprint = Blueprint::new(TASK_IDS[0], Default::default()).expect("defaults are sound");
    let mut batch = Batch::new(&blueprint, envs).expect("memory");
    let reset = batch.reset(None, Some((0..envs as u64).collect()), Default::default()).expect("a sound reset");
    let mut batch = pool.wait(batch, reset).expect("a reset");

    let actions = vec![0.4_f32; envs * batch.spec().action.len()];
    let bytes: Vec<u8> = actions.iter().flat_map(|a| a.to_le_bytes()).collect();
    let (mut inside, mut outside) = (Vec::new(), Vec::new());
    for _ in 0..ROUNDS {
        for _ in 0..STEPS {
            let start = Instant::now();
            let step = batch.step(actions.clone()).expect("sound actions");
            batch = pool.wait(batch, step).expect("a step");
            inside.push(start.elapsed());
        }
        for _ in 0..STEPS {
            let start = Instant::now();
            ask(Request::Step(Step { actions: bytes.clone().into() })).await;
            outside.push(start.elapsed());
        }
    }
    stop.cancel();
    drop(requests);
    let _ = server.await;
    (median(inside), median(outside))
}
