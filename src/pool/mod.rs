//! Runs many environments on threads.
//!
//! ```text
//!  session ── Batch (its shards) ──▶ Pool queue ──▶ worker threads, one shard at a time, sessions in turn
//!     ▲                                                              │
//!     └──────────────── done(Batch), once every shard has run ◀──────┘
//! ```
//!
//! One thread owns a shard while the shard runs. Results depend neither on the thread nor on the number of threads. The
//! queue gives out one shard of each waiting batch in turn, so a session of many environments cannot starve a small
//! one. While other sessions wait, a shard of a rollout is given out for one control step at a time. This crate knows
//! no messages of the server, and never runs on the threads of its async runtime.

use sandgait_base::{error, parallel};
use sandgait_env as env;
use sandgait_policy as policy;

mod batch;
mod building;
mod operation;
mod seal;
mod snapshot;
mod threads;

pub use batch::{Account, Batch, check_envs};
pub use building::Building;
pub use operation::{Operation, Roll};
pub use seal::Seal;
pub use snapshot::Snapshot;
pub use threads::Pool;
