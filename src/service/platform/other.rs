//! Systems without Unix sockets and modes of files, such as Windows. There, folders of a user's profile can be used by this user alone;
//! other folders are as their owner has made them.

use super::SocketFile;
use std::fs::{self, File, OpenOptions};
use std::io::{Error, ErrorKind, Result};
use std::path::Path;
use std::time::Duration;
use tokio::io::DuplexStream;
use tokio::net::TcpStream;

/// There is none.
pub enum UnixListener {}

impl UnixListener {
    pub async fn accept(&self) -> Result<(DuplexStream, ())> {
        match *self {}
    }
}

/// No file is known by its number.
pub fn is_file(_: &Path, _: u64) -> bool {
    false
}

/// # Errors
/// Always.
pub fn bind_unix(_: &Path) -> Result<(UnixListener, SocketFile)> {
    Err(Error::new(ErrorKind::Unsupported, "this system has no Unix sockets; name a port of 127.0.0.1"))
}

/// No limit is known.
pub fn descriptors() -> usize {
    usize::MAX
}

/// Here pings of HTTP/2 alone find silent peers.
pub fn limit_silence(_: &TcpStream, _: Duration) -> Result<()> {
    Ok(())
}

/// Can others than its owner use a file or folder? The access lists of this system are not read.
pub fn is_shared(_: &Path) -> bool {
    false
}

pub fn make_private_folder(path: &Path) -> Result<()> {
    fs::create_dir_all(path)
}

pub fn private(options: &mut OpenOptions) -> &mut OpenOptions {
    options
}

/// NTFS keeps names in its journal, and folders cannot be opened as files.
pub fn sync_folder(_: &Path, _: fn(&File) -> Result<()>) -> Result<()> {
    Ok(())
}
