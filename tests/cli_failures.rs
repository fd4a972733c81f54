//! Failures of the machine have exit code 1 and one line; a request that can never be carried out has exit code 2. What
//! a user gave is repeated only in part, and a hostile file takes little memory.

use flate2::Compression;
use flate2::write::GzEncoder;
use sandgait::view::recording::head_block;
use std::io::Write as _;
use std::process::{Command, Output};

fn sandgait(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_sandgait")).args(arguments).output().unwrap()
}

/// The one line on stderr.
fn line(output: &Output, code: i32) -> String {
    let line = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(code), "{line}");
    assert!(line.ends_with('\n') && line.lines().count() == 1, "{line:?}");
    line
}

/// `/dev/full` is a full disk, and nobody can make files in `/sys`, not even root.
#[test]
fn what_cannot_be_written_is_the_machines_failure() {
    let intrude = |file: &str| sandgait(&["intrude", "--shape", "L", "--csv", file]);
    for (file, code, words) in [
        ("/dev/full", 1, "No space left on device"),
        ("/sys/force.csv", 1, "/sys/force.csv: "),
        ("/none/force.csv", 2, "No such file or directory"),
        ("/dev", 2, "is a directory"),
    ] {
        let said = line(&intrude(file), code);
        assert!(said.contains(words), "{said}");
    }
    let train = ["train", "--set", "n_envs=16", "--set", "n_steps=4", "--set", "batch_size=64", "--timesteps", "64"];
    line(&sandgait(&[&train[..], &["--out", "/sys/runs"]].concat()), 1);
    let out = tempfile::tempdir().unwrap();
    let mut limited = Command::new("sh");
    limited.args(["-c", "trap '' XFSZ; ulimit -f 1; exec \"$@\"", "sh", env!("CARGO_BIN_EXE_sandgait")]);
    let output = limited.args(train).arg("--out").arg(out.path()).output().unwrap();
    assert!(line(&output, 1).contains("File too large"), "{output:?}");
}

#[test]
fn only_a_part_of_a_long_text_is_repeated() {
    let long = "x".repeat(100_000);
    let (hardware, sand) = (format!("hardware=action_delay = {long}"), format!("robot={long}"));
    for arguments in [
        &["train", "--option", &hardware, "--out", "/none"] as &[&str],
        &["train", "--option", &sand, "--out", "/none"],
        &["train", "--task", &long],
        &["bench", "--repeats", &long],
        &["walk", "--frequency", "1", "--sand", &long],
        &["walk", "--frequency", "1", "--medium", &long],
        &["replay", &long],
        &[&long],
    ] {
        let said = line(&sandgait(arguments), 2);
        assert!(said.len() < 5000, "{:?}: {} bytes", arguments[0], said.len());
    }
}

/// JSON of 20 MB, in a file of 20 kB, takes 2 GB as a tree of values; the process gets 600 MB.
#[test]
fn a_recordings_headers_take_little_memory() {
    let head = r#"{"format":"sandgait recording","version":1,"columns":[{"name":"t","shape":[]}],"x":["#;
    let mut file = GzEncoder::new(Vec::new(), Compression::fast());
    file.write_all(&head_block(&format!("{head}{}0]}}", r#"{"":0},"#.repeat(3_000_000)))).unwrap();
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("walk.rec");
    std::fs::write(&path, file.finish().unwrap()).unwrap();
    let mut limited = Command::new("sh");
    limited.args(["-c", "ulimit -v 600000; exec \"$@\"", "sh", env!("CARGO_BIN_EXE_sandgait"), "replay"]);
    let output = limited.arg(&path).output().unwrap();
    assert!(output.status.success(), "{output:?}");
}
