//! A stress that grows with the size of the intruder, hidden in pushes of square plates. The forces are those of the test
//! bed, which shares no code with `src/`.

use crate::{file, sound, testbed};
use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;
use sandgait::diagnose::experiment::Experiment;
use sandgait::diagnose::report::Report;
use sandgait::diagnose::verdict::Verdict;
use std::fmt::Write;

/// Attack angle, intrusion angle [rad] and speed [m/s] of the pushes.
const PUSHES: [[f64; 3]; 4] =
    [[0.0, std::f64::consts::FRAC_PI_2, 0.05], [0.5, 1.0, 0.1], [-0.5, 1.0, 0.1], [0.8, 0.6, 0.3]];
const SAMPLES: usize = 40;
const PIECES: usize = 51;

/// Diagnoses pushes of plates with these sides [m], in sand whose stress is × (side / 5 cm)^`power`. Trials scatter by 3 %, samples by
/// 1 % and 5 mN. `sideways`: factor on Fx.
fn diagnosed(seed: u64, sides: &[f64], power: f64, sideways: f64) -> Report {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut csv = String::from("trial,condition,rep,kind,shape,plate_beta,plate_gamma,t,x,z,vx,vz,Fx,Fz\n");
    let mut experiment = String::from("kind = \"intrusion\"\nmedium = \"poppy-loose\"\nbulk_density = 638.0\n");
    for (s, side) in sides.iter().enumerate() {
        write!(experiment, "[shape.s{s}]\ntype = \"plate\"\nlength = {side}\nwidth = {side}\n").unwrap();
        for (k, push) in PUSHES.into_iter().enumerate() {
            for rep in 0..3 {
                let strength = (side / 0.05).powf(power) * (1.0 + 0.03 * testbed::normal(&mut random));
                let surface = 3e-4 * testbed::normal(&mut random);
                write_trial(&mut csv, [s, k, rep], (*side, push), [strength, surface, sideways], &mut random);
            }
        }
    }
    let folder = tempfile::tempdir().unwrap();
    sound(&file(folder.path(), &csv), &Experiment::from_toml(&experiment).unwrap()).report
}

fn write_trial(
    csv: &mut String,
    [s, k, rep]: [usize; 3],
    (side, push): (f64, [f64; 3]),
    [strength, surface, sideways]: [f64; 3],
    random: &mut Xoshiro256PlusPlus,
) {
    let [beta, gamma, speed] = push;
    let [ax, az] = testbed::stress_per_depth(&testbed::TABLE, beta, gamma);
    let duration = 0.06 / speed;
    for i in 0..SAMPLES {
        let t = duration * i as f64 / (SAMPLES - 1) as f64;
        let (x, z) = (speed * t * gamma.cos(), 0.005 - speed * t * gamma.sin());
        let piece = |p: usize| {
            let along = side * ((p as f64 + 0.5) / PIECES as f64 - 0.5);
            (-(z + surface + along * beta.sin())).max(0.0) * side * side / PIECES as f64
        };
        let load = strength * (0..PIECES).map(piece).sum::<f64>();
        let force = [-ax * load, az * load];
        let scatter = 5e-3 + 0.01 * force[1].abs();
        let [fx, fz] = force.map(|f| f + scatter * testbed::normal(random));
        let (vx, vz, fx) = (speed * gamma.cos(), -speed * gamma.sin(), sideways * fx);
        writeln!(
            csv,
            "{s}-{k}-{rep},{s}-{k},{rep},plate,s{s},{beta},{gamma},{t:.5},{x:.6},{z:.6},{vx:.5},{vz:.5},{fx:.5},{fz:.5}"
        )
        .unwrap();
    }
}

const FOUR: [f64; 4] = [0.02, 0.03, 0.05, 0.08];

fn named(r: &Report, power: f64) {
    assert_eq!(
        (r.verdict, r.ambiguity_set.concat()),
        (Verdict::Named, vec!["size_power".to_string()]),
        "{}",
        r.summary
    );
    let [low, high] = r.causes[0].ci95;
    assert!((low..=high).contains(&power) && high - low < 0.2, "{low} to {high}: {}", r.summary);
}

#[test]
fn a_stress_that_grows_with_the_size_is_named() {
    named(&diagnosed(1, &FOUR, 0.6, 1.0), 0.6);
    named(&diagnosed(8, &FOUR, -0.4, 1.0), -0.4);
}

#[test]
fn without_it_plates_of_four_sizes_show_nothing() {
    for seed in [2, 7] {
        let r = diagnosed(seed, &FOUR, 0.0, 1.0);
        assert_eq!(r.verdict, Verdict::NoiseFloor, "{}", r.summary);
    }
}

/// One size cannot tell it from the strength of the sand, which then is what the report gives.
#[test]
fn one_size_shows_another_strength() {
    let r = diagnosed(3, &[0.03], 0.6, 1.0);
    assert!(r.untestable.iter().any(|u| u.id == "size_power" && u.why.contains("hardly vary")), "{:?}", r.untestable);
    assert!(!r.ambiguity_set.concat().contains(&"size_power".to_string()), "{}", r.summary);
}

/// A column of zeros was not measured. It must not decide: its scatter is 0.
#[test]
fn a_column_of_zeros_does_not_count() {
    let r = diagnosed(1, &FOUR, 0.6, 0.0);
    named(&r, 0.6);
    let said =
        r.check.findings.iter().any(|f| f.what.contains("is 0 in all rows") && f.place.column.as_deref() == Some("Fx"));
    assert!(said, "{:?}", r.check.findings);
}
