//! sandgait: batched reinforcement-learning environments of legged robots on sand.
//!
//! Data flow one way: [`service`] → [`pool`] → [`env`] → [`sim`] → [`sand`]; no layer knows the ones before it.
pub mod diagnose;
pub mod env;
pub mod error;
pub mod number;
pub mod pool;
pub mod sand;
pub mod service;
pub mod sim;
pub mod table;
pub use error::{Error, Result};
