//! Measures the walking speed over the time step for both engines and prints the table of docs/convergence.md.
//! `cargo run --release --example convergence_study` (or `make study-convergence`)

use sandgait::number::Isa;
use sandgait::sand::Medium;
use sandgait::sim::engine::EngineKind;
use sandgait::sim::model::Scene;
use sandgait::sim::walk::{WalkTrial, walk_many};
use sandgait::sim::{Model, Robot};

const FREQUENCIES: [f64; 4] = [1.0, 2.0, 3.0, 5.0];
const STEPS: [f64; 5] = [2e-3, 1e-3, 5e-4, 2.5e-4, 1.25e-4];

/// Time step of the reference [s].
const FINE: f64 = 2e-5;

/// Speeds [m/s] at [`FREQUENCIES`].
fn speeds(engine: EngineKind, leg: &str, dt: f64) -> sandgait::Result<Vec<f64>> {
    let robot = Robot::load("xplorer")?.with_leg_shape(leg)?;
    let model = Model::new(&robot, &Scene { dt, ..Scene::flat(Medium::named("poppy-loose")?) })?;
    let trials = FREQUENCIES.map(|frequency| WalkTrial::new(model.clone(), frequency));
    Ok(walk_many(engine, &trials, &|_| Ok(()))?.iter().map(|r| r.speed).collect())
}

fn row(first: &str, dt: f64, cells: impl Iterator<Item = String>) {
    println!("| {first} | {} | {} |", dt * 1e3, cells.collect::<Vec<_>>().join(" | "));
}

fn main() -> sandgait::Result<()> {
    println!(
        "Instruction set of engine lanes: {} (f32). Speeds of the reference in cm/s, others as the",
        Isa::choose()?.name()
    );
    println!("deviation from it in percent.\n");
    for leg in ["L", "revL", "C", "revC"] {
        println!("## Leg {leg}\n\n| engine | dt [ms] | 1 Hz | 2 Hz | 3 Hz | 5 Hz |\n|---|---|---|---|---|---|");
        let reference = speeds(EngineKind::Rapier, leg, FINE)?;
        row("rapier, the reference", FINE, reference.iter().map(|v| format!("{:.2}", v * 1e2)));
        for engine in EngineKind::ALL {
            for dt in STEPS {
                let found = speeds(engine, leg, dt)?;
                row(
                    engine.name(),
                    dt,
                    found.iter().zip(&reference).map(|(v, r)| format!("{:+.2}", (v / r - 1.0) * 1e2)),
                );
            }
        }
        println!();
    }
    Ok(())
}
