//! The live page: in a browser it shows the sessions of this server while they step.
//!
//! ```text
//!  GET /                     the page, the same that `sandgait replay --html` writes
//!  GET /sessions             names, tasks and numbers of environments, as JSON
//!  GET /watch/NAME/INDEX     a recording without end, in the format of recordings: one environment of a session
//! ```
//!
//! The page shows the names of sessions, as logs and lists do, never their ids. Watching changes nothing.
//!
//! * [`play`]: the page of one environment that is steered.
//! * [`watchers`]: the watchers of each environment; [`frames`]: their data. The thread that steps only copies the
//!   state.

mod frames;
pub mod play;
pub mod watchers;

use super::connections;
use super::refusals::{Refusal, Refusals};
use super::sessions::{SessionSummary, Sessions};
use axum::Router;
use axum::body::Body;
use axum::extract::{Path, Request, State};
use axum::http::StatusCode;
use axum::http::header::{CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, HOST};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use futures_util::stream;
use serde_json::Value;
use std::net::IpAddr;
use std::sync::Arc;
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;

/// The content policy: the page may use its own scripts and ask this server, nothing else.
const POLICY: &str = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:; \
                      connect-src 'self'; frame-ancestors 'none'";

/// The data of the page.
#[derive(Clone)]
struct PageData {
    sessions: Arc<Sessions>,
    refusals: Arc<Refusals>,
}

/// Answers browsers until `stop` is cancelled.
pub async fn serve(listener: TcpListener, sessions: Arc<Sessions>, refusals: Arc<Refusals>, stop: CancellationToken) {
    let all = sessions.watchers.most() + connections::BESIDE_WATCHERS;
    let local = listener.local_addr().is_ok_and(|a| a.ip().is_loopback());
    let mut app = Router::new()
        .route("/", get(async || page("sandgait")))
        .route("/sessions", get(list))
        .route("/watch/{name}/{index}", get(watch))
        .with_state(PageData { sessions, refusals: refusals.clone() });
    if local {
        app = app.layer(middleware::from_fn(same_machine));
    }
    connections::pages(listener, app, all, refusals, stop).await;
}

/// DNS rebinding: a page of another site, whose name was made to resolve to this machine, must not read this
/// server's data.
async fn same_machine(request: Request, next: Next) -> Response {
    let host = request.headers().get(HOST).and_then(|h| h.to_str().ok()).unwrap_or_default();
    let name = host.rsplit_once(':').filter(|(_, port)| port.parse::<u16>().is_ok()).map_or(host, |(name, _)| name);
    let plain = name.trim_start_matches('[').trim_end_matches(']');
    if plain == "localhost" || plain.parse::<IpAddr>().is_ok() {
        return next.run(request).await;
    }
    (StatusCode::FORBIDDEN, "request this page by an IP address or as localhost").into_response()
}

/// The page, with this title.
fn page(title: &str) -> Response {
    let headers = [(CONTENT_TYPE, "text/html; charset=utf-8"), (CONTENT_SECURITY_POLICY, POLICY)];
    (headers, sandgait_view::page::live(title)).into_response()
}

/// Data of the page.
fn json(value: &Value) -> Response {
    ([(CONTENT_TYPE, "application/json"), (CACHE_CONTROL, "no-store")], value.to_string()).into_response()
}

/// Blocks of a recording.
fn recording(blocks: Body) -> Response {
    ([(CONTENT_TYPE, "application/octet-stream"), (CACHE_CONTROL, "no-store")], blocks).into_response()
}

async fn list(State(PageData { sessions, .. }): State<PageData>) -> Response {
    let one =
        |s: &SessionSummary| serde_json::json!({"name": s.name, "task": s.blueprint.task.spec().id, "envs": s.envs});
    json(&sessions.list().iter().map(one).collect())
}

async fn watch(State(shown): State<PageData>, Path((name, index)): Path<(String, usize)>) -> Response {
    let PageData { sessions, refusals } = shown;
    let unknown = || (StatusCode::NOT_FOUND, format!("session {name:?} is none of this server's\n")).into_response();
    let Some(summary) = sessions.named(&name) else { return unknown() };
    if index >= summary.envs {
        let reason = format!("index: {index} is outside [0, {})\n", summary.envs);
        return (StatusCode::NOT_FOUND, reason).into_response();
    }
    let Some(watcher) = sessions.watchers.watch(&name, index, &summary.blueprint.task) else {
        let most = sessions.watchers.most();
        refusals.log(Refusal::Watcher, "", &format!("{most} watch already"));
        let reason = format!("{most} watch this server already, which is its limit; try again later\n");
        return (StatusCode::SERVICE_UNAVAILABLE, reason).into_response();
    };
    // The session may have ended between the check and here; from now on watchers are notified of its end.
    if sessions.named(&name).is_none() {
        return unknown();
    }
    let blocks = stream::unfold((watcher, sessions.stop().clone()), |(mut watcher, stop)| async move {
        let block = stop.run_until_cancelled(watcher.next()).await??;
        Some((Ok::<_, std::convert::Infallible>(block), (watcher, stop)))
    });
    recording(Body::from_stream(blocks))
}
