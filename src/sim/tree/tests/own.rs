//! Contact between bodies of one robot, and springs of joints.

use super::engine::{conserved, quadruped, scene, standing};
use super::*;
use crate::engine::Command;
use crate::number::Isa;
use crate::{Model, State};

/// The quadruped in free flight without gravity; its calves can touch each other. `own`: do its bodies push each other?
fn floating(own: bool) -> Model {
    let mut tree = quadruped();
    for body in tree.bodies.iter_mut().filter(|b| b.name.ends_with("calf")) {
        let origin = Isometry3::from_parts(V::new(0.0, 0.0, -0.1).into(), UnitQuaternion::identity());
        let geometry = Geometry::Capsule { radius: 0.02, half_length: 0.1 };
        body.shapes.push(TreeShape { name: "calf".into(), origin, geometry, friction: 1.0 });
    }
    let plates = vec![Vec::new(); tree.bodies.len()];
    let mut model = TreeModel::new(tree, plates).unwrap();
    for motor in &mut model.motors {
        motor.speed_limit = None;
    }
    let model = if own { model } else { model.without_self_contact() };
    let mut model = Model::of_tree(model, &scene(1e-3)).unwrap();
    model.gravity = V::zeros();
    model
}

/// Left and right legs swing towards each other; returns the least distance of the front feet's places along y, and the
/// final state.
fn squeezed(model: &Model, isa: Isa) -> (f64, State) {
    let tree = &model.tree.as_ref().unwrap().tree;
    let mut state = standing(tree);
    state.position[2] = 10.0;
    let mut engine = TreeEngine::with_isa(isa, model, 1).unwrap();
    engine.set_state(0, &state);
    let mut targets = state.angles.clone();
    // Hips turn the left legs to the right and the right ones to the left.
    for (leg, inward) in [(0, -0.8), (1, 0.8), (2, -0.8), (3, 0.8)] {
        targets[3 * leg] = inward;
    }
    let zeros = vec![0.0; targets.len()];
    engine.command(0, &Command { rates: zeros.clone(), torques: zeros, targets });
    let mut least = f64::INFINITY;
    for _ in 0..500 {
        engine.advance(1);
        engine.state(0, &mut state);
        let frames = stance::frames(tree, &state);
        let foot = |b: usize| frames[b].transform_point(&V::new(0.0, 0.0, -0.2).into()).coords;
        let across = frames[0].rotation * V::y();
        least = least.min(across.dot(&(foot(3) - foot(6))));
    }
    (least, state)
}

/// Legs that are pulled through each other stop where they touch; without self-contact they pass. Contact makes neither
/// momentum nor angular momentum.
#[test]
fn legs_do_not_pass_through_each_other() {
    for isa in [Isa::F64, Isa::Baseline] {
        let (own, none) = (floating(true), floating(false));
        let ((held, state), (passed, _)) = (squeezed(&own, isa), squeezed(&none, isa));
        assert!(passed < -0.05, "{isa:?}: they do not meet: {passed}");
        assert!(held > 0.02, "{isa:?}: {held}");
        let (p, l, _) = conserved(&own, &state);
        let small = if isa == Isa::F64 { 1e-3 } else { 1e-2 };
        assert!(p.norm() < small && l.norm() < small, "{isa:?}: {p} {l}");
    }
}

/// A lane whose legs touch does not change a bit of its neighbours.
#[test]
fn self_contact_stays_in_its_lane() {
    let model = floating(true);
    let tree = &model.tree.as_ref().unwrap().tree;
    let start = |_| State { position: [0.0, 0.0, 10.0], ..standing(tree) };
    let run = |pulled: &[usize]| {
        let mut engine = TreeEngine::with_isa(Isa::Baseline, &model, 4).unwrap();
        for lane in 0..4 {
            let state: State = start(lane);
            engine.set_state(lane, &state);
            let mut targets = state.angles.clone();
            if pulled.contains(&lane) {
                for (leg, inward) in [(0, -0.8), (1, 0.8), (2, -0.8), (3, 0.8)] {
                    targets[3 * leg] = inward;
                }
            }
            let zeros = vec![0.0; targets.len()];
            engine.command(lane, &Command { rates: zeros.clone(), torques: zeros, targets });
        }
        engine.advance(300);
        let mut state = start(0);
        engine.state(2, &mut state);
        state
    };
    assert_eq!(run(&[]), run(&[0, 1]));
    assert_ne!(run(&[]), run(&[2]));
}

/// A pendulum with a spring and a heavy base swings about the spring's rest with the frequency √(k/I).
#[test]
fn a_spring_swings() {
    let (stiffness, rest, dt) = (2.0, 0.3, 1e-4);
    let mut tree = quadruped();
    tree.bodies.truncate(2);
    tree.bodies[0].mass = 1e5;
    tree.bodies[0].inertia = M::identity() * 1e5;
    let (mass, arm) = (0.5, 0.2);
    let pendulum = &mut tree.bodies[1];
    (pendulum.mass, pendulum.center, pendulum.inertia) = (mass, V::new(0.0, 0.0, -arm), M::identity() * 1e-3);
    let joint = pendulum.joint.as_mut().unwrap();
    (joint.range, joint.damping, joint.friction, joint.armature) = (None, 0.0, 0.0, 0.0);
    (joint.kp, joint.kd, joint.spring) = (Some(0.0), Some(0.0), Some([stiffness, rest]));
    let mut model = Model::of_tree(TreeModel::new(tree, vec![Vec::new(); 2]).unwrap(), &scene(dt)).unwrap();
    model.gravity = V::zeros();
    let mut engine = TreeEngine::with_isa(Isa::F64, &model, 1).unwrap();
    let mut state = State::at_rest(10.0, &[0.0]);
    engine.set_state(0, &state);
    let period = std::f64::consts::TAU * ((1e-3 + mass * arm * arm) / stiffness).sqrt();
    engine.advance((period / 2.0 / dt).round() as usize);
    engine.state(0, &mut state);
    assert!((state.angles[0] - 2.0 * rest).abs() < 2e-3, "{}", state.angles[0]);
    engine.advance((period / 2.0 / dt).round() as usize);
    engine.state(0, &mut state);
    assert!(state.angles[0].abs() < 4e-3, "{}", state.angles[0]);
}
