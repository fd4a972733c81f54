//! What differs between systems: Unix sockets, files that only their owner can use, and limits of the process.

use std::fs;
use std::path::PathBuf;

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

/// The socket file that this process made. It is removed when this is dropped.
#[cfg_attr(not(unix), allow(dead_code))] // other systems never make one
pub struct SocketFile {
    pub path: PathBuf,
    inode: u64,
}

impl Drop for SocketFile {
    fn drop(&mut self) {
        // Another server may have replaced the file by its own socket.
        if is_file(&self.path, self.inode) {
            // If it cannot be removed, the next server finds it stale.
            let _ = fs::remove_file(&self.path);
        }
    }
}
