//! Data that are refused, and data in other units.

use crate::{experiment, file, testbed};
use sandgait::diagnose::diagnose;
use sandgait::diagnose::experiment::{Experiment, MOST_ROWS};
use sandgait::diagnose::force_log;
use sandgait::progress::Silent;
use std::path::Path;
use testbed::Hidden;

#[test]
fn bad_data_are_refused_with_file_row_and_column() {
    let log = testbed::log(11, &Hidden::default(), 0.05).noisy;
    let directory = tempfile::tempdir().unwrap();
    let says = |text: &str, experiment: &str| {
        let experiment = Experiment::from_toml(experiment);
        let outcome = experiment.and_then(|e| diagnose(&file(directory.path(), text), &e, &Silent));
        outcome.err().map(|e| e.to_string()).unwrap_or_default()
    };
    let row = |from: &str, to: &str| log.replacen(from, to, 1);
    let header = log.lines().next().unwrap();
    for (text, expected) in [
        (row(",Fz", ""), vec!["data.csv", "row 1", "Fz"]),
        (row("poppy-loose", "mud"), vec!["data.csv", "row 2", "medium", "mud"]),
        (row(",L,", ",X,"), vec!["data.csv", "row 2", "shape", "\"X\""]),
        (row("0_0,0,0,leg", "0_0,0,0,wheel"), vec!["row 2", "kind", "wheel"]),
        (header.to_string(), vec!["row 2", "no rows"]),
        (
            log.lines()
                .take(2)
                .map(|l| {
                    l.rsplit_once(',').unwrap().0.to_string() + if l.starts_with("trial") { ",Ty" } else { ",inf" }
                })
                .collect::<Vec<_>>()
                .join("\n"),
            vec!["row 2", "Ty", "finite"],
        ),
        (format!("{header}\n1,2"), vec!["row 2", "2 cells"]),
        (String::new(), vec!["row 1"]),
    ] {
        let message = says(&text, testbed::EXPERIMENT);
        assert!(
            expected.iter().all(|e| message.contains(e)) && message.lines().count() == 1,
            "{expected:?}: {message}"
        );
    }
    let unit = says(&log, &format!("{}[units]\nFx = \"stone\"\n", testbed::EXPERIMENT));
    assert!(unit.contains("Fx") && unit.contains("stone"), "{unit}");
    let shapeless = testbed::EXPERIMENT.split("[shape").next().unwrap();
    let shape = says(&log, shapeless);
    assert!(
        shape.ends_with(
            "column shape: shape \"L\" is unknown; the experiment describes no shape; give a table [shape.NAME]"
        ),
        "{shape}"
    );
}

/// A file of a gigabyte is refused before it is read, and a log with too many samples while it is read. Both give one
/// line that says what to do.
#[test]
fn logs_beyond_the_limits_are_refused() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("huge.csv");
    std::fs::File::create(&path).unwrap().set_len(1 << 30).unwrap();
    let says = |path: &Path| diagnose(path, &experiment(), &Silent).err().unwrap().to_string();
    let message = says(&path);
    assert!(
        message.contains("huge.csv: 1024 MiB is more than the 256 MiB") && message.lines().count() == 1,
        "{message}"
    );
    let mut text = testbed::log(11, &Hidden::default(), 0.05).noisy.lines().next().unwrap().to_string();
    for k in 0..=MOST_ROWS {
        text.push_str(&format!("\na,0,0,leg,L,poppy-loose,0.02,,,1,0,0,{k},0,1,,,,,0,0,0"));
    }
    let message = says(&file(directory.path(), &text));
    let said = format!("more than {} rows: keep every n-th sample", MOST_ROWS);
    assert!(message.contains(&said) && message.lines().count() == 1, "{message}");
}

/// The same log in other units and under other column names gives the same numbers.
#[test]
fn units_and_column_names_are_converted() {
    let log = testbed::log(11, &Hidden::default(), 0.05).noisy;
    let directory = tempfile::tempdir().unwrap();
    let read = |text: &str, experiment: &str| {
        let experiment = Experiment::from_toml(experiment).unwrap();
        force_log::read(&file(directory.path(), text), &experiment, &Silent).unwrap().observations.values
    };
    let plain = read(&log, testbed::EXPERIMENT);
    let renamed = log.replacen(",Fz,", ",lift,", 1);
    let extra = format!("{}[columns]\nFz = \"lift\"\n[units]\nlift = \"mN\"\n", testbed::EXPERIMENT);
    let scaled = read(&renamed, &extra);
    // 40 samples of Fx, then 40 of Fz
    assert_eq!(plain[0], scaled[0]);
    assert!((plain[45] - 1000.0 * scaled[45]).abs() < 1e-9);
}
