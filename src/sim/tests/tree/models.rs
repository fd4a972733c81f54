//! Robots and scenes of the tests.

use super::*;
use sandgait_number::{Isa, Vec3};
use sandgait_sand::Medium;
use sandgait_sand::intruder::{BodyShape, IntruderPlate, PlatedBody};
use sandgait_sim::engine::{Command, Integrator as _};
use sandgait_sim::model::Scene;
use sandgait_sim::{Model, State};

pub fn scene(dt: f64) -> Scene {
    Scene { dt, ..Scene::flat(Medium::named("poppy-loose").unwrap()) }
}

pub fn model_of(tree: Tree, dt: f64) -> Model {
    let plates = vec![Vec::new(); tree.bodies.len()];
    Model::of_tree(TreeModel::new(tree, plates).unwrap(), &scene(dt)).unwrap()
}

pub fn state_of(pose: &TreePose, height: f64) -> State {
    let mut state = State::at_rest(height, &pose.q);
    (state.orientation, state.velocity, state.angular_velocity) = (pose.quat, pose.v, pose.w);
    state.rates.clone_from(&pose.qd);
    state
}

/// The model with its servos switched off.
pub fn loosened(model: &Model) -> Model {
    let mut tree = (**model.tree.as_ref().unwrap()).clone();
    tree.motors.iter_mut().for_each(|m| (m.kp, m.kd) = (0.0, 0.0));
    Model::of_tree(tree, &model.scene).unwrap()
}

pub fn pose_of(state: &State) -> TreePose {
    TreePose {
        quat: state.orientation,
        v: state.velocity,
        w: state.angular_velocity,
        q: state.angles.clone(),
        qd: state.rates.clone(),
        tau: vec![0.0; state.angles.len()],
    }
}

/// A box of `mass` with its corners as points of contact.
pub fn block(half: [f64; 3], mass: f64, friction: f64) -> Tree {
    let [x, y, z] = half.map(|h| h * h * mass / 3.0);
    let shape = TreeShape {
        name: "block".into(),
        origin: Isometry3::identity(),
        geometry: Geometry::Box { half: V::from(half) },
        friction,
    };
    let body = TreeBody {
        name: "block".into(),
        parent: 0,
        origin: Isometry3::identity(),
        joint: None,
        mass,
        center: V::zeros(),
        inertia: M::from_diagonal(&V::new(y + z, x + z, x + y)),
        held: Default::default(),
        shapes: vec![shape],
    };
    Tree { name: "block".into(), bodies: vec![body], gravity: None }
}

pub fn on_hard(tree: Tree, slope_deg: f64, dt: f64) -> Model {
    let plates = vec![Vec::new(); tree.bodies.len()];
    let scene = Scene { slope_deg, hard: vec![HardGround::everywhere()], ..scene(dt) };
    Model::of_tree(TreeModel::new(tree, plates).unwrap(), &scene).unwrap()
}

/// The state after `time`.
pub fn run(isa: Isa, model: &Model, start: &State, time: f64) -> State {
    let mut engine = sandgait_sim::tree::engine(isa, model, 1).unwrap();
    engine.set_state(0, start);
    let mut state = start.clone();
    let steps = (time / model.scene.dt).round() as usize;
    for _ in 0..steps.div_ceil(20) {
        sandgait_number::flushed(|| engine.advance(20));
    }
    engine.state(0, &mut state);
    state
}

/// A quadruped whose feet are balls; each leg has a hip and a knee.
pub fn quadruped() -> Tree {
    let body = |name: String, parent, at: V, joint, mass: f64, half: V, center: V, shape| {
        let square = half.map(|h| h * h * mass / 3.0);
        let inertia = M::from_diagonal(&V::new(square.y + square.z, square.x + square.z, square.x + square.y));
        let origin = Isometry3::from_parts(at.into(), UnitQuaternion::identity());
        TreeBody { name, parent, origin, joint, mass, center, inertia, held: Default::default(), shapes: shape }
    };
    let joint = |name: String, axis: V, range, rest| {
        Some(TreeJoint {
            name,
            kind: JointKind::Hinge,
            axis: Unit::new_normalize(axis),
            range: Some(range),
            damping: 0.01,
            friction: 0.1,
            spring: None,
            mimic: None,
            armature: 0.005,
            torque_limit: Some(20.0),
            speed_limit: Some(20.0),
            motor: Default::default(),
            kp: Some(60.0),
            kd: Some(1.5),
            rest: Some(rest),
            target_time: None,
        })
    };
    let shape = |geometry, at: V| {
        let origin = Isometry3::from_parts(at.into(), UnitQuaternion::identity());
        vec![TreeShape { name: "shape".into(), origin, geometry, friction: 0.8 }]
    };
    let half = V::new(0.2, 0.1, 0.06);
    let trunk = shape(Geometry::Box { half }, V::zeros());
    let mut bodies = vec![body("trunk".into(), 0, V::zeros(), None, 6.0, half, V::new(0.01, 0.0, 0.0), trunk)];
    for (x, y, name) in [(1.0, 1.0, "FL"), (1.0, -1.0, "FR"), (-1.0, 1.0, "RL"), (-1.0, -1.0, "RR")] {
        let thin = V::new(0.015, 0.015, 0.1);
        let first = bodies.len();
        let at = V::new(0.18 * x, 0.08 * y, 0.0);
        let hip = joint(format!("{name}_hip"), V::x(), [-0.8, 0.8], 0.0);
        bodies.push(body(format!("{name}_hip"), 0, at, hip, 0.5, V::repeat(0.03), V::zeros(), vec![]));
        let thigh = joint(format!("{name}_thigh"), V::y(), [-1.0, 3.0], 0.8);
        let middle = V::new(0.0, 0.0, -0.1);
        bodies.push(body(format!("{name}_thigh"), first, V::y() * (0.05 * y), thigh, 0.8, thin, middle, vec![]));
        let calf = joint(format!("{name}_calf"), V::y(), [-2.7, -0.8], -1.5);
        let foot = shape(Geometry::Sphere { radius: 0.02 }, V::new(0.0, 0.0, -0.2));
        bodies.push(body(format!("{name}_calf"), first + 1, V::new(0.0, 0.0, -0.2), calf, 0.15, thin, middle, foot));
    }
    Tree { name: "quadruped".into(), bodies, gravity: None }
}

pub fn standing(tree: &Tree) -> State {
    let angles: Vec<f64> = tree.joints().map(|j| j.rest.unwrap()).collect();
    State::at_rest(0.35, &angles)
}

/// Plates of the balls at the feet; other bodies have none.
pub fn plates(tree: &Tree) -> Vec<Vec<IntruderPlate>> {
    let ball = PlatedBody::cut(&BodyShape::Sphere { radius: 0.02 }, Some(0.01)).unwrap().plates;
    let shifted = |p: &IntruderPlate| IntruderPlate { center: p.center + Vec3::new(0.0, 0.0, -0.2), ..*p };
    let foot: Vec<IntruderPlate> = ball.iter().map(shifted).collect();
    let is_calf = |b: &TreeBody| b.name.ends_with("calf");
    tree.bodies.iter().map(|b| if is_calf(b) { foot.clone() } else { Vec::new() }).collect()
}

/// Loose sand with slabs of hard ground at `depth` under the surface.
pub fn on_sand(slabs: Option<f64>) -> Model {
    let tree = quadruped();
    let plates = plates(&tree);
    let slab = |depth| HardGround { size: [0.3, 0.4], every: [0.6, 0.8], depth, ..HardGround::everywhere() };
    let scene = Scene { hard: slabs.map(slab).into_iter().collect(), ..scene(1e-3) };
    Model::of_tree(TreeModel::new(tree, plates).unwrap(), &scene).unwrap()
}

/// Commands of a trot in place, different for every robot.
pub fn trot(k: usize, step: usize) -> Command {
    let tree = quadruped();
    let t = step as f64 * 0.02;
    let phase = |i: usize| if matches!(i / 3, 0 | 3) { 0.0 } else { std::f64::consts::PI };
    let swing = |i: usize| (10.0 * t + phase(i) + 0.1 * k as f64).sin();
    let target = |(i, j): (usize, &TreeJoint)| j.rest.unwrap() + [0.0, 0.3, -0.3][i % 3] * swing(i);
    Command { targets: tree.joints().enumerate().map(target).collect(), ..Command::still(12) }
}
