//! A listener, the service and an end: one server.

use super::Service;
use super::address::Listener;
use super::dm_env_rpc::DmEnvRpc;
use super::dm_env_rpc::proto::environment_server::EnvironmentServer as DmEnvRpcServer;
use super::proto::environment_service_server::EnvironmentServiceServer;
use super::proto::study_service_server::StudyServiceServer;
use super::sessions::Limits;
use super::studies::{self, Studies};
use crate::error::{Error, Result};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio_stream::wrappers::UnixListenerStream;
use tokio_stream::{Stream, StreamExt as _};
use tokio_util::sync::CancellationToken;
use tonic::transport::server::{Connected, TcpIncoming};

/// How long connections may take to end once the server stops; a step in flight takes milliseconds.
const GRACE: Duration = Duration::from_secs(3);

/// A TCP peer that is silent for this long is asked for a sign of life, and dropped if it gives none as long.
const KEEPALIVE: Duration = Duration::from_secs(60);

/// Time to wait before accepting again when it failed (no file descriptors left).
const ACCEPT_PAUSE: Duration = Duration::from_millis(50);

/// Bytes a client may send ahead on a connection: a step of the largest usual batch without waiting for credit.
const WINDOW: u32 = 4 << 20;

/// HTTP/2 frame size we accept.
const FRAME: u32 = 1 << 20;

/// Serves until `stop` is cancelled, then lets every stream finish the operation it has in flight.
pub async fn serve(listener: Listener, threads: usize, limits: Limits, stop: CancellationToken) -> Result<()> {
    let largest = limits.request;
    let with_dm_env_rpc = limits.dm_env_rpc;
    let service = Service::new(threads, limits, stop.clone());
    let dm_env_rpc = DmEnvRpc::new(service.sessions.clone(), service.pool.clone());
    let dm_env_rpc = with_dm_env_rpc.then(|| DmEnvRpcServer::new(dm_env_rpc));
    let environments = EnvironmentServiceServer::new(service)
        .max_decoding_message_size(largest)
        .max_encoding_message_size(u32::MAX as usize);
    let studies = StudyServiceServer::new(Studies::new(stop.clone()))
        .max_decoding_message_size(studies::MOST_BYTES)
        .max_encoding_message_size(u32::MAX as usize);
    let services = Services { environments, studies, dm_env_rpc };
    match listener {
        Listener::Tcp(listener) => {
            // Without nodelay a small call takes 44 ms; `Server::tcp_nodelay` is ignored when we bring the listener.
            let tcp = TcpIncoming::from(listener).with_nodelay(Some(true)).with_keepalive(Some(KEEPALIVE));
            drive(services, tcp, Some(KEEPALIVE), stop).await
        }
        Listener::Unix(listener, _file) => drive(services, UnixListenerStream::new(listener), None, stop).await,
    }
}

struct Services {
    environments: EnvironmentServiceServer<Service>,
    studies: StudyServiceServer<Studies>,
    dm_env_rpc: Option<DmEnvRpcServer<DmEnvRpc>>,
}

async fn drive<C>(
    services: Services,
    incoming: impl Stream<Item = std::io::Result<C>>,
    keepalive: Option<Duration>,
    stop: CancellationToken,
) -> Result<()>
where
    C: AsyncRead + AsyncWrite + Connected + Unpin + Send + 'static,
{
    let incoming = incoming.then(async |connection| {
        if let Err(error) = &connection {
            tracing::warn!(%error, "cannot accept a connection");
            tokio::time::sleep(ACCEPT_PAUSE).await;
        }
        connection
    });
    let serving = tonic::transport::Server::builder()
        .http2_keepalive_interval(keepalive)
        .http2_keepalive_timeout(keepalive)
        .initial_stream_window_size(WINDOW)
        .initial_connection_window_size(2 * WINDOW)
        .max_frame_size(FRAME)
        .add_service(services.environments)
        .add_service(services.studies)
        .add_optional_service(services.dm_env_rpc)
        .serve_with_incoming_shutdown(incoming, stop.clone().cancelled_owned());
    let too_late = async {
        stop.cancelled().await;
        tokio::time::sleep(GRACE).await;
    };
    tokio::select! {
        result = serving => result.map_err(|e| Error::Exhausted(format!("the server failed: {e}"))),
        () = too_late => {
            tracing::warn!("connections were cut that did not end in time");
            Ok(())
        }
    }
}
