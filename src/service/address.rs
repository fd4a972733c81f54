//! The address that a server listens on: TCP or a Unix socket.

use crate::error::{Error, Result};
use std::fmt::{self, Display, Formatter};
use std::fs::{self, Permissions};
use std::net::{SocketAddr, ToSocketAddrs};
use std::os::unix::fs::{FileTypeExt as _, MetadataExt as _, PermissionsExt as _};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use tokio::net::{TcpListener, TcpSocket, UnixListener, UnixSocket};

/// Largest number of connections that the kernel queues until they are accepted: our choice, as many as the server has
/// at a time by default.
const BACKLOG: u32 = 1024;

#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Address {
    Tcp(SocketAddr),
    Unix(PathBuf),
}

impl FromStr for Address {
    type Err = Error;

    /// `HOST:PORT` (port 0: any free port) or `unix:PATH`.
    fn from_str(text: &str) -> Result<Self> {
        if let Some(path) = text.strip_prefix("unix:") {
            let path = path.strip_prefix("//").unwrap_or(path);
            return match path {
                "" => Err(Error::invalid("address", "unix: lacks a path")),
                path => Ok(Self::Unix(path.into())),
            };
        }
        let unusable =
            |why: String| Error::invalid("address", format!("{text:?} is not HOST:PORT or unix:PATH ({why})"));
        let mut found = text.to_socket_addrs().map_err(|e| unusable(e.to_string()))?;
        found.next().map(Self::Tcp).ok_or_else(|| unusable("no such host".into()))
    }
}

impl Display for Address {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self {
            Self::Tcp(address) => address.fmt(f),
            Self::Unix(path) => write!(f, "unix:{}", path.display()),
        }
    }
}

impl Address {
    /// Can only processes of this machine connect?
    pub fn is_local(&self) -> bool {
        match self {
            Self::Tcp(address) => address.ip().is_loopback(),
            Self::Unix(_) => true,
        }
    }
}

/// A bound address. A socket file is removed when this is dropped.
pub enum Listener {
    Tcp(TcpListener),
    Unix(UnixListener, SocketFile),
}

impl Listener {
    /// Needs a tokio runtime.
    pub async fn bind(address: &Address) -> Result<Self> {
        let failed = |e: std::io::Error| Error::Exhausted(format!("cannot listen on {address}: {e}"));
        match address {
            Address::Tcp(address) => bind_tcp(*address).map(Self::Tcp).map_err(failed),
            Address::Unix(path) => {
                let (listener, file) = bind_unix(path).map_err(failed)?;
                Ok(Self::Unix(listener, file))
            }
        }
    }

    /// The address for clients, with the actual port if port 0 was given.
    pub fn address(&self) -> Result<Address> {
        match self {
            Self::Tcp(listener) => match listener.local_addr() {
                Ok(address) => Ok(Address::Tcp(address)),
                Err(e) => Err(Error::Exhausted(format!("the listening socket is unusable: {e}"))),
            },
            Self::Unix(_, file) => Ok(Address::Unix(file.path.clone())),
        }
    }
}

/// The socket file that this process made.
pub struct SocketFile {
    path: PathBuf,
    inode: u64,
}

impl Drop for SocketFile {
    fn drop(&mut self) {
        // Another server may have replaced the file by its own socket.
        if fs::symlink_metadata(&self.path).is_ok_and(|m| m.ino() == self.inode) {
            // If it cannot be removed, the next server finds it stale.
            let _ = fs::remove_file(&self.path);
        }
    }
}

/// A TCP listener with a queue of `BACKLOG` connections, because the usual 128 are too few if a hundred connections
/// arrive in a second. Needs a tokio runtime.
pub fn bind_tcp(address: SocketAddr) -> std::io::Result<TcpListener> {
    let socket = if address.is_ipv4() { TcpSocket::new_v4() } else { TcpSocket::new_v6() }?;
    // A port can be used again while its last connections are still closing.
    socket.set_reuseaddr(true)?;
    socket.bind(address)?;
    socket.listen(BACKLOG)
}

/// A socket to which only its owner can connect. The mode is set between bind and listen, before anyone can connect.
fn bind_unix(path: &Path) -> std::io::Result<(UnixListener, SocketFile)> {
    remove_stale(path)?;
    let socket = UnixSocket::new_stream()?;
    socket.bind(path)?;
    let file = SocketFile { path: path.into(), inode: fs::symlink_metadata(path)?.ino() };
    fs::set_permissions(path, Permissions::from_mode(0o600))?;
    Ok((socket.listen(BACKLOG)?, file))
}

/// Removes the socket of a server that no longer runs; any other file at this path is kept and gives an error.
fn remove_stale(path: &Path) -> std::io::Result<()> {
    use std::io::{Error, ErrorKind};
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
