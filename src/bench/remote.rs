//! Steps through the real service: a server and a client in this process, joined by a socket.

use super::Stepper;
use crate::service::proto::environment_service_client::EnvironmentServiceClient;
use crate::service::proto::run_session_request::Request;
use crate::service::proto::run_session_response::Response;
use crate::service::proto::{CreateSessionRequest, Reset, Rollout, RunSessionRequest, RunSessionResponse, Step};
use crate::service::{self, Address, Listener, PROTOCOL, ServerSetup};
use crate::{Error, Result};
use prost_types::value::Kind;
use serde_json::Value;
use std::sync::atomic::{AtomicU32, Ordering};
use tokio::runtime::Runtime;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tokio_util::sync::CancellationToken;
use tonic::Streaming;

/// Number of the next socket of this process.
static NEXT: AtomicU32 = AtomicU32::new(0);

/// A session of a server in this process, one stream, one step in flight.
pub struct ServerStepper {
    runtime: Runtime,
    requests: mpsc::Sender<RunSessionRequest>,
    answers: Streaming<RunSessionResponse>,
    stop: CancellationToken,
    sequence: u64,
}

fn failed(what: impl std::fmt::Display) -> Error {
    Error::Exhausted(format!("the session failed: {what}"))
}

impl ServerStepper {
    pub fn new(task: &str, options: Value, envs: usize, threads: usize, tcp: bool) -> Result<Self> {
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build();
        let runtime = runtime.map_err(failed)?;
        let stop = CancellationToken::new();
        let create = CreateSessionRequest {
            task_id: task.into(),
            num_envs: envs as u32,
            options: match service::from_json(&options).kind {
                Some(Kind::StructValue(options)) => Some(options),
                _ => None,
            },
            protocol: PROTOCOL,
        };
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        let socket = std::env::temp_dir().join(format!("sandgait-bench-{}-{number}.sock", std::process::id()));
        let address = if tcp { "127.0.0.1:0".into() } else { format!("unix:{}", socket.display()) };
        let (requests, receiver) = mpsc::channel(2);
        let answers = runtime.block_on(async {
            let listener = Listener::bind(&address.parse::<Address>()?).await?;
            let bound = listener.address()?.to_string();
            tokio::spawn(service::serve(listener, ServerSetup { threads, ..ServerSetup::default() }, stop.clone()));
            let target = if tcp { format!("http://{bound}") } else { bound };
            let endpoint = tonic::transport::Endpoint::from_shared(target).map_err(failed)?.tcp_nodelay(true);
            let mut client = EnvironmentServiceClient::new(endpoint.connect().await.map_err(failed)?)
                .max_decoding_message_size(usize::MAX)
                .max_encoding_message_size(usize::MAX);
            let session_id = client.create_session(create).await.map_err(failed)?.into_inner().session_id;
            let reset = Reset { seeds: (0..envs as u64).collect(), ..Default::default() };
            let first = RunSessionRequest { session_id, sequence: 1, request: Some(Request::Reset(reset)) };
            requests.send(first).await.map_err(failed)?;
            let mut answers = client.run_session(ReceiverStream::new(receiver)).await.map_err(failed)?.into_inner();
            answers.message().await.map_err(failed)?;
            Ok::<_, Error>(answers)
        })?;
        Ok(Self { runtime, requests, answers, stop, sequence: 1 })
    }
}

impl ServerStepper {
    /// Makes a request and waits for the answer for which `is_last` is true.
    fn ask(&mut self, request: Option<Request>, is_last: impl Fn(&Response) -> bool) -> Result<()> {
        self.sequence += 1;
        let message = RunSessionRequest { session_id: String::new(), sequence: self.sequence, request };
        self.runtime.block_on(async {
            self.requests.send(message).await.map_err(failed)?;
            loop {
                match self.answers.message().await.map_err(failed)?.and_then(|a| a.response) {
                    Some(answer) if is_last(&answer) => return Ok(()),
                    Some(Response::Failure(f)) => return Err(failed(f.message)),
                    Some(_) => {}
                    None => return Err(failed("the stream ended")),
                }
            }
        })
    }
}

impl Stepper for ServerStepper {
    fn step(&mut self, actions: &[f32]) -> Result<()> {
        let actions: Vec<u8> = actions.iter().flat_map(|a| a.to_le_bytes()).collect();
        let request = Some(Request::Step(Step { actions: actions.into(), ..Default::default() }));
        self.ask(request, |answer| matches!(answer, Response::Batch(_)))
    }
}

/// Control steps of one rollout: our choice, the episode of `examples/ray_es.py`.
const ROLLOUT: usize = 150;

/// The same session, a rollout at a time.
pub struct RolloutStepper {
    pub remote: ServerStepper,
    /// Request every step's rows?
    pub trajectories: bool,
}

impl Stepper for RolloutStepper {
    fn steps(&self) -> usize {
        ROLLOUT
    }

    fn step(&mut self, actions: &[f32]) -> Result<()> {
        let actions: Vec<u8> = actions.iter().flat_map(|a| a.to_le_bytes()).collect();
        let rollout = Rollout { actions: actions.into(), trajectories: self.trajectories };
        let is_last = |answer: &Response| matches!(answer, Response::Rollout(part) if !part.returns.is_empty());
        self.remote.ask(Some(Request::Rollout(rollout)), is_last)
    }
}

impl Drop for ServerStepper {
    fn drop(&mut self) {
        self.stop.cancel();
    }
}
