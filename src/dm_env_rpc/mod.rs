//! `dm_env_rpc.v1.Environment`: the same tasks for DeepMind's protocol and its clients.
//!
//! ```text
//!  Process stream ──▶ connection ──▶ worlds ──▶ Sessions, Pool
//!                        └── settings, tensors: messages from and to the crate's types
//! ```
//!
//! A world is a session of one environment, with the session's id as its name, limits and lease. One connection at a
//! time can join it. Every refusal is an answer inside the stream and changes nothing.

use sandgait_base::error;
use sandgait_env as env;
use sandgait_pool as pool;
use sandgait_service::{frame, intake, sessions, status, values};

mod connection;
mod settings;
mod tensors;
mod worlds;

/// Code that is generated from `proto/dm_env_rpc/v1/` and `proto/google/rpc/`. Its modules are nested like the packages.
pub mod proto {
    pub mod google {
        pub mod rpc {
            include!("generated/google.rpc.rs");
        }
    }
    pub mod dm_env_rpc {
        pub mod v1 {
            include!("generated/dm_env_rpc.v1.rs");
            include!("generated/server/dm_env_rpc.v1.rs");
        }
    }
    pub use dm_env_rpc::v1::*;
}

use crate::pool::Pool;
use frame::RequestFrame;
use futures_util::Stream;
use intake::Messages;
use proto::environment_server::{Environment, EnvironmentServer};
use proto::{EnvironmentRequest, EnvironmentResponse};
use sessions::Sessions;
use std::pin::Pin;
use std::sync::Arc;
use tonic::{Request, Response, Status, Streaming};
use worlds::Worlds;

/// The service, which shares sessions and threads with `sandgait.v1`.
struct DmEnvRpc {
    worlds: Arc<Worlds>,
}

/// Adds this service to a server.
pub fn service() -> sandgait_service::AddServices {
    Box::new(|services, sessions, pool| {
        services.add(EnvironmentServer::new(DmEnvRpc::new(sessions.clone(), pool.clone())));
    })
}

impl DmEnvRpc {
    fn new(sessions: Arc<Sessions>, pool: Arc<Pool>) -> Self {
        Self { worlds: Worlds::new(sessions, pool) }
    }
}

#[tonic::async_trait]
impl Environment for DmEnvRpc {
    type ProcessStream = Pin<Box<dyn Stream<Item = Result<EnvironmentResponse, Status>> + Send>>;

    async fn process(
        &self,
        request: Request<Streaming<RequestFrame<EnvironmentRequest>>>,
    ) -> Result<Response<Self::ProcessStream>, Status> {
        let messages = Messages::of(&request);
        let answers = connection::run(request.into_inner(), messages, self.worlds.clone());
        Ok(Response::new(Box::pin(answers)))
    }
}
