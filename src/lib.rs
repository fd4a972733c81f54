//! sandgait: batched reinforcement-learning environments of legged robots on sand.
pub mod error;
pub mod number;
pub mod sand;
pub mod sim;
pub use error::{Error, Result};
