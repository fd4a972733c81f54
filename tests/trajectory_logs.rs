//! Runs `sandgait diagnose` on a robot's own log, as CSV, Parquet and MCAP.

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

/// The log was simulated with an `inertial_drag` of 4 (tests/data/trajectory/README.md).
#[test]
fn three_formats_of_a_log_give_the_same_verdict() {
    let directory = tempfile::tempdir().unwrap();
    let reports =
        [("csv", "walk.toml"), ("parquet", "walk.toml"), ("mcap", "walk_mcap.toml")].map(|(format, experiment)| {
            let out = directory.path().join(format);
            let output = diagnose(&data(&format!("walk.{format}")), &data(experiment), &out);
            assert!(output.status.success(), "{format}: {}", String::from_utf8_lossy(&output.stderr));
            assert!(out.join("report.html").is_file() && out.join("sand.toml").is_file());
            serde_json::from_slice::<Value>(&std::fs::read(out.join("report.json")).unwrap()).unwrap()
        });
    let [csv, parquet, mcap] = &reports;
    assert_eq!(csv["verdict"], "named", "{}", csv["summary"]);
    let [cause] = &csv["causes"].as_array().unwrap()[..] else { panic!("{}", csv["summary"]) };
    let of = |report: &Value| report["causes"][0]["value"].as_f64().unwrap();
    assert!(cause["id"] == "inertial_drag" && (of(csv) / 4.0 - 1.0).abs() < 0.1, "{}", csv["summary"]);
    // CSV and Parquet have the same numbers, bit by bit.
    for key in ["verdict", "causes", "ambiguity_set", "candidates", "gain", "nuisances", "untestable", "summary"] {
        assert_eq!(csv[key], parquet[key], "{key}");
    }
    // In MCAP, times since the start of a run differ in the last bit.
    assert_eq!((&mcap["verdict"], &mcap["causes"][0]["id"]), (&csv["verdict"], &cause["id"]), "{}", mcap["summary"]);
    assert!((of(mcap) / of(csv) - 1.0).abs() < 1e-3, "{} {}", of(mcap), of(csv));
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
    // Keys that only MCAP files take, and topics, runs and joints that the MCAP file does not have.
    refused(&csv, &with("[topics]\nimu = \"/imu\"\n"), &["topics", "only MCAP files"]);
    refused(&parquet, &with("[[run]]\nfrom = 1.0\n"), &["run", "only MCAP files"]);
    refused(&mcap, &with("[topics]\nimu = \"/other\"\n"), &["walk.log", "no topic of sensor_msgs/msg/Imu"]);
    refused(&mcap, &toml, &["walk.log", "run 1", "split it into two runs"]);
    refused(&mcap, &with("[[run]]\nfrom = 100.0\n"), &["walk.log", "no rows"]);
    refused(&mcap, &with("[columns]\n\"q:left-rear\" = \"q:LR\"\n"), &["walk.log", "q:LR", "missing"]);
    // Files that are cut off, of another format, or empty.
    refused(&csv[..1000], &toml, &["walk.log", "row"]);
    refused(&parquet[..parquet.len() / 2], &toml, &["walk.log", "Parquet: the file does not end"]);
    refused(&mcap[..mcap.len() / 2], &toml, &["walk.log", "MCAP"]);
    refused(b"SQLite format 3\0", &toml, &["walk.log", "neither CSV, Parquet nor MCAP"]);
    refused(b"", &toml, &["walk.log", "row 1"]);
    // Errors in the experiment file.
    refused(&csv, &with("[columns]\nt = \"time\"\n"), &["walk.log", "time", "missing"]);
    refused(&csv, &with("[units]\nacc_x = \"stone\"\n"), &["walk.log", "acc_x", "stone"]);
    refused(&csv, &with("[[run]]\nfrom = 2.0\nto = 1.0\n"), &["run 1", "from = 2 is not before to = 1"]);
    refused(&csv, &with("[[run]]\nmood = 1\n"), &["walk.toml", "mood"]);
    refused(&csv, &toml.replace("xplorer", "tank"), &["tank"]);
    refused(&csv, &toml.replace("trajectory", "walking"), &["imu", "trajectory"]);
    // Wrong units.
    refused(&csv, &with("[units]\nacc_x = \"g\"\nacc_y = \"g\"\nacc_z = \"g\"\n"), &["walk.log", "acc"]);
    refused(&csv, &with("[units]\nt = \"ms\"\n"), &["run 3_0 diverges"]);
}
