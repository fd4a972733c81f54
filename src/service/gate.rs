//! What every call passes on its way in and out: the token is asked for, failures are counted.

use super::metrics::Metrics;
use super::security::Token;
use axum::body::Body;
use axum::extract::{Request, State};
use axum::http::HeaderMap;
use axum::http::header::AUTHORIZATION;
use axum::middleware::Next;
use axum::response::Response;
use http_body_util::BodyExt as _;
use std::net::SocketAddr;
use std::sync::Arc;
use tonic::transport::server::{TcpConnectInfo, TlsConnectInfo};
use tonic::{Code, Status};

/// Calls of this service need no token: who asks whether a server is well seldom has one, and learns nothing else.
const OPEN: &str = "/grpc.health.v1.Health/";

#[derive(Clone)]
pub struct Gate {
    pub token: Option<Token>,
    pub metrics: Arc<Metrics>,
}

/// Answers a call, or refuses it.
pub async fn pass(State(gate): State<Gate>, call: Request, next: Next) -> Response {
    let given = call.headers().get(AUTHORIZATION).map_or(&[][..], |v| v.as_bytes());
    let admitted = call.uri().path().starts_with(OPEN) || gate.token.as_ref().is_none_or(|t| t.admits(given));
    let answer = if admitted {
        next.run(call).await
    } else {
        let peer = peer(&call).map_or_else(|| "a Unix socket".into(), |a| a.to_string());
        tracing::warn!(peer, call = call.uri().path(), "a call without this server's token was refused");
        Status::unauthenticated("this server asks for its bearer token").into_http()
    };
    // A call that fails at once says so in its headers, another in its trailers.
    count(&gate.metrics, answer.headers());
    answer.map(|body| {
        let counted = body.map_frame(move |frame| {
            frame.trailers_ref().into_iter().for_each(|trailers| count(&gate.metrics, trailers));
            frame
        });
        Body::new(counted)
    })
}

fn peer(call: &Request) -> Option<SocketAddr> {
    let plain = || call.extensions().get::<TcpConnectInfo>();
    let encrypted = call.extensions().get::<TlsConnectInfo<TcpConnectInfo>>().map(TlsConnectInfo::get_ref);
    encrypted.or_else(plain)?.remote_addr()
}

fn count(metrics: &Metrics, headers: &HeaderMap) {
    if let Some(code) = headers.get(Status::GRPC_STATUS) {
        metrics.ended(Code::from_bytes(code.as_bytes()));
    }
}
