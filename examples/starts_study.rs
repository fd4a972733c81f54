//! Compares the walking speed at a time step of 1 ms with the converged reference: means over 24 starts for gaits that
//! stick and slip, and walks with each mechanism alone. docs/convergence.md has the errors of the tables that it prints.
//! `cargo run --release --example starts_study` (or `make study-starts`)

use sandgait::Result;
use sandgait::parallel;
use sandgait::sand::Medium;
use sandgait::sand::mechanism::{CATALOG, Mechanisms, Side};
use sandgait::sim::engine::EngineKind;
use sandgait::sim::model::Scene;
use sandgait::sim::walk::{WalkTrial, walk_many};
use sandgait::sim::{Model, Robot};

/// Number of starts; the hips' angles differ by equal parts of a turn.
const STARTS: usize = 24;
/// Leg and stride frequency [Hz]. With the first two, legs stick and slip.
const WALKS: [(&str, f64); 4] = [("revL", 1.0), ("revC", 2.0), ("L", 2.0), ("revL", 2.0)];
/// Time steps of the reference, engine `rapier`, and of the tested engine `lanes` [s].
const FINE: f64 = 2e-5;
const JUDGED: f64 = 1e-3;

/// Speeds [m/s] of walks with one leg shape at one frequency, from `starts` different starts.
fn speeds(
    engine: EngineKind,
    dt: f64,
    (leg, frequency): (&str, f64),
    sand: Mechanisms,
    starts: usize,
) -> Result<Vec<f64>> {
    let robot = Robot::load("xplorer")?.with_leg_shape(leg)?;
    let scene = Scene { dt, mechanisms: sand, ..Scene::flat(Medium::named("poppy-loose")?) };
    let model = Model::new(&robot, &scene)?;
    let phase = |k: usize| std::f64::consts::TAU * k as f64 / STARTS as f64;
    let trials: Vec<WalkTrial> =
        (0..starts).map(|k| WalkTrial { phase: phase(k), ..WalkTrial::new(model.clone(), frequency) }).collect();
    let blocks: Vec<&[WalkTrial]> = trials.chunks(engine.shard_size()).collect();
    let walked = parallel::map(&blocks, |block| walk_many(engine, block, &|_| Ok(())));
    Ok(walked.into_iter().collect::<Result<Vec<_>>>()?.concat().iter().map(|r| r.speed).collect())
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Standard error of the mean of `values`.
fn error(values: &[f64]) -> f64 {
    let (n, m) = (values.len() as f64, mean(values));
    (values.iter().map(|v| (v - m) * (v - m)).sum::<f64>() / (n - 1.0) / n).sqrt()
}

fn main() -> Result<()> {
    println!("### Means over {STARTS} starts\n");
    println!(
        "| leg | rate [Hz] | reference [cm/s] | spread of starts [cm/s] | lanes at 1 ms [%] | standard error [%] |"
    );
    println!("|---|---|---|---|---|---|");
    for walk in WALKS {
        let reference = speeds(EngineKind::Rapier, FINE, walk, Mechanisms::PLAIN, STARTS)?;
        let judged = speeds(EngineKind::Lanes, JUDGED, walk, Mechanisms::PLAIN, STARTS)?;
        let (center, off): (f64, Vec<f64>) =
            (mean(&reference), judged.iter().zip(&reference).map(|(a, b)| a - b).collect());
        let spread = error(&reference) * (STARTS as f64).sqrt();
        let percent = 1e2 / center;
        let (deviation, sure) = (percent * mean(&off), percent * error(&off));
        let (center, spread) = (1e2 * center, 1e2 * spread);
        println!("| {} | {} | {center:.2} | {spread:.2} | {deviation:+.2} | {sure:.2} |", walk.0, walk.1);
    }
    println!("\n### Each mechanism alone, at its typical strength, 2 Hz\n");
    println!(
        "| mechanism | value | L, reference [cm/s] | lanes at 1 ms [%] | revL, reference [cm/s] | lanes at 1 ms [%] |"
    );
    println!("|---|---|---|---|---|---|");
    for (k, mechanism) in CATALOG.iter().enumerate() {
        if mechanism.side != Side::Sand || mechanism.unfelt.is_some() {
            continue;
        }
        let mut values = [0.0; Mechanisms::COUNT];
        values[k] = mechanism.typical;
        let sand = Mechanisms::from_values(values);
        let mut cells = String::new();
        for walk in [("L", 2.0), ("revL", 2.0)] {
            let reference = speeds(EngineKind::Rapier, FINE, walk, sand, 1)?[0];
            let judged = speeds(EngineKind::Lanes, JUDGED, walk, sand, 1)?[0];
            cells += &format!(" {:.2} | {:+.2} |", 1e2 * reference, 1e2 * (judged / reference - 1.0));
        }
        println!("| {} | {} |{cells}", mechanism.id, mechanism.typical);
    }
    Ok(())
}
