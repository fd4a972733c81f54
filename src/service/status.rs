//! The map from the program's errors to gRPC codes.

use super::proto;
use crate::error::Error;
use tonic::{Code, Status};

/// The kind in [`Error::Unknown`] for a session that does not exist.
pub const SESSION: &str = "session";

fn code(error: &Error) -> Code {
    match error {
        Error::Unknown { what: SESSION, .. } => Code::NotFound,
        Error::Invalid { .. } | Error::Unknown { .. } | Error::Replaced { .. } => Code::InvalidArgument,
        Error::OutOfOrder(_) => Code::FailedPrecondition,
        Error::Exhausted(_) => Code::ResourceExhausted,
        Error::Cancelled(_) => Code::Cancelled,
        Error::File { .. } | Error::Unwritten { .. } | Error::Lost { .. } => Code::Internal,
        Error::Internal(_) => {
            tracing::error!(%error, "bug");
            Code::Internal
        }
    }
}

/// The status of a failed call.
pub fn status(error: &Error) -> Status {
    Status::new(code(error), error.to_string())
}

/// The refusal of one request in a stream that goes on.
pub fn failure(error: &Error) -> proto::Failure {
    proto::Failure { code: code(error).into(), message: error.to_string() }
}

/// tonic's errors about messages that it could not read, with codes that name the side at fault.
pub fn unreadable(status: Status) -> Status {
    let message = format!("message cannot be read: {}", status.message());
    match status.code() {
        Code::Internal => Status::invalid_argument(message),
        Code::OutOfRange => Status::resource_exhausted(message),
        _ => status,
    }
}
