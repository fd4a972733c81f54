//! Puts extreme cells into every column of every table for diagnosis and calibration. Each gives a result or one clear
//! line, and never a panic.

#[path = "testbed/walking.rs"]
#[allow(dead_code)] // only its tables are used here
mod hall;
#[path = "testbed/long.rs"]
mod long;
#[allow(dead_code)] // only its tables are used here
mod testbed;

use sandgait::diagnose::diagnose;
use sandgait::diagnose::experiment::Experiment;
use sandgait::diagnose::force_log;
use sandgait::diagnose::walking_log;
use sandgait::progress::Silent;
use std::path::Path;
use std::process::Command;
use testbed::{Hidden, normal};

/// Contents that replace one cell or a whole column.
fn cells() -> Vec<String> {
    let short = ["1e200", "-1e200", "1e308", "1e-320", "-0.0", "999999", "-999999", "1e17", "nan", "inf", "-inf", ""];
    let long = ["x".repeat(100_000), "9".repeat(400), format!("1e-{}", "9".repeat(300))];
    short.map(String::from).into_iter().chain(long).collect()
}

/// `table` with the cells of one column replaced in `rows` (0 is the first below the header).
fn replaced(table: &str, column: usize, rows: impl Fn(usize) -> bool, by: &str) -> String {
    let line = |(i, line): (usize, &str)| {
        let mut cells: Vec<&str> = line.split(',').collect();
        if i > 0 && rows(i - 1) {
            cells[column] = by;
        }
        cells.join(",")
    };
    table.lines().enumerate().map(line).collect::<Vec<_>>().join("\n")
}

/// `table` with one column twice; the second one has a unit if `unit` is true.
fn doubled(table: &str, column: usize, unit: &str) -> String {
    let line = |(i, line): (usize, &str)| {
        let cell = line.split(',').nth(column).unwrap();
        format!("{line},{cell}{}", if i == 0 { unit } else { "" })
    };
    table.lines().enumerate().map(line).collect::<Vec<_>>().join("\n")
}

/// Each kind of damage to each column, with a description.
fn damages(table: &str) -> Vec<(String, String)> {
    let columns: Vec<&str> = table.lines().next().unwrap().split(',').collect();
    let rows = table.lines().count() - 1;
    let mut all = Vec::new();
    for (c, name) in columns.iter().enumerate() {
        for cell in cells() {
            let said = &cell[..cell.len().min(10)];
            all.push((format!("{name} = {said} once"), replaced(table, c, |row| row == rows / 2, &cell)));
            all.push((format!("{name} = {said} throughout"), replaced(table, c, |_| true, &cell)));
        }
        all.push((format!("{name} twice"), doubled(table, c, "")));
    }
    all
}

fn one_line(what: &str, message: &str) {
    assert!(!message.is_empty() && message.trim_end().lines().count() == 1, "{what}: {message:?}");
    assert!(message.len() < 2000, "{what}: a line of {} bytes", message.len());
    if what.ends_with("twice") {
        assert!(message.contains("twice") && message.contains("row 1"), "{what}: {message}");
    }
}

#[test]
fn force_logs() {
    let log = testbed::log(3, &Hidden::default(), 0.05).noisy;
    let kept = |(i, line): &(usize, &str)| {
        let trial = line.split(',').next().unwrap();
        *i == 0 || (i % 8 == 1 && ["0_0", "0_1", "9_0", "9_1"].contains(&trial))
    };
    let small = log.lines().enumerate().filter(kept).map(|l| l.1).collect::<Vec<_>>().join("\n");
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("data.csv");
    let experiment = Experiment::from_toml(testbed::EXPERIMENT).unwrap();
    let (mut taken, mut diagnosed, mut refused) = (Vec::new(), 0, 0);
    for (what, text) in damages(&small) {
        std::fs::write(&path, &text).unwrap();
        match force_log::read(&path, &experiment, &Silent) {
            Ok(_) => {
                assert!(!what.ends_with("twice"), "{what}: taken");
                taken.push((what, text));
            }
            Err(error) => {
                one_line(&what, &error.to_string());
                refused += 1;
            }
        }
    }
    assert!(taken.len() > 50 && refused > 100, "{} taken, {refused} refused", taken.len());
    for (what, text) in long::every(5, &taken) {
        std::fs::write(&path, text).unwrap();
        match diagnose(&path, &experiment, &Silent) {
            Ok(d) => {
                assert!(d.report.causes.iter().all(|c| c.value.is_finite()), "{what}");
                diagnosed += 1;
            }
            Err(error) => one_line(what, &error.to_string()),
        }
    }
    assert!(diagnosed > taken.len() / 10, "{diagnosed} diagnosed of {}", taken.len());
}

#[test]
fn walking_runs() {
    let header = "run,condition,rep,robot,leg,xi_deg,stride_frequency,slope_deg,payload,x_bed,duration,speed,base_height,\
                  pitch_rms,hip_torque_rms,hip_speed_error_rms";
    let row = |c: usize, r: usize| format!("{c}_{r},{c},{r},xplorer,L,45,4,0,0,0,1,0.{c}8{r},0.02,0.04,0.01,0.{r}1");
    let rows: Vec<String> = (0..2).flat_map(|c| (0..2).map(move |r| row(c, r))).collect();
    let table = format!("{header}\n{}", rows.join("\n"));
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("runs.csv");
    let experiment = Experiment::from_toml(hall::EXPERIMENT).unwrap();
    let (mut taken, mut refused) = (Vec::new(), 0);
    for (what, text) in damages(&table) {
        std::fs::write(&path, &text).unwrap();
        match walking_log::read(&path, &experiment, &Silent) {
            Ok(_) => taken.push((what, text)),
            Err(error) => {
                one_line(&what, &error.to_string());
                refused += 1;
            }
        }
    }
    assert!(taken.len() > 30 && refused > 100, "{} taken, {refused} refused", taken.len());
    // Simulations are slow, so only the most extreme numbers that are accepted are simulated, in one column each.
    let wild = |what: &str| what.ends_with("999999 once") && !what.starts_with("run");
    let simulated = taken.iter().filter(|t| wild(&t.0) && (t.0.starts_with("speed") || t.0.starts_with("hip_t")));
    for (what, text) in long::every(2, simulated) {
        std::fs::write(&path, text).unwrap();
        match diagnose(&path, &experiment, &Silent) {
            Ok(d) => assert!(d.report.causes.iter().all(|c| c.value.is_finite()), "{what}"),
            Err(error) => one_line(what, &error.to_string()),
        }
    }
}

/// Checks that the command ends with exit code 0 and a result, or with 2 and one line. Returns which.
fn calibrated(what: &str, path: &Path) -> bool {
    let output = Command::new(env!("CARGO_BIN_EXE_sandgait")).arg("calibrate").arg(path).output().unwrap();
    let line = String::from_utf8_lossy(&output.stderr).into_owned();
    match output.status.code() {
        Some(0) => assert!(String::from_utf8_lossy(&output.stdout).starts_with('ζ'), "{what}"),
        Some(2) => one_line(what, &line),
        other => panic!("{what}: exit {other:?}: {line}"),
    }
    output.status.success()
}

#[test]
fn penetration_tests() {
    let mut rng = rand::SeedableRng::seed_from_u64(4);
    let rows = (1..=60).map(|i| {
        let depth = 1e-3 * f64::from(i);
        format!("{},{depth},{}", 0.1 * f64::from(i), 241.3 * depth + 0.05 * normal(&mut rng))
    });
    let table = format!("time,depth,force\n{}", rows.collect::<Vec<_>>().join("\n"));
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("push.csv");
    let run = |what: &str, text: &str| {
        std::fs::write(&path, text).unwrap();
        calibrated(what, &path)
    };
    assert!(run("whole", &table));
    let (mut taken, mut refused) = (0, 0);
    for (what, text) in damages(&table) {
        let success = run(&what, &text);
        assert!(!(success && what.ends_with("twice")), "{what}: taken");
        *(if success { &mut taken } else { &mut refused }) += 1;
    }
    assert!(!run("force with a unit twice", &doubled(&table, 2, " [N]")), "which of the two is meant?");
    assert!(taken > 10 && refused > 20, "{taken} taken, {refused} refused");
}
