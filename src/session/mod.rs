//! The operations of a session on its environments, for clients over the network and for the same process.
//!
//! * [`view`]: pictures, and the moments of recordings.
//! * [`roll`]: rollouts, some steps at a time.
//! * [`environments`]: a session of this process, without messages or a network.

use sandgait_base::error;
use sandgait_env as env;
use sandgait_pool as pool;
use sandgait_sim as sim;

pub mod environments;
pub mod roll;
pub mod view;

pub use environments::{Answer, Environments, EnvironmentsGuard};

/// Largest number of environments of one session: our choice, room for any training.
pub const MOST_ENVIRONMENTS: usize = 65_536;

/// Largest memory of all sessions together [bytes]: our choice, half of a machine with 16 GiB.
pub const MOST_MEMORY: usize = 8 << 30;
