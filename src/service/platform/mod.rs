//! What differs between systems: Unix sockets, files that only their owner can use, and limits of the process.

#[cfg(not(unix))]
mod other;
#[cfg(unix)]
mod unix;

#[cfg(not(unix))]
pub use self::other::*;
#[cfg(unix)]
pub use self::unix::*;

/// Largest number of connections that the kernel queues until they are accepted: our choice, as many as the server has
/// at a time by default.
pub const BACKLOG: u32 = 1024;
