//! The live page: sessions of this server as they step, for browsers.
//!
//! ```text
//!  GET /                     the page, the same that `sandgait replay --html` writes
//!  GET /sessions             names, tasks and numbers of environments, as JSON
//!  GET /watch/NAME/INDEX     a recording without end, in the format of recordings: one environment of a session
//! ```
//!
//! Sessions go by the names of logs and lists, never by their ids. Who only looks changes nothing.
//!
//! * [`watchers`]: who looks at what; a server that nobody looks at does nothing for it.

mod watchers;

pub use watchers::Watchers;

use super::sessions::{Sessions, Summary};
use crate::error::{Error, Result};
use crate::view::page;
use axum::Router;
use axum::body::Body;
use axum::extract::{Path, Request, State};
use axum::http::StatusCode;
use axum::http::header::{CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, HOST};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use futures_util::stream;
use std::net::IpAddr;
use std::sync::Arc;
use std::time::Duration;
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;

/// The page may use what stands in it and ask this server; nothing else.
const POLICY: &str = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:; \
                      connect-src 'self'; frame-ancestors 'none'";

/// How often a stream that has nothing to say looks whether its session is still there.
const LOOK: Duration = Duration::from_secs(1);

/// Answers browsers until `stop` is cancelled.
pub async fn serve(listener: TcpListener, sessions: Arc<Sessions>, stop: CancellationToken) -> Result<()> {
    let local = listener.local_addr().is_ok_and(|a| a.ip().is_loopback());
    let mut app = Router::new()
        .route("/", get(show))
        .route("/sessions", get(list))
        .route("/watch/{name}/{index}", get(watch))
        .with_state(sessions);
    if local {
        app = app.layer(middleware::from_fn(same_machine));
    }
    let served = axum::serve(listener, app).with_graceful_shutdown(stop.cancelled_owned()).await;
    served.map_err(|e| Error::Exhausted(format!("the live page failed: {e}")))
}

/// A page from elsewhere whose name was made to point at this machine must not read what it serves.
async fn same_machine(request: Request, next: Next) -> Response {
    let host = request.headers().get(HOST).and_then(|h| h.to_str().ok()).unwrap_or_default();
    let name = host.rsplit_once(':').filter(|(_, port)| port.parse::<u16>().is_ok()).map_or(host, |(name, _)| name);
    let plain = name.trim_start_matches('[').trim_end_matches(']');
    if plain == "localhost" || plain.parse::<IpAddr>().is_ok() {
        return next.run(request).await;
    }
    (StatusCode::FORBIDDEN, "this page is asked for by an address or as localhost").into_response()
}

async fn show() -> impl IntoResponse {
    let headers = [(CONTENT_TYPE, "text/html; charset=utf-8"), (CONTENT_SECURITY_POLICY, POLICY)];
    (headers, page::live("sandgait"))
}

async fn list(State(sessions): State<Arc<Sessions>>) -> impl IntoResponse {
    let one = |s: &Summary| serde_json::json!({"name": s.name, "task": s.blueprint.task.spec().id, "envs": s.envs});
    let body = serde_json::Value::Array(sessions.list().iter().map(one).collect()).to_string();
    ([(CONTENT_TYPE, "application/json"), (CACHE_CONTROL, "no-store")], body)
}

async fn watch(State(sessions): State<Arc<Sessions>>, Path((name, index)): Path<(String, usize)>) -> Response {
    let Some(summary) = sessions.list().into_iter().find(|s| s.name == name) else {
        return (StatusCode::NOT_FOUND, format!("session {name:?} is none of this server's\n")).into_response();
    };
    if index >= summary.envs {
        let reason = format!("index: {index} is outside [0, {})\n", summary.envs);
        return (StatusCode::NOT_FOUND, reason).into_response();
    }
    let watcher = sessions.watchers.watch(&name, index);
    let blocks = stream::unfold((watcher, sessions, name), |(mut watcher, sessions, name)| async move {
        let stop = sessions.stop().clone();
        loop {
            tokio::select! {
                biased;
                () = stop.cancelled() => return None,
                block = watcher.next() => {
                    return block.map(|b| (Ok::<_, std::convert::Infallible>(b), (watcher, sessions, name)));
                }
                () = tokio::time::sleep(LOOK) => {
                    if !sessions.list().iter().any(|s| s.name == name) {
                        return None;
                    }
                }
            }
        }
    });
    let headers = [(CONTENT_TYPE, "application/octet-stream"), (CACHE_CONTROL, "no-store")];
    (headers, Body::from_stream(blocks)).into_response()
}
