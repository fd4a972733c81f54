//! The reference hexapod as a tree, with the plates of engine `lanes`.

use super::models::scene;
use super::*;
use sandgait_number::Vec3;
use sandgait_sand::Regularization;
use sandgait_sand::intruder::IntruderPlate;
use sandgait_sim::engine::{Command, Engine, EngineKind};
use sandgait_sim::model::Scene;
use sandgait_sim::solid::Plate;
use sandgait_sim::walk::{WalkTrial, hip_angle, walk};
use sandgait_sim::{Model, Robot, State};

/// `plate` of a strip or, if `one_sided`, of the belly, as flat plates that push outward.
fn faces(plate: &Plate, one_sided: bool) -> Vec<IntruderPlate> {
    let vec3 = |v: V| Vec3::new(v.x, v.y, v.z);
    let across = if one_sided { V::x() } else { V::y() };
    let along = plate.normal.cross(&across);
    let face = |side: f64| IntruderPlate {
        center: vec3(plate.center),
        normal: vec3(plate.normal * side),
        area: plate.area,
        half: [vec3(along * (plate.area / plate.width / 2.0)), vec3(across * (plate.width / 2.0))],
        bend: [0.0, 0.0],
    };
    let sides: &[f64] = if one_sided { &[1.0] } else { &[1.0, -1.0] };
    sides.iter().map(|side| face(*side)).collect()
}

fn as_tree(robot: &Robot, scene: &Scene) -> Model {
    let lanes = Model::new(robot, scene).unwrap();
    let mut plates: Vec<Vec<IntruderPlate>> = vec![lanes.belly.iter().flat_map(|p| faces(p, true)).collect()];
    plates.extend(lanes.legs.iter().flatten().map(|body| body.plates.iter().flat_map(|p| faces(p, false)).collect()));
    let tree = of_robot("hexapod", robot).unwrap();
    Model::of_tree(TreeModel::new(tree, plates).unwrap(), scene).unwrap()
}

/// Forward speed [m/s] in the protocol of [`walk`]: hold, ramp, two strides, then four.
fn tree_speed(robot: &Robot, scene: &Scene, frequency: f64) -> f64 {
    let lanes = Model::new(robot, scene).unwrap();
    let angles = lanes.tripod_angles();
    let mut state = State::at_rest(lanes.standing_height(&angles), &angles);
    let mut engine = Engine::new(EngineKind::Tree, &as_tree(robot, scene), 1).unwrap();
    engine.set_state(0, &state);
    let start = 0.5 + 2.0 / frequency;
    let end = start + 4.0 / frequency;
    let mut from = 0.0;
    let steps = |time: f64| (time / scene.dt).round() as usize;
    for k in 0..steps(end) {
        if k == steps(start) {
            engine.state(0, &mut state);
            from = state.position[0];
        }
        let [_, rate] = hip_angle(frequency, (k as f64 + 0.5) * scene.dt);
        engine.command(0, &Command { rates: vec![rate; 6], ..Command::still(6) });
        sandgait_number::flushed(|| engine.advance(1));
    }
    engine.state(0, &mut state);
    (state.position[0] - from) / (end - start)
}

/// Engine `tree` has no gradual leading edge, so engine `lanes` with a sharp one is compared: within 1 % up to 3 Hz with the convex
/// side leading, except where legs leave the sand soon (5 Hz) or its concave side leads.
#[test]
fn the_reference_hexapod_walks_as_in_lanes() {
    for (leg, most) in [("L", 0.01), ("revL", 0.07)] {
        let mut robot = Robot::built_in("xplorer").unwrap();
        robot.leg.link[0].sand.as_mut().unwrap().shape = leg.into();
        for frequency in [1.0, 2.0, 3.0, 5.0] {
            let scene = Scene { surface: Regularization::SOLID, ..scene(1e-3) };
            let trial = WalkTrial::new(Model::new(&robot, &scene).unwrap(), frequency);
            let lanes = walk(EngineKind::Lanes, &trial).unwrap().speed;
            let tree = tree_speed(&robot, &scene, frequency);
            let most = if frequency > 3.0 { 0.05_f64.max(most) } else { most };
            assert!((tree / lanes - 1.0).abs() < most, "{leg} {frequency} Hz: {lanes} {tree}");
        }
    }
}
