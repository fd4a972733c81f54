//! Unix sockets, modes of files, and limits of processes.

use super::{BACKLOG, SocketFile};
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use std::fs::{self, DirBuilder, File, OpenOptions, Permissions};
use std::io::{Error, ErrorKind, Result};
use std::os::unix::fs::{
    DirBuilderExt as _, FileTypeExt as _, MetadataExt as _, OpenOptionsExt as _, PermissionsExt as _,
};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::time::Duration;
pub use tokio::net::UnixListener;
use tokio::net::{TcpStream, UnixSocket};

/// Is this the file that had the number `inode`?
pub fn is_file(path: &Path, inode: u64) -> bool {
    fs::symlink_metadata(path).is_ok_and(|m| m.ino() == inode)
}

/// A socket to which only its owner can connect. The mode is set between bind and listen, before anyone can connect.
pub fn bind_unix(path: &Path) -> Result<(UnixListener, SocketFile)> {
    remove_stale(path)?;
    let socket = UnixSocket::new_stream()?;
    socket.bind(path)?;
    let file = SocketFile { path: path.into(), inode: fs::symlink_metadata(path)?.ino() };
    fs::set_permissions(path, Permissions::from_mode(0o600))?;
    Ok((socket.listen(BACKLOG)?, file))
}

/// Removes the socket of a server that no longer runs; any other file at this path is kept and gives an error.
fn remove_stale(path: &Path) -> Result<()> {
    match fs::symlink_metadata(path) {
        Err(e) if e.kind() == ErrorKind::NotFound => Ok(()),
        Err(e) => Err(e),
        Ok(m) if !m.file_type().is_socket() => {
            Err(Error::new(ErrorKind::AlreadyExists, "a file that is no socket is there"))
        }
        Ok(_) => match UnixStream::connect(path) {
            Err(e) if e.kind() == ErrorKind::ConnectionRefused => fs::remove_file(path),
            Err(e) => Err(e),
            Ok(_) => Err(Error::new(ErrorKind::AddrInUse, "another server listens there")),
        },
    }
}

/// Raises this process's limit of file descriptors as far as it may, and returns it.
pub fn descriptors() -> usize {
    let Rlimit { mut current, maximum } = getrlimit(Resource::Nofile);
    // The soft limit exists for programs that use `select`; this program does not use it.
    if setrlimit(Resource::Nofile, Rlimit { current: maximum, maximum }).is_ok() {
        current = maximum;
    }
    current.map_or(usize::MAX, |n| usize::try_from(n).unwrap_or(usize::MAX))
}

/// Ends a connection whose peer acknowledges no data for this time. Only Linux can; elsewhere pings of HTTP/2 find silent peers.
pub fn limit_silence(stream: &TcpStream, time: Duration) -> Result<()> {
    #[cfg(any(target_os = "linux", target_os = "android"))]
    rustix::net::sockopt::set_tcp_user_timeout(stream, time.as_millis() as u32)?;
    let _ = (stream, time);
    Ok(())
}

/// Can others than its owner use a file or folder?
pub fn is_shared(path: &Path) -> bool {
    fs::metadata(path).is_ok_and(|m| m.permissions().mode() & 0o077 != 0)
}

/// Makes a folder, and those above it, if it does not exist; only its owner can enter it.
pub fn make_private_folder(path: &Path) -> Result<()> {
    DirBuilder::new().recursive(true).mode(0o700).create(path)
}

/// A file that is made so can be read and written by its owner alone.
pub fn private(options: &mut OpenOptions) -> &mut OpenOptions {
    options.mode(0o600)
}

/// Makes the names of new and removed files in a folder durable.
pub fn sync_folder(path: &Path, sync: fn(&File) -> Result<()>) -> Result<()> {
    sync(&File::open(path)?)
}
