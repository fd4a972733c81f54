//! Options of `sandgait serve` from a file, and limits.

use crate::harness::create;
use crate::process::{Process, refused, text};
use std::fs;
use tonic::Code;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_file_has_every_option_and_the_command_line_wins() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("serve.toml");
    let address = format!("unix:{}", directory.path().join("sock").display());
    fs::write(&file, format!("listen = {address:?}\nmax-envs = 5\nmax-sessions = 2\nexit-on-stdin-close = false\n"))
        .unwrap();
    let server = Process::start(&["--config", text(&file), "--max-envs", "7"]);
    assert_eq!(server.address, address);
    let mut client = server.client().await;
    let refused = client.create_session(create(8, &[])).await.unwrap_err();
    assert_eq!((refused.code(), refused.message()), (Code::ResourceExhausted, "num_envs: 8 is outside [1, 7]"));
    for _ in 0..2 {
        let created = client.create_session(create(7, &[])).await.unwrap().into_inner();
        assert_eq!(created.lease_seconds, 300.0);
    }
    let refused = client.create_session(create(1, &[])).await.unwrap_err();
    assert_eq!(refused.message(), "all 2 sessions of this server are taken");
}

#[test]
fn wrong_files_are_refused_by_name_and_key() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("serve.toml");
    let cases = [
        ("max-env = 5", vec!["\"max-env\" is unknown", "max-envs"]),
        ("config = \"x\"", vec!["\"config\" is unknown"]),
        ("threads = true", vec!["threads: boolean where text or a whole number is expected"]),
        ("insecure = 1", vec!["insecure: integer where true or false is expected"]),
        ("threads = \"many\"", vec!["many", "--threads"]),
        ("max-sessions = 0", vec!["--max-sessions", "0"]),
        ("listen = \"nowhere\"", vec!["nowhere", "HOST:PORT"]),
        ("threads = 1\n= 5", vec!["line 2: "]),
        ("threads = 1\nmax-envs = 2\nthreads = 1", vec!["line 3: ", "duplicate key"]),
        ("threads = ", vec!["line 1: "]),
    ];
    for (content, words) in cases {
        fs::write(&file, content).unwrap();
        let line = refused(&["--config", text(&file)]);
        for word in words.iter().chain(&[text(&file)]) {
            assert!(line.contains(word), "{content}: {line:?} lacks {word:?}");
        }
    }
    assert!(refused(&["--config", "/nowhere.toml"]).contains("/nowhere.toml: No such file"));
    // An unsafe combination of options is refused from a file, too.
    fs::write(&file, "listen = \"0.0.0.0:0\"").unwrap();
    assert!(refused(&["--config", text(&file)]).contains("--insecure"));
}

/// The first lines of the log say what the server is and what it allows; a line at SIGTERM says what becomes of
/// sessions.
#[test]
fn the_log_says_what_the_server_is_and_what_it_keeps() {
    let directory = tempfile::tempdir().unwrap();
    let token = directory.path().join("token");
    fs::write(&token, "0123456789abcdef0123456789abcdef\n").unwrap();
    let state = directory.path().join("state");
    for saves in [true, false] {
        let keeping: &[&str] = if saves { &["--state-dir", text(&state)] } else { &[] };
        let listen = ["--listen", "127.0.0.1:0", "--token-file", text(&token), "--max-envs", "77"];
        let server = Process::start(&[&listen[..], keeping].concat());
        let address = server.address.clone();
        let (_, log) = server.end();
        let lines: Vec<&str> = log.lines().filter(|line| line.contains(" INFO ")).collect();
        for word in
            [&format!("version=\"{}\"", env!("CARGO_PKG_VERSION")), &address, "tls=\"none\"", "token=\"needed\""]
        {
            assert!(lines[0].contains(word), "{word}: {log}");
        }
        assert!(lines[1].contains("environments=77") && lines[1].contains("memory_mib="), "{log}");
        let kept = if saves { "saves its sessions" } else { "sessions are not saved" };
        assert!(lines.iter().any(|line| line.contains("SIGTERM") && line.contains(kept)), "{log}");
    }
}
