//! What every part uses: the error type, files that survive a power cut, progress reports, Student's t, and work spread
//! over processors.
pub mod error;
pub mod files;
pub mod parallel;
pub mod progress;
pub mod student;
pub use error::{Error, Result};
