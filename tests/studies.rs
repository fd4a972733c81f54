//! Calibration and design studies.

use sandgait::calibrate::calibrate;
use sandgait::diagnose::experiment::Experiment;
use sandgait::diagnose::force_log;
use sandgait::diagnose::force_model::ForceLogModel;
use sandgait::diagnose::forward::ForwardModel;
use sandgait::progress::Silent;
use sandgait::sand::intrusion::Rotation;
use sandgait::sand::mechanism::{CATALOG, Mechanisms};
use sandgait::sand::{LegShape, Medium, SandDescription};
use sandgait::sim::engine::EngineKind;
use sandgait::sim::model::Scene;
use sandgait::sim::{Robot, walk};
use sandgait::sweep::{Design, Parameter, SweepAxis, SweepMeasure, optimize, walk_all};
use sandgait::table::{self, HeaderColumn, Quantity, ReadOptions};
use std::path::Path;

const PLATE: f64 = 0.038 * 0.025;

fn design() -> Design {
    let scene = Scene::flat(Medium::named("poppy-loose").unwrap());
    Design { robot: Robot::load("xplorer").unwrap(), scene, frequency: 2.0, phase: 0.0 }
}

/// The data are of plates pushed slowly through a simulation of single grains; its authors state ζ = 0.46 from three
/// such runs.
#[test]
fn a_penetration_test_gives_the_scale() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/penetration.csv");
    let columns = [HeaderColumn::needed("depth", Quantity::Length), HeaderColumn::needed("force", Quantity::Force)];
    let (mut depth, mut force) = (Vec::new(), Vec::new());
    let take = |row: &table::Row| {
        depth.push(row.needed(0)?);
        force.push(row.needed(1)?);
        Ok(())
    };
    table::read(&path, &ReadOptions::new(&columns), take).unwrap();
    assert!((0.04..0.06).contains(depth.last().unwrap()), "the header's mm were not read");
    let c = calibrate(&depth, &force, PLATE).unwrap();
    assert!(c.zeta_interval[0] < 0.46 && 0.46 < c.zeta_interval[1], "{c:?}");
    assert!((c.xi_n / c.zeta - 1.0 / 0.87574).abs() < 1e-12);
}

/// The interval contains the true value nearly as often as its confidence level, for noise that is correlated along the
/// path. `calibrate::STRETCHES` says how nearly.
#[test]
fn the_confidence_interval_has_its_coverage() {
    use rand::{Rng, SeedableRng};
    let mut random = rand_xoshiro::Xoshiro256PlusPlus::seed_from_u64(1);
    let depth: Vec<f64> = (1..=200).map(|i| f64::from(i) * 2.5e-4).collect();
    let covered = (0..400).filter(|_| {
        let mut noise = 0.0;
        let force: Vec<f64> = depth
            .iter()
            .map(|z| {
                noise = 0.8 * noise + random.random_range(-0.5..0.5);
                0.5e6 * PLATE * z + noise
            })
            .collect();
        let c = calibrate(&depth, &force, PLATE).unwrap();
        c.zeta_interval[0] < 0.5 && 0.5 < c.zeta_interval[1]
    });
    let share = covered.count() as f64 / 400.0;
    assert!((0.89..=0.99).contains(&share), "{share}");
}

#[test]
fn data_that_are_no_penetration_test_are_refused() {
    let depth: Vec<f64> = (0..100).map(|i| f64::from(i) * 5e-4).collect();
    let line = |slope: f64| depth.iter().map(|z| slope * z).collect::<Vec<_>>();
    let back: Vec<f64> = depth.iter().rev().copied().collect();
    let constant = vec![3.0; 100];
    for (depth, force, what) in [
        (&depth, line(-400.0), "pulling"),
        (&back, line(400.0), "on the way up"),
        (&depth, constant, "constant"),
        (&depth[..5].to_vec(), line(400.0)[..5].to_vec(), "short"),
        (&depth.iter().map(|z| z * 1e3).collect(), line(400.0), "millimetres taken for metres"),
    ] {
        let error = calibrate(depth, &force, PLATE).expect_err(what).to_string();
        assert!(!error.contains('\n'), "{error}");
    }
    assert!(calibrate(&depth, &line(400.0), -1.0).is_err());
}

#[test]
fn bad_cells_are_named() {
    let read = |text: &str, units: &[(&str, &str)]| {
        let columns = [HeaderColumn::needed("depth", Quantity::Length)];
        let units = units.iter().map(|(name, unit)| (name.to_string(), unit.to_string())).collect();
        let mut depth = Vec::new();
        let asked = ReadOptions { units, ..ReadOptions::new(&columns) };
        table::parse(Path::new("x.csv"), text.as_bytes(), &asked, |row| row.needed(0).map(|z| depth.push(z)))?;
        sandgait::Result::Ok(depth)
    };
    assert_eq!(read("depth (mm)\n1\n2\n", &[]).unwrap(), [1e-3, 2e-3]);
    assert_eq!(read("depth\n1\n", &[("depth", "cm")]).unwrap(), [1e-2]);
    assert_eq!(read("depth [cm]\n1\n", &[("depth", "cm")]).unwrap(), [1e-2]);
    let long = format!("depth\n{}\n", "x".repeat(100_000));
    for (text, unit, says) in [
        ("depth\n1\nabc\n", "m", "row 3, column depth"),
        ("depth\nnan\n", "m", "row 2, column depth"),
        ("depth,force\n1\n", "m", "row 2"),
        ("force\n1\n", "m", "row 1, column depth: missing; the header has force"),
        ("depth [furlong]\n1\n", "m", "furlong"),
        ("depth\n1\n", "furlong", "row 1, column depth: unit \"furlong\" is unknown; known: m, cm"),
        ("depth [mm]\n1\n", "cm", "row 1, column depth: the header gives another unit"),
        ("depth\n", "m", "no rows"),
        ("depth,depth\n1,2\n", "m", "twice"),
        ("depth [m],depth [mm]\n1,2\n", "m", "twice"),
        (&long, "m", "row 2, column depth: \"xxx"),
    ] {
        let error = read(text, &[("depth", unit)]).unwrap_err().to_string();
        assert!(error.contains(says) && error.len() < 400 && !error.contains('\n'), "{text:.40?}: {error}");
    }
}

/// A walk is bit-identical alone and together with others, in lanes and on several cores.
#[test]
fn parallel_walks_equal_single_walks() {
    let mut trials = Vec::new();
    for (k, law) in ["li2013", "penetration-drag-1d", "agarwal2023", "li2013"].into_iter().enumerate() {
        for xi in [-40.0, 10.0, 40.0] {
            let mut d = design();
            d.frequency = 2.0 + k as f64;
            Parameter::named("law").unwrap().set(&mut d, law).unwrap();
            Parameter::named("xi").unwrap().set(&mut d, &xi.to_string()).unwrap();
            trials.push(d.trial().unwrap());
        }
    }
    let together = walk_all(EngineKind::Lanes, &trials, &Silent).unwrap();
    for (trial, result) in trials.iter().zip(&together) {
        assert_eq!(walk::walk(EngineKind::Lanes, trial).unwrap(), *result);
    }
}

/// At most frequencies the ends of the evaluated window lie between two samples. The cost of transport must not depend on
/// their positions between these samples.
#[test]
fn the_cost_of_transport_is_smooth_in_the_frequency() {
    let cost = |frequency: f64| {
        let trial = Design { frequency, ..design() }.trial().unwrap();
        walk::walk(EngineKind::Lanes, &trial).unwrap().cost_of_transport
    };
    for [aligned, between] in [[2.5, 2.497], [2.0, 2.003], [1.0, 0.9995]] {
        let (a, b) = (cost(aligned), cost(between));
        assert!((a / b - 1.0).abs() < 0.02, "{aligned} Hz: {a}, {between} Hz: {b}");
    }
}

/// With every law, two engines with independent dynamics give the same walk.
#[test]
fn engines_agree_under_every_law() {
    for law in sandgait::sand::Law::ALL {
        for leg in ["L", "revL"] {
            let mut d = design();
            d.scene.law = law;
            Parameter::named("leg").unwrap().set(&mut d, leg).unwrap();
            let trial = d.trial().unwrap();
            let [lanes, rapier] =
                [EngineKind::Lanes, EngineKind::Rapier].map(|kind| walk::walk(kind, &trial).unwrap().speed);
            assert!((lanes / rapier - 1.0).abs() < 0.02, "{} {leg}: {lanes} {rapier}", law.name());
        }
    }
}

#[test]
fn parameters_change_the_model() {
    let mut d = design();
    for (name, value) in [("chord", "0.05"), ("leg-mass", "0.004"), ("payload", "0.03"), ("slope", "5")] {
        Parameter::named(name).unwrap().set(&mut d, value).unwrap();
    }
    let model = d.trial().unwrap().model;
    assert!((model.legs[0][0].reach.norm() - 0.05).abs() < 1e-12);
    assert!((model.total_mass() - (0.138 + 6.0 * 0.004 + 0.03)).abs() < 1e-12);
    assert!(model.gravity.x < 0.0);
    for (name, value) in [("xi", "90"), ("width", "-0.01"), ("medium", "mud"), ("kp", "nan"), ("law", "x")] {
        assert!(Parameter::named(name).unwrap().set(&mut d, value).is_err(), "{name}={value}");
    }
    for bad in ["xi", "xi=", "xi=1:2", "xi=1:2:1", "mood=1,2", "xi=a:b:3"] {
        assert!(SweepAxis::parse(bad).is_err(), "{bad}");
    }
    assert_eq!(SweepAxis::parse("xi=-0.1:0.2:4").unwrap().values, ["-0.1", "0", "0.1", "0.2"]);
}

/// The search finds a design at least as good as the best of a coarse grid, stays within its bounds, and is
/// reproducible.
#[test]
fn the_search_beats_a_grid() {
    let axes = [SweepAxis::parse("xi=0:75:2").unwrap()];
    let grid = (0..=15).map(|k| {
        let mut d = design();
        Parameter::named("xi").unwrap().set(&mut d, &(5 * k).to_string()).unwrap();
        d.trial().unwrap()
    });
    let best = walk_all(EngineKind::Lanes, &grid.collect::<Vec<_>>(), &Silent)
        .unwrap()
        .iter()
        .map(|r| r.speed)
        .fold(0.0, f64::max);
    let [a, b] = [(); 2].map(|()| optimize::optimize(&design(), &axes, SweepMeasure::Speed, &Silent).unwrap());
    assert!(a.result.speed >= best * 0.999 && (0.0..=75.0).contains(&a.values[0]), "{} {best}", a.result.speed);
    assert_eq!(a.values, b.values);
}

/// The forces on a leg that rotates through sand with a mechanism agree with the diagnosis's prediction. The prediction
/// divides the leg into fewer segments, and has separate code for slopes and filled legs.
#[test]
fn forces_with_mechanisms_agree_with_the_diagnosis() {
    let acting =
        ["inertial_drag", "concave_fill", "depth_power", "cohesion", "scale", "packing_grad", "slope", "size_power"];
    let sensors = ["bias_x", "bias_z", "sensor_tilt", "depth_zero", "delay", "lowpass", "compliance"];
    let toml = "kind = \"intrusion\"\nmedium = \"poppy-loose\"\n\
                [shape.leg]\ntype = \"leg\"\nchord = 0.076\nwidth = 0.025\nxi_deg = -45.0\n";
    let experiment = Experiment::from_toml(toml).unwrap();
    let mut log = String::from(
        "trial,condition,rep,kind,shape,medium,hip_z,plate_beta,plate_gamma,t,theta,omega,x,z,vx,vz,Fx,Fz\n",
    );
    for i in (-175..=175).step_by(10) {
        let theta = f64::from(i) * 0.01;
        log += &format!("0,0,0,leg,leg,poppy-loose,0.02,,,{},{theta},10,0,0,0,0,0,0\n", (theta + 2.0) / 10.0);
    }
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("log.csv");
    std::fs::write(&path, log).unwrap();
    let log = force_log::read(&path, &experiment, &Silent).unwrap();
    let model = ForceLogModel::new(&log, &experiment).unwrap();
    let rotation = Rotation { omega: 10.0, ..Rotation::of(LegShape::named("revL").unwrap()) };
    let loads = |mechanisms: Mechanisms| {
        let sand = SandDescription { mechanisms, ..SandDescription::plain(&experiment.medium) };
        rotation.loads(&sand).unwrap().into_iter().step_by(10).map(|(_, l)| l).collect::<Vec<_>>()
    };
    let plain = loads(Mechanisms::PLAIN);
    for id in acting {
        let index = Mechanisms::index(id).unwrap();
        let mechanisms = Mechanisms::PLAIN.with(index, CATALOG[index].typical);
        let (ours, theirs) = (loads(mechanisms), model.predict(&(mechanisms, experiment.medium.coefficients)));
        let largest = |d: &dyn Fn(usize) -> f64| (0..ours.len()).map(d).fold(0.0, f64::max);
        let effect = largest(&|k| (ours[k].fx - plain[k].fx).hypot(ours[k].fz - plain[k].fz));
        let off = largest(&|k| (ours[k].fx - theirs[k]).hypot(ours[k].fz - theirs[ours.len() + k]));
        // 400 segments here and 40 in the diagnosis differ by 4 mN; the effects of the mechanisms are 57 mN and more.
        assert!(off < 0.005 && effect > 0.05, "{id}: effect {effect} N, off by {off} N");
    }
    for id in sensors {
        let index = Mechanisms::index(id).unwrap();
        assert_eq!(loads(Mechanisms::PLAIN.with(index, CATALOG[index].typical)), plain, "{id}");
    }
}

/// A large grid is computed in portions and gives the results of its single walks. A wrong value is named before the
/// first walk.
#[test]
fn a_large_grid_equals_its_single_walks() {
    let axes = [SweepAxis::parse("xi=-40,40").unwrap(), SweepAxis::parse("frequency=19:20:2100").unwrap()];
    let results = sandgait::sweep::grid(&design(), &axes, &Silent).unwrap();
    assert_eq!(results.len(), 4200);
    let mut last = Design { frequency: 20.0, ..design() };
    Parameter::named("xi").unwrap().set(&mut last, "40").unwrap();
    assert_eq!(walk::walk(EngineKind::Lanes, &last.trial().unwrap()).unwrap(), results[4199]);
    let wrong = [SweepAxis::parse("xi=-40,40").unwrap(), SweepAxis::parse("frequency=2,21").unwrap()];
    let error = sandgait::sweep::grid(&design(), &wrong, &Silent).unwrap_err().to_string();
    assert_eq!(error, "frequency: 21 is outside [-20, 20]");
}
