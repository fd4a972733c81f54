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

/// Largest text of a status as it is sent [bytes]. Clients on gRPC's C core accept 8 KiB of headers and drop a longer
/// status with its reason (`grpc.max_metadata_size`); 2 KiB are left for other headers.
const LONGEST: usize = 6 << 10;

/// The status of a failed call.
pub fn status(error: &Error) -> Status {
    Status::new(code(error), sendable(error.to_string()))
}

/// `text`, cut off where it would be longer than [`LONGEST`]. It is sent percent-encoded (gRPC over HTTP2,
/// Status-Message): a byte that is no visible ASCII takes three.
fn sendable(mut text: String) -> String {
    let mut sent = 0;
    let cut = text.char_indices().find(|(_, c)| {
        sent += if matches!(c, ' '..='~') && *c != '%' { 1 } else { 3 * c.len_utf8() };
        sent > LONGEST
    });
    if let Some((end, _)) = cut {
        text.truncate(end);
        text.push('…');
    }
    text
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

#[cfg(test)]
mod tests {
    use super::*;

    /// A text of letters that need three bytes each when they are sent.
    #[test]
    fn a_long_reason_fits_into_the_headers_of_any_client() {
        for (text, whole) in [("é".repeat(4000), false), ("%".repeat(2000), true), ("a".repeat(4200), true)] {
            let sent = sendable(text.clone());
            assert_eq!(sent == text, whole);
            assert!(sent.chars().count() >= 1000 && sent.len() <= text.len());
            let headers = Status::invalid_argument(sent).into_http::<()>().into_parts().0.headers;
            let bytes: usize = headers.iter().map(|(name, value)| name.as_str().len() + value.len() + 32).sum();
            assert!(bytes < 8 << 10, "{bytes}");
        }
    }
}
