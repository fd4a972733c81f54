//! A server process with its log, and clients of it.

use crate::harness::{Bearer, Client, client};
use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use tonic::transport::{Certificate, Channel, ClientTlsConfig, Endpoint, Identity};

/// Starts a server with wrong options; checks the exit code and returns its one line.
pub fn refused(arguments: &[&str]) -> String {
    let Output { status, stdout, stderr } =
        Command::new(env!("CARGO_BIN_EXE_sandgait")).arg("serve").args(arguments).output().unwrap();
    let text = String::from_utf8(stderr).unwrap();
    assert_eq!((status.code(), stdout.len()), (Some(2), 0), "{arguments:?}: {text}");
    assert_eq!(text.lines().count(), 1, "{text}");
    text
}

pub struct Process {
    child: Child,
    /// Reads the log all the time, because a server blocks when the pipe of its log is full.
    reader: Option<JoinHandle<()>>,
    log: Arc<Mutex<String>>,
    /// The address, as printed.
    pub address: String,
}

impl Drop for Process {
    fn drop(&mut self) {
        // Fails if it has already ended.
        let _ = self.child.kill();
    }
}

impl Process {
    pub fn start(arguments: &[&str]) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_sandgait"));
        command.arg("serve");
        Self::of(command, arguments)
    }

    /// Starts a server by `command`, which runs `sandgait serve` directly or through another program.
    pub fn of(mut command: Command, arguments: &[&str]) -> Self {
        command.args(arguments).args(["--threads", "1"]);
        command.env_remove("SANDGAIT_LOG").stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let address = line.trim_end().strip_prefix("listening on ").unwrap_or_default().to_owned();
        let (stderr, log) = (child.stderr.take().unwrap(), Arc::<Mutex<String>>::default());
        let kept = log.clone();
        let reader = std::thread::spawn(move || {
            for line in BufReader::new(stderr).lines() {
                *kept.lock().unwrap() += &(line.unwrap() + "\n");
            }
        });
        Self { child, reader: Some(reader), log, address }
    }

    /// The log so far.
    pub fn log(&self) -> String {
        self.log.lock().unwrap().clone()
    }

    /// The address in the log's line with `words`, which the server writes before it says that it listens.
    pub fn address_of(&self, words: &str) -> String {
        for _ in 0..1000 {
            let log = self.log();
            if let Some((_, after)) = log.lines().find(|l| l.contains(words)).and_then(|l| l.split_once("127.0.0.1:")) {
                let port: String = after.chars().take_while(char::is_ascii_digit).collect();
                return format!("127.0.0.1:{port}");
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        panic!("no {words:?} in {}", self.log());
    }

    /// Processor time of all threads of the process [s].
    pub fn processor_time(&self) -> f64 {
        let tasks = std::fs::read_dir(format!("/proc/{}/task", self.id())).unwrap();
        let spent = |task: std::fs::DirEntry| std::fs::read_to_string(task.path().join("schedstat")).ok();
        let texts = tasks.filter_map(|task| spent(task.unwrap()));
        texts.map(|text| text.split_whitespace().next().unwrap().parse::<f64>().unwrap() * 1e-9).sum()
    }

    pub fn id(&self) -> u32 {
        self.child.id()
    }

    pub fn signal(&self, name: &str) {
        assert!(Command::new("kill").args([name, &self.id().to_string()]).status().unwrap().success());
    }

    /// Kills the process, and waits until it has ended.
    pub fn kill(mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }

    /// Sends SIGTERM. Returns the time until the process has ended with success, and its log.
    pub fn end(self) -> (Duration, String) {
        self.end_with(0)
    }

    /// The same, with another exit code than success.
    pub fn end_with(mut self, code: i32) -> (Duration, String) {
        let begun = Instant::now();
        self.signal("-TERM");
        let status = self.child.wait().unwrap();
        let time = begun.elapsed();
        self.reader.take().unwrap().join().unwrap();
        let log = self.log();
        assert_eq!(status.code(), Some(code), "{log}");
        (time, log)
    }

    pub async fn client(&self) -> Client {
        let uri = match self.address.strip_prefix("unix:") {
            Some(path) => format!("unix://{path}"),
            None => format!("http://{}", self.address),
        };
        client(Endpoint::from_shared(uri).unwrap().connect().await.unwrap(), Bearer::default())
    }

    /// A connection that encrypts, trusts `ca`, and shows `identity` if it has one.
    pub async fn encrypted(&self, ca: &str, identity: Option<Identity>) -> Result<Channel, String> {
        let tls = ClientTlsConfig::new().ca_certificate(Certificate::from_pem(ca)).domain_name("localhost");
        let tls = identity.into_iter().fold(tls, ClientTlsConfig::identity);
        let endpoint = Endpoint::from_shared(format!("https://{}", self.address)).unwrap().tls_config(tls).unwrap();
        endpoint.connect().await.map_err(|e| format!("{e:?}"))
    }
}

/// A path as an argument.
pub fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}
