//! The layer around all calls: checks the token, and counts failures.
//!
//! Services need no code for authentication. Only the health can be asked for without the token; such calls are bounded in
//! number for a connection, for all connections together, and in time. hyper cannot change the number of streams of an open
//! connection, and tower's limit of concurrency ends with the head of an answer, so this layer counts calls itself.

use super::connection_table::ConnectionHandle;
use super::metrics::Metrics;
use super::refusals::{Refusal, Refusals};
use super::security::Token;
use axum::body::Body;
use axum::extract::{Request, State};
use axum::http::HeaderMap;
use axum::http::header::AUTHORIZATION;
use axum::middleware::Next;
use axum::response::Response;
use http_body_util::BodyExt as _;
use std::sync::Arc;
use tokio::sync::Semaphore;
use tonic::{Code, Status};

/// Calls of this service need no token: a client that checks a server's health seldom has a token, and the answer
/// reveals only the health.
const OPEN: &str = "/grpc.health.v1.Health/";

#[derive(Clone)]
pub struct Gate {
    pub token: Option<Token>,
    pub metrics: Arc<Metrics>,
    pub refusals: Arc<Refusals>,
    /// Room for admitted calls, [`super::limits::Limits::calls`]. tower's limit of concurrency ends with the head of an
    /// answer, but a call with a stream of answers goes on after it.
    pub calls: Arc<Semaphore>,
    /// Room for calls of [`REFLECTION`].
    pub reflections: Arc<Semaphore>,
}

/// Calls of this service hold descriptions of the protos, some 0.2 MB each, until their client has read them.
const REFLECTION: &str = "/grpc.reflection.";

/// Largest number of calls of [`REFLECTION`] at the same time: our choice, for some people with tools.
pub const REFLECTIONS: usize = 16;

/// Answers a call, or refuses it.
pub async fn pass(State(gate): State<Gate>, call: Request, next: Next) -> Response {
    let given = call.headers().get(AUTHORIZATION).map_or(&[][..], |v| v.as_bytes());
    let open = call.uri().path().starts_with(OPEN);
    let admitted = open || gate.token.as_ref().is_none_or(|t| t.admits(given));
    let link = call.extensions().get::<ConnectionHandle>().cloned();
    // The call counts until the body of its answer is dropped.
    let begun = link.as_ref().map(|link| link.begin(admitted && !open));
    let Some(begun) = begun.map_or(Some(None), |begun| begun.map(Some)) else {
        return exhausted(&gate.metrics, "this connection has too many calls without the server's token");
    };
    // A connection may have as many calls as are left for others (Choudhury & Hahne 1998, Dynamic queue length
    // thresholds, with α = 1), so no connection takes them all.
    if admitted && !open && link.as_ref().is_some_and(|link| link.admitted() > gate.calls.available_permits()) {
        return exhausted(
            &gate.metrics,
            "this connection has as many calls as this server leaves for others; try again",
        );
    }
    let place = if admitted && !open { gate.calls.clone().try_acquire_owned().map(Some) } else { Ok(None) };
    let reflects = admitted && call.uri().path().starts_with(REFLECTION);
    let looks = if reflects { gate.reflections.clone().try_acquire_owned().map(Some) } else { Ok(None) };
    let (Ok(place), Ok(looks)) = (place, looks) else {
        return exhausted(&gate.metrics, "this server has as many calls as its memory allows; try again");
    };
    let held = (begun, place, looks);
    let answer = if admitted {
        next.run(call).await
    } else {
        let peer = link.map_or_else(String::new, |l| l.name());
        gate.refusals.log(Refusal::Token, &peer, call.uri().path());
        Status::unauthenticated("this server asks for its bearer token").into_http()
    };
    // A call that fails at once has its code in the headers; other calls have it in the trailers.
    count(&gate.metrics, answer.headers());
    answer.map(|body| {
        let counted = body.map_frame(move |frame| {
            let _ = &held;
            frame.trailers_ref().into_iter().for_each(|trailers| count(&gate.metrics, trailers));
            frame
        });
        Body::new(counted)
    })
}

fn exhausted(metrics: &Metrics, reason: &str) -> Response {
    let answer = Status::resource_exhausted(reason).into_http();
    count(metrics, answer.headers());
    answer
}

fn count(metrics: &Metrics, headers: &HeaderMap) {
    if let Some(code) = headers.get(Status::GRPC_STATUS) {
        metrics.ended(Code::from_bytes(code.as_bytes()));
    }
}
