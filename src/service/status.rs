//! The one map from the crate's errors to gRPC codes.

use super::proto;
use crate::error::Error;
use tonic::{Code, Status};

/// What [`Error::Unknown`] calls a session that is not, or no longer, there.
pub const SESSION: &str = "session";

fn code(error: &Error) -> Code {
    match error {
        Error::Unknown { what: SESSION, .. } => Code::NotFound,
        Error::Invalid { .. } | Error::Unknown { .. } | Error::Replaced { .. } => Code::InvalidArgument,
        Error::OutOfOrder(_) => Code::FailedPrecondition,
        Error::Exhausted(_) => Code::ResourceExhausted,
        Error::Cancelled(_) => Code::Cancelled,
        Error::File { .. } => Code::Internal,
        Error::Internal(_) => {
            tracing::error!(%error, "bug");
            Code::Internal
        }
    }
}

/// Ends a call.
pub fn status(error: &Error) -> Status {
    Status::new(code(error), error.to_string())
}

/// Refuses one request of a stream that goes on.
pub fn failure(error: &Error) -> proto::Failure {
    proto::Failure { code: code(error).into(), message: error.to_string() }
}

/// What tonic says about a message it could not read, in the codes that tell a caller whose mistake it was.
pub fn unreadable(status: Status) -> Status {
    let message = format!("message cannot be read: {}", status.message());
    match status.code() {
        Code::Internal => Status::invalid_argument(message),
        Code::OutOfRange => Status::resource_exhausted(message),
        _ => status,
    }
}
