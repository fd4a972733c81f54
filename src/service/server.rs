//! A server: its listener, its services and how it stops.
//!
//! ```text
//!  stop ──▶ health NOT_SERVING ──▶ operations in flight end, streams and connections close ──▶ sessions are saved
//! ```

use super::address::Listener;
use super::connection_table::ConnectionTable;
use super::connections::{self, Connections, ListenSocket, Protocol};
use super::gate::{self, Gate};
use super::intake::{self, Intake};
use super::limits::Limits;
use super::metrics;
use super::outgoing;
use super::proto::DESCRIPTORS;
use super::proto::environment_service_server::EnvironmentServiceServer;
use super::proto::study_service_server::StudyServiceServer;
use super::refusals::Refusals;
use super::security::{Tls, Token};
use super::sessions::Sessions;
use super::state::StateDir;
use super::studies::{self, Studies};
use super::{Service, off_runtime, viewer};
use crate::error::{Error, Result};
use crate::pool::{Pool, Seal};
use axum::middleware;
use futures_util::future::BoxFuture;
use std::sync::Arc;
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::sync::{OnceCell, Semaphore};
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;
use tonic::body::Body;
use tonic::server::NamedService;
use tonic::service::{Routes, RoutesBuilder};
use tonic_health::ServingStatus;
use tonic_health::server::{HealthReporter, HealthService};

/// Time limit for saving sessions after the server was stopped: our choice, because the server must end within 5 s.
const SAVED: Duration = Duration::from_secs(4);

/// The settings of a server, apart from its address.
#[derive(Default)]
pub struct ServerSetup {
    /// Threads that simulate; 0: one for each processor.
    pub threads: usize,
    pub limits: Limits,
    /// Encryption; for TCP only.
    pub tls: Option<Tls>,
    /// The secret that every call needs, except calls for the server's health.
    pub token: Option<Token>,
    /// The key of snapshots and kept sessions.
    pub seal: Seal,
    /// Where `GET /metrics` is answered.
    pub metrics: Option<TcpListener>,
    /// Address of the live page.
    pub viewer: Option<TcpListener>,
    /// Directory in which sessions are saved while no server runs.
    pub state: Option<StateDir>,
    /// Adds services of other crates.
    pub others: Option<AddServices>,
}

/// Adds services that share the sessions and the threads of a server.
pub type AddServices = Box<dyn FnOnce(&mut Services, &Arc<Sessions>, &Arc<Pool>) + Send>;

/// Serves until `stop` is cancelled, then lets every stream finish its present operation. The future is boxed, so that the server is
/// compiled here, and not again in each crate that waits for it.
#[inline(never)]
pub fn serve(listener: Listener, setup: ServerSetup, stop: CancellationToken) -> BoxFuture<'static, Result<()>> {
    Box::pin(serve_all(listener, setup, stop))
}

async fn serve_all(listener: Listener, setup: ServerSetup, stop: CancellationToken) -> Result<()> {
    let ServerSetup { threads, limits, tls, token, seal, metrics, viewer, state, others: add_others } = setup;
    // The connections of the pages need file descriptors, too.
    let (most, streams) = (limits.connections as usize, limits.streams);
    let (few, frame) = (limits.few_streams(), limits.frame());
    let watched = limits.watchers + connections::BESIDE_WATCHERS;
    let others = [(metrics.is_some(), connections::METRICS), (viewer.is_some(), watched)];
    let others = others.iter().filter(|(given, _)| *given).map(|(_, connections)| connections).sum();
    let (sessions, pool) = (Sessions::new(limits, seal, stop.clone()), Arc::new(Pool::new(threads)));
    if let Some(state) = state.clone() {
        let files = state.clone();
        // It was not set before, because the sessions are new.
        let _ = sessions.forget.set(Box::new(move |name| files.remove(name)));
        let (sessions, pool) = (sessions.clone(), pool.clone());
        off_runtime(move || state.take_up(&sessions, &pool)).await.map_err(|e| Error::Exhausted(e.message().into()))?;
    }
    tokio::spawn(sessions.clone().expire());
    let refusals = Arc::<Refusals>::default();
    if let Some(listener) = metrics {
        let (metrics, all) = (sessions.metrics.clone(), sessions.clone());
        tokio::spawn(metrics::serve(listener, metrics, move || all.usage(), refusals.clone(), stop.clone()));
    }
    if let Some(listener) = viewer {
        tokio::spawn(viewer::serve(listener, sessions.clone(), refusals.clone(), stop.clone()));
    }
    let health = HealthReporter::new();
    let mut services = Services { routes: Routes::builder(), names: vec![""] };
    if let Some(add) = add_others {
        add(&mut services, &sessions, &pool);
    }
    let intake = Intake::new(sessions.limits());
    let (window, strangers) = (intake.window(), sessions.limits().strangers());
    add_services(&mut services, &sessions, pool.clone(), &intake, &health)?;
    for name in &services.names {
        health.set_service_status(name, ServingStatus::Serving).await;
    }
    let calls = Arc::new(Semaphore::new(sessions.limits().calls()));
    let reflections = Arc::new(Semaphore::new(gate::REFLECTIONS));
    let gate = Gate { token, metrics: sessions.metrics.clone(), refusals: refusals.clone(), calls, reflections };
    let routes = services.routes.routes().into_axum_router();
    // The outermost layer comes last.
    let routes = routes.layer(middleware::from_fn(studies::refuse_old));
    let routes = routes.layer(middleware::from_fn(outgoing::pass));
    let routes = routes.layer(middleware::from_fn_with_state(intake, intake::pass));
    let routes = routes.layer(middleware::from_fn_with_state(gate, gate::pass));
    let saved = tokio::spawn(end(sessions, health, services.names, state));
    // The socket's file stays until all connections have ended.
    let (socket, _file) = match listener {
        Listener::Tcp(listener) => (ListenSocket::Tcp(listener), None),
        Listener::Unix(listener, file) => (ListenSocket::Unix(listener), Some(file)),
    };
    let table = ConnectionTable::new(connections::room(most, others), strangers);
    let protocol = Protocol::Http2 { streams, few, window, frame };
    Connections { table, tls, protocol, routes, refusals }.serve(socket, stop).await;
    let saved = saved.await;
    // The pool ends last, because it then drops the batches whose clients have left.
    drop(pool);
    saved.unwrap_or_else(|e| Err(Error::Exhausted(format!("the sessions could not be saved: {e}"))))
}

/// Services and their names.
pub struct Services {
    routes: RoutesBuilder,
    names: Vec<&'static str>,
}

impl Services {
    /// Adds a service. The health service then reports it, and its calls need the token.
    pub fn add<S>(&mut self, service: S) -> &mut Self
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

/// Builds all services.
fn add_services(
    services: &mut Services,
    sessions: &Arc<Sessions>,
    pool: Arc<Pool>,
    intake: &Arc<Intake>,
    health: &HealthReporter,
) -> Result<()> {
    // The intake refuses larger messages before tonic reads them.
    let largest = sessions.limits().request;
    let environments = Service { sessions: sessions.clone(), pool, intake: intake.clone(), described: OnceCell::new() };
    let reflection = || {
        tonic_reflection::server::Builder::configure()
            .register_encoded_file_descriptor_set(DESCRIPTORS)
            .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
    };
    let broken = |e| Error::Exhausted(format!("reflection is not available: {e}"));
    services
        .add(
            EnvironmentServiceServer::new(environments)
                .max_decoding_message_size(largest)
                .max_encoding_message_size(u32::MAX as usize),
        )
        .add(
            StudyServiceServer::new(Studies::new(sessions.stop().clone(), sessions.limits().memory, intake.clone()))
                .max_decoding_message_size(largest)
                .max_encoding_message_size(u32::MAX as usize),
        )
        .add(tonic_health::pb::health_server::HealthServer::new(HealthService::from_health_reporter(health.clone())))
        .add(reflection().build_v1().map_err(broken)?)
        .add(reflection().build_v1alpha().map_err(broken)?);
    Ok(())
}

/// Waits until the server stops; then does everything that is left to do, except closing its connections.
async fn end(
    sessions: Arc<Sessions>,
    mut health: HealthReporter,
    names: Vec<&'static str>,
    state: Option<StateDir>,
) -> Result<()> {
    sessions.stop().cancelled().await;
    let deadline = Instant::now() + SAVED;
    for name in names {
        health.set_service_status(name, ServingStatus::NotServing).await;
        // Ends the streams of clients that watch the health, after their last events.
        health.clear_service_status(name).await;
    }
    match state {
        Some(state) => state.save(&sessions, deadline).await,
        None => Ok(()),
    }
}
