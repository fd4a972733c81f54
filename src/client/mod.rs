//! A client of `sandgait.v1`; the Python package uses it.
//!
//! The waiting thread reads and writes the socket itself, so no other thread has to be woken for an answer. While
//! no thread waits, [`keeper`] answers the server's pings and sends queued requests.
//!
//! * [`address`]: a server's address and credentials.
//! * [`stream`]: one RunSession stream; [`call`]: calls with one answer; [`studies`]: studies with progress reports.
//! * [`training`]: a training's environments.

use sandgait_base::error;
use sandgait_service as service;
use sandgait_study as study;
use sandgait_train as train;

mod address;
pub mod call;
mod keeper;
mod stream;
mod studies;
pub mod training;
#[cfg(unix)]
mod unix_socket;

pub use address::ServerAddress;
pub use stream::{PATIENCE, Stream};
pub use studies::{StudyCall, StudyEvent, next, study};

use crate::service::proto::environment_service_client::EnvironmentServiceClient;
use crate::service::proto::study_service_client::StudyServiceClient;
use address::Bearer;
use std::future::Future;
use std::pin::Pin;
use std::time::Duration;
use tokio::runtime::{Builder, Runtime};
use tonic::service::interceptor::InterceptedService;
use tonic::transport::Channel;
use tonic::{Code, Status};

pub type Environments = EnvironmentServiceClient<InterceptedService<Channel, Bearer>>;
pub type Studies = StudyServiceClient<InterceptedService<Channel, Bearer>>;

/// A runtime that runs only while one of its callers waits.
pub fn runtime() -> Result<Runtime, Status> {
    let made = Builder::new_current_thread().enable_all().build();
    made.map_err(|e| Status::unavailable(format!("the connection cannot be set up: {e}")))
}

/// Waits for `future` for at most `time`; None: it is not done yet.
pub fn wait<F: Future + ?Sized>(runtime: &Runtime, future: Pin<&mut F>, time: Duration) -> Option<F::Output> {
    runtime.block_on(async { tokio::time::timeout(time, future).await.ok() })
}

/// A client for environments at `place`.
pub async fn environments(place: &ServerAddress) -> Result<Environments, Status> {
    let (channel, bearer) = place.connect().await?;
    let client = EnvironmentServiceClient::with_interceptor(channel, bearer);
    Ok(client.max_decoding_message_size(usize::MAX).max_encoding_message_size(usize::MAX))
}

/// A client for studies at `place`.
pub async fn study_client(place: &ServerAddress) -> Result<Studies, Status> {
    let (channel, bearer) = place.connect().await?;
    let client = StudyServiceClient::with_interceptor(channel, bearer);
    Ok(client.max_decoding_message_size(usize::MAX).max_encoding_message_size(usize::MAX))
}

/// Changes the status of a call that did not reach the server, or whose answer was lost. A status that the server sent
/// has no source error, and stays as it is.
fn lost(status: Status) -> Status {
    match std::error::Error::source(&status) {
        Some(cause) => Status::unavailable(reason(cause)),
        None => status,
    }
}

/// The last, most specific cause of an error.
fn reason(error: &dyn std::error::Error) -> String {
    let mut cause = error;
    while let Some(source) = cause.source() {
        cause = source;
    }
    let said = cause.to_string();
    // h2 reads a TLS server's refusal of a connection without TLS as a frame of HTTP/2.
    match said.ends_with("frame with invalid size") {
        true => format!("{said}: a server with TLS, or none of gRPC? TLS needs its certificate"),
        false => said,
    }
}

/// The status of a stream that was cut off inside a message: the session may still exist.
fn cut(status: Status) -> Status {
    // A broken connection may cancel its streams; a server's own status has no source.
    let broken = status.code() == Code::Cancelled && std::error::Error::source(&status).is_some();
    match status.code() {
        Code::Unknown | Code::Internal => Status::unavailable(status.message().to_owned()),
        Code::Cancelled if broken => Status::unavailable(status.message().to_owned()),
        _ => status,
    }
}
