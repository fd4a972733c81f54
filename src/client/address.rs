//! A server's address and credentials.

use std::time::Duration;
use tonic::metadata::{Ascii, MetadataValue};
use tonic::service::Interceptor;
use tonic::transport::{Certificate, Channel, ClientTlsConfig, Endpoint, Identity};
use tonic::{Request, Status};

/// Interval of pings, and longest wait for their answers: our choice. A vanished host is noticed within 40 s, and an
/// idle connection costs three pings a minute.
const KEEPALIVE: Duration = Duration::from_secs(20);

/// Longest wait for a connection: our choice, as long as MIN_CONNECT_TIMEOUT of gRPC's connection backoff.
const CONNECT: Duration = Duration::from_secs(20);

/// A server's address, and how to connect to it.
#[derive(Clone, Default)]
pub struct ServerAddress {
    /// `host:port` or `unix:/path`.
    pub address: String,
    pub token: Option<String>,
    pub tls: bool,
    /// PEM; without it the system's authorities are trusted.
    pub ca: Option<Vec<u8>>,
    /// This client's certificate and key, PEM.
    pub identity: Option<(Vec<u8>, Vec<u8>)>,
}

/// The client's identification in every call.
#[derive(Clone)]
pub struct Bearer(Option<MetadataValue<Ascii>>);

impl Interceptor for Bearer {
    fn call(&mut self, mut call: Request<()>) -> Result<Request<()>, Status> {
        if let Some(token) = &self.0 {
            call.metadata_mut().insert("authorization", token.clone());
        }
        Ok(call)
    }
}

impl ServerAddress {
    /// A new connection. Proxies that environment variables name are not used.
    pub async fn connect(&self) -> Result<(Channel, Bearer), Status> {
        let token = self.token.as_ref().map(|token| format!("Bearer {token}").parse());
        let bearer = Bearer(token.transpose().map_err(|_| Status::invalid_argument("token: not visible ASCII"))?);
        let channel = match self.address.strip_prefix("unix:") {
            #[cfg(unix)]
            Some(path) => {
                let socket = super::unix_socket::UnixConnector(path.into());
                endpoint("http://localhost".into())?.connect_with_connector(socket).await
            }
            #[cfg(not(unix))]
            Some(_) => return Err(Status::invalid_argument("address: this system has no Unix sockets; use host:port")),
            None if self.tls => {
                let endpoint = endpoint(format!("https://{}", self.address))?;
                endpoint.tls_config(self.encryption()).map_err(|e| unreachable(&e))?.connect().await
            }
            None => endpoint(format!("http://{}", self.address))?.connect().await,
        };
        Ok((channel.map_err(|e| unreachable(&e))?, bearer))
    }

    fn encryption(&self) -> ClientTlsConfig {
        let config = match &self.ca {
            Some(pem) => ClientTlsConfig::new().ca_certificate(Certificate::from_pem(pem)),
            None => ClientTlsConfig::new().with_native_roots(),
        };
        match &self.identity {
            Some((certificate, key)) => config.identity(Identity::from_pem(certificate, key)),
            None => config,
        }
    }
}

fn endpoint(uri: String) -> Result<Endpoint, Status> {
    let endpoint = Endpoint::from_shared(uri).map_err(|e| Status::invalid_argument(format!("address: {e}")))?;
    Ok(endpoint
        .tcp_nodelay(true)
        .connect_timeout(CONNECT)
        .http2_keep_alive_interval(KEEPALIVE)
        .keep_alive_timeout(KEEPALIVE)
        .keep_alive_while_idle(true))
}

/// The status that says why there is no connection.
fn unreachable(error: &tonic::transport::Error) -> Status {
    Status::unavailable(super::reason(error))
}
