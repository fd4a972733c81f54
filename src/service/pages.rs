//! Pages for browsers and programs that speak HTTP/1: metrics and the live page.

use super::connections::{Caps, Connection, Door, Greeting, Table};
use super::refusals::Refusals;
use axum::Router;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use std::sync::Arc;
use std::time::Duration;
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;

/// Time limit for a request to arrive: our choice, as for the first bytes of any connection.
const REQUEST: Duration = Duration::from_secs(10);

/// Largest number of connections to the page of metrics: our choice, for some programs that ask at the same time.
pub const METRICS: usize = 32;

/// Largest number of connections to the live page besides those of watchers: our choice, enough for some browsers.
pub const BESIDE_WATCHERS: usize = 128;

/// Answers the requests at `listener` with `app`, on at most `all` connections, until `stop` is cancelled.
pub async fn serve(listener: TcpListener, app: Router, all: usize, refusals: Arc<Refusals>, stop: CancellationToken) {
    let table = Table::new(Caps { all, peer: all, opening: all });
    let door = Door { table, tls: None, greeting: Greeting::Any, rate: None, refusals };
    let mut connections = door.open(listener.into(), stop.clone());
    while let Some(connection) = connections.recv().await {
        tokio::spawn(answer(connection, app.clone(), stop.clone()));
    }
}

/// Answers one request. A connection that waits for another request would only take room.
async fn answer(connection: Connection, app: Router, stop: CancellationToken) {
    // The connection counts as having a call from its first bytes on. `REQUEST` limits the time of the call, and for
    // watchers the time without reading.
    let _call = connection.link().begin();
    let mut builder = http1::Builder::new();
    builder.timer(TokioTimer::new()).header_read_timeout(REQUEST).keep_alive(false);
    let app = TowerToHyperService::new(app);
    let serving = builder.serve_connection(TokioIo::new(connection), app);
    let mut serving = std::pin::pin!(serving);
    // Errors on a connection concern its peer only.
    tokio::select! {
        _ = serving.as_mut() => return,
        () = stop.cancelled() => serving.as_mut().graceful_shutdown(),
    }
    let _ = serving.await;
}
