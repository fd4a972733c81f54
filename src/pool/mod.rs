//! Many environments over threads.
//!
//! ```text
//!  session ── Batch (its shards) ──▶ Pool queue ──▶ worker threads, one shard at a time, sessions in turn
//!     ▲                                                              │
//!     └──────────────── done(Batch), once every shard has run ◀──────┘
//! ```
//!
//! A shard is owned by one thread while it runs and results never depend on which, or on how many there are. The
//! queue hands out one shard of each waiting batch in turn, so a session of many environments cannot starve a small
//! one; of a rollout it hands out one control step of a shard wherever somebody else waits. This layer knows nothing of
//! messages; it never runs on the async runtime's threads.

use sandgait_base::{error, parallel};
use sandgait_env as env;
use sandgait_policy as policy;

mod batch;
mod building;
mod seal;
mod snapshot;
mod threads;

pub use batch::{Batch, Operation, Roll};
pub use building::Building;
pub use seal::Seal;
pub use snapshot::Snapshot;
pub use threads::Pool;
