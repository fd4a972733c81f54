//! The engine: laws of free flight, precision, the same bits wherever a robot is computed, servos and stops.

use super::*;
use crate::number::Isa;
use crate::sand::Medium;
use crate::sim::engine::Command;
use crate::sim::model::Scene;
use crate::sim::{Model, State};

fn scene(dt: f64) -> Scene {
    Scene { dt, ..Scene::flat(Medium::named("poppy-loose").unwrap()) }
}

fn model_of(tree: Tree, dt: f64) -> Model {
    let plates = vec![Vec::new(); tree.bodies.len()];
    Model::of_tree(TreeModel::new(tree, plates).unwrap(), &scene(dt)).unwrap()
}

fn state_of(pose: &Pose, height: f64) -> State {
    let mut state = State::at_rest(height, &pose.q);
    (state.orientation, state.velocity, state.angular_velocity) = (pose.quat, pose.v, pose.w);
    state.rates.clone_from(&pose.qd);
    state
}

/// Motors off and nothing that rubs.
fn loosened(model: &Model) -> Model {
    let mut tree = (**model.tree.as_ref().unwrap()).clone();
    tree.motors.iter_mut().for_each(|m| (m.kp, m.kd) = (0.0, 0.0));
    Model::of_tree(tree, &model.scene).unwrap()
}

fn pose_of(state: &State) -> Pose {
    Pose {
        quat: state.orientation,
        v: state.velocity,
        w: state.angular_velocity,
        q: state.angles.clone(),
        qd: state.rates.clone(),
        tau: vec![0.0; state.angles.len()],
    }
}

/// Momentum, angular momentum about the centre of mass, and energy.
fn conserved(model: &Model, state: &State) -> (V, V, f64) {
    let (tree, pose) = (&model.tree.as_ref().unwrap().tree, pose_of(state));
    let none = Accelerations { a: [0.0; 3], alpha: [0.0; 3], qdd: vec![0.0; pose.q.len()] };
    let motions = motions(tree, &pose, &none);
    let at = V::from(state.position);
    let center = |(b, m): (&TreeBody, &Moving)| m.at + m.turn * b.center;
    let parts = || tree.bodies.iter().zip(&motions);
    let middle = parts().map(|p| center(p) * p.0.mass).sum::<V>() / tree.mass();
    let (mut p, mut l, mut e) = (V::zeros(), V::zeros(), 0.0);
    for (body, m) in parts() {
        let c = center((body, m));
        let v = m.velocity(c);
        let inertia = m.turn.matrix() * body.inertia * m.turn.matrix().transpose();
        p += v * body.mass;
        l += (c - middle).cross(&(v * body.mass)) + inertia * m.w;
        e += 0.5 * body.mass * v.norm_squared() + 0.5 * m.w.dot(&(inertia * m.w))
            - body.mass * model.gravity.dot(&(at + c));
    }
    (p, l, e)
}

/// Where a robot is after `time` with nothing but gravity.
fn flown(tree: &Tree, pose: &Pose, dt: f64, time: f64) -> [(V, V, f64); 2] {
    let model = loosened(&model_of(tree.clone(), dt));
    let mut engine = TreeEngine::with_isa(Isa::F64, &model, 1).unwrap();
    let mut state = state_of(pose, 100.0);
    engine.set_state(0, &state);
    let before = conserved(&model, &state);
    engine.advance((time / dt).round() as usize);
    engine.state(0, &mut state);
    [before, conserved(&model, &state)]
}

/// In free flight momentum changes by gravity alone, angular momentum about the centre of mass and energy do not; what the time
/// step adds falls with it.
#[test]
fn free_flight_conserves() {
    let mut draw = Draw::new(3);
    for count in [1, 4, 13] {
        let tree = random_tree(&mut draw, count);
        let pose = random_pose(&mut draw, count - 1);
        let errors = [2e-4, 1e-4].map(|dt| {
            let [(p0, l0, e0), (p1, l1, e1)] = flown(&tree, &pose, dt, 0.2);
            let fallen = V::z() * (-0.2 * tree.mass() * crate::sand::GRAVITY);
            let scale = p0.norm() + fallen.norm();
            [(p1 - p0 - fallen).norm() / scale, (l1 - l0).norm() / l0.norm(), (e1 - e0).abs() / e0.abs().max(10.0)]
        });
        for k in 0..3 {
            let [coarse, fine] = errors.map(|e| e[k]);
            assert!(fine < 2e-3, "{count}: {errors:?}");
            assert!(fine < 0.6 * coarse + 1e-12, "{count}: {errors:?}");
        }
    }
}
