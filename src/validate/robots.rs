//! Robots in free flight and on hard ground, compared with pinocchio and MuJoCo. There is no sand here: the
//! comparisons check the rigid bodies.

use crate::error::{Error, Result};
use crate::number::Isa;
use crate::sand::{Medium, Regularization};
use crate::sim::engine::{Command, Integrator as _};
use crate::sim::model::Scene;
use crate::sim::tree::plates::of_touching;
use crate::sim::tree::{self, HardGround, TreeModel};
use crate::sim::{Model, State};
use sandgait_robots::{self as robots, states};
use serde::Deserialize;
use std::fmt::Write as _;
use std::path::Path;

macro_rules! flight {
    ($robot:literal, $folder:literal, $results:literal, $program:literal) => {
        (
            $robot,
            include_str!(concat!("../../", $folder, $robot)),
            include_str!(concat!("../../tests/data/robots/", $results)),
            $program,
        )
    };
}

/// A robot's file, another program's results for it, and that program. tests/data/robots/README.md describes how
/// they were made.
const FLIGHTS: [(&str, &str, &str, &str); 5] = [
    flight!("solo12.urdf", "tests/data/robots/", "solo12.json", "pinocchio 4.1.0"),
    flight!("odd.urdf", "tests/data/robots/", "odd_urdf.json", "pinocchio 4.1.0"),
    flight!("sandcat.urdf", "robots/", "sandcat_urdf.json", "pinocchio 4.1.0"),
    flight!("odd.xml", "tests/data/robots/", "odd_mjcf.json", "MuJoCo 4.0.0"),
    flight!("sandcat.xml", "robots/", "sandcat_mjcf.json", "MuJoCo 4.0.0"),
];

/// MuJoCo's results for a quadruped that is dropped onto a hard floor, rests, and trots.
const FLOOR: &str = include_str!("../../tests/data/robots/sandcat_mujoco.json");

#[derive(Deserialize)]
struct Flight {
    rows: Vec<ReferenceAccelerations>,
}

#[derive(Deserialize)]
struct ReferenceAccelerations {
    a: Vec<f64>,
    alpha: Vec<f64>,
    qdd: Vec<f64>,
}

#[derive(Deserialize)]
struct ReferenceFloor {
    kp: f64,
    kd: f64,
    start: f64,
    stand: Vec<Vec<f64>>,
    trot: Vec<Vec<f64>>,
}

fn read<'a, T: Deserialize<'a>>(text: &'a str) -> Result<T> {
    serde_json::from_str(text).map_err(|e| Error::Internal(format!("data that are compiled in: {e}")))
}

/// The comparisons as Markdown.
pub fn text() -> Result<String> {
    let folder = tempfile::tempdir().map_err(|e| Error::Exhausted(format!("no directory for temporary files: {e}")))?;
    let mut text = String::from(
        "## Comparison of robots with pinocchio and MuJoCo\n\nThis is a test of bodies, joints and servos, without sand. Each row has the \
         accelerations of a robot in free flight at random states. The difference is the largest one in % of the largest acceleration \
         of its kind (linear, angular, joint):\n\n| robot | program | states | difference % |\n|---|---|---|---|\n",
    );
    for (name, robot, reference, program) in FLIGHTS {
        let (count, worst) = flight(folder.path(), name, robot, reference)?;
        let _ = writeln!(text, "| {name} | {program} | {count} | {:.0e} |", 100.0 * worst);
    }
    let floor: ReferenceFloor = read(FLOOR)?;
    text += "\nA quadruped is dropped on a hard floor and simulated for three seconds, here and by MuJoCo 4.0, which has another contact law:\n\n\
             | motion | compared times | largest distance of the trunks [mm] |\n|---|---|---|\n";
    for (name, trots, rows) in [("stands", false, &floor.stand), ("trots", true, &floor.trot)] {
        let _ = writeln!(text, "| {name} | {} | {:.1} |", rows.len(), 1e3 * moved(&floor, trots, rows)?);
    }
    Ok(text)
}

/// Number of states, and the largest relative difference.
fn flight(folder: &Path, name: &str, robot: &str, reference: &str) -> Result<(usize, f64)> {
    let save = |name: &str, text: &str| {
        let path = folder.join(name);
        std::fs::write(&path, text).map_err(|e| Error::unwritten(&path, &e)).map(|()| path)
    };
    let (robot, rows) = (save(name, robot)?, save("rows.json", reference)?);
    let found = states::compute(&robots::load(&robot)?.tree, &rows)?;
    let wanted: Flight = read(reference)?;
    let mut worst: f64 = 0.0;
    for (row, found) in wanted.rows.iter().zip(&found) {
        for (wanted, found) in [(&row.a, &found.a[..]), (&row.alpha, &found.alpha[..]), (&row.qdd, &found.qdd[..])] {
            let size = wanted.iter().fold(f64::MIN_POSITIVE, |m, x| m.max(x.abs()));
            worst = wanted.iter().zip(found).map(|(x, y)| (x - y).abs() / size).fold(worst, f64::max);
        }
    }
    Ok((found.len(), worst))
}

/// The quadruped with the servo gains of the reference simulation.
fn quadruped(floor: &ReferenceFloor) -> Result<Model> {
    let folder = tempfile::tempdir().map_err(|e| Error::Exhausted(format!("no directory for temporary files: {e}")))?;
    let path = folder.path().join("sandcat.xml");
    std::fs::write(&path, FLIGHTS[4].1).map_err(|e| Error::unwritten(&path, &e))?;
    let import = robots::load(&path)?;
    let plates = of_touching(&import.tree, &import.touching(None)?, None)?;
    let mut tree = TreeModel::new(import.tree, plates)?;
    for motor in &mut tree.motors {
        (motor.kp, motor.kd) = (floor.kp, floor.kd);
    }
    let hard = vec![HardGround::everywhere()];
    let scene = Scene { hard, surface: Regularization::SOLID, ..Scene::flat(Medium::named("poppy-close")?) };
    Model::of_tree(tree, &scene)
}

/// Targets of a trot that begins after half a second.
fn trot(rest: &[f64], t: f64) -> Vec<f64> {
    let ramp = (t - 0.5).clamp(0.0, 1.0);
    let target = |(i, rest): (usize, &f64)| {
        let phase = if matches!(i / 3, 0 | 3) { 0.0 } else { std::f64::consts::PI };
        let (sin, cos) = (12.0 * t + phase).sin_cos();
        rest + ramp * [0.0, 0.2 * cos + 0.15 * sin.max(0.0), -0.35 * sin.max(0.0)][i % 3]
    };
    rest.iter().enumerate().map(target).collect()
}

/// Largest distance of the trunk from the reference [m].
fn moved(floor: &ReferenceFloor, trots: bool, rows: &[Vec<f64>]) -> Result<f64> {
    /// Interval at which targets change [s], as in the reference.
    const CONTROL: f64 = 0.02;
    let model = quadruped(floor)?;
    let Some(tree) = model.tree.as_ref() else { return Err(Error::Internal("the quadruped is no tree".into())) };
    let rest = tree.stance.angles.clone();
    let mut engine = tree::engine(Isa::F64, &model, 1)?;
    let mut state = State::at_rest(tree.standing_height(&rest) + floor.start, &rest);
    engine.set_state(0, &state);
    let (mut step, mut worst) = (0, 0.0);
    for row in rows {
        while step < (row[0] / CONTROL).round() as usize {
            let targets = if trots { trot(&rest, step as f64 * CONTROL) } else { rest.clone() };
            engine.command(0, &Command { targets, ..Command::still(rest.len()) });
            engine.advance((CONTROL / model.scene.dt).round() as usize);
            step += 1;
        }
        engine.state(0, &mut state);
        worst = (0..3).map(|k| (state.position[k] - row[1 + k]).abs()).fold(worst, f64::max);
    }
    Ok(worst)
}
