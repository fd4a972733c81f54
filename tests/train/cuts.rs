//! A training whose environments are on a server survives cuts of the link and restarts of the server.

use crate::servers::Server;
use crate::{SMALL, result, train};
use std::io::{Read as _, Write as _};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::Duration;

/// A link that can be cut, to a server that can change.
struct Link {
    address: String,
    ends: Arc<LinkEnds>,
}

#[derive(Default)]
struct LinkEnds {
    server: Mutex<String>,
    open: Mutex<Vec<TcpStream>>,
    is_cut: AtomicBool,
    /// How often something came from the client.
    messages: AtomicUsize,
}

impl Link {
    fn to(server: &str) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let link = Self { address: listener.local_addr().unwrap().to_string(), ends: Arc::default() };
        *link.ends.server.lock().unwrap() = server.into();
        let ends = link.ends.clone();
        thread::spawn(move || listener.incoming().for_each(|stream| ends.clone().connect(stream.unwrap())));
        link
    }

    fn cut(&self, time: Duration) {
        self.ends.is_cut.store(true, Ordering::SeqCst);
        for stream in self.ends.open.lock().unwrap().drain(..) {
            // It may be closed already.
            let _ = stream.shutdown(Shutdown::Both);
        }
        thread::sleep(time);
        self.ends.is_cut.store(false, Ordering::SeqCst);
    }

    /// Waits until the training has sent `count` more messages.
    fn wait_for(&self, count: usize, training: &mut Child) {
        let until = self.ends.messages.load(Ordering::SeqCst) + count;
        while self.ends.messages.load(Ordering::SeqCst) < until {
            assert!(training.try_wait().unwrap().is_none(), "the training has ended");
            thread::sleep(Duration::from_millis(1));
        }
    }
}

impl LinkEnds {
    fn connect(self: Arc<Self>, client: TcpStream) {
        if self.is_cut.load(Ordering::SeqCst) {
            return;
        }
        // Without a server the client's connection is closed.
        let Ok(server) = TcpStream::connect(&*self.server.lock().unwrap()) else { return };
        client.set_nodelay(true).unwrap();
        server.set_nodelay(true).unwrap();
        let mut open = self.open.lock().unwrap();
        open.extend([client.try_clone().unwrap(), server.try_clone().unwrap()]);
        let ends = self.clone();
        let (from, to) = (client.try_clone().unwrap(), server.try_clone().unwrap());
        thread::spawn(move || {
            pass(from, to, move || {
                ends.messages.fetch_add(1, Ordering::SeqCst);
            })
        });
        thread::spawn(move || pass(server, client, || ()));
    }
}

fn pass(mut from: TcpStream, mut to: TcpStream, told: impl Fn()) {
    let mut bytes = [0; 1 << 16];
    while let Ok(count @ 1..) = from.read(&mut bytes) {
        told();
        if to.write_all(&bytes[..count]).is_err() {
            break;
        }
    }
    let _ = from.shutdown(Shutdown::Both);
    let _ = to.shutdown(Shutdown::Both);
}

fn start(out: &Path, address: &str) -> Child {
    let arguments =
        [&SMALL[..], &["--timesteps", STEPS, "--out", out.to_str().unwrap(), "--address", address]].concat();
    let mut command = Command::new(env!("CARGO_BIN_EXE_sandgait"));
    command.arg("train").args(arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
}

const STEPS: &str = "25600";

/// The policy and the curve have the bits of a training without a server. The last restart is after a kill, so the
/// server has an older state of the session, from the restart before it.
#[test]
fn cuts_and_restarts_change_no_bit() {
    let directory = tempfile::tempdir().unwrap();
    let [here, away] = ["here", "away"].map(|name| directory.path().join(name));
    let done = train(&[&SMALL[..], &["--timesteps", STEPS, "--out", here.to_str().unwrap()]].concat());
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let state = directory.path().join("state");
    let keeping = ["--state-dir", state.to_str().unwrap()];
    let mut server = Server::start_with(&keeping);
    let link = Link::to(&server.address);
    let mut training = start(&away, &link.address);
    for cut in [50, 50, 3000] {
        link.wait_for(40, &mut training);
        link.cut(Duration::from_millis(cut));
    }
    for signal in ["-TERM", "-KILL"] {
        link.wait_for(40, &mut training);
        server.end(signal);
        thread::sleep(Duration::from_millis(500));
        server = Server::start_with(&keeping);
        *link.ends.server.lock().unwrap() = server.address.clone();
    }
    let output = training.wait_with_output().unwrap();
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let named = format!("server {}: the connection was lost and opened again ", link.address);
    assert!(text.contains(&named) && text.contains("the session was lost, and made anew"), "{text}");
    assert!(result(&here) == result(&away));
}
