//! Damaged files are read or refused, without a panic.

use crate::testbed::Hidden;
use crate::{experiment, long, sound, testbed};
use rand::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use sandgait::Error;
use sandgait::diagnose::experiment::Experiment;
use sandgait::diagnose::{force_log, walking_log};
use sandgait::progress::Silent;

/// `base` with random changes at one to three positions.
fn damaged(base: &[u8], rng: &mut Xoshiro256PlusPlus) -> Vec<u8> {
    const WORDS: [&str; 18] = [
        "", "nan", "inf", "-1e308", "1e-320", "0", "-0.0", "\"", ",", "\n", "plate", "leg", "2", "é", "\u{0}", "1e400",
        "[", "=",
    ];
    let mut bytes = base.to_vec();
    for _ in 0..rng.random_range(1..4) {
        let (at, end) = (rng.random_range(0..bytes.len()), rng.random_range(0..bytes.len()));
        let word = WORDS[rng.random_range(0..WORDS.len())];
        match rng.random_range(0..5) {
            0 => bytes[at] = rng.random_range(0..=255),
            1 => drop(bytes.drain(at.min(end)..at.max(end).min(at.min(end) + 40))),
            2 => drop(bytes.splice(at..at, word.bytes())),
            3 => {
                let cell = at + bytes[at..].iter().position(|b| *b == b',').unwrap_or(0);
                let next = cell + 1 + bytes[cell + 1..].iter().position(|b| *b == b',').unwrap_or(0);
                bytes.splice(cell + 1..next.max(cell + 1), word.bytes());
            }
            _ => bytes.truncate(at.max(1)),
        }
        if bytes.is_empty() {
            break;
        }
    }
    bytes
}

/// Damaged walking logs and as many damaged experiment files are read, or refused in one line, without a
/// panic.
#[test]
fn damaged_runs_and_experiments_never_panic() {
    const WALKS: &str = "run,condition,rep,robot,leg,xi_deg,stride_frequency,slope_deg,payload,x_bed,duration,speed,pitch_rms\n\
        a,0,0,xplorer,L,45,2,0,0,0,2,0.28,0.04\nb,0,1,xplorer,L,45,2,0,0,0,2,0.27,0.05\n\
        c,1,0,xplorer,revL,-45,3,5,0.03,0.1,1.3333,0.4,0.01\nd,1,1,xplorer,C,,3,5,0.03,0.1,,0.41,0.01\n";
    const EXPERIMENT: &str = "kind = \"walking\"\nbulk_density = 638.0\ncoefficient_sd = 0.08\nrobot = \"xplorer\"\n\
        [sand]\ncoefficients = \"generic\"\nzeta = 0.46\n[shape.L]\ntype = \"leg\"\nchord = 0.076\nwidth = 0.025\n\
        xi_deg = 45.0\n[units]\nspeed = \"cm/s\"\n[columns]\nrun = \"name\"\n";
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("runs.csv");
    let experiment =
        Experiment::from_toml("kind = \"walking\"\nmedium = \"poppy-loose\"\nbulk_density = 638.0\n").unwrap();
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(2);
    let (mut accepted, mut refused) = ([0; 2], [0; 2]);
    let mut count = |kind: usize, outcome: Result<(), Error>| match outcome {
        Ok(()) => accepted[kind] += 1,
        Err(error) => {
            let line = error.to_string();
            assert!(!line.is_empty() && line.trim_end().lines().count() == 1, "{line:?}");
            refused[kind] += 1;
        }
    };
    for _ in long::first(1500, 0..10_000) {
        std::fs::write(&path, damaged(WALKS.as_bytes(), &mut rng)).unwrap();
        count(0, walking_log::read(&path, &experiment, &Silent).map(drop));
        let text = String::from_utf8_lossy(&damaged(EXPERIMENT.as_bytes(), &mut rng)).into_owned();
        count(1, Experiment::from_toml(&text).map(drop));
    }
    assert!(
        accepted.iter().chain(&refused).all(|n| *n > long::either(30, 100)),
        "{accepted:?} accepted, {refused:?} refused"
    );
}

/// Damaged files are read without a panic, and those that can still be read are diagnosed without one.
#[test]
fn damaged_files_never_panic() {
    let log = testbed::log(3, &Hidden::default(), 0.05).noisy;
    // Two conditions, two repetitions, few samples: in a small file, random damage reaches every part.
    let small: Vec<&str> = log
        .lines()
        .enumerate()
        .filter(|(i, l)| {
            *i == 0 || (i % 8 == 1 && ["0_0", "0_1", "9_0", "9_1"].contains(&l.split(',').next().unwrap()))
        })
        .map(|l| l.1)
        .collect();
    let base = small.join("\n").into_bytes();
    let directory = tempfile::tempdir().unwrap();
    let (path, experiment) = (directory.path().join("data.csv"), experiment());
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(1);
    let mut diagnosed = 0;
    for round in long::first(1500, 0..10_000) {
        let bytes = damaged(&base, &mut rng);
        std::fs::write(&path, &bytes).unwrap();
        if force_log::read(&path, &experiment, &Silent).is_ok() && round % long::either(2, 10) == 0 {
            let report = sound(&path, &experiment);
            assert!(report.json().unwrap().contains("verdict"));
            diagnosed += 1;
        }
    }
    assert!(diagnosed > long::either(8, 20), "{diagnosed} damaged files were still readable");
}
