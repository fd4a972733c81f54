//! Clients without permission are refused with a reason, others are not affected, and the log contains no secrets.

use crate::harness::{Bearer, Session, client};
use crate::process::{Process, refused, text};
use rcgen::{
    BasicConstraints, CertificateParams, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair, date_time_ymd,
};
use sandgait::service::proto::DescribeRequest;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tonic::transport::{Certificate, Channel, ClientTlsConfig, Endpoint, Identity};
use tonic::{Code, Status};

const TOKEN: &str = "the-token-that-nobody-may-log";

/// A certificate authority, made for this run.
pub struct Authority {
    issuer: Issuer<'static, KeyPair>,
    pub pem: String,
}

impl Authority {
    pub fn new(name: &str) -> Self {
        let mut params = CertificateParams::new(vec![]).unwrap();
        params.distinguished_name.push(DnType::CommonName, name);
        params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        let key = KeyPair::generate().unwrap();
        let pem = params.self_signed(&key).unwrap().pem();
        Self { issuer: Issuer::new(params, key), pem }
    }

    /// A certificate for localhost that is valid until the end of `year`, and its key, as PEM.
    pub fn issue(&self, year: i32) -> (String, String) {
        let mut params = CertificateParams::new(vec!["localhost".into()]).unwrap();
        params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ServerAuth, ExtendedKeyUsagePurpose::ClientAuth];
        (params.not_before, params.not_after) = (date_time_ymd(2020, 1, 1), date_time_ymd(year, 12, 31));
        let key = KeyPair::generate().unwrap();
        (params.signed_by(&key, &self.issuer).unwrap().pem(), key.serialize_pem())
    }

    fn identity(&self, year: i32) -> Identity {
        let (certificate, key) = self.issue(year);
        Identity::from_pem(certificate, key)
    }
}

pub const VALID: i32 = 2099;
const EXPIRED: i32 = 2021;

pub fn write(directory: &Path, name: &str, content: &str) -> PathBuf {
    let path = directory.join(name);
    fs::write(&path, content).unwrap();
    path
}

/// Starts a server with TLS and the token. With `clients`, it admits only certificates of this authority.
fn start(directory: &Path, authority: &Authority, year: i32, clients: Option<&Authority>) -> Process {
    let (certificate, key) = authority.issue(year);
    let [certificate, key, token] =
        [("cert.pem", &*certificate), ("key.pem", &key), ("token", TOKEN)].map(|(n, c)| write(directory, n, c));
    let mut arguments = vec!["--listen", "127.0.0.1:0", "--tls-cert", text(&certificate), "--tls-key", text(&key)];
    arguments.extend(["--token-file", text(&token)]);
    let ca = clients.map(|a| write(directory, "ca.pem", &a.pem));
    arguments.extend(ca.iter().flat_map(|path| ["--client-ca", text(path)]));
    Process::start(&arguments)
}

async fn describe(channel: Channel, token: Option<&str>) -> Result<String, Status> {
    let mut client = client(channel, Bearer(token.map(Into::into)));
    Ok(client.describe(DescribeRequest {}).await?.into_inner().version)
}

/// A session that goes on while others are refused.
struct Witness(Session, Session, usize);

impl Witness {
    async fn new(channel: Channel) -> Self {
        let session = async || {
            let client = client(channel.clone(), Bearer(Some(TOKEN.into())));
            let mut session = Session::create(client, 3, &[]).await.unwrap();
            session.reset(1).await;
            session
        };
        Self(session().await, session().await, 0)
    }

    async fn goes_on(&mut self) {
        self.2 += 1;
        assert_eq!(self.0.step(self.2).await, self.1.step(self.2).await);
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn only_those_who_know_the_token_are_served() {
    let (directory, authority) = (tempfile::tempdir().unwrap(), Authority::new("ours"));
    let server = start(directory.path(), &authority, VALID, None);
    let channel = server.encrypted(&authority.pem, None).await.unwrap();
    let mut witness = Witness::new(channel.clone()).await;
    let wrong = format!("{TOKEN}-not");
    let mut answers = Vec::new();
    for token in [None, Some(""), Some(&*wrong), Some(&TOKEN[1..])] {
        let status = describe(channel.clone(), token).await.unwrap_err();
        assert_eq!(status.code(), Code::Unauthenticated);
        answers.push(status.message().to_owned());
        // A stream is refused before its first message is read.
        let stream = Session::create(client(channel.clone(), Bearer(token.map(Into::into))), 1, &[]).await;
        assert_eq!(stream.err().unwrap().code(), Code::Unauthenticated);
        witness.goes_on().await;
    }
    answers.dedup();
    assert_eq!(answers, ["this server asks for its bearer token"]);
    assert_eq!(describe(channel, Some(TOKEN)).await.unwrap(), env!("CARGO_PKG_VERSION"));
    let id = witness.0.id.clone();
    let (_, log) = server.end();
    assert!(log.contains("without this server's token") && log.contains("127.0.0.1:"), "{log}");
    // The log has neither the token, right or wrong, nor a session's id, because whoever knows the id may use the session.
    assert!(!log.contains(&TOKEN[1..]) && !log.contains(&id), "{log}");
    assert_eq!(log.matches("others than its owner can use this").count(), 2, "the token and the key: {log}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn only_handshakes_that_succeed_reach_the_services() {
    let (directory, authority, other) =
        (tempfile::tempdir().unwrap(), Authority::new("ours"), Authority::new("another"));
    let server = start(directory.path(), &authority, VALID, Some(&authority));
    let known = authority.identity(VALID);
    let channel = server.encrypted(&authority.pem, Some(known.clone())).await.unwrap();
    let mut witness = Witness::new(channel).await;
    let plain = Endpoint::from_shared(format!("http://{}", server.address)).unwrap().connect().await;
    let mut refusals = vec![("plain text", use_it(plain.map_err(|e| format!("{e:?}"))).await)];
    witness.goes_on().await;
    let cases = [
        ("an authority that did not issue the server's certificate", &other, Some(known)),
        ("no certificate", &authority, None),
        ("a certificate of another authority", &authority, Some(other.identity(VALID))),
        ("an expired certificate", &authority, Some(authority.identity(EXPIRED))),
    ];
    for (what, trusted, identity) in cases {
        // The log has at most one line a second for refused connections, so the test waits to get one for each reason.
        tokio::time::sleep(Duration::from_millis(1100)).await;
        refusals.push((what, use_it(server.encrypted(&trusted.pem, identity).await).await));
        witness.goes_on().await;
    }
    for (what, outcome) in &refusals {
        assert!(outcome.is_err(), "{what} was taken");
    }
    let (_, log) = server.end();
    for reason in ["corrupt message", "peer sent no certificates", "UnknownIssuer", "certificate expired"] {
        assert!(log.contains(reason), "{reason}: {log}");
    }
    assert!(log.matches("a TLS handshake failed").count() >= refusals.len(), "{log}");
    assert!(!log.contains(TOKEN) && !log.contains("PRIVATE KEY"));
}

/// The client gets the refusal when it connects or at its first call.
async fn use_it(connected: Result<Channel, String>) -> Result<String, String> {
    describe(connected?, Some(TOKEN)).await.map_err(|status| format!("{status:?}"))
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_client_does_not_talk_to_a_server_it_cannot_trust() {
    let (directory, authority) = (tempfile::tempdir().unwrap(), Authority::new("ours"));
    let server = start(directory.path(), &authority, EXPIRED, None);
    let error = server.encrypted(&authority.pem, None).await.unwrap_err();
    assert!(error.contains("Expired"), "{error}");
    let plain = Process::start(&["--listen", "127.0.0.1:0"]);
    let mut witness = Session::create(plain.client().await, 1, &[]).await.unwrap();
    assert!(plain.encrypted(&authority.pem, None).await.is_err(), "TLS to a port without it");
    witness.reset(0).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_server_can_make_its_own_certificate() {
    let directory = tempfile::tempdir().unwrap();
    let (token, certificate) = (write(directory.path(), "token", TOKEN), directory.path().join("certificate"));
    let arguments = ["--listen", "127.0.0.1:0", "--token-file", text(&token), "--tls-self-signed", text(&certificate)];
    let server = Process::start(&arguments);
    let pem = fs::read_to_string(&certificate).unwrap();
    assert!(pem.starts_with("-----BEGIN CERTIFICATE") && !pem.contains("KEY"), "{pem}");
    let connect = async |ca: &str, name: &str| {
        let tls = ClientTlsConfig::new().ca_certificate(Certificate::from_pem(ca)).domain_name(name);
        let endpoint = Endpoint::from_shared(format!("https://{}", server.address)).unwrap();
        endpoint.tls_config(tls).unwrap().connect().await.map_err(|e| format!("{e:?}"))
    };
    let channel = connect(&pem, "127.0.0.1").await.unwrap();
    assert_eq!(describe(channel.clone(), Some(TOKEN)).await.unwrap(), env!("CARGO_PKG_VERSION"));
    assert_eq!(describe(channel, None).await.unwrap_err().code(), Code::Unauthenticated);
    let error = connect(&pem, "127.0.0.2").await.unwrap_err();
    assert!(error.contains("NotValidForName"), "{error}");
    // The key is new in each run.
    let other = Process::start(&arguments);
    assert_ne!(fs::read_to_string(&certificate).unwrap(), pem);
    drop(other);
}

#[test]
fn servers_that_would_be_open_by_mistake_are_refused() {
    let (directory, authority) = (tempfile::tempdir().unwrap(), Authority::new("ours"));
    let (certificate, key) = authority.issue(VALID);
    let at = |name, content| write(directory.path(), name, content);
    let [cert, key, token] = [at("cert", &certificate), at("key", &key), at("token", TOKEN)];
    let (empty, other) = (at("empty", " \n"), at("other", &authority.issue(VALID).1));
    let [cert, key, token, empty, other] = [&cert, &key, &token, &empty, &other].map(|p| text(p));
    let tls = ["--tls-cert", cert, "--tls-key", key];
    let everywhere = ["--listen", "0.0.0.0:0"];
    let own = ["--tls-self-signed", other];
    let cases: [(&[&str], &[&str]); 18] = [
        (&everywhere, &["0.0.0.0:0", "--tls-cert and --tls-key and --token-file", "--insecure"]),
        (&[&everywhere[..], &tls].concat(), &["add --token-file, or --insecure"]),
        (&[&everywhere[..], &["--token-file", token]].concat(), &["add --tls-cert and --tls-key, or"]),
        (&["--listen", "[::]:0"], &["--insecure"]),
        (&["--metrics", "0.0.0.0:0"], &["--metrics", "0.0.0.0:0", "add --metrics-insecure"]),
        (&["--insecure", "--metrics", "0.0.0.0:0"], &["add --metrics-insecure"]),
        (&[&everywhere[..], &["--metrics-insecure", "--viewer-insecure"]].concat(), &["--listen", "or --insecure"]),
        (&["--token-file", empty], &[empty, "empty"]),
        (&["--token-file", "/nowhere"], &["/nowhere", "No such file"]),
        (&tls[..2], &["--tls-key: missing"]),
        (&["--client-ca", cert], &["--tls-cert: missing"]),
        (&["--tls-cert", key, "--tls-key", key], &[key, "holds no certificate"]),
        (&["--tls-cert", cert, "--tls-key", other], &[other, "not the key of"]),
        (&[&["--listen", "unix:/nowhere/sock"][..], &tls].concat(), &["needs no TLS"]),
        (&[&["--listen", "unix:/nowhere/sock"][..], &own].concat(), &["--tls-self-signed", "needs no TLS"]),
        (&[&everywhere[..], &own, &["--token-file", token]].concat(), &["--tls-self-signed", "not an address"]),
        (&[&own[..], &tls].concat(), &["--tls-self-signed", "cannot be given with"]),
        (&["--tls-self-signed", "/nowhere/certificate"], &["/nowhere/certificate"]),
    ];
    for (arguments, words) in cases {
        let line = refused(arguments);
        for word in words {
            assert!(line.contains(word), "{arguments:?}: {line:?} lacks {word:?}");
        }
    }
    let (_, log) = Process::start(&["--listen", "0.0.0.0:0", "--insecure"]).end();
    assert!(log.contains("because of --insecure"), "{log}");
}
