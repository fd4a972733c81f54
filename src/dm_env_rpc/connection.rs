//! One Process stream: requests are answered one by one, in order.
//!
//! ```text
//!           join               step (its action is ignored)
//!  outside ──────▶ not running ──────────────────────────▶ running ──┐ step
//!     ▲                │ ▲                                  │   ▲    │
//!     └──── leave ─────┘ └── reset, or the episode's end ───┘   └────┘
//! ```

use super::proto::environment_request::Payload as Request;
use super::proto::environment_response::Payload as Answer;
use super::proto::google::rpc;
use super::proto::{self, EnvironmentRequest, EnvironmentResponse, EnvironmentStateType, StepRequest, StepResponse};
use super::settings::{self, ResetChanges, TensorSettings};
use super::tensors::{self, WorldView};
use super::worlds::{JoinedWorld, PendingReset, Worlds};
use crate::error::{Error, Result};
use crate::frame::RequestFrame;
use crate::intake::Messages;
use crate::status;
use futures_util::{Stream, stream};
use std::collections::HashMap;
use std::sync::Arc;
use tonic::{Code, Status, Streaming};

/// The answers to `requests`.
pub fn run(
    requests: Streaming<RequestFrame<EnvironmentRequest>>,
    messages: Messages,
    worlds: Arc<Worlds>,
) -> impl Stream<Item = std::result::Result<EnvironmentResponse, Status>> {
    let connection = Connection { requests, messages, worlds, agent: None };
    stream::try_unfold(connection, |mut c| async move { Ok(c.answer().await?.map(|answer| (answer, c))) })
}

struct Connection {
    requests: Streaming<RequestFrame<EnvironmentRequest>>,
    messages: Messages,
    worlds: Arc<Worlds>,
    /// None: no world is joined.
    agent: Option<Agent>,
}

/// The world that this connection has joined.
struct Agent {
    place: JoinedWorld,
    /// The last result of the episode; None while it is not running.
    last: Option<WorldView>,
}

impl Connection {
    /// The next answer; None when the client has no more requests.
    async fn answer(&mut self) -> std::result::Result<Option<EnvironmentResponse>, Status> {
        let stop = self.worlds.sessions.stop().clone();
        let message = stop.run_until_cancelled(self.requests.message()).await;
        let message = message.ok_or_else(|| Status::unavailable("the server is shutting down"))?;
        let Some(frame) = message.map_err(status::unreadable)? else { return Ok(None) };
        let (message, _share) = frame.open(&self.messages).await?;
        let payload = match message.payload {
            Some(request) => self.handle(request).await.unwrap_or_else(|e| refusal(&e)),
            None => refusal(&Error::invalid("payload", "the request is empty")),
        };
        if let Answer::Error(refused) = &payload {
            self.worlds.sessions.metrics.ended(refused.code.into());
        }
        Ok(Some(EnvironmentResponse { payload: Some(payload) }))
    }

    async fn handle(&mut self, request: Request) -> Result<Answer> {
        Ok(match request {
            Request::CreateWorld(create) => {
                let world_name = self.worlds.create(settings::plan(create.settings)?).await?;
                Answer::CreateWorld(proto::CreateWorldResponse { world_name })
            }
            Request::JoinWorld(join) => {
                let specs = Some(self.join(&join)?);
                Answer::JoinWorld(proto::JoinWorldResponse { specs })
            }
            Request::Step(step) => Answer::Step(self.agent("step")?.step(step).await?),
            Request::Reset(reset) => {
                let agent = self.agent("reset")?;
                agent.reset(reset.settings).await?;
                Answer::Reset(proto::ResetResponse { specs: Some(agent.place.specs()) })
            }
            Request::ResetWorld(reset) => {
                self.reset_world(reset).await?;
                Answer::ResetWorld(proto::ResetWorldResponse {})
            }
            Request::LeaveWorld(_) => {
                self.agent = None;
                Answer::LeaveWorld(proto::LeaveWorldResponse {})
            }
            Request::DestroyWorld(destroy) => {
                self.worlds.destroy(&destroy.world_name)?;
                Answer::DestroyWorld(proto::DestroyWorldResponse {})
            }
            Request::Extension(extension) => {
                let message = format!("extension: {:?} is not offered; there are no properties", extension.type_url);
                Answer::Error(rpc::Status { code: Code::Unimplemented.into(), message, details: vec![] })
            }
        })
    }

    fn agent(&mut self, what: &str) -> Result<&mut Agent> {
        self.agent.as_mut().ok_or_else(|| Error::OutOfOrder(format!("{what}: this connection has joined no world")))
    }

    fn join(&mut self, join: &proto::JoinWorldRequest) -> Result<proto::ActionObservationSpecs> {
        if let Some(agent) = &self.agent {
            let reason = format!("join_world: this connection has joined {:?}; leave it first", agent.place.name());
            return Err(Error::OutOfOrder(reason));
        }
        settings::none(&join.settings)?;
        let place = self.worlds.join(&join.world_name)?;
        Ok(self.agent.insert(Agent { place, last: None }).place.specs())
    }

    async fn reset_world(&mut self, reset: proto::ResetWorldRequest) -> Result<()> {
        match &mut self.agent {
            Some(agent) if agent.place.name() == reset.world_name => agent.reset(reset.settings).await,
            _ => {
                // The connection that has joined the world may never make another step, so this wait also ends when the
                // server stops.
                let stop = self.worlds.sessions.stop();
                let done = self.worlds.reset(&reset.world_name, settings::changes(reset.settings)?);
                let stopped = || Err(Error::Cancelled("the server is shutting down".into()));
                stop.run_until_cancelled(done).await.unwrap_or_else(stopped)
            }
        }
    }
}

impl Agent {
    async fn step(&mut self, request: StepRequest) -> Result<StepResponse> {
        tensors::check_requested(&request.requested_observations)?;
        let view = self.next_view(request.actions).await?;
        let observations = view.tensors(&request.requested_observations);
        let state = view.state;
        self.last = (state == EnvironmentStateType::Running).then_some(view);
        Ok(StepResponse { state: state.into(), observations })
    }

    async fn next_view(&self, actions: HashMap<u64, proto::Tensor>) -> Result<WorldView> {
        if let Some(PendingReset { changes, done }) = self.place.interrupt() {
            let reset = self.place.reset(changes).await;
            let changed = reset.is_ok();
            // The connection that requested the reset may have ended.
            let _ = done.send(reset.map(drop));
            if let (true, Some(last)) = (changed, &self.last) {
                return Ok(last.interrupted());
            }
        }
        if self.last.is_none() {
            return self.place.begin().await;
        }
        self.place.step(tensors::action(self.place.task.spec(), actions)?).await
    }

    /// Begins another episode; the next step returns its first observation. The present episode is used if it has no
    /// steps yet and there are no changes.
    async fn reset(&mut self, settings: TensorSettings) -> Result<()> {
        let changes = settings::changes(settings)?;
        if self.last.is_some() || changes != ResetChanges::default() {
            self.place.reset(changes).await?;
        }
        self.last = None;
        Ok(())
    }
}

fn refusal(error: &Error) -> Answer {
    let failure = status::failure(error);
    Answer::Error(rpc::Status { code: failure.code, message: failure.message, details: vec![] })
}
