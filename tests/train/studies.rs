//! `sandgait sweep --train`: a training for each design.

use std::process::{Command, Output};

/// `sandgait sweep` with short episodes.
fn sweep(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_sandgait"));
    command.arg("sweep").args(arguments).args(["--option", "max_episode_steps=40"]).output().unwrap()
}

/// When a stopped study is started again, it reads finished trainings from their files and repeats the others. Its
/// results equal those of an uninterrupted study to the bit.
#[test]
fn a_study_that_was_stopped_goes_on() {
    let directory = tempfile::tempdir().unwrap();
    let out = directory.path().join("study");
    let study = |steps: &str| {
        let arguments = ["--vary", "xi=-40:40:2", "--learn-steps", steps, "--trainings", "2", "--out"];
        let done = sweep(&[&arguments[..], &[out.to_str().unwrap(), "--measure", "return"]].concat());
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        String::from_utf8(done.stdout).unwrap()
    };
    let read = |name: &str| std::fs::read(out.join(name)).unwrap();
    let made = |name: &str| std::fs::metadata(out.join(name)).unwrap().modified().unwrap();
    let text = study("8192");
    assert!(text.contains("design0-*.onnx") && text.contains("±"), "{text}");
    let (table, policy, kept, lost) =
        (read("learnt.csv"), read("design1-0.onnx"), made("design0-1.json"), made("design1-0.json"));
    // Without its file of results a training counts as unfinished.
    std::fs::remove_file(out.join("design1-0.json")).unwrap();
    assert_eq!(study("8192"), text);
    assert!(read("learnt.csv") == table && read("design1-0.onnx") == policy);
    assert!(made("design0-1.json") == kept && made("design1-0.json") > lost);
    // With other settings in the same directory, the old results are not used.
    study("4096");
    assert!(read("learnt.csv") != table && made("design0-1.json") > kept);
}

/// A search that trains a policy for each design stays within the bounds and tries more designs near the expected best.
#[test]
fn a_search_learns_for_each_design() {
    let directory = tempfile::tempdir().unwrap();
    let out = directory.path().to_str().unwrap();
    let arguments = ["--vary", "base-mass=0.1:0.4:2", "--optimize", "return", "--designs", "10", "--trainings", "1"];
    let done = sweep(&[&arguments[..], &["--learn-steps", "4096", "--out", out]].concat());
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let table = std::fs::read_to_string(directory.path().join("learnt.csv")).unwrap();
    let masses: Vec<f64> = table.lines().skip(1).map(|l| l.split(',').next().unwrap().parse().unwrap()).collect();
    assert_eq!(masses.len(), 10);
    assert!(masses.iter().all(|m| (0.1..=0.4).contains(m)), "{masses:?}");
    let mut sorted = masses.clone();
    sorted.sort_by(f64::total_cmp);
    sorted.dedup();
    assert_eq!(sorted.len(), 10, "{masses:?}");
}

#[test]
fn wrong_studies_are_one_line_and_write_nothing() {
    let directory = tempfile::tempdir().unwrap();
    let out = directory.path().join("out");
    let vary = ["--vary", "xi=-40:40:2", "--out", out.to_str().unwrap()];
    for (arguments, words) in [
        (&["--learn", "5", "--learn-steps", "5"] as &[&str], "cannot be used with"),
        (&["--learn-steps", "0"], "--learn-steps: 0 is outside"),
        (&["--learn", "0"], "seconds: 0 is outside"),
        (&["--learn", "5", "--trainings", "0"], "--trainings: 0 is outside"),
        (&["--learn", "5", "--optimize", "return", "--designs", "0"], "--designs: 0 is outside"),
        (&["--learn", "5", "--optimize", "height"], "measure \"height\" is unknown"),
        (
            &["--learn", "5", "--optimize", "return", "--vary", "leg=L,C"],
            "vary: leg needs two numbers to search between",
        ),
        (&["--learn", "5", "--vary", "frequency=1:2:2"], "frequency: with --learn each design learns its own"),
        (&["--warm", "5"], "they are used only with --learn or --learn-steps"),
    ] {
        let done = sweep(&[&vary[..], arguments].concat());
        let line = String::from_utf8(done.stderr).unwrap();
        assert_eq!(done.status.code(), Some(2), "{arguments:?}: {line}");
        assert!(line.lines().count() == 1 && line.contains(words), "{line}");
        assert!(!out.exists(), "{arguments:?} wrote something");
    }
}
