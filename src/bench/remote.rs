//! Steps through the real service: a server in this process, and the client that the Python package has, joined by a
//! socket.

use super::Stepper;
use crate::client::{PATIENCE, ServerAddress, Stream, call, runtime};
use crate::service::proto::run_session_request::Request;
use crate::service::proto::run_session_response::Response;
use crate::service::proto::{Reset, Rollout, RunSessionRequest, Step};
use crate::service::{self, Address, Listener, ServerSetup};
use crate::{Error, Result};
use serde_json::Value;
use std::sync::atomic::{AtomicU32, Ordering};
use tokio::runtime::{Builder, Runtime};
use tokio_util::sync::CancellationToken;

/// Number of the next socket of this process.
static NEXT: AtomicU32 = AtomicU32::new(0);

/// A session of a server in this process, with one stream and one step in flight.
pub struct ServerStepper {
    stream: Stream,
    sequence: u64,
    stop: CancellationToken,
    _server: Runtime,
}

fn failed(what: impl std::fmt::Display) -> Error {
    Error::Exhausted(format!("the session failed: {what}"))
}

impl ServerStepper {
    pub fn new(task: &str, options: Value, envs: usize, threads: usize, tcp: bool) -> Result<Self> {
        let server = Builder::new_multi_thread().worker_threads(2).enable_all().build().map_err(failed)?;
        let stop = CancellationToken::new();
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        let socket = std::env::temp_dir().join(format!("sandgait-bench-{}-{number}.sock", std::process::id()));
        let address = if tcp { "127.0.0.1:0".into() } else { format!("unix:{}", socket.display()) };
        let listener = server.block_on(Listener::bind(&address.parse::<Address>()?))?;
        let place = ServerAddress { address: listener.address()?.to_string(), ..ServerAddress::default() };
        server.spawn(service::serve(listener, ServerSetup { threads, ..ServerSetup::default() }, stop.clone()));
        let created = call::create_session(&place, task.into(), envs as u32, &options);
        let session = runtime().map_err(failed)?.block_on(created).map_err(failed)?.session_id;
        let stream = Stream::open(place, session, || Ok::<_, Error>(()))?.map_err(failed)?;
        let mut stepper = Self { stream, sequence: 0, stop, _server: server };
        let reset = Reset { seeds: (0..envs as u64).collect(), ..Default::default() };
        stepper.ask(Request::Reset(reset), |answer| matches!(answer, Response::Batch(_)))?;
        Ok(stepper)
    }

    /// Makes a request and waits for the answer for which `is_last` is true.
    fn ask(&mut self, request: Request, is_last: impl Fn(&Response) -> bool) -> Result<()> {
        self.sequence += 1;
        let (session_id, sequence) = (String::new(), self.sequence);
        self.stream.send(RunSessionRequest { session_id, sequence, request: Some(request) }, true);
        loop {
            match self.stream.receive(PATIENCE).transpose().map_err(failed)?.and_then(|answer| answer.response) {
                Some(answer) if is_last(&answer) => return Ok(()),
                Some(Response::Failure(f)) => return Err(failed(f.message)),
                _ => {}
            }
        }
    }
}

impl Stepper for ServerStepper {
    fn step(&mut self, actions: &[f32]) -> Result<()> {
        let actions: Vec<u8> = actions.iter().flat_map(|a| a.to_le_bytes()).collect();
        let request = Request::Step(Step { actions: actions.into(), ..Default::default() });
        self.ask(request, |answer| matches!(answer, Response::Batch(_)))
    }
}

/// Control steps of one rollout: our choice, the episode of `examples/ray_es.py`.
const ROLLOUT: usize = 150;

/// A session like that of [`ServerStepper`], but each step of it is a rollout.
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
        self.remote.ask(Request::Rollout(rollout), is_last)
    }
}

impl Drop for ServerStepper {
    fn drop(&mut self) {
        self.stop.cancel();
    }
}
