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
//! one. While other sessions wait, a shard is given out for some milliseconds at a time, and in a rollout for one control
//! step at most. If nobody waits for an operation any more, it ends and is undone (`Batch::set_stop`). This crate knows
//! no messages of the server, and never runs on the threads of its async runtime.

use sandgait_base::{error, parallel};
use sandgait_env as env;
use sandgait_policy as policy;
use sandgait_sim as sim;

mod batch;
mod building;
mod operation;
mod preparing;
mod seal;
mod snapshot;
mod threads;

pub use batch::{Account, Batch, Stop, check_envs};
pub use building::Building;
pub use operation::{Gather, Operation, Roll};
pub use preparing::{Prepared, Preparing};
pub use seal::Seal;
pub use snapshot::Snapshot;
pub use threads::Pool;
