//! A robot from a file on hard ground and in sand: agreement with MuJoCo, and convergence in the time step.

use sandgait::number::Isa;
use sandgait::robots;
use sandgait::sand::{Medium, Regularization};
use sandgait::sim::engine::{Command, Integrator as _};
use sandgait::sim::model::Scene;
use sandgait::sim::tree::plates::of_touching;
use sandgait::sim::tree::{self, HardGround, TreeModel};
use sandgait::sim::{Model, State};
use serde_json::Value;
use std::path::Path;

/// Our own quadruped from its MJCF, with the servos of the reference.
fn sandcat(hard: Vec<HardGround>, dt: f64, reference: &Value) -> Model {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("robots/sandcat.xml");
    let import = robots::load(&path).unwrap();
    let touching = import.touching(None).unwrap();
    let plates = of_touching(&import.tree, &touching, None).unwrap();
    let mut tree = TreeModel::new(import.tree, plates).unwrap();
    for motor in &mut tree.motors {
        (motor.kp, motor.kd) = (reference["kp"].as_f64().unwrap(), reference["kd"].as_f64().unwrap());
    }
    let medium = Medium::named("poppy-close").unwrap();
    let scene = Scene { hard, dt, surface: Regularization::SOLID, ..Scene::flat(medium) };
    Model::of_tree(tree, &scene).unwrap()
}

fn reference() -> Value {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/robots/sandcat_mujoco.json");
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

/// Joint targets of a trot that begins after half a second, as in the program that made the reference.
fn trot(rest: &[f64], t: f64) -> Vec<f64> {
    let ramp = (t - 0.5).clamp(0.0, 1.0);
    let target = |(i, rest): (usize, &f64)| {
        let phase = if matches!(i / 3, 0 | 3) { 0.0 } else { std::f64::consts::PI };
        let (sin, cos) = (12.0 * t + phase).sin_cos();
        rest + ramp * [0.0, 0.2 * cos + 0.15 * sin.max(0.0), -0.35 * sin.max(0.0)][i % 3]
    };
    rest.iter().enumerate().map(target).collect()
}

/// States every 20 ms.
fn run(model: &Model, isa: Isa, drop: f64, trots: bool, seconds: f64) -> Vec<State> {
    let tree = model.tree.as_ref().unwrap();
    let rest = tree.stance.angles.clone();
    let mut engine = tree::engine(isa, model, 1).unwrap();
    let mut state = State::at_rest(tree.standing_height(&rest) + drop, &rest);
    engine.set_state(0, &state);
    let steps = (0.02 / model.scene.dt).round() as usize;
    let control = |k: usize| {
        let targets = if trots { trot(&rest, k as f64 * 0.02) } else { rest.clone() };
        engine.command(0, &Command { targets, ..Command::still(rest.len()) });
        engine.advance(steps);
        engine.state(0, &mut state);
        state.clone()
    };
    (0..(seconds / 0.02) as usize).map(control).collect()
}

/// Dropped onto its feet, at rest and trotting, the trunk is where MuJoCo has it. The contact laws of the feet differ,
/// so the difference grows with time: 1.5 mm at rest, 3 mm after a second of trotting.
#[test]
fn a_quadruped_moves_as_in_mujoco() {
    let reference = reference();
    let model = sandcat(vec![HardGround::everywhere()], 1e-3, &reference);
    for (name, trots, bound) in [("stand", false, 1.7e-3), ("trot", true, 3e-3)] {
        let states = run(&model, Isa::F64, reference["start"].as_f64().unwrap(), trots, 3.0);
        for row in reference[name].as_array().unwrap() {
            let row: Vec<f64> = row.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect();
            let state = &states[(row[0] / 0.02).round() as usize - 1];
            for k in 0..3 {
                let off = (state.position[k] - row[1 + k]).abs();
                assert!(off < bound, "{name} at {} s: {:?}, MuJoCo {:?}", row[0], state.position, &row[1..4]);
            }
            assert!((state.rotation()[2][2] - row[4]).abs() < 2e-3, "{name} at {} s", row[0]);
        }
    }
}

/// In sand the trot is the same with half the time step, and with single precision.
#[test]
fn a_trot_in_sand_does_not_depend_on_the_time_step() {
    let reference = reference();
    let at = |dt: f64, isa: Isa| {
        let states = run(&sandcat(Vec::new(), dt, &reference), isa, 0.0, true, 2.0);
        states.last().unwrap().position
    };
    let (coarse, fine, single) = (at(1e-3, Isa::F64), at(2.5e-4, Isa::F64), at(1e-3, Isa::Baseline));
    for k in 0..3 {
        assert!((coarse[k] - fine[k]).abs() < 4e-3, "{coarse:?} {fine:?}");
        assert!((coarse[k] - single[k]).abs() < 4e-3, "{coarse:?} {single:?}");
    }
}

/// Feet that sink onto a slab buried in the sand stop there.
#[test]
fn a_buried_slab_stops_the_feet() {
    let reference = reference();
    let slab = |depth| vec![HardGround { depth, ..HardGround::everywhere() }];
    let height = |hard| run(&sandcat(hard, 1e-3, &reference), Isa::F64, 0.0, false, 1.0).last().unwrap().position[2];
    let (flush, buried, loose) = (height(slab(0.0)), height(slab(0.02)), height(Vec::new()));
    // The sand carries a part of the weight, so the knees bend less.
    assert!((flush - buried - 0.02).abs() < 3e-3, "{flush} {buried}");
    assert!(loose < buried - 0.005, "{loose} {buried}");
}
