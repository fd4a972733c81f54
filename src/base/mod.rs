//! What every part uses: the error type, progress bars, Student's t, and work spread over processors.
pub mod error;
pub mod parallel;
pub mod progress;
pub mod student;
pub use error::{Error, Result};
