//! The diagnosis of force logs: it finds hidden causes, refuses bad data, and never panics.

mod broken;
mod damage;
mod input;
#[path = "../testbed/long.rs"]
mod long;
mod other_laboratory;
mod recalibration;
mod sizes;
#[path = "../testbed/mod.rs"]
mod testbed;
#[path = "../testbed/truth.rs"]
mod truth;

use rand::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use sandgait::Error;
use sandgait::diagnose::diagnose;
use sandgait::diagnose::experiment::{self, Experiment};
use sandgait::diagnose::force_log;
use sandgait::diagnose::force_model::ForceLogModel;
use sandgait::diagnose::forward::ForwardModel;
use sandgait::diagnose::nuisance::CauseKind;
use sandgait::diagnose::report::{Diagnosis, Report};
use sandgait::diagnose::verdict::{Verdict, Written};
use sandgait::progress::{Progress, Silent};
use sandgait::sand::SandDescription;
use sandgait::sand::mechanism::{CATALOG, Mechanisms};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use testbed::dirt::dirty;
use testbed::rests::{Rests, with_rests};
use testbed::{Design, Hidden};

fn experiment() -> Experiment {
    Experiment::from_toml(testbed::EXPERIMENT).unwrap()
}

fn file(directory: &Path, text: &str) -> PathBuf {
    let path = directory.join("data.csv");
    std::fs::write(&path, text).unwrap();
    path
}

/// A diagnosis whose report violates none of the statements that hold for every report.
fn sound(data: &Path, experiment: &Experiment) -> Diagnosis {
    let diagnosis = diagnose(data, experiment, &Silent).unwrap();
    let json = serde_json::from_str(&diagnosis.json().unwrap()).unwrap();
    assert_eq!(truth::contradictions(&json), Vec::<String>::new());
    diagnosis
}

fn diagnosis(text: &str) -> Diagnosis {
    let directory = tempfile::tempdir().unwrap();
    sound(&file(directory.path(), text), &experiment())
}

fn hidden(causes: &[(&'static str, f64)]) -> Report {
    diagnosis(&testbed::log(11, &Hidden { causes: causes.to_vec() }, 0.05).noisy).report
}

/// Every law agrees with the test bed's independent implementation to 1 % of the largest force, the difference between
/// 40 and 53 segments.
#[test]
fn forward_model_agrees_with_the_test_bed() {
    let directory = tempfile::tempdir().unwrap();
    let medium = experiment().medium;
    for entry in CATALOG.iter().filter(|m| m.intrusion) {
        let hidden = Hidden { causes: vec![(entry.id, entry.typical)] };
        let lab = testbed::log(5, &hidden, 0.0);
        assert!(lab.effect > 0.005, "{} does nothing in the laboratory", entry.id);
        let log = force_log::read(&file(directory.path(), &lab.clean), &experiment(), &Silent).unwrap();
        let model = ForceLogModel::new(&log, &experiment()).unwrap();
        let mechanisms = Mechanisms::default().with(Mechanisms::index(entry.id).unwrap(), entry.typical);
        let ours = model.predict(&(mechanisms, medium.coefficients));
        let o = &log.observations;
        for unit in &o.units {
            for channel in 0..2 {
                let largest = (0..2).flat_map(|c| unit.block(c)).map(|k| o.values[k].abs()).fold(0.1, f64::max);
                for k in unit.block(channel) {
                    let off = (ours[k] - o.values[k]).abs() / largest;
                    assert!(
                        off < 0.01,
                        "{}: trial {} channel {channel}: {off:.4} of {largest:.2} N",
                        entry.id,
                        unit.id
                    );
                }
            }
        }
    }
}

/// On this design every rival is more than 12 σ away, so the diagnosis must name the right cause, and its value must be
/// right.
#[test]
fn hidden_causes_are_named() {
    // Other tests here have logs with drag and cohesion, too.
    let all = [("slope", -0.05), ("concave_fill", 0.3), ("inertial_drag", 1.0), ("cohesion", 150.0)];
    for (id, value) in long::first(2, all) {
        let r = hidden(&[(id, value)]);
        named_alone(&r, id, CauseKind::Sand);
        assert!((r.causes[0].value / value - 1.0).abs() < 0.15, "{id}: {}", r.summary);
        holds(&r, value);
    }
}

/// Cross-talk of 2 % in each force channel, which a data sheet may state, is a tilt of 0.014 rad, and with it the uncertain coefficients
/// take a part of a tilt. So the interval of one log is ±0.033 rad, and its value may be off by more than 15 %; the mean of several is
/// not: values are not biased.
#[test]
fn a_tilted_sensor_is_named() {
    let seeds = [11, 12, 13, 14, 15];
    let value = |seed: u64| {
        let r = diagnosis(&testbed::log(seed, &Hidden { causes: vec![("sensor_tilt", 0.08)] }, 0.05).noisy).report;
        named_alone(&r, "sensor_tilt", CauseKind::Measurement);
        holds(&r, 0.08);
        r.causes[0].value
    };
    let mean = seeds.map(value).iter().sum::<f64>() / seeds.len() as f64;
    assert!((mean / 0.08 - 1.0).abs() < 0.15, "{mean}");
}

/// The report names this cause alone, of this kind, with a gain that is certain.
fn named_alone(r: &Report, id: &str, kind: CauseKind) {
    let set = vec![vec![id.to_string()]];
    assert_eq!((r.verdict, &r.ambiguity_set), (Verdict::Named, &set), "{id}: {}", r.summary);
    assert_eq!(r.causes[0].kind, kind, "{id}");
    assert!(r.gain.reduction.unwrap() > 0.0 && r.gain.ci95.unwrap()[0] > 0.0, "{id}: {:?}", r.gain);
}

/// The interval of the first cause holds its true value.
fn holds(r: &Report, value: f64) {
    let [low, high] = r.causes[0].ci95;
    assert!((low..=high).contains(&value), "{value}: {}", r.summary);
}

#[test]
fn a_pair_is_named() {
    let r = hidden(&[("inertial_drag", 1.0), ("cohesion", 150.0)]);
    assert_eq!(r.ambiguity_set, [["inertial_drag", "cohesion"]], "{}", r.summary);
    // If the causes are right, no law is added to them.
    assert!(r.terms.is_empty() && r.notes.is_empty(), "{:?} {:?}", r.terms, r.notes);
}

/// The coefficients of the hidden sand are off by 5 %, which a fit may find. No cause is given.
#[test]
fn without_a_hidden_cause_none_is_given() {
    let r = hidden(&[]);
    assert!(quiet(&r), "{}", r.summary);
    assert!(r.causes.is_empty() && r.ambiguity_set.is_empty());
}

#[test]
fn a_cause_outside_the_library_is_none_of_these() {
    let r = hidden(&[("wall", 1.0)]);
    assert_eq!(r.verdict, Verdict::NoneOfThese, "{}", r.summary);
    assert!(r.causes.is_empty() && !r.whereabouts.is_empty());
    // A log of examples/diagnosis_study.rs, in which fits with values of the plain sand gain from the freedom of an unused parameter. They
    // are not compared, so the table of evidence must not have them (`sound` checks it).
    let value = Xoshiro256PlusPlus::seed_from_u64(158).random_range(0.4..1.5);
    let log = testbed::log(7515, &Hidden { causes: vec![("wall", value)] }, 0.05);
    assert_eq!(diagnosis(&log.noisy).report.verdict, Verdict::NoneOfThese);
}

/// Says the report that the law holds, with the stated coefficients or with others?
fn quiet(r: &Report) -> bool {
    matches!(r.verdict, Verdict::NoiseFloor | Verdict::Recalibrated)
}

/// The log with some columns changed; `change` gets the old value, and leaves blank cells alone.
fn changed(log: &str, columns: &[&str], change: impl Fn(f64) -> f64) -> String {
    let header: Vec<&str> = log.lines().next().unwrap().split(',').collect();
    let places: Vec<usize> = columns.iter().map(|c| header.iter().position(|h| h == c).unwrap()).collect();
    let line = |line: &str| {
        let mut cells: Vec<String> = line.split(',').map(String::from).collect();
        for &k in &places {
            if let Ok(value) = cells[k].parse::<f64>() {
                cells[k] = change(value).to_string();
            }
        }
        cells.join(",")
    };
    std::iter::once(header.join(",")).chain(log.lines().skip(1).map(line)).collect::<Vec<_>>().join("\n")
}

/// A plate that is tilted is no slope of the sand, whether the tilt is within what is stated or far beyond it.
#[test]
fn a_tilted_plate_is_no_cause_of_the_sand() {
    let log = testbed::log(11, &Hidden::default(), 0.02).noisy;
    for degrees in [2.0_f64, 12.0] {
        let r = diagnosis(&changed(&log, &["plate_beta"], |beta| beta - degrees.to_radians())).report;
        assert!(r.causes.iter().all(|c| c.kind == CauseKind::Measurement), "{degrees}: {}", r.summary);
        if degrees > 10.0 {
            assert_eq!((r.verdict, &*r.causes[0].id), (Verdict::Named, "attitude"), "{}", r.summary);
            assert!((r.causes[0].value.to_degrees() - degrees).abs() < 2.0, "{}", r.summary);
        }
    }
}

/// A log that is late is late, and the report says which rows to shift.
#[test]
fn a_late_log_is_late() {
    let r = hidden(&[("delay", 0.02)]);
    assert_eq!((r.verdict, &*r.causes[0].id), (Verdict::Named, "delay"), "{}", r.summary);
    assert!(
        (r.causes[0].value - 0.02).abs() < 0.004 && r.action.contains("Shift the rows"),
        "{} {}",
        r.summary,
        r.action
    );
}

/// With one condition no cause can be named, but the report says how far forces are off, and what to measure.
#[test]
fn one_condition_names_no_cause() {
    let log = testbed::log(11, &Hidden { causes: vec![("scale", -0.3)] }, 0.0).noisy;
    let one: Vec<&str> = log.lines().filter(|l| l.starts_with("trial") || l.split(',').nth(1) == Some("0")).collect();
    let r = diagnosis(&one.join("\n")).report;
    assert_eq!(r.verdict, Verdict::InsufficientData, "{}", r.summary);
    assert!((r.recalibration.unwrap().factor - 0.7).abs() < 0.1 && r.headline.contains("below the prediction"));
    assert!(!r.next_experiment.unwrap().conditions.is_empty());
}

/// Effects that one condition shows, or one trial, are not named.
#[test]
fn the_evidence_of_one_trial_names_no_cause() {
    let log = testbed::log(11, &Hidden::default(), 0.02).noisy;
    // In one trial of a used bed all forces are 60 % greater.
    let used =
        log.lines().skip(1).find(|l| l.split(',').nth(9) == Some("2")).unwrap().split(',').next().unwrap().to_string();
    let louder = changed(&log, &["Fx", "Fz", "Ty"], |force| 1.6 * force);
    let own = |line: &str| line.split(',').next() == Some(&used);
    let lines = log.lines().zip(louder.lines()).map(|(line, louder)| if own(line) { louder } else { line });
    let r = diagnosis(&lines.collect::<Vec<_>>().join("\n")).report;
    assert!(r.causes.is_empty(), "{}", r.summary);
}

/// Measured discs: their pressure grows with their size, which no mechanism of the catalogue has.
#[test]
fn what_depends_on_size_is_not_named_as_a_power_of_depth() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/real_wheel");
    let experiment = Experiment::load(&folder.join("discs_force_log.toml")).unwrap();
    let r = sound(&folder.join("discs_force_log.csv"), &experiment).report;
    assert!(r.verdict != Verdict::Named, "{}", r.summary);
    assert!(r.next_experiment.is_some());
}

/// A log of simulated grains, which no force theory made, and facts about it.
fn grains(file: &str) -> (PathBuf, Experiment) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/grains");
    let experiment = Experiment::from_toml(&std::fs::read_to_string(folder.join("experiment.toml")).unwrap()).unwrap();
    (folder.join(file), experiment)
}

/// The concave side of the reversed leg holds grains. This cause acts on that leg only, and much misfit remains.
#[test]
fn the_concave_side_is_the_main_cause_in_grains() {
    let (data, experiment) = grains("legs.csv");
    let r = sound(&data, &experiment).report;
    assert_eq!(r.verdict, Verdict::Named, "{}", r.summary);
    assert_eq!(r.causes.iter().map(|c| c.id.as_str()).collect::<Vec<_>>(), ["concave_fill"]);
    assert!(r.gain.reduction.unwrap() > 0.4, "{:?}", r.gain);
    assert!(r.remainder.as_ref().unwrap().significant);
}

/// The model's error is much larger than the noise. The verdict still names the cause, with a gain beside all effects of measuring, and
/// the extended sand gives the report's prediction. The error on left-out conditions is less than that of the stated sand alone by more
/// than 55 %: 3.08 to 1.25 N. (Version 3 of the report: to 1.60 N, 48 %.) The report's own gain is less, because effects of measuring
/// lower the error of the plain model, too, to 1.76 N. The sand without these effects, of which a delay is the largest, gives 1.79 N, 42 %.
#[test]
fn drag_is_the_main_cause_of_plates_in_grains() {
    let (data, experiment) = grains("plates.csv");
    let Diagnosis { report: r, sand, curves, .. } = sound(&data, &experiment);
    assert_eq!(r.verdict, Verdict::Named, "{}", r.summary);
    assert_eq!(r.ambiguity_set, [["inertial_drag"]], "{}", r.summary);
    assert!(r.gain.nested && r.gain.ci95.unwrap()[0] > 0.0, "{:?}", r.gain);
    let o = &curves.observations;
    let rms = |p: &[f64]| {
        let squares: Vec<f64> = o.counted(o.units.iter()).map(|k| (o.values[k] - p[k]).powi(2)).collect();
        (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
    };
    let (stated, left_out) = (rms(&curves.plain), r.gain.in_units.as_ref().unwrap().extended);
    assert!(left_out < 0.45 * stated, "{left_out} of {stated}");
    let alone = rms(curves.extended.as_ref().unwrap());
    assert!(alone < 0.6 * stated, "{alone} of {stated}");
    assert_eq!(r.causes[0].value, sand.mechanisms.inertial_drag);
    assert_eq!(r.terms.len(), sand.terms.len());
    let log = force_log::read(&data, &experiment, &Silent).unwrap();
    let model = ForceLogModel::new(&log, &experiment).unwrap();
    let again = model.with_terms(&sand.terms).unwrap().predict(&(sand.mechanisms, sand.coefficients));
    assert!(again.iter().zip(&curves.extended.unwrap()).all(|(a, b)| (a - b).abs() < 1e-9));
}

/// The hidden drag has another power of the speed than the law. If the data exclude the law's power, the law is not
/// named. If the data do not distinguish the powers, the report says so.
#[test]
fn the_exponent_of_the_speed_is_tested() {
    let of = |design, loud, id, value| {
        diagnosis(&testbed::noisy_log(design, loud, 11, &Hidden { causes: vec![(id, value)] }, 0.05).noisy).report
    };
    let r = of(Design::Crossed, 0.5, "drag_1.5", 1.5);
    assert_eq!((r.verdict, r.written), (Verdict::Described, Written::Description), "{}", r.summary);
    // This term is proportional to v^1.5 and does not depend on the depth: (v²/(g|z|))^0.75 (|z|/w)^−0.25 |z|.
    let term = &r.terms[0];
    assert_eq!((term.groups["froude"], term.groups["depth_over_width"]), (0.75, -0.25), "{}", r.summary);
    let r = of(Design::Crossed, 0.5, "inertial_drag", 1.5);
    assert_eq!(r.verdict, Verdict::Named, "{}", r.summary);
    assert!(r.form.as_ref().is_some_and(|form| !form.excluded && form.told_apart), "{:?}", r.form);
    let r = of(Design::Crossed, 2.0, "inertial_drag", 0.3);
    assert!(r.form.as_ref().is_some_and(|form| !form.excluded && !form.told_apart), "{:?}", r.form);
    assert!(r.summary.contains("these data allow every power"), "{}", r.summary);
}

/// The verdict does not depend on samples at rest: at the start, as with every real drive, at the end, or at stops in
/// between. The velocities and forces logged during a rest do not matter.
#[test]
fn rests_change_no_verdict() {
    let rests = [
        Rests { samples: [1, 0, 0], noise: 0.0, held: 0.0 },
        Rests { samples: [5, 7, 6], noise: 0.0, held: 0.8 },
        Rests { samples: [9, 8, 4], noise: 0.02, held: 0.7 },
    ];
    for (k, causes) in [vec![], vec![("inertial_drag", 1.0)], vec![("scale", 0.3)]].into_iter().enumerate() {
        let log = testbed::log(11, &Hidden { causes }, 0.05).noisy;
        let base = diagnosis(&log).report;
        // In `make test` each cause has rests of one kind.
        for rests in long::first(1, (k..k + 3).map(|kind| rests[kind % 3])) {
            let r = diagnosis(&with_rests(&log, rests)).report;
            assert_eq!((r.verdict, &r.ambiguity_set), (base.verdict, &base.ambiguity_set), "{rests:?}: {}", r.summary);
            for (found, expected) in r.causes.iter().zip(&base.causes) {
                let off = (found.value - expected.value).abs();
                assert!(off < 0.03 * expected.value.abs(), "{rests:?}: {} for {}", r.summary, base.summary);
            }
            assert!(r.notes.iter().any(|n| n.contains("rests")), "{:?}", r.notes);
        }
        assert!(base.notes.iter().all(|n| !n.contains("rests")), "{:?}", base.notes);
    }
}

/// The usual errors of a load cell are reported as nuisances. They neither hide a cause nor are they named as one.
#[test]
fn a_dirty_load_cell_changes_no_verdict() {
    let of = |causes: Vec<(&'static str, f64)>| {
        diagnosis(&dirty(&testbed::log(11, &Hidden { causes }, 0.05).noisy, 0.06)).report
    };
    let r = of(Vec::new());
    assert!(quiet(&r), "{}", r.summary);
    let offset = r.nuisances.iter().find(|n| (n.id.as_str(), n.level) == ("offset", "trial")).unwrap();
    assert!((0.04..0.08).contains(&offset.sd), "{offset:?}");
    let limit = r.upper_limits.iter().find(|l| l.id == "inertial_drag").unwrap();
    assert!((0.0..0.5).contains(&limit.value) && limit.level == 0.95, "{limit:?}");
    let r = of(vec![("inertial_drag", 1.0)]);
    assert_eq!(
        (r.verdict, r.ambiguity_set),
        (Verdict::Named, vec![vec!["inertial_drag".to_string()]]),
        "{}",
        r.summary
    );
    let cause = &r.causes[0];
    assert!((cause.ci95[0]..=cause.ci95[1]).contains(&1.0), "{}", r.summary);
    assert!(!r.remainder.as_ref().unwrap().significant && r.gain.nested && r.degrees_of_freedom.unwrap() > 5.0);
    assert_eq!(r.schema, "sandgait.diagnosis.v4");
}

/// The velocity of the first row is exactly zero, but the trial does not begin with a rest.
#[test]
fn a_first_velocity_of_zero_changes_no_verdict() {
    let log = testbed::log(11, &Hidden { causes: vec![("inertial_drag", 1.0)] }, 0.05).noisy;
    let mut last = String::new();
    let still = log.lines().map(|line| {
        let mut cells: Vec<&str> = line.split(',').collect();
        let first = cells[0] != last && cells[0] != "trial";
        last = cells[0].into();
        for k in [14, 17, 18].into_iter().filter(|_| first) {
            cells[k] = "0";
        }
        cells.join(",")
    });
    let r = diagnosis(&still.collect::<Vec<_>>().join("\n")).report;
    assert_eq!(
        (r.verdict, r.ambiguity_set),
        (Verdict::Named, vec![vec!["inertial_drag".to_string()]]),
        "{}",
        r.summary
    );
    assert!((r.causes[0].value - 1.0).abs() < 0.1, "{}", r.summary);
}

/// A plate that starts from rest toward −x gives the mirror image of one toward +x, whatever the noise of its velocity
/// at rest.
#[test]
fn plates_that_start_from_rest_are_mirrored() {
    let directory = tempfile::tempdir().unwrap();
    let header = "trial,condition,rep,kind,shape,medium,hip_z,plate_beta,plate_gamma,t,theta,omega,x,z,vx,vz,Fx,Fz";
    let text = |vx: [f64; 4]| {
        let mut x = 0.0;
        let rows = vx.iter().enumerate().map(|(i, v)| {
            x += 0.1 * v;
            format!("a,0,0,plate,plate,poppy-loose,,0.5,0.3,{},,,{x},-0.02,{v},-0.03,1,1", 0.1 * i as f64)
        });
        format!("{header}\n{}", rows.collect::<Vec<_>>().join("\n"))
    };
    for (vx, beta) in [([0.0, 0.1, 0.1, 0.1], 0.5), ([0.0, -0.1, -0.1, -0.1], -0.5), ([0.001, -0.1, -0.1, -0.1], -0.5)]
    {
        let log = force_log::read(&file(directory.path(), &text(vx)), &experiment(), &Silent).unwrap();
        assert_eq!(log.settings[0].beta, beta, "{vx:?}");
    }
}

#[test]
fn without_repetitions_the_verdict_is_insufficient_data() {
    let log = testbed::log(11, &Hidden::default(), 0.05).noisy;
    let once: Vec<&str> = log.lines().filter(|l| l.starts_with("trial") || l.split(',').nth(2) == Some("0")).collect();
    let r = diagnosis(&once.join("\n")).report;
    assert_eq!(r.verdict, Verdict::InsufficientData);
}

/// In a log without noise, all repetitions are equal to the last digit.
#[test]
fn copied_trials_are_not_repetitions() {
    let r = diagnosis(&testbed::log(11, &Hidden { causes: vec![("inertial_drag", 1.0)] }, 0.05).clean).report;
    assert_eq!(r.verdict, Verdict::InsufficientData, "{}", r.summary);
    assert!(r.summary.contains("copies"), "{}", r.summary);
}

#[test]
fn missing_columns_are_reported_with_their_untestable_causes() {
    let log = testbed::log(11, &Hidden::default(), 0.05).noisy;
    let drop = [9, 10, 11]; // pass, pass_dx, x_bed
    let keep = |l: &str| {
        l.split(',').enumerate().filter(|(i, _)| !drop.contains(i)).map(|c| c.1).collect::<Vec<_>>().join(",")
    };
    let r = diagnosis(&log.lines().map(keep).collect::<Vec<_>>().join("\n")).report;
    for id in ["footprint", "packing_grad"] {
        assert!(r.untestable.iter().any(|u| u.id == id && u.why.contains("no column")), "{:?}", r.untestable);
    }
}

/// Progress only grows, and the caller can stop the work at each report.
#[test]
fn work_reports_progress_and_can_be_stopped() {
    struct Until(usize, Mutex<Vec<f64>>);
    impl Progress for Until {
        fn report(&self, done: f64, stage: &str) -> sandgait::Result<()> {
            let mut told = self.1.lock().unwrap();
            // A long stage reports the same progress several times; how often depends on the machine.
            if told.last() != Some(&done) {
                told.push(done);
            }
            if told.len() > self.0 { Err(Error::Cancelled(stage.into())) } else { Ok(()) }
        }
    }
    let directory = tempfile::tempdir().unwrap();
    let path = file(directory.path(), &testbed::log(11, &Hidden { causes: vec![("inertial_drag", 1.0)] }, 0.05).noisy);
    let all = Until(usize::MAX, Mutex::default());
    diagnose(&path, &experiment(), &all).unwrap();
    let told = all.1.into_inner().unwrap();
    assert!(told.len() > 5 && told.is_sorted() && told[0] == 0.0 && told[told.len() - 1] <= 1.0, "{told:?}");
    for stop in 0..told.len() {
        let outcome = diagnose(&path, &experiment(), &Until(stop, Mutex::default()));
        assert!(matches!(outcome.err(), Some(Error::Cancelled(_))), "stopped at report {stop}");
    }
}

/// A simulation of the data's conditions with the written sand.toml gives the report's predictions.
#[test]
fn the_extended_sand_predicts_what_the_report_shows() {
    let directory = tempfile::tempdir().unwrap();
    let path = file(directory.path(), &testbed::log(11, &Hidden { causes: vec![("inertial_drag", 1.0)] }, 0.05).noisy);
    let diagnosis = sound(&path, &experiment());
    diagnosis.write(&directory.path().join("out")).unwrap();
    let sand = SandDescription::load(&directory.path().join("out/sand.toml")).unwrap();
    let log = force_log::read(&path, &experiment(), &Silent).unwrap();
    let model = ForceLogModel::new(&log, &experiment()).unwrap();
    let again = model.predict(&(sand.mechanisms, sand.coefficients));
    let shown = diagnosis.curves.extended.unwrap();
    assert!(again.iter().zip(&shown).all(|(a, b)| (a - b).abs() < 1e-9));
}
