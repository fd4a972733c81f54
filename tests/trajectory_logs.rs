//! Runs `sandgait diagnose` on a robot's own log.

#[path = "testbed/long.rs"]
mod long;

use sandgait::diagnose::experiment::Experiment;
use sandgait::sand::SandDescription;
use sandgait::sim::hardware::HardwareDescription;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/trajectory").join(name)
}

fn diagnose(log: &Path, experiment: &Path, out: &Path) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_sandgait"));
    command.arg("diagnose").arg(log).arg("--experiment").arg(experiment).arg("--out").arg(out).output().unwrap()
}

/// The log was simulated with an `inertial_drag` of 4 (tests/data/trajectory/README.md). What is found can be given to another diagnosis. Its
/// result is checked by `make test-long`, and on another log by `what_is_found_closes_the_loop` in src/diagnose/trajectory.
#[test]
fn a_log_names_its_cause() {
    let directory = tempfile::tempdir().unwrap();
    let out = directory.path().join("out");
    let output = diagnose(&data("walk.csv"), &data("walk.toml"), &out);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(out.join("report.html").is_file() && out.join("sand.toml").is_file());
    let report: Value = serde_json::from_slice(&std::fs::read(out.join("report.json")).unwrap()).unwrap();
    assert_eq!(report["verdict"], "named", "{}", report["summary"]);
    let [cause] = &report["causes"].as_array().unwrap()[..] else { panic!("{}", report["summary"]) };
    let value = cause["value"].as_f64().unwrap();
    assert!(cause["id"] == "inertial_drag" && (value / 4.0 - 1.0).abs() < 0.1, "{}", report["summary"]);
    let (again, next) = (directory.path().join("again.toml"), directory.path().join("next"));
    let found = |name: &str| format!("{:?}", out.join(name));
    let toml = std::fs::read_to_string(data("walk.toml")).unwrap().replace("\"poppy-loose\"", &found("sand.toml"));
    std::fs::write(&again, format!("hardware = {}\n{toml}", found("hardware.toml"))).unwrap();
    let given = Experiment::load(&again).unwrap().given;
    assert_eq!(given.mechanisms, SandDescription::load(&out.join("sand.toml")).unwrap().mechanisms);
    assert!((given.mechanisms.inertial_drag - value).abs() < 1e-6 * value);
    let hardware = HardwareDescription::load(&out.join("hardware.toml")).unwrap();
    assert!(!hardware.quantities.is_empty() && given.hardware == hardware);
    // A diagnosis that is given what was found finds nothing more.
    for log in long::first(0, [data("walk.csv")]) {
        let output = diagnose(&log, &again, &next);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let report: Value = serde_json::from_slice(&std::fs::read(next.join("report.json")).unwrap()).unwrap();
        let quiet = report["verdict"] == "noise_floor" || report["verdict"] == "recalibrated";
        assert!(quiet && report["causes"].as_array().is_some_and(Vec::is_empty), "{}", report["summary"]);
        assert_eq!(SandDescription::load(&next.join("sand.toml")).unwrap().mechanisms, given.mechanisms);
    }
}

/// The exit code is 2, one line on stderr names the file and the error, and no report is written.
#[test]
fn wrong_input_gives_one_line_and_no_report() {
    let directory = tempfile::tempdir().unwrap();
    let (log, experiment, out) =
        (directory.path().join("walk.log"), directory.path().join("walk.toml"), directory.path().join("out"));
    let (toml, bytes) =
        (std::fs::read_to_string(data("walk.toml")).unwrap(), |name| std::fs::read(data(name)).unwrap());
    let refused = |content: &[u8], text: &str, words: &[&str]| {
        std::fs::write(&log, content).unwrap();
        std::fs::write(&experiment, text).unwrap();
        let output = diagnose(&log, &experiment, &out);
        let line = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{words:?}: {line}");
        assert!(output.stdout.is_empty() && line.ends_with('\n') && line.lines().count() == 1, "{line:?}");
        assert!(words.iter().all(|word| line.contains(word)), "{line:?} lacks one of {words:?}");
        assert!(!out.exists(), "{words:?}: something was written");
    };
    let with = |more: &str| format!("{toml}{more}");
    let [csv, parquet, mcap] = ["walk.csv", "walk.parquet", "walk.mcap"].map(bytes);
    // Other formats, which Python reads.
    for (bytes, format) in [(&parquet, "Parquet"), (&mcap, "MCAP"), (&b"#ROSBAG V2.0\n".to_vec(), "a ROS 1 bag")] {
        let how = "python -m sandgait.logs walk.log --out walk.log.csv";
        refused(bytes, &toml, &["walk.log", &format!("is {format}, not CSV"), how, "sandgait[logs]"]);
    }
    refused(b"SQLite format 3\0", &toml, &["an SQLite database", "sandgait.logs"]);
    // Runs that the experiment file lists, in a log that has them in a column or has none of them.
    refused(&csv, &with("[[run]]\nfrom = 1.0\n"), &["walk.log", "row 102, column run", "[[run]] too"]);
    let plain = String::from_utf8(csv.clone()).unwrap().replacen("run,", "other,", 1).into_bytes();
    refused(&plain, &with("[[run]]\nfrom = 100.0\n"), &["walk.log", "no row belongs to a run"]);
    refused(&csv, &with("[columns]\n\"q:*\" = \"angle.*\"\n"), &["walk.log", "angle.right-front", "missing"]);
    // Files that are cut off or empty.
    refused(&csv[..1000], &toml, &["walk.log", "row"]);
    refused(b"", &toml, &["walk.log", "row 1"]);
    // Errors in the experiment file.
    refused(&csv, &with("[columns]\nt = \"time\"\n"), &["walk.log", "time", "missing"]);
    refused(&csv, &with("[units]\nacc_x = \"stone\"\n"), &["walk.log", "acc_x", "stone"]);
    refused(&csv, &with("[[run]]\nfrom = 2.0\nto = 1.0\n"), &["run 1", "from = 2 is not before to = 1"]);
    refused(&csv, &with("[[run]]\nmood = 1\n"), &["walk.toml", "mood"]);
    refused(&csv, &toml.replace("xplorer", "tank"), &["tank"]);
    refused(&csv, &toml.replace("trajectory", "walking"), &["imu", "trajectory"]);
    // Files that the experiment file names.
    refused(&csv, &format!("hardware = \"none.toml\"\n{toml}"), &["none.toml", "No such file"]);
    refused(&csv, &toml.replace("poppy-loose", "none.toml"), &["none.toml", "No such file"]);
    let own = directory.path().join("own.toml");
    let named = |key: &str| format!("{key} = {own:?}\n");
    std::fs::write(&own, "delay = 1.0\n").unwrap();
    refused(&csv, &(named("hardware") + &toml), &["walk.toml", "delay", "value and interval"]);
    refused(&csv, &toml.replace("medium = \"poppy-loose\"\n", &named("medium")), &["walk.toml", "sand"]);
    let walking = "kind = \"walking\"\nmedium = \"poppy-loose\"\n";
    refused(&csv, &(named("hardware") + walking), &["hardware", "trajectory"]);
    std::fs::copy(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/real_wheel/sand_smooth.toml"), &own).unwrap();
    refused(&csv, &toml.replace("medium = \"poppy-loose\"\n", &named("medium")), &["walk.toml", "li2013"]);
    // Wrong units.
    refused(&csv, &with("[units]\nacc_x = \"g\"\nacc_y = \"g\"\nacc_z = \"g\"\n"), &["walk.log", "acc"]);
    // Motions a thousand times as fast, which no robot follows.
    refused(
        &csv,
        &with("[units]\nt = \"ms\"\n"),
        &["the simulation of run 1_0 diverges: check that the log is of this robot"],
    );
}
