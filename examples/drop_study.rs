//! Drops a robot on hard ground from 5 cm and prints, every 20 ms for 2 s: time, x, y, z of the base [m], and the cosine of
//! its tilt. `examples/drop_study.py` compares this with MuJoCo.
//!
//! `cargo run --release --example drop_study -- FILE KP KD ANGLE,…`: gains of all servos [N·m/rad, N·m·s/rad] and the joints'
//! start and target positions.

use sandgait::number::Isa;
use sandgait::robots;
use sandgait::sand::Medium;
use sandgait::sim::actuator::Actuator;
use sandgait::sim::engine::{Command, Integrator as _};
use sandgait::sim::model::Scene;
use sandgait::sim::tree::{self, HardGround, TreeModel};
use sandgait::sim::{Model, State};
use sandgait::{Error, Result};
use std::path::Path;

/// Height above the ground at the start [m], and interval of the rows [s].
const START: f64 = 0.05;
const INTERVAL: f64 = 0.02;

fn number(text: &str) -> Result<f64> {
    text.parse().map_err(|_| Error::invalid("arguments", format!("{text:?} is no number")))
}

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [file, kp, kd, angles] = &arguments[..] else {
        return Err(Error::invalid("arguments", "FILE KP KD ANGLE,…"));
    };
    let angles = angles.split(',').map(number).collect::<Result<Vec<f64>>>()?;
    let import = robots::load(Path::new(file))?;
    let plates = vec![Vec::new(); import.tree.bodies.len()];
    let mut tree = TreeModel::new(import.tree, plates)?;
    if angles.len() != tree.joints() {
        return Err(Error::invalid("arguments", format!("{} joints, {} angles", tree.joints(), angles.len())));
    }
    for motor in &mut tree.motors {
        (motor.kp, motor.kd) = (number(kp)?, number(kd)?);
        (motor.speed_limit, motor.actuator) = (None, Actuator::default());
    }
    let height = tree.standing_height(&angles) + START;
    let scene = Scene { hard: vec![HardGround::everywhere()], dt: 1e-4, ..Scene::flat(Medium::named("poppy-close")?) };
    let model = Model::of_tree(tree, &scene)?;
    let mut engine = tree::engine(Isa::F64, &model, 1)?;
    let mut state = State::at_rest(height, &angles);
    engine.set_state(0, &state);
    engine.command(0, &Command { targets: angles.clone(), ..Command::still(angles.len()) });
    for row in 0..=100 {
        let [x, y, z] = state.position;
        println!("{} {x} {y} {z} {}", f64::from(row) * INTERVAL, state.rotation()[2][2]);
        engine.advance((INTERVAL / scene.dt).round() as usize);
        engine.state(0, &mut state);
    }
    Ok(())
}
