//! The map from the program's errors to Python's exceptions.

use pyo3::exceptions::PyException;
use pyo3::prelude::*;
use sandgait::Error;

pyo3::create_exception!(
    sandgait._native,
    StatusError,
    PyException,
    "A call to a server failed: its gRPC code, and why."
);

/// The class of `sandgait.errors`, chosen by what the caller can do.
fn class(error: &Error) -> &'static str {
    match error {
        Error::Lost { .. } => "ServerLost",
        Error::Invalid { .. } | Error::Unknown { .. } | Error::Replaced { .. } | Error::File { .. } => "InvalidRequest",
        Error::OutOfOrder(_) => "OutOfOrder",
        Error::Exhausted(_) => "LimitReached",
        Error::Cancelled(_) => "SessionLost",
        Error::Unwritten { .. } | Error::Internal(_) => "SandgaitError",
    }
}

/// `error` as an exception.
pub fn raise(error: &Error) -> PyErr {
    of(class(error), error.to_string())
}

/// The exception `class` of `sandgait.errors`.
pub fn of(class: &str, message: String) -> PyErr {
    Python::attach(|py| {
        let made = py.import("sandgait.errors").and_then(|errors| errors.getattr(class)?.call1((message,)));
        made.map_or_else(|failed| failed, PyErr::from_value)
    })
}

pub fn invalid(field: &str, reason: impl Into<String>) -> PyErr {
    raise(&Error::invalid(field, reason))
}
