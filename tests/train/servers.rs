//! Trainings whose environments are on a server.

use crate::{SMALL, result, train};
use std::io::{BufRead as _, BufReader, Read as _};
use std::path::Path;
use std::process::{Child, Command, Stdio};

/// A process `sandgait serve`, which is ended when this value is dropped.
pub struct Server {
    process: Child,
    pub address: String,
}

impl Server {
    fn start() -> Self {
        Self::start_with(&[])
    }

    pub fn start_with(arguments: &[&str]) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_sandgait"));
        command.args(["serve", "--listen", "127.0.0.1:0", "--exit-on-stdin-close"]).args(arguments);
        let mut process = command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
        let mut line = String::new();
        BufReader::new(process.stdout.as_mut().unwrap()).read_line(&mut line).unwrap();
        let address = line.trim().trim_start_matches("listening on ").to_owned();
        Self { process, address }
    }

    /// Sends the signal, and waits for the end.
    pub fn end(&mut self, signal: &str) {
        assert!(Command::new("kill").args([signal, &self.process.id().to_string()]).status().unwrap().success());
        self.process.wait().unwrap();
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// Training with environments on a server gives the same bits as in the process, also after it is resumed.
#[test]
fn environments_on_a_server_give_the_same_bits() {
    let server = Server::start();
    let directory = tempfile::tempdir().unwrap();
    let [here, away] = ["here", "away"].map(|name| directory.path().join(name));
    let run = |out: &Path, more: &[&str]| {
        let done =
            train(&[&SMALL[..], &["--out", out.to_str().unwrap(), "--set", "learning_rate=1e-3"], more].concat());
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        String::from_utf8(done.stdout).unwrap()
    };
    run(&here, &["--timesteps", "1280"]);
    run(&away, &["--timesteps", "640", "--address", &server.address]);
    let text = run(&away, &["--timesteps", "1280", "--address", &server.address, "--resume"]);
    assert!(!text.contains("new episodes began"), "{text}");
    assert!(result(&here) == result(&away));
    let text = run(&away, &["--timesteps", "1408", "--resume"]);
    assert!(
        text.contains("new episodes began at the resumption: the checkpoint's environments are of a server"),
        "{text}"
    );
}

/// A server that is not there is no wrong request.
#[test]
fn a_server_that_cannot_be_reached_is_a_failure_of_the_machine() {
    let output = train(&["--address", "unix:/none/sand.sock", "--out", "/none/out"]);
    let line = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{line}");
    assert!(line.starts_with("sandgait: server unix:/none/sand.sock: it cannot be reached: "), "{line}");
    assert!(line.lines().count() == 1 && !Path::new("/none/out").exists());
}

/// If the server is killed during a training and does not come back, there is one line and a checkpoint, and the
/// training can be resumed without the server.
#[test]
fn a_training_survives_a_killed_server() {
    let mut server = Server::start();
    let directory = tempfile::tempdir().unwrap();
    let out = directory.path().join("out");
    let curve = out.join("curve.csv");
    let arguments = [&SMALL[..], &["--out", out.to_str().unwrap(), "--timesteps", "100000000"]].concat();
    let mut command = Command::new(env!("CARGO_BIN_EXE_sandgait"));
    command.arg("train").args(&arguments).args(["--address", &server.address]);
    let mut training = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    // Some updates, so that the checkpoint matters.
    while std::fs::read_to_string(&curve).map_or(0, |text| text.lines().count()) < 5 {
        assert!(training.try_wait().unwrap().is_none(), "the training ended");
        std::thread::sleep(std::time::Duration::from_millis(10));
    }
    server.end("-KILL");
    assert_eq!(training.wait().unwrap().code(), Some(1));
    let mut line = String::new();
    training.stderr.take().unwrap().read_to_string(&mut line).unwrap();
    let begins = format!("sandgait: server {}: ", server.address);
    // Lines on the training's progress come first.
    let last = line.lines().last().unwrap_or_default();
    assert!(last.starts_with(&begins) && last.ends_with("go on with --resume"), "{line}");
    let text = std::fs::read_to_string(&curve).unwrap();
    let told: u64 = text.lines().last().unwrap().split(',').next().unwrap().parse().unwrap();
    let kept = std::fs::read_dir(out.join("checkpoints")).unwrap();
    let kept = kept.map(|e| e.unwrap().path().file_stem().unwrap().to_str().unwrap().parse::<u64>().unwrap());
    let kept = kept.max().unwrap();
    assert!(kept >= told, "{kept} steps are kept, {told} were told");
    let more = (kept + 128).to_string();
    let arguments = [&arguments[..arguments.len() - 1], &[more.as_str(), "--resume"]].concat();
    let done = train(&arguments);
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
}
