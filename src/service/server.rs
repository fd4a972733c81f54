//! A listener, the services and an end: one server.
//!
//! ```text
//!  stop ──▶ health NOT_SERVING ──▶ operations in flight end, streams and connections close ──▶ sessions are saved
//! ```

use super::address::Listener;
use super::dm_env_rpc::DmEnvRpc;
use super::dm_env_rpc::proto::environment_server::EnvironmentServer as DmEnvRpcServer;
use super::gate::{self, Gate};
use super::intake::{self, Intake};
use super::metrics;
use super::proto::DESCRIPTORS;
use super::proto::environment_service_server::EnvironmentServiceServer;
use super::proto::study_service_server::StudyServiceServer;
use super::security::{Tls, Token};
use super::sessions::{Limits, Sessions};
use super::state::StateDir;
use super::studies::Studies;
use super::{Service, off_runtime, viewer};
use crate::error::{Error, Result};
use crate::pool::{Pool, Seal};
use axum::middleware;
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpListener;
use tokio::time::Instant;
use tokio_stream::wrappers::UnixListenerStream;
use tokio_stream::{Stream, StreamExt as _};
use tokio_util::sync::CancellationToken;
use tonic::body::Body;
use tonic::server::NamedService;
use tonic::service::{Routes, RoutesBuilder};
use tonic::transport::server::{Connected, TcpIncoming};
use tonic_health::ServingStatus;
use tonic_health::server::{HealthReporter, HealthService};

/// How long connections may take to end once the server stops; a step in flight takes milliseconds.
const GRACE: Duration = Duration::from_secs(3);

/// When sessions must have been saved after the server was told to stop.
const SAVED: Duration = Duration::from_secs(4);

/// A TCP peer that is silent for this long is asked for a sign of life, and dropped if it gives none as long.
const KEEPALIVE: Duration = Duration::from_secs(60);

/// Time to wait before accepting again when it failed (no file descriptors left).
const ACCEPT_PAUSE: Duration = Duration::from_millis(50);

/// Largest HTTP/2 frame we accept.
const FRAME: u32 = 1 << 20;

/// What a server is made of, apart from where it listens.
#[derive(Default)]
pub struct Setup {
    /// Threads that simulate; 0: one for each processor.
    pub threads: usize,
    pub limits: Limits,
    /// Encryption; for TCP only.
    pub tls: Option<Tls>,
    /// What every call must say, but those that ask for the server's health.
    pub token: Option<Token>,
    /// Of snapshots and kept sessions.
    pub seal: Seal,
    /// Where `GET /metrics` is answered.
    pub metrics: Option<TcpListener>,
    /// Where browsers see the sessions.
    pub viewer: Option<TcpListener>,
    /// Where sessions are kept while no server runs.
    pub state: Option<StateDir>,
    /// Also serve dm_env_rpc.
    pub dm_env_rpc: bool,
}

/// Serves until `stop` is cancelled, then lets every stream finish the operation it has in flight.
pub async fn serve(listener: Listener, setup: Setup, stop: CancellationToken) -> Result<()> {
    let Setup { threads, limits, tls, token, seal, metrics, viewer, state, dm_env_rpc } = setup;
    let (sessions, pool) = (Sessions::new(limits, seal, stop.clone()), Arc::new(Pool::new(threads)));
    if let Some(state) = state.clone() {
        let (sessions, pool) = (sessions.clone(), pool.clone());
        let taken = off_runtime(move || state.take_up(&sessions, &pool)).await;
        taken.map_err(|e| Error::Exhausted(e.message().into()))?;
    }
    tokio::spawn(sessions.clone().expire());
    if let Some(listener) = metrics {
        let page = metrics::serve(listener, sessions.clone(), stop.clone());
        tokio::spawn(async { page.await.inspect_err(|error| tracing::error!(%error, "metrics")) });
    }
    if let Some(listener) = viewer {
        let page = viewer::serve(listener, sessions.clone(), stop.clone());
        tokio::spawn(async { page.await.inspect_err(|error| tracing::error!(%error, "viewer")) });
    }
    let health = HealthReporter::new();
    let mut offer = Offer { routes: Routes::builder(), names: vec![""] };
    if dm_env_rpc {
        offer.add(DmEnvRpcServer::new(DmEnvRpc::new(sessions.clone(), pool.clone())));
    }
    let intake = Intake::new(sessions.limits());
    let window = intake.window();
    add_services(&mut offer, &sessions, pool.clone(), &intake, &health)?;
    for name in &offer.names {
        health.set_service_status(name, ServingStatus::Serving).await;
    }
    let gate = Gate { token, metrics: sessions.metrics.clone() };
    let routes = offer.routes.routes().into_axum_router();
    let routes = routes.layer(middleware::from_fn_with_state(intake, intake::pass));
    let routes = routes.layer(middleware::from_fn_with_state(gate, gate::pass));
    let saved = tokio::spawn(end(sessions, health, offer.names, state));
    match listener {
        Listener::Tcp(listener) => {
            // Without nodelay a small call takes 44 ms; `Server::tcp_nodelay` is ignored when we bring the listener.
            let tcp = TcpIncoming::from(listener).with_nodelay(Some(true)).with_keepalive(Some(KEEPALIVE));
            match tls {
                None => drive(routes.into(), tcp, Some(KEEPALIVE), window, stop).await?,
                Some(tls) => drive(routes.into(), tls.accept(tcp), Some(KEEPALIVE), window, stop).await?,
            }
        }
        Listener::Unix(listener, _file) => {
            drive(routes.into(), UnixListenerStream::new(listener), None, window, stop).await?;
        }
    }
    let saved = saved.await;
    // Not before: a pool that ends drops the batches whose clients have gone.
    drop(pool);
    saved.map_err(|e| Error::Exhausted(format!("the sessions could not be saved: {e}")))
}

/// Services and their names.
struct Offer {
    routes: RoutesBuilder,
    names: Vec<&'static str>,
}

impl Offer {
    fn add<S>(&mut self, service: S) -> &mut Self
    where
        S: NamedService + Clone + Send + Sync + 'static,
        S: tower_service::Service<axum::http::Request<Body>, Error = std::convert::Infallible>,
        S::Response: axum::response::IntoResponse,
        S::Future: Send + 'static,
    {
        self.routes.add_service(service);
        self.names.push(S::NAME);
        self
    }
}

/// Everything a client can call.
fn add_services(
    offer: &mut Offer,
    sessions: &Arc<Sessions>,
    pool: Arc<Pool>,
    intake: &Arc<Intake>,
    health: &HealthReporter,
) -> Result<()> {
    // The intake has let no message pass that is too large.
    let largest = sessions.limits().request;
    let environments = Service { sessions: sessions.clone(), pool, intake: intake.clone() };
    let reflection = || {
        tonic_reflection::server::Builder::configure()
            .register_encoded_file_descriptor_set(DESCRIPTORS)
            .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
    };
    let broken = |e| Error::Exhausted(format!("reflection is not available: {e}"));
    offer
        .add(
            EnvironmentServiceServer::new(environments)
                .max_decoding_message_size(largest)
                .max_encoding_message_size(u32::MAX as usize),
        )
        .add(
            StudyServiceServer::new(Studies::new(sessions.stop().clone()))
                .max_decoding_message_size(largest)
                .max_encoding_message_size(u32::MAX as usize),
        )
        .add(tonic_health::pb::health_server::HealthServer::new(HealthService::from_health_reporter(health.clone())))
        .add(reflection().build_v1().map_err(broken)?)
        .add(reflection().build_v1alpha().map_err(broken)?);
    Ok(())
}

/// What is done when the server stops, beside closing its connections.
async fn end(sessions: Arc<Sessions>, mut health: HealthReporter, names: Vec<&'static str>, state: Option<StateDir>) {
    sessions.stop().cancelled().await;
    let deadline = Instant::now() + SAVED;
    for name in names {
        health.set_service_status(name, ServingStatus::NotServing).await;
        // Ends the streams of those who watch, after they were told.
        health.clear_service_status(name).await;
    }
    let Some(state) = state else { return };
    let seal = sessions.seal.clone();
    let sessions = sessions.drain(deadline - SAVED / 4).await;
    let save = tokio::task::spawn_blocking(move || state.save(sessions, &seal, deadline.into_std()));
    match tokio::time::timeout_at(deadline, save).await {
        Ok(Ok(())) => {}
        Ok(Err(error)) => tracing::error!(%error, "sessions were lost: they could not be saved"),
        Err(_) => tracing::error!("sessions were lost: the disk took too long"),
    }
}

async fn drive<C>(
    routes: Routes,
    incoming: impl Stream<Item = std::io::Result<C>>,
    keepalive: Option<Duration>,
    window: u32,
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
        .initial_stream_window_size(window)
        .initial_connection_window_size(2 * window)
        .max_frame_size(window.min(FRAME))
        .add_routes(routes)
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
