//! The gRPC service `sandgait.v1`: messages in, messages out.
//!
//! The async runtime's threads pass messages on, and unpack and check small requests. Simulation and other long work
//! run on other threads.
//!
//! * [`address`]: the address of a server; [`server`]: its services until it is stopped.
//! * [`connections`]: incoming connections and their limits; [`refusals`]: the sampled log of refusals.
//! * [`security`]: TLS and the token; [`gate`]: the layer around all calls.
//! * [`metrics`]: counters, as a page.
//! * [`sessions`]: the environments of clients, and the limits; [`state`]: sessions that outlive their server.
//! * [`stream`]: one RunSession stream, request by request; [`work`]: the work of one request; [`rollout`]: the work of a request for a rollout.
//! * [`view`]: requests for pictures and moments; [`viewer`]: the page that follows sessions.
//! * [`studies`]: the offline tools, one at a time.
//! * [`price`]: what each call may cost; [`fields`]: what a message may contain; [`intake`]: the memory of requests;
//!   [`outgoing`]: the memory of answers; [`share`]: a part of it, and [`unread`]: until its client has read an answer;
//!   [`frame`]: requests that are not unpacked.
//! * [`decode`], [`encode`], [`values`]: messages from and to the crate's types.
//! * [`status`]: the map from errors to gRPC codes.

use sandgait_base::{error, parallel, progress};
use sandgait_env as env;
use sandgait_pool as pool;
use sandgait_session as session;
use sandgait_sim as sim;
use sandgait_study as study;

pub mod address;
mod building;
mod connection_table;
mod connections;
mod decode;
mod encode;
mod fields;
pub mod frame;
#[cfg(test)]
mod fuzz;
mod gate;
pub mod intake;
pub mod limits;
mod metrics;
mod names;
mod outgoing;
mod platform;
mod price;
mod refusals;
mod rollout;
mod security;
pub mod server;
pub mod sessions;
mod share;
mod sliced;
mod state;
pub mod status;
mod stream;
pub mod studies;
mod unread;
pub mod values;
mod view;
mod viewer;
mod work;

/// Generated from `proto/sandgait/v1/` by `make proto`; `tests/generated.rs` checks that it is current.
pub mod proto {
    include!("generated/sandgait.v1.rs");
    include!("generated/server/sandgait.v1.rs");

    /// The descriptors of the protos, for reflection.
    pub const DESCRIPTORS: &[u8] = include_bytes!("generated/descriptors.bin");
}

pub use crate::pool::Seal;
pub use address::{Address, Listener, bind_tcp};
pub use encode::task;
pub use limits::Limits;
pub use security::{Tls, Token, warn_if_shared};
pub use server::{AddServices, ServerSetup, serve};
pub use state::StateDir;
pub use values::{from_json, number};
pub use viewer::play::{PlayedEnvironment, resting};

use crate::env::registry::{Blueprint, TASK_IDS};
use crate::error::Error;
use crate::pool::Pool;
use frame::RequestFrame;
use futures_util::Stream;
use intake::{Intake, Messages};
use proto::environment_service_server::EnvironmentService;
use proto::{CloseSessionRequest, CloseSessionResponse, CreateSessionRequest, CreateSessionResponse};
use proto::{DescribeRequest, DescribeResponse, RunSessionRequest, RunSessionResponse};
use proto::{DescribeSessionRequest, DescribeSessionResponse, ListSessionsRequest, ListSessionsResponse};
use serde_json::Value;
use sessions::Sessions;
use std::pin::Pin;
use std::sync::Arc;
use tokio::sync::OnceCell;
use tonic::{Request, Response, Status, Streaming};

/// Version of the protocol. It is increased by every change after which an old client would misread this server.
pub const PROTOCOL: u32 = 1;

const VERSION: &str = env!("CARGO_PKG_VERSION");

/// `sandgait.v1.EnvironmentService`.
pub struct Service {
    sessions: Arc<Sessions>,
    pool: Arc<Pool>,
    intake: Arc<Intake>,
    /// The answer of Describe, which is always the same.
    described: OnceCell<DescribeResponse>,
}

/// Runs `work` on a blocking thread.
async fn off_runtime<T: Send + 'static>(
    work: impl FnOnce() -> crate::error::Result<T> + Send + 'static,
) -> Result<T, Status> {
    let done = tokio::task::spawn_blocking(work).await;
    let failed = |_| Err(Error::Internal("the request failed inside the server".into()));
    done.unwrap_or_else(failed).map_err(|e| status::status(&e))
}

fn check_protocol(client: u32) -> crate::error::Result<()> {
    if client == PROTOCOL {
        return Ok(());
    }
    let older = if client < PROTOCOL { "the client" } else { "the server" };
    Err(Error::invalid(
        "protocol",
        format!("the client speaks {client}, sandgait {VERSION} speaks {PROTOCOL}: update {older}"),
    ))
}

#[tonic::async_trait]
impl EnvironmentService for Service {
    async fn describe(
        &self,
        request: Request<RequestFrame<DescribeRequest>>,
    ) -> Result<Response<DescribeResponse>, Status> {
        let messages = Messages::of(&request);
        let describe = || async {
            let describe = |id: &&str| Blueprint::new(id, Value::Null).map(|b| encode::task(&b));
            let tasks = off_runtime(move || TASK_IDS.iter().map(describe).collect()).await?;
            Ok::<_, Status>(DescribeResponse { version: VERSION.into(), protocol: PROTOCOL, tasks })
        };
        let described = self.described.get_or_try_init(describe).await?;
        outgoing::answer(&self.intake, &messages, || Ok(described.clone())).await
    }

    async fn create_session(
        &self,
        request: Request<RequestFrame<CreateSessionRequest>>,
    ) -> Result<Response<CreateSessionResponse>, Status> {
        let lease_seconds = self.sessions.limits().lease.as_secs_f64();
        let messages = Messages::of(&request);
        let (request, _share) = RequestFrame::only(request).await?;
        let CreateSessionRequest { task_id, num_envs, options, protocol } = request;
        let made = async {
            check_protocol(protocol)?;
            self.sessions.create(task_id, num_envs as usize, values::to_json(options)?).await
        };
        let (session_id, blueprint) = made.await.map_err(|e| status::status(&e))?;
        let unanswered = self.sessions.unanswered(&session_id).map_err(|e| status::status(&e))?;
        let made = || {
            let (task, warnings) = (Some(encode::task(&blueprint)), blueprint.warnings());
            Ok(CreateSessionResponse { session_id: session_id.clone(), task, lease_seconds, warnings })
        };
        let answer = outgoing::answer(&self.intake, &messages, made).await?;
        unanswered.answered();
        Ok(answer)
    }

    type RunSessionStream = Pin<Box<dyn Stream<Item = Result<RunSessionResponse, Status>> + Send>>;

    async fn run_session(
        &self,
        request: Request<Streaming<RequestFrame<RunSessionRequest>>>,
    ) -> Result<Response<Self::RunSessionStream>, Status> {
        let messages = Messages::of(&request);
        let answers = stream::run(
            request.into_inner(),
            stream::SessionCall { messages, intake: self.intake.clone() },
            self.sessions.clone(),
            self.pool.clone(),
        );
        Ok(Response::new(Box::pin(answers)))
    }

    async fn describe_session(
        &self,
        request: Request<RequestFrame<DescribeSessionRequest>>,
    ) -> Result<Response<DescribeSessionResponse>, Status> {
        let messages = Messages::of(&request);
        let (request, _) = RequestFrame::only(request).await?;
        let describe = || {
            let summary = self.sessions.describe(&request.session_id)?;
            let task = Some(encode::task(&summary.blueprint));
            Ok(DescribeSessionResponse { task, summary: Some(encode::summary(&summary)) })
        };
        outgoing::answer(&self.intake, &messages, describe).await
    }

    async fn list_sessions(
        &self,
        request: Request<RequestFrame<ListSessionsRequest>>,
    ) -> Result<Response<ListSessionsResponse>, Status> {
        let list = || {
            let sessions = self.sessions.list().iter().map(encode::summary).collect();
            Ok(ListSessionsResponse { sessions })
        };
        outgoing::answer(&self.intake, &Messages::of(&request), list).await
    }

    async fn close_session(
        &self,
        request: Request<RequestFrame<CloseSessionRequest>>,
    ) -> Result<Response<CloseSessionResponse>, Status> {
        let (request, _) = RequestFrame::only(request).await?;
        self.sessions.close(&request.session_id).map_err(|e| status::status(&e))?;
        Ok(Response::new(CloseSessionResponse {}))
    }
}
