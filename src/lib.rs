//! sandgait: batched reinforcement-learning environments of legged robots on sand.
pub mod env;
pub mod error;
pub mod number;
pub mod pool;
pub mod sand;
pub mod sim;
pub use error::{Error, Result};
