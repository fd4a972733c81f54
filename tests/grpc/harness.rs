//! A server on a Unix socket in a new directory, and a client that uses only the public protocol.

use sandgait::service::proto::environment_service_client::EnvironmentServiceClient;
use sandgait::service::proto::run_session_request::Request;
use sandgait::service::proto::run_session_response::Response;
use sandgait::service::proto::{Attach, DescribeSessionRequest, Step, Task};
use sandgait::service::proto::{Batch, CreateSessionRequest, Failure, Reset, RunSessionRequest, RunSessionResponse};
use sandgait::service::{Address, Limits, Listener, PROTOCOL, ServerSetup, serve};
use std::time::Duration;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tokio_util::sync::CancellationToken;
use tonic::service::Interceptor;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::{Channel, Endpoint};
use tonic::{Code, Status, Streaming};

pub const TASK: &str = "sandgait/HexapodGait-v1";

/// Joints of the reference robot: numbers in an action row.
pub const ACTIONS: usize = 6;

pub type Client = EnvironmentServiceClient<InterceptedService<Channel, Bearer>>;

/// Adds the client's token, if it has one, to every call.
#[derive(Clone, Default)]
pub struct Bearer(pub Option<String>);

impl Interceptor for Bearer {
    fn call(&mut self, mut call: tonic::Request<()>) -> Result<tonic::Request<()>, Status> {
        if let Some(token) = &self.0 {
            call.metadata_mut().insert("authorization", format!("Bearer {token}").parse().unwrap());
        }
        Ok(call)
    }
}

pub fn client(channel: Channel, bearer: Bearer) -> Client {
    EnvironmentServiceClient::with_interceptor(channel, bearer).max_decoding_message_size(usize::MAX)
}

pub struct Server {
    pub address: Address,
    pub stop: CancellationToken,
    pub done: Option<tokio::task::JoinHandle<sandgait::Result<()>>>,
    _directory: tempfile::TempDir,
}

impl Drop for Server {
    fn drop(&mut self) {
        self.stop.cancel();
    }
}

impl Server {
    pub async fn start(threads: usize) -> Self {
        Self::with_limits(threads, Limits::default()).await
    }

    pub async fn with_limits(threads: usize, limits: Limits) -> Self {
        Self::with(ServerSetup { threads, limits, ..ServerSetup::default() }).await
    }

    pub async fn with(setup: ServerSetup) -> Self {
        let directory = tempfile::tempdir().unwrap();
        let address = Address::Unix(directory.path().join("sock"));
        Self::listen(setup, address, directory).await
    }

    /// A server on a TCP port of the loopback interface.
    pub async fn tcp(setup: ServerSetup) -> Self {
        Self::listen(setup, "127.0.0.1:0".parse().unwrap(), tempfile::tempdir().unwrap()).await
    }

    async fn listen(setup: ServerSetup, address: Address, directory: tempfile::TempDir) -> Self {
        let listener = Listener::bind(&address).await.unwrap();
        let (address, stop) = (listener.address().unwrap(), CancellationToken::new());
        let done = Some(tokio::spawn(serve(listener, setup, stop.clone())));
        Self { address, stop, done, _directory: directory }
    }

    pub async fn channel(&self) -> Channel {
        let uri = match &self.address {
            Address::Tcp(address) => format!("http://{address}"),
            Address::Unix(path) => format!("unix://{}", path.display()),
        };
        Endpoint::from_shared(uri).unwrap().connect().await.unwrap()
    }

    pub async fn client(&self) -> Client {
        client(self.channel().await, Bearer::default())
    }

    pub async fn session(&self, envs: u32) -> Session {
        Session::create(self.client().await, envs, &[]).await.unwrap()
    }
}

pub fn text(s: &str) -> prost_types::Value {
    prost_types::Value { kind: Some(prost_types::value::Kind::StringValue(s.into())) }
}

pub fn number(x: f64) -> prost_types::Value {
    prost_types::Value { kind: Some(prost_types::value::Kind::NumberValue(x)) }
}

pub fn options(fields: &[(&str, prost_types::Value)]) -> Option<prost_types::Struct> {
    let fields = fields.iter().map(|(k, v)| ((*k).to_owned(), v.clone())).collect();
    Some(prost_types::Struct { fields })
}

pub fn create(envs: u32, fields: &[(&str, prost_types::Value)]) -> CreateSessionRequest {
    CreateSessionRequest { task_id: TASK.into(), num_envs: envs, options: options(fields), protocol: PROTOCOL }
}

/// A stream: a sender of requests and a receiver of answers.
async fn open(client: &mut Client) -> Result<(mpsc::Sender<RunSessionRequest>, Streaming<RunSessionResponse>), Status> {
    let (requests, receiver) = mpsc::channel(8);
    let answers = client.run_session(ReceiverStream::new(receiver)).await?.into_inner();
    Ok((requests, answers))
}

/// A session with an open stream.
pub struct Session {
    pub client: Client,
    pub id: String,
    pub task: Task,
    pub envs: usize,
    pub requests: mpsc::Sender<RunSessionRequest>,
    pub answers: Streaming<RunSessionResponse>,
    sequence: u64,
}

impl Session {
    pub async fn create(client: Client, envs: u32, fields: &[(&str, prost_types::Value)]) -> Result<Self, Status> {
        Self::create_by(client, create(envs, fields)).await
    }

    pub async fn create_by(mut client: Client, request: CreateSessionRequest) -> Result<Self, Status> {
        let envs = request.num_envs;
        let created = client.create_session(request).await?.into_inner();
        let (requests, answers) = open(&mut client).await?;
        let task = created.task.unwrap();
        Ok(Self { client, id: created.session_id, task, envs: envs as usize, requests, answers, sequence: 0 })
    }

    /// Opens a new stream to a session, as a client does after it lost its stream. `sequence` is the number of the last request whose
    /// answer it has. Returns the number of the last request that the server has carried out.
    pub async fn resume(mut client: Client, id: &str, sequence: u64) -> Result<(Self, u64), Status> {
        let request = DescribeSessionRequest { session_id: id.into() };
        let described = client.describe_session(request).await?.into_inner();
        let (requests, answers) = open(&mut client).await?;
        let (task, envs) = (described.task.unwrap(), described.summary.unwrap().num_envs as usize);
        let mut session = Self { client, id: id.into(), task, envs, requests, answers, sequence };
        let message =
            RunSessionRequest { session_id: id.into(), sequence: 0, request: Some(Request::Attach(Attach {})) };
        session.requests.send(message).await.unwrap();
        match session.receive().await? {
            (0, Response::Attached(attached)) => Ok((session, attached.last_sequence)),
            (_, other) => panic!("{other:?}"),
        }
    }

    /// Sends a request and does not wait. Every message names the session.
    pub async fn send(&mut self, request: Option<Request>) -> u64 {
        self.sequence += 1;
        let message = RunSessionRequest { session_id: self.id.clone(), sequence: self.sequence, request };
        self.requests.send(message).await.unwrap();
        self.sequence
    }

    /// The next answer and its sequence number.
    pub async fn receive(&mut self) -> Result<(u64, Response), Status> {
        let answer = tokio::time::timeout(Duration::from_secs(60), self.answers.message()).await.unwrap()?;
        let answer = answer.ok_or_else(|| Status::new(Code::Ok, "end of stream"))?;
        Ok((answer.sequence, answer.response.unwrap()))
    }

    pub async fn ask(&mut self, request: Option<Request>) -> Response {
        let sent = self.send(request).await;
        let (sequence, response) = self.receive().await.unwrap();
        assert_eq!(sequence, sent);
        response
    }

    pub async fn batch(&mut self, request: Request) -> Batch {
        match self.ask(Some(request)).await {
            Response::Batch(batch) => batch,
            other => panic!("{other:?}"),
        }
    }

    pub async fn failure(&mut self, request: Option<Request>) -> Failure {
        match self.ask(request).await {
            Response::Failure(failure) => failure,
            _ => panic!("the request was carried out"),
        }
    }

    /// Resets all environments; environment i gets the seed `first` + i.
    pub async fn reset(&mut self, first: u64) -> Batch {
        let seeds = (0..self.envs as u64).map(|i| first + i).collect();
        self.batch(Request::Reset(Reset { seeds, ..Default::default() })).await
    }

    /// One step with actions that differ by environment, joint and `time`.
    pub async fn step(&mut self, time: usize) -> Batch {
        self.batch(step(&wave(0..self.envs, time))).await
    }
}

pub fn step(actions: &[f32]) -> Request {
    Request::Step(Step { actions: actions.iter().flat_map(|a| a.to_le_bytes()).collect(), ..Default::default() })
}

/// Smooth actions of environments `envs` at step `time`.
pub fn wave(envs: std::ops::Range<usize>, time: usize) -> Vec<f32> {
    let action = |env: usize, joint: usize| ((env * 7 + joint * 3 + time) as f32 * 0.37).sin();
    envs.flat_map(|env| (0..ACTIONS).map(move |joint| action(env, joint))).collect()
}

pub fn floats(bytes: &[u8]) -> Vec<f32> {
    bytes.chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect()
}

/// Waits until `ready`, with a limit that suits a slow machine.
pub async fn until(mut ready: impl AsyncFnMut() -> bool) {
    for _ in 0..500 {
        if ready().await {
            return;
        }
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    panic!("not within 5 s");
}
