//! The address that a server listens on: TCP or a Unix socket.

use super::platform::{BACKLOG, SocketFile, UnixListener, bind_unix};
use crate::error::{Error, Result};
use std::fmt::{self, Display, Formatter};
use std::net::{SocketAddr, ToSocketAddrs};
use std::path::PathBuf;
use std::str::FromStr;
use tokio::net::{TcpListener, TcpSocket};

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

/// A TCP listener with a queue of `BACKLOG` connections, because the usual 128 are too few if a hundred connections
/// arrive in a second. Needs a tokio runtime.
pub fn bind_tcp(address: SocketAddr) -> std::io::Result<TcpListener> {
    let socket = if address.is_ipv4() { TcpSocket::new_v4() } else { TcpSocket::new_v6() }?;
    // A port can be used again while its last connections are still closing.
    socket.set_reuseaddr(true)?;
    socket.bind(address)?;
    socket.listen(BACKLOG)
}
