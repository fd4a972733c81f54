//! sandgait: batched reinforcement-learning environments of legged robots on sand.
pub mod diagnose;
pub mod error;
pub mod number;
pub mod sand;
pub use error::{Error, Result};
