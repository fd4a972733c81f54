//! Faults that people's data have are found, and good data are not refused.

use super::finding::{Finding, Severity};
use crate::diagnose;
use crate::experiment::Experiment;
use crate::force_log::{ForceLogFile, read_rows};
use crate::force_model::ForceLogModel;
use crate::intruder_log;
use crate::intruder_model::IntruderModel;
use crate::progress::{Latch, Silent};
use crate::trajectory;
use std::path::{Path, PathBuf};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// A table of texts.
#[derive(Clone)]
struct Cells {
    header: Vec<String>,
    rows: Vec<Vec<String>>,
}

impl Cells {
    fn read(path: &str) -> Self {
        let text = std::fs::read_to_string(root().join(path)).unwrap();
        let mut lines =
            text.lines().filter(|l| !l.starts_with('#')).map(|l| l.split(',').map(str::to_owned).collect::<Vec<_>>());
        Self { header: lines.next().unwrap(), rows: lines.collect() }
    }

    fn place(&self, column: &str) -> usize {
        self.header.iter().position(|h| h == column).unwrap_or_else(|| panic!("{column}"))
    }

    /// This table with the numbers of some columns changed; `change` gets the row's index and the number.
    fn with(&self, columns: &[&str], change: impl Fn(usize, f64) -> f64) -> Self {
        let mut changed = self.clone();
        for place in columns.iter().map(|c| self.place(c)) {
            for (i, row) in changed.rows.iter_mut().enumerate() {
                if let Ok(value) = row[place].parse::<f64>() {
                    row[place] = change(i, value).to_string();
                }
            }
        }
        changed
    }

    fn number(&self, row: usize, column: &str) -> f64 {
        self.rows[row][self.place(column)].parse().unwrap()
    }

    fn text(&self) -> String {
        let lines = std::iter::once(&self.header).chain(&self.rows).map(|row| row.join(","));
        lines.collect::<Vec<_>>().join("\n")
    }
}

fn file(text: &str) -> tempfile::NamedTempFile {
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), text).unwrap();
    file
}

/// What the check of a force log finds, or the error.
fn found(text: &str, experiment: &Experiment) -> Result<Vec<Finding>, String> {
    let file = file(text);
    let ForceLogFile { log, trials, broken } =
        read_rows(file.path(), experiment, &Silent).map_err(|e| e.to_string())?;
    let model = ForceLogModel::new(&log, experiment).unwrap();
    super::force_log::check(file.path(), &trials, &log, &model, broken).map_err(|e| e.to_string())
}

fn experiment(path: &str) -> Experiment {
    Experiment::load(&root().join(path)).unwrap()
}

fn legs() -> (Cells, Experiment) {
    (Cells::read("examples/data/force_log.csv"), experiment("examples/data/force_log.toml"))
}

fn plates() -> (Cells, Experiment) {
    (Cells::read("tests/data/grains/plates.csv"), experiment("tests/data/grains/experiment.toml"))
}

#[track_caller]
fn refused(table: &Cells, experiment: &Experiment, words: &str) {
    let error = found(&table.text(), experiment).expect_err(words);
    assert!(error.contains(words) && !error.contains('\n'), "{error:?} lacks {words:?}");
}

#[track_caller]
fn warned(table: &Cells, experiment: &Experiment, words: &str) {
    let all: Vec<String> = found(&table.text(), experiment).unwrap().iter().map(Finding::line).collect();
    assert!(all.iter().any(|line| line.contains(words)), "{all:?} lacks {words:?}");
}

#[test]
fn good_force_logs_give_no_finding() {
    for (table, experiment) in [legs(), plates()] {
        assert_eq!(found(&table.text(), &experiment), Ok(Vec::new()));
    }
    let (table, experiment) =
        (Cells::read("tests/data/grains/legs.csv"), experiment("tests/data/grains/experiment.toml"));
    assert_eq!(found(&table.text(), &experiment), Ok(Vec::new()));
}

#[test]
fn units_of_legs_are_named() {
    let (log, experiment) = legs();
    let times = |columns: &[&str], factor: f64| log.with(columns, |_, v| factor * v);
    let degree = 1f64.to_degrees();
    let told = |columns: &[&str], factor: f64, words: &str| refused(&times(columns, factor), &experiment, words);
    told(&["omega"], degree, "omega = \"deg/s\"");
    told(&["omega"], 60.0 / std::f64::consts::TAU, "omega = \"rpm\"");
    told(&["omega"], -1.0, "has the opposite sign");
    told(&["theta"], degree, "theta = \"deg\"");
    told(&["theta", "omega"], degree, "theta = \"deg\"");
    told(&["t"], 1e3, "t = \"ms\"");
    told(&["t"], 1e6, "t = \"us\"");
    told(&["x", "z", "vx", "vz"], 1e3, "x = \"mm\"; state [units] z = \"mm\"");
    told(&["x", "z", "vx", "vz"], 100.0, "x = \"cm\"");
    told(&["z", "vz"], 1.0 / 0.0254, "z = \"in\"");
    told(&["vx"], 1e3, "vx = \"mm/s\"");
    told(&["hip_z"], 1e3, "hip_z = \"mm\"");
    told(&["z", "vz", "Fz"], -1.0, "z points up");
    told(&["x", "vx", "Fx"], -1.0, "multiply x, vx and Fx");
    for (factor, unit) in [(1e3, "mN"), (1e-3, "kN"), (1.0 / 9.80665e-3, "gf")] {
        told(&["Fx", "Fz", "Ty"], factor, &format!("Fz = \"{unit}\""));
    }
    told(&["Fz"], 1e3, "column Fz");
    told(&["Ty"], 1e3, "Ty = \"mN·m\"");
    told(&["Ty"], 1e2, "Ty = \"N·cm\"");
    told(&["Ty"], -1.0, "Ty = x·Fz − z·Fx");
    told(&["Fx", "Fz", "Ty"], -1.0, "the forces on the intruder are needed");
    told(&["Fx"], -1.0, "multiply Fx by -1");
    told(&["Fx", "Fz"], 0.0, "are 0 in all rows");
    warned(&times(&["Fx", "Fz", "Ty"], 1.0 / 4.4482216152605), &experiment, "Fz = \"lbf\"");
    warned(&times(&["Fx", "Fz", "Ty"], 1.0 / 9.80665), &experiment, "Fz = \"kgf\"");
    // Without positions only the angle is left.
    let blind = |columns: &[&str], factor: f64| {
        let mut table = times(columns, factor);
        let gone = ["x", "z", "vx", "vz"].map(|c| table.place(c));
        let keep = |row: &Vec<String>| {
            row.iter().enumerate().filter(|(k, _)| !gone.contains(k)).map(|(_, c)| c.clone()).collect::<Vec<_>>()
        };
        let header = table.header.clone();
        table.header = keep(&header);
        table.rows = table.rows.iter().map(keep).collect();
        table
    };
    assert_eq!(found(&blind(&[], 1.0).text(), &experiment), Ok(Vec::new()));
    refused(&blind(&["hip_z"], 1e3), &experiment, "hip_z = \"mm\"");
    refused(&blind(&["omega"], degree), &experiment, "omega = \"deg/s\"");
}

#[test]
fn units_of_plates_are_named() {
    let (log, experiment) = plates();
    let told = |columns: &[&str], factor: f64, words: &str| {
        refused(&log.with(columns, |_, v| factor * v), &experiment, words);
    };
    told(&["plate_gamma"], 1f64.to_degrees(), "plate_gamma = \"deg\"");
    told(&["vx", "vz"], 1e3, "vx = \"mm/s\" or [units] t = \"ms\"");
    told(&["x", "z"], 1e3, "x = \"mm\"");
    told(&["x", "z"], 100.0, "x = \"cm\"");
    told(&["t"], 1e3, "t = \"ms\"");
    told(&["z", "vz", "Fz"], -1.0, "z points up");
    told(&["vz"], -1.0, "column vz: has the opposite sign");
    told(&["Fx", "Fz"], 1e3, "\"mN\"");
    warned(&log.with(&["plate_gamma"], |_, v| v + 0.6), &experiment, "the velocity counts");
}

/// A plate on an arc turns its direction from row to row. What counts is the angle of each row, not that of the first one.
#[test]
fn a_plate_on_an_arc_has_an_angle_in_each_row() {
    let (mut log, experiment) = plates();
    let trial = log.place("trial");
    let [x, z, vx, vz, gamma] = ["x", "z", "vx", "vz", "plate_gamma"].map(|name| log.place(name));
    let mut before: Option<(String, f64, [f64; 2])> = None;
    for i in 0..log.rows.len() {
        let (id, t) = (log.rows[i][trial].clone(), log.number(i, "t"));
        let (since, at) = match before.take().filter(|b| b.0 == id) {
            Some((_, last, at)) => (t - last, at),
            None => (0.0, [0.0, -0.02]),
        };
        let angle = 0.2 + 4.0 * t;
        let velocity = [0.02 * angle.cos(), -0.02 * angle.sin()];
        let at: [f64; 2] = std::array::from_fn(|k| at[k] + since * velocity[k]);
        for (place, value) in [(x, at[0]), (z, at[1]), (vx, velocity[0]), (vz, velocity[1]), (gamma, angle)] {
            log.rows[i][place] = value.to_string();
        }
        before = Some((id, t, at));
    }
    let first = |log: &Cells| found(&log.text(), &experiment).unwrap().iter().map(Finding::line).collect::<Vec<_>>();
    let of = |log: &Cells| first(log).into_iter().filter(|line| line.contains("plate_gamma")).count();
    assert_eq!(of(&log), 0, "{:?}", first(&log));
    assert_eq!(of(&log.with(&["plate_gamma"], |_, v| v + 0.6)), 1);
}

#[test]
fn broken_channels_are_warned_of() {
    let (log, experiment) = legs();
    let trial_of = |i: usize| log.rows[i][0].clone();
    warned(&log.with(&["Fz"], |_, v| v.min(1.5)), &experiment, "saturated");
    warned(&log.with(&["Fz"], |i, v| if i == 205 { v + 40.0 } else { v }), &experiment, "row 207, column Fz: differs");
    let still = log.number(3, "Fz");
    warned(
        &log.with(&["Fz"], |i, v| if trial_of(i) == trial_of(0) && i > 3 { still } else { v }),
        &experiment,
        "frozen",
    );
    // The force of the sample before: late by one sample in each trial.
    let late = |columns: &[&str]| {
        columns.iter().fold(log.clone(), |table, column| {
            table.with(
                &[column],
                |i, v| if i > 0 && trial_of(i) == trial_of(i - 1) { log.number(i - 1, column) } else { v },
            )
        })
    };
    warned(&late(&["Fx", "Fz", "Ty"]), &experiment, "column Fx, Fz: fits the motion best if it is");
    warned(&late(&["Fz"]), &experiment, "column Fz: fits the motion best if it is");
    let gap = log.with(&["t"], |i, v| if i > 10 && trial_of(i) == trial_of(0) { v + 50.0 } else { v });
    let told = found(&gap.text(), &experiment);
    assert!(format!("{told:?}").contains("without a sample") || told.is_err(), "{told:?}");
    let (log, experiment) =
        (Cells::read("tests/data/grains/legs.csv"), self::experiment("tests/data/grains/experiment.toml"));
    warned(&log.with(&["Fz"], |_, v| v - 3.0), &experiment, "before the intruder reaches the sand");
}

#[test]
fn other_dialects_and_clocks_give_the_same_log() {
    let (log, experiment) = legs();
    let values = |text: &str| {
        let file = file(text);
        let log = read_rows(file.path(), &experiment, &Silent).unwrap().log;
        (log.observations.values, log.settings.iter().flat_map(|t| t.poses.iter().map(|p| p.t)).collect::<Vec<_>>())
    };
    let plain = values(&log.text());
    assert_eq!(values(&log.text().replace(',', ";").replace('.', ",")), plain);
    let epoch = values(&log.with(&["t"], |_, v| v + 1_764_000_000.0).text());
    assert_eq!(epoch.0, plain.0);
    assert!(epoch.1.iter().zip(&plain.1).all(|(a, b)| (a - b).abs() < 1e-6));
}

/// The design depends on the motions, and not on the forces.
#[test]
fn the_design_is_known_before_the_forces() {
    let (log, experiment) = legs();
    let design =
        |table: &Cells| diagnose(file(&table.text()).path(), &experiment, &Silent).unwrap().report.check.design;
    let mut single = log.clone();
    let (condition, rep) = (log.place("condition"), log.place("rep"));
    single.rows.retain(|row| row[rep] == "0");
    let own = design(&single);
    assert_eq!((own.conditions, own.repetitions, own.trials), (16, 1, 16));
    assert_eq!(design(&single.with(&["Fx", "Fz", "Ty"], |i, v| v * (1.0 + 0.1 * (i as f64).sin()))), own);
    let sigma = |d: &super::design::ExperimentDesign, a: &str, b: &str| {
        d.separable.iter().find(|(x, y, _)| (x == a && y == b) || (x == b && y == a)).map_or(0.0, |p| p.2)
    };
    // Slow motions cannot show what grows with the square of the speed.
    let mut slow = single.clone();
    slow.rows.retain(|row| row[log.place("omega")].parse::<f64>().unwrap().abs() < 1.0);
    let slow = design(&slow);
    assert!(sigma(&own, "inertial_drag", "plain") > 8.0, "{own:?}");
    assert!(slow.cannot_separate.contains(&("inertial_drag".into(), "plain".into())), "{slow:?}");
    // A stronger sand looks like the gain of the sensor, as far as the forces of one shape tell.
    assert!(sigma(&own, "concave_fill", "cohesion") > 4.0);
    let seen = |d: &super::design::ExperimentDesign| d.separable.len();
    assert!(seen(&slow) < seen(&own) && !single.rows[0][condition].is_empty());
}

#[test]
fn bodies_in_other_units_are_refused() {
    let (log, experiment) =
        (Cells::read("tests/data/real_wheel/intruder.csv"), experiment("tests/data/real_wheel/intruder.toml"));
    let check = |table: &Cells| {
        let file = file(&table.text());
        let log = intruder_log::read(file.path(), &experiment, &Silent).unwrap();
        let latch = Latch::new(&Silent);
        let model = IntruderModel::new(&log, &experiment, &latch).unwrap();
        crate::means_checked(file.path(), &log.observations, &model).map_err(|e| e.to_string())
    };
    assert_eq!(check(&log), Ok(Vec::new()));
    let told = |columns: &[&str], factor: f64, words: &str| {
        let error = check(&log.with(columns, |_, v| factor * v)).expect_err(words);
        assert!(error.contains(words) && !error.contains('\n'), "{error}");
    };
    told(&["depth"], 1e3, "depth = \"mm\"");
    told(&["depth"], -1.0, "depth is positive below the surface");
    told(&["Fx", "Fy"], 1e3, "Fx = \"mN\"");
}

#[test]
fn faults_of_robots_logs_are_named() {
    let log = Cells::read("tests/data/trajectory/walk.csv");
    let experiment = experiment("tests/data/trajectory/walk.toml");
    let check = |table: &Cells| {
        let file = file(&table.text());
        trajectory::read(file.path(), &experiment, &Silent).map(|read| read.2).map_err(|e| e.to_string())
    };
    let good = check(&log).unwrap();
    assert!(good.is_empty(), "{good:?}");
    let told = |table: &Cells, words: &str| {
        let error = check(table).expect_err(words);
        assert!(error.contains(words) && !error.contains('\n'), "{error:?} lacks {words:?}");
    };
    let quat = ["quat_w", "quat_x", "quat_y", "quat_z"].map(|c| log.place(c));
    let mut shifted = log.clone();
    for row in &mut shifted.rows {
        let own = quat.map(|k| row[k].clone());
        quat.iter().zip([1, 2, 3, 0]).for_each(|(&k, from)| row[k].clone_from(&own[from]));
    }
    told(&shifted, "x, y, z, w");
    let joint = log.header.iter().find(|h| h.starts_with("q:")).unwrap().clone();
    told(&log.with(&[&joint], |i, v| if (50..90).contains(&i) { v - 3.7 } else { v }), "says");
    told(&log.with(&[&joint], |i, v| if i >= 60 { v - 3.7 } else { v }), "its encoder was reset or lost counts");
    told(&log.with(&[&joint], |i, v| if i >= 60 { v + 8.0 * std::f64::consts::PI } else { v }), "add full turns");
    let warned = |table: &Cells, words: &str| {
        let all: Vec<String> = check(table).unwrap().iter().map(Finding::line).collect();
        assert!(all.iter().any(|line| line.contains(words)), "{all:?} lacks {words:?}");
    };
    let still = log.number(20, "gyro_y");
    warned(&log.with(&["gyro_y"], |i, v| if (20..70).contains(&i) { still } else { v }), "column gyro_y: stays at");
    warned(&log.with(&["acc_x"], |_, v| v.clamp(-1.0, 1.0)), "column acc_x: stands at ");
    let epoch = log.with(&["t"], |_, v| v + 1_764_000_000.0);
    assert!(check(&epoch).unwrap().is_empty());
    assert!(found(&log.text(), &experiment).is_err_and(|e| e.contains("missing")));
    assert_eq!(Finding::new(Severity::Note, "t", "a", "b").at([3, 3]).line(), "row 3, column t: a; b");
}
