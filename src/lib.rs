//! sandgait: batched reinforcement-learning environments of legged robots on sand.
//!
//! Data flow one way: [`service`] → [`session`] → [`pool`] → [`policy`] → [`env`] → [`sim`] → [`sand`]; no layer knows the ones before it.
pub mod bench;
pub mod calibrate;
pub mod cli;
pub mod client;
pub mod diagnose;
pub mod env;
pub mod error;
pub mod evaluate;
pub mod number;
pub mod parallel;
pub mod plot;
pub mod policy;
pub mod pool;
pub mod progress;
pub mod reproduce;
pub mod robots;
pub mod sand;
pub mod service;
pub mod session;
pub mod sim;
pub mod student;
pub mod sweep;
pub mod table;
pub mod train;
pub mod validate;
pub mod view;
pub use error::{Error, Result};

// The command line is written as a user of this crate would write it.
extern crate self as sandgait;
