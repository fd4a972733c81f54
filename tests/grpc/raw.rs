//! Bytes that no gRPC library would send: their stream ends with a reason, and everything else goes on.

use crate::harness::{Server, Session, create};
use bytes::Bytes;
use h2::client::SendRequest;
use prost::Message as _;
use sandgait::service::Address;
use sandgait::service::proto::run_session_request::Request;
use sandgait::service::proto::{Reset, RunSessionRequest};
use std::time::Duration;
use tokio::io::AsyncWriteExt as _;
use tokio::net::UnixStream;
use tonic::Code;

async fn socket(server: &Server) -> UnixStream {
    let Address::Unix(path) = &server.address else { panic!("a Unix socket") };
    UnixStream::connect(path).await.unwrap()
}

async fn http2(server: &Server) -> SendRequest<Bytes> {
    let (client, connection) = h2::client::handshake(socket(server).await).await.unwrap();
    tokio::spawn(connection);
    client.ready().await.unwrap()
}

/// Sends a RunSession stream whose only content is `body`, and returns the status with which the server ends it.
async fn answer(server: &Server, body: Vec<u8>) -> (Code, String) {
    let request = http::Request::post("http://localhost/sandgait.v1.EnvironmentService/RunSession");
    let request = request.header("content-type", "application/grpc").header("te", "trailers").body(()).unwrap();
    let (response, mut sender) = http2(server).await.send_request(request, false).unwrap();
    sender.send_data(body.into(), true).unwrap();
    let response = response.await.unwrap();
    let mut headers = response.headers().clone();
    let mut body = response.into_body();
    while let Some(data) = body.data().await {
        body.flow_control().release_capacity(data.unwrap().len()).unwrap();
    }
    headers.extend(body.trailers().await.unwrap().unwrap_or_default());
    let field = |name| headers.get(name).map_or("", |v: &http::HeaderValue| v.to_str().unwrap()).to_owned();
    (Code::from_bytes(field("grpc-status").as_bytes()), field("grpc-message"))
}

/// A gRPC frame whose header states `length` bytes.
fn frame(flag: u8, length: usize, message: &[u8]) -> Vec<u8> {
    [&[flag][..], &(length as u32).to_be_bytes(), message].concat()
}

async fn first_message(server: &Server) -> Vec<u8> {
    let session_id = server.client().await.create_session(create(2, &[])).await.unwrap().into_inner().session_id;
    let request = Some(Request::Reset(Reset::default()));
    RunSessionRequest { session_id, sequence: 1, request }.encode_to_vec()
}

/// A session that makes steps between the attempts of other clients, and the same session undisturbed.
struct Witness(Session, Session, usize);

impl Witness {
    async fn new(server: &Server) -> Self {
        let (mut one, mut other) = (server.session(3).await, server.session(3).await);
        assert_eq!(one.reset(1).await, other.reset(1).await);
        Self(one, other, 0)
    }

    async fn goes_on(&mut self) {
        self.2 += 1;
        assert_eq!(self.0.step(self.2).await, self.1.step(self.2).await);
    }
}

#[tokio::test]
async fn broken_messages_end_their_own_stream_with_a_reason() {
    let server = Server::start(1).await;
    let mut witness = Witness::new(&server).await;
    let good = first_message(&server).await;
    let whole = frame(0, good.len(), &good);
    let cases = [
        ("half a message", frame(0, good.len(), &good[..good.len() / 2]), Code::InvalidArgument),
        ("half a message after a whole one", [&whole[..], &whole[..9]].concat(), Code::InvalidArgument),
        ("not protobuf", frame(0, 4, &[0xff; 4]), Code::InvalidArgument),
        ("protobuf cut short", frame(0, 9, &good[..9]), Code::InvalidArgument),
        ("a compression nobody agreed on", frame(1, good.len(), &good), Code::InvalidArgument),
        ("an unknown flag", frame(9, good.len(), &good), Code::InvalidArgument),
        ("a length beyond all limits", frame(0, u32::MAX as usize, &good), Code::ResourceExhausted),
        ("nothing", Vec::new(), Code::Ok),
    ];
    for (what, body, code) in cases {
        let (got, message) = answer(&server, body).await;
        assert_eq!(got, code, "{what}: {message}");
        assert!(code == Code::Ok || message.starts_with("message"), "{what}: {message}");
        witness.goes_on().await;
    }
}

#[tokio::test]
async fn a_client_that_is_cut_off_in_mid_message() {
    let server = Server::start(1).await;
    let mut witness = Witness::new(&server).await;
    for cut in [0, 3, 5, 20] {
        let good = first_message(&server).await;
        let request = http::Request::post("http://localhost/sandgait.v1.EnvironmentService/RunSession");
        let request = request.header("content-type", "application/grpc").body(()).unwrap();
        let mut client = http2(&server).await;
        let (_response, mut sender) = client.send_request(request, false).unwrap();
        sender.send_data(frame(0, good.len(), &good)[..cut].to_vec().into(), false).unwrap();
        tokio::time::sleep(Duration::from_millis(5)).await;
        drop((client, sender));
        witness.goes_on().await;
    }
}

#[tokio::test]
async fn a_peer_that_does_not_speak_http2() {
    let server = Server::start(1).await;
    let mut witness = Witness::new(&server).await;
    for noise in
        [&b"GET / HTTP/1.1\r\n\r\n"[..], &[0; 1000], &[0xff; 10], b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\xff\xff\xff\xff"]
    {
        let mut stream = socket(&server).await;
        stream.write_all(noise).await.unwrap();
        witness.goes_on().await;
    }
}
