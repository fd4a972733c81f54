//! Access to this server: encryption, client certificates, the token.

use super::platform;
use crate::error::{Error, Result};
use sha2::{Digest as _, Sha256};
use std::fmt::Display;
use std::io;
use std::net::IpAddr;
use std::path::Path;
use std::sync::Arc;
use subtle::ConstantTimeEq as _;
use tokio::net::TcpStream;
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::pem::PemObject as _;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio_rustls::rustls::server::WebPkiClientVerifier;
use tokio_rustls::rustls::{RootCertStore, ServerConfig};
use tokio_rustls::server::TlsStream;

/// The secret that clients must send. Only its digest is kept.
#[derive(Clone)]
pub struct Token([u8; 32]);

impl Token {
    /// The token in a file: its text without surrounding blanks.
    ///
    /// # Errors
    /// The file cannot be read, is empty, or has characters that do not fit into a header.
    pub fn load(path: &Path) -> Result<Self> {
        let text = sandgait_base::files::read_text(path)?;
        let token = text.trim();
        if token.is_empty() {
            return Err(Error::file(path, "the token is empty"));
        }
        if !token.bytes().all(|b| b.is_ascii_graphic()) {
            return Err(Error::file(path, "the token has characters other than visible ASCII ones"));
        }
        Ok(Self::new(token))
    }

    pub fn new(token: &str) -> Self {
        Self(Sha256::digest(token).into())
    }

    /// Is this the value of an `authorization` header with this token? The comparison takes the same time for every
    /// wrong value of the right length.
    pub fn admits(&self, authorization: &[u8]) -> bool {
        let Some((scheme, given)) = authorization.split_at_checked(SCHEME.len()) else { return false };
        scheme.eq_ignore_ascii_case(SCHEME) && bool::from(Sha256::digest(given).as_slice().ct_eq(&self.0))
    }
}

const SCHEME: &[u8] = b"Bearer ";

/// TLS for a server: its certificate, its key, and the authorities of clients' certificates.
#[derive(Clone)]
pub struct Tls(TlsAcceptor);

impl Tls {
    /// Reads PEM files: the certificate (with the intermediate certificates, if there are any), its private key and, if
    /// clients must have certificates too, the certificates of the authorities that issue them.
    pub fn load(certificate: &Path, key: &Path, client_ca: Option<&Path>) -> Result<Self> {
        let chain = certificates(certificate)?;
        let secret = PrivateKeyDer::from_pem_file(key).map_err(|e| Error::file(key, format!("no private key: {e}")))?;
        let unusable = |e| Error::file(key, format!("not the key of {}: {e}", certificate.display()));
        Self::with(chain, secret, client_ca)?.map_err(unusable)
    }

    /// A self-signed certificate for `host` with a new key. It is valid until this process ends. The text is its
    /// PEM, which clients must trust.
    pub fn self_signed(host: IpAddr) -> Result<(Self, String)> {
        let failed = |e: &dyn Display| Error::Exhausted(format!("a certificate cannot be made: {e}"));
        let made = rcgen::generate_simple_self_signed(vec![host.to_string()]).map_err(|e| failed(&e))?;
        let secret = PrivateKeyDer::Pkcs8(made.signing_key.serialize_der().into());
        let tls = Self::with(vec![made.cert.der().clone()], secret, None)?.map_err(|e| failed(&e))?;
        Ok((tls, made.cert.pem()))
    }

    /// The inner error means that the key does not belong to the certificate.
    fn with(
        chain: Vec<CertificateDer<'static>>,
        secret: PrivateKeyDer<'static>,
        client_ca: Option<&Path>,
    ) -> Result<std::result::Result<Self, tokio_rustls::rustls::Error>> {
        let provider = Arc::new(ring::default_provider());
        let versions = ServerConfig::builder_with_provider(provider.clone()).with_safe_default_protocol_versions();
        let versions = versions.map_err(|e| Error::Exhausted(format!("TLS cannot be used: {e}")))?;
        let clients = match client_ca {
            None => versions.with_no_client_auth(),
            Some(path) => {
                let mut roots = RootCertStore::empty();
                for authority in certificates(path)? {
                    roots.add(authority).map_err(|e| Error::file(path, e))?;
                }
                let verifier = WebPkiClientVerifier::builder_with_provider(roots.into(), provider).build();
                versions.with_client_cert_verifier(verifier.map_err(|e| Error::file(path, e))?)
            }
        };
        Ok(clients.with_single_cert(chain, secret).map(|mut config| {
            config.alpn_protocols = vec![b"h2".to_vec()];
            Self(Arc::new(config).into())
        }))
    }

    /// A connection, encrypted.
    pub(super) async fn shake_hands(&self, stream: TcpStream) -> io::Result<TlsStream<TcpStream>> {
        self.0.accept(stream).await
    }
}

/// Warns if other users can read a file or directory of secrets; it is used nevertheless.
pub fn warn_if_shared(path: &Path) {
    if platform::is_shared(path) {
        tracing::warn!(path = %path.display(), "others than its owner can use this, which holds secrets");
    }
}

/// Reads certificates; the file must have at least one.
fn certificates(path: &Path) -> Result<Vec<CertificateDer<'static>>> {
    let read = CertificateDer::pem_file_iter(path).and_then(Iterator::collect::<std::result::Result<Vec<_>, _>>);
    let found = read.map_err(|e| Error::file(path, e))?;
    if found.is_empty() {
        return Err(Error::file(path, "holds no certificate"));
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_token_is_admitted() {
        let token = Token::new("s3cret");
        for right in [&b"Bearer s3cret"[..], b"bearer s3cret"] {
            assert!(token.admits(right));
        }
        for wrong in [&b""[..], b"Bearer", b"Bearer ", b"s3cret", b"Basic s3cret", b"Bearer s3cret ", b"Bearer S3cret"]
        {
            assert!(!token.admits(wrong), "{wrong:?}");
        }
    }
}
