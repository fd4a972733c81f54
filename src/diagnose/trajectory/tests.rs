//! Diagnoses of logs that the module `generate` simulates in the rapier engine.

use super::generate::{EXPERIMENT, Truth, csv, experiment, file};
use super::log::Run;
use super::model::TrajectoryModel;
use super::replay::ReplayRobot;
use super::sensors::Mounting;
use super::windows::BINS;
use super::{consistency, measured, read};
use crate::error::Result;
use crate::experiment::Experiment;
use crate::forward::ForwardModel;
use crate::hardware::found;
use crate::progress::{Latch, Silent};
use crate::report::{Diagnosis, Report};
use crate::sand::mechanism::Mechanisms;
use crate::sim::hardware::{HardwareDescription, HardwareQuantity};
use crate::sim::model::Scene;
use crate::verdict::Verdict;
use crate::{diagnose, long, truth};
use rand::{Rng as _, SeedableRng as _};

fn diagnosed(text: &str) -> Result<Diagnosis> {
    let diagnosis = diagnose(file(text).path(), &experiment(), &Silent);
    diagnosis.inspect(|d| {
        let json = serde_json::from_str(&d.json().unwrap()).unwrap();
        assert_eq!(truth::contradictions(&json), Vec::<String>::new());
    })
}

fn read_text(text: &str) -> Result<Vec<Run>> {
    Ok(read(file(text).path(), &experiment(), &Silent)?.0)
}

/// The verdict names this cause alone, with its value to a tenth.
fn named(report: &Report, id: &str, value: f64) {
    assert_eq!(report.verdict, Verdict::Named, "{}", report.summary);
    let [cause] = &report.causes[..] else { panic!("{}", report.summary) };
    assert_eq!(cause.id, id, "{}", report.summary);
    assert!((cause.value / value - 1.0).abs() < 0.1, "{id} {} of {value}", cause.value);
}

/// No hidden cause in the sand, but a robot 3 % heavier than its description and an IMU that is late by most of what is stated of it: the delay
/// is the answer, and the sand is not.
#[test]
fn a_late_imu_is_not_the_sand() {
    let truth = Truth { mass: 1.03, delay: 0.008, ..Truth::new(Mechanisms::PLAIN, 1) };
    let Diagnosis { report, hardware, .. } = diagnosed(&csv(&truth)).unwrap();
    named_within(&report, "imu_delay", None, truth.delay);
    lag_found(&hardware, 1, [truth.delay, truth.low_pass]);
    let value = |id: &str, of: Option<&str>| {
        report.nuisances.iter().find(|n| n.id == id && n.of.as_deref() == of).unwrap().value
    };
    let delay = value("imu_delay", None);
    assert!((delay - truth.delay).abs() < 1.5e-3, "{delay}");
    for (axis, turn) in ["x", "y", "z"].into_iter().zip(truth.turn) {
        let found = value("imu_rotation", Some(axis));
        assert!((found - turn).abs() < 0.01, "{axis} {found} of {turn}");
    }
}

/// What a robot's description has wrong is named, not the sand: a mass, here of the base, and the zero of one joint.
#[test]
fn a_wrong_description_is_named() {
    let base = crate::sim::Robot::built_in("xplorer").unwrap().base.mass;
    let heavy = Truth { mass: 1.4, turn: [0.0; 3], delay: 0.0, ..Truth::new(Mechanisms::PLAIN, 12) };
    named_within(&diagnosed(&csv(&heavy)).unwrap().report, "payload", None, 0.4 * base);
    let exact = Truth { turn: [0.0; 3], delay: 0.0, ..Truth::new(Mechanisms::PLAIN, 13) };
    let turned = changed(&csv(&exact), &["q:right-front"], |q| q - 0.15);
    named_within(&diagnosed(&turned).unwrap().report, "joint_zero", Some("right-front"), 0.15);
}

/// Torques that are logged late are named.
#[test]
fn late_torques_are_named() {
    let text = csv(&Truth::new(Mechanisms::PLAIN, 14));
    let late = moved_down(&text, "tau:", 3);
    named_within(&diagnosed(&late).unwrap().report, "torque_delay", None, 0.015);
}

/// Exactly this effect is named, and its interval contains the value.
fn named_within(report: &Report, id: &str, of: Option<&str>, value: f64) {
    assert_eq!(report.verdict, Verdict::Named, "{}", report.summary);
    let [cause] = &report.causes[..] else { panic!("{}", report.summary) };
    assert_eq!((&*cause.id, cause.of.as_deref()), (id, of), "{}", report.summary);
    let [low, high] = cause.ci95;
    assert!((low..=high).contains(&value), "{value} is outside of {low} to {high}");
}

/// A log in which some columns have the values of so many rows before.
fn moved_down(text: &str, columns: &str, rows: usize) -> String {
    let lines: Vec<Vec<&str>> = text.lines().map(|line| line.split(',').collect()).collect();
    let of = |i: usize| {
        let from = if i <= rows || lines[i][0] != lines[i - rows][0] { i } else { i - rows };
        let cell = |k: usize| lines[if lines[0][k].starts_with(columns) { from } else { i }][k];
        (0..lines[0].len()).map(cell).collect::<Vec<_>>().join(",")
    };
    (0..lines.len()).map(of).collect::<Vec<_>>().join("\n") + "\n"
}

/// `what_is_found_closes_the_loop` has a log with drag, and `intervals_contain_the_truth` one with weak motors.
#[test]
fn causes_are_named() {
    let all = [
        (Mechanisms { slope: 0.07, ..Mechanisms::PLAIN }, 3, 0.004, "slope", 0.07),
        (Mechanisms { inertial_drag: 5.0, ..Mechanisms::PLAIN }, 2, 0.004, "inertial_drag", 5.0),
        (Mechanisms { motor_torque_limit: 0.01, ..Mechanisms::PLAIN }, 5, 0.002, "motor_torque_limit", 0.01),
    ];
    for (mechanisms, seed, delay, id, value) in long::first(1, all) {
        named(&diagnosed(&csv(&Truth { delay, ..Truth::new(mechanisms, seed) })).unwrap().report, id, value);
    }
}

/// A log does not contain the places in the bed where runs began, so a medium that looks stronger may be a bed whose strength varies.
#[test]
fn what_an_unknown_place_may_hide_is_not_named_alone() {
    let strong = Truth::new(Mechanisms { scale: 0.5, ..Mechanisms::PLAIN }, 4);
    let report = diagnosed(&csv(&strong)).unwrap().report;
    assert_eq!(report.ambiguity_set, [["scale"], ["packing_grad"]], "{}", report.summary);
    assert!((report.causes[0].value / 0.5 - 1.0).abs() < 0.1, "{}", report.summary);
    let why = "packing_grad cannot be tested: the log does not say at which position of the bed each run began";
    assert!(report.summary.contains(why), "{}", report.summary);
    for seed in long::first(0, [9]) {
        let graded = Truth::new(Mechanisms { packing_grad: 0.25, ..Mechanisms::PLAIN }, seed);
        let report = diagnosed(&csv(&graded)).unwrap().report;
        assert_eq!(report.verdict, Verdict::Ambiguous, "{}", report.summary);
        assert!(report.ambiguity_set.contains(&vec!["packing_grad".to_string()]), "{}", report.summary);
    }
}

/// If a drive computes with a wrong torque constant, the logged torque is the torque that its servo requests. If a torque sensor is wrong,
/// the logged torque differs from the request. `what_is_found_closes_the_loop` has another log of a wrong drive. An error of 4 % is not
/// certain: the simulated torques err by 1 %, and the mass and joint zeros are uncertain, too.
#[test]
fn a_wrong_drive_is_told_from_a_wrong_sensor() {
    let found = |text: &str| found(&diagnosed(text).unwrap().report);
    drive_found(&found(&changed(&csv(&Truth::new(Mechanisms::PLAIN, 10)), &["tau:"], |v| 1.1 * v)), 0.1, None);
    for seed in long::first(0, [10]) {
        let wrong = Truth { drive: 0.9, ..Truth::new(Mechanisms::PLAIN, seed) };
        drive_found(&found(&csv(&wrong)), 1.0 / 0.9 - 1.0, Some(0.9));
    }
}

/// The intervals contain the gain of the torque sensors and the drives' torque constant; a torque constant that is right is not reported.
fn drive_found(hardware: &HardwareDescription, gain: f64, constant: Option<f64>) {
    for (path, truth) in [("sensors.joint_torque.gain", Some(gain)), ("actuator.torque_constant", constant)] {
        let found = hardware.quantities.get(path);
        assert_eq!(found.is_some(), truth.is_some(), "{path}: {found:?}");
        if let (Some(HardwareQuantity { interval: [low, high], .. }), Some(truth)) = (found, truth) {
            assert!((low..=high).contains(&&truth), "{path}: {truth} is outside [{low}, {high}]");
        }
    }
}

/// Seeds of the logs: our choice, because each takes seconds.
const LOGS: [u64; 3] = [1, 0, 2];

/// Logs of walks whose IMU is late and rotated. Logs with an odd seed also have weak motors; the diagnosis names this cause, and its
/// value is right to a tenth. Nearly all intervals of the found quantities contain the true value; with so few logs two of ten may
/// miss it.
#[test]
fn intervals_contain_the_truth() {
    let (mut within, mut all, mut logs) = (0, 0, 0);
    for seed in long::first(1, LOGS) {
        logs += 1;
        let mut draw = rand_xoshiro::Xoshiro256PlusPlus::seed_from_u64(7000 + seed);
        let limit = if seed % 2 == 1 { draw.random_range(0.007..0.013) } else { 0.0 };
        let mechanisms = Mechanisms { motor_torque_limit: limit, ..Mechanisms::PLAIN };
        let turn = [0; 3].map(|_| draw.random_range(-0.05..0.05));
        let truth =
            Truth { turn, delay: f64::from(draw.random_range(0..13_u8)) * 1e-3, ..Truth::new(mechanisms, 7000 + seed) };
        let report = diagnosed(&csv(&truth)).unwrap().report;
        if limit > 0.0 {
            named(&report, "motor_torque_limit", limit);
        }
        let hardware = found(&report);
        assert_eq!(HardwareDescription::from_toml(&hardware.to_toml()).unwrap(), hardware);
        for (path, value) in [
            ("sensors.gyroscope.delay", truth.delay),
            ("sensors.imu_rotation.x", turn[0]),
            ("sensors.imu_rotation.y", turn[1]),
            ("sensors.imu_rotation.z", turn[2]),
            ("actuator.torque_limit", limit),
        ] {
            let Some(HardwareQuantity { interval: [low, high], .. }) = hardware.quantities.get(path) else {
                assert!(path != "actuator.torque_limit" || limit == 0.0, "{}", report.summary);
                continue;
            };
            println!("{seed} {path}: {value:.5} in [{low:.5}, {high:.5}]: {}", (low..=high).contains(&&value));
            all += 1;
            within += u32::from((low..=high).contains(&&value));
        }
    }
    println!("{within} of {all}");
    assert!(all >= 3 * logs && 10 * within >= 8 * all, "{within} of {all}");
}

/// If a log is diagnosed again with the sand and hardware that were found, the predictions are those of the first report, and nothing more is found.
#[test]
fn what_is_found_closes_the_loop() {
    // A robot whose mass and joint zeros are known, and a simulation whose torques are exact, show an error of 4 %.
    let known =
        EXPERIMENT.to_owned() + "[nuisances]\nmodel_scale = 0.0\n[uncertainty]\npayload = 0.0\njoint_zero = 0.0\n";
    let truth = Truth { drive: 0.96, ..Truth::new(Mechanisms { inertial_drag: 5.0, ..Mechanisms::PLAIN }, 11) };
    let text = csv(&truth);
    let first = diagnose(file(&text).path(), &Experiment::from_toml(&known).unwrap(), &Silent).unwrap();
    named(&first.report, "inertial_drag", 5.0);
    drive_found(&first.hardware, 1.0 / 0.96 - 1.0, Some(0.96));
    let hardware = first.hardware.to_toml();
    assert!(first.hardware.value("sensors.gyroscope.delay").is_some(), "{hardware}");
    let again = |hardware: &str| {
        let own =
            known.replace("\"poppy-loose\"\nbulk_density = 638.0", &format!("{:?}", first.sand.to_toml().unwrap()));
        Experiment::from_toml(&format!("hardware = {hardware:?}\n{own}")).unwrap()
    };
    let second = diagnose(file(&text).path(), &again(&hardware), &Silent).unwrap();
    assert_eq!(second.report.verdict, Verdict::NoiseFloor, "{}", second.report.summary);
    let told = first.curves.extended.unwrap();
    for (k, (a, b)) in told.iter().zip(&second.curves.plain).enumerate() {
        assert!((a - b).abs() <= 1e-12 * a.abs().max(1e-3), "number {k}: {a} and {b}");
    }
    // The second diagnosis keeps what it was given: the sand and the hardware of the first.
    assert_eq!(second.sand.mechanisms, first.sand.mechanisms);
    assert!(first.hardware.quantities.iter().all(|(path, q)| second.hardware.quantities[path] == *q));
    // Without the hardware the predictions differ.
    let latch = Latch::new(&Silent);
    let model = measured(file(&text).path(), &again("source = \"none\"\n"), &latch).unwrap().model;
    assert!(told.iter().zip(&model.plain()).any(|(a, b)| (a - b).abs() > 0.01));
}

/// The intervals contain delay and filter of the IMU, and a slow filter is distinguished from a delay.
#[test]
fn a_filter_is_told_from_a_delay() {
    let all = [(24, [0.004, 0.009]), (21, [0.0, 0.008]), (22, [0.0, 0.004]), (23, [0.006, 0.0])];
    for (seed, truth) in long::first(1, all) {
        let truth_of_log = Truth { delay: truth[0], low_pass: truth[1], ..Truth::new(Mechanisms::PLAIN, seed) };
        lag_found(&diagnosed(&csv(&truth_of_log)).unwrap().hardware, seed, truth);
    }
}

/// The intervals contain delay and filter of the IMU. A filter is found if its time constant is more than 6 ms.
fn lag_found(found: &HardwareDescription, seed: u64, truth: [f64; 2]) {
    let paths = ["sensors.gyroscope.delay", "sensors.gyroscope.low_pass"];
    println!("{seed}: {truth:?} {:?}", paths.map(|path| found.quantities.get(path).copied()));
    for (path, truth) in paths.into_iter().zip(truth) {
        let interval = found.quantities.get(path).map_or([0.0; 2], |q| q.interval);
        assert!((interval[0]..=interval[1]).contains(&truth) || interval == [0.0; 2], "{seed} {path}: {found:?}");
    }
    assert!(truth[1] < 0.006 || found.value(paths[1]).is_some(), "{seed}: {found:?}");
    assert!(paths.iter().any(|path| found.value(path).is_some()), "{seed}: nothing is found");
}

/// Every planned walk is predicted, and the predictions of different causes differ.
#[test]
fn planned_walks_distinguish_causes() {
    let runs = read_text(&csv(&Truth::new(Mechanisms::PLAIN, 7))).unwrap();
    let latch = Latch::new(&Silent);
    let (model, _) = TrajectoryModel::new(runs, &experiment(), &latch).unwrap();
    let menu = model.menu().unwrap();
    let descriptions = &menu.observations.conditions;
    // With leg L this walk is in the log, so it is not proposed.
    let planned = |leg: &str| descriptions.iter().any(|d| *d == format!("walk at 3 Hz up 5°, leg {leg}"));
    assert!(planned("revL") && !planned("L"), "{descriptions:?}");
    assert_eq!(descriptions.len(), menu.observations.units.len());
    let coefficients = model.medium().coefficients;
    let causes = [
        Mechanisms::PLAIN,
        Mechanisms { slope: 0.1, ..Mechanisms::PLAIN },
        Mechanisms { motor_torque_limit: 0.005, ..Mechanisms::PLAIN },
    ];
    let [plain, slope, weak] = causes.map(|m| menu.model.predict(&(m, coefficients)));
    for unit in &menu.observations.units {
        let span = menu.observations.span(unit);
        let apart = |a: &[f64]| a[span.clone()].iter().zip(&plain[span.clone()]).any(|(a, b)| (a - b).abs() > 1e-5);
        assert!(plain[span.clone()].iter().all(|p| p.is_finite()), "{}", unit.id);
        assert!(apart(&slope) && apart(&weak), "{}", unit.id);
    }
}

/// A log with some columns changed.
fn changed(text: &str, columns: &[&str], change: impl Fn(f64) -> f64) -> String {
    let mut lines = text.lines();
    let header: Vec<&str> = lines.next().unwrap().split(',').collect();
    let places: Vec<usize> = (0..header.len()).filter(|&k| columns.iter().any(|c| header[k].starts_with(c))).collect();
    let mut out = header.join(",") + "\n";
    for line in lines {
        let mut cells: Vec<String> = line.split(',').map(Into::into).collect();
        places.iter().for_each(|&k| cells[k] = change(cells[k].parse().unwrap()).to_string());
        out += &(cells.join(",") + "\n");
    }
    out
}

#[test]
fn wrong_units_and_signs_are_named() {
    let text = csv(&Truth::new(Mechanisms::PLAIN, 6));
    assert!(read_text(&text).is_ok());
    let told = |columns: &[&str], change: &dyn Fn(f64) -> f64, words: &str| {
        let error = diagnosed(&changed(&text, columns, change)).err().map(|e| e.to_string()).unwrap_or_default();
        assert!(error.contains(words) && !error.contains('\n'), "{columns:?}: {error:?} lacks {words:?}");
    };
    told(&["qd:"], &|v| v.to_degrees(), "\"qd:right-front\" = \"deg/s\"");
    told(&["qd:right-rear"], &|v| -v, "qd:right-rear has the opposite sign");
    told(&["q:"], &|v| v.to_degrees(), "\"q:right-front\" = \"deg\"");
    told(&["q:", "qd:"], &|v| v.to_degrees(), "turns 57.3 times as fast as stride_frequency");
    told(&["q:", "qd:"], &|v| -v, "turns against stride_frequency");
    told(&["acc_"], &|v| -v, "gravity's direction");
    told(&["acc_"], &|v| v / 9.81, "it is in g");
    told(&["acc_"], &|v| 1e3 * v, "mm/s²");
    told(&["tau:"], &|v| 1e3 * v, "mN·m");
    told(&["tau:"], &|v| -v, "torque is -");
    told(&["gyro_"], &|v| v.to_degrees(), "deg/s");
    told(&["gyro_"], &|v| -v, "gyro is -");
    told(&["t"], &|v| 1e3 * v, "is t in ms");
}

/// Quaternions in another order, and the inverse rotation.
#[test]
fn wrong_quaternions_are_named() {
    let mut runs = read_text(&csv(&Truth::new(Mechanisms::PLAIN, 7))).unwrap();
    runs.truncate(1);
    let run = &mut runs[0];
    run.acc = [vec![2.0; run.t.len()], vec![0.5; run.t.len()], vec![9.6; run.t.len()]];
    // The rotation that turns this specific force upward.
    let up = nalgebra::Vector3::new(2.0, 0.5, 9.6);
    let turn = nalgebra::UnitQuaternion::rotation_between(&up, &nalgebra::Vector3::z()).unwrap();
    let [x, y, z, w] = [turn.i, turn.j, turn.k, turn.w];
    let names: Vec<String> = ReplayRobot::load("xplorer", None).unwrap().joint_names();
    let mut told = |q: [f64; 4]| {
        runs[0].attitude = q.map(|v| vec![v; runs[0].t.len()]);
        let checked = consistency::check(std::path::Path::new("log"), &runs, &names, [1.0, 0.0, 0.0, 0.0]);
        checked.err().map(|e| e.to_string()).unwrap_or_default()
    };
    assert_eq!(told([w, x, y, z]), "");
    assert!(told([w, -x, -y, -z]).contains("inverse"));
    assert!(told([x, y, z, w]).contains("x, y, z, w"));
}

/// Reading a randomly changed file gives a log or an error of one line.
#[test]
fn mutated_logs_do_not_panic() {
    let whole = csv(&Truth::new(Mechanisms::PLAIN, 8));
    let small: String = whole.lines().take(40).flat_map(|l| [l, "\n"]).collect();
    assert!(read_text(&small).is_ok());
    let mut rng = rand_xoshiro::Xoshiro256PlusPlus::seed_from_u64(1);
    for _ in 0..1000 {
        let mut bytes = small.clone().into_bytes();
        for _ in 0..rng.random_range(1..8) {
            let at = rng.random_range(0..bytes.len());
            match rng.random_range(0..4) {
                0 => bytes[at] = rng.random(),
                1 => drop(bytes.remove(at)),
                2 => bytes.insert(at, b",\n-e9\""[rng.random_range(0..6)]),
                _ => bytes.truncate(at.max(1)),
            }
        }
        if let Err(error) = read(file(&bytes).path(), &experiment(), &Silent) {
            assert!(!error.to_string().contains('\n'), "{error}");
        }
    }
}

/// The readings of a replay are at the right time: compared with a replay in steps of a sixteenth, they are late by less than a
/// third of a time step.
#[test]
fn readings_are_not_late() {
    let runs = read_text(&csv(&Truth::new(Mechanisms::PLAIN, 7))).unwrap();
    let latch = Latch::new(&Silent);
    let (mut model, _) = TrajectoryModel::new(runs, &experiment(), &latch).unwrap();
    let plain = (Mechanisms::default(), model.medium().coefficients);
    let [coarse, fine] = [1.0, 16.0].map(|finer| model.tracks(&[(plain, Vec::new())], finer).swap_remove(0));
    let [coarse, here] = [&coarse, &fine].map(|tracks| model.read(tracks, Mounting::default()));
    let shift = 1e-3;
    model.windows.iter_mut().flat_map(|w| &mut w.strides).flatten().for_each(|t| *t += shift);
    let later = model.read(&fine, Mounting::default());
    for channel in 0..model.layout.joints + 6 {
        let own = (0..here.len()).filter(|k| k % model.span() / BINS == channel);
        let (product, square) = own.fold((0.0, 0.0), |(product, square), k| {
            let rate = (later[k] - here[k]) / shift;
            (product - (coarse[k] - here[k]) * rate, square + rate * rate)
        });
        let late = product / square;
        assert!(late.abs() < Scene::DEFAULT_DT / 3.0, "channel {channel} is late by {late} s");
    }
}
