//! Forces in pictures are the forces that move the robot.

use super::engine::conserved;
use super::models::{block, on_hard, on_sand, plates, quadruped, run, scene, standing, trot};
use super::*;
use sandgait_number::Isa;
use sandgait_sim::engine::Integrator as _;
use sandgait_sim::model::Scene;
use sandgait_sim::tree::forces::{pushes, touching};
use sandgait_sim::{Model, State};
use std::sync::Arc;

fn on_dunes() -> Model {
    let relief = Some(Arc::new(sandgait_sim::tree::relief::Relief::dunes(3, 1.5, 15.0).unwrap()));
    let scene = Scene { relief, ..scene(1e-3) };
    Model::of_tree(TreeModel::new(quadruped(), plates(&quadruped())).unwrap(), &scene).unwrap()
}

fn grounds() -> [(&'static str, Model); 5] {
    [
        ("sand", on_sand(None)),
        ("slabs", on_sand(Some(0.0))),
        ("buried slabs", on_sand(Some(0.03))),
        ("hard slope", on_hard(quadruped(), 10.0, 1e-3)),
        ("dunes", on_dunes()),
    ]
}

fn sum(model: &Model, state: &State) -> V {
    pushes(model, state).iter().map(|p| p.force).sum()
}

/// In each time step of a trot, forces and weight change the momentum.
#[test]
fn forces_change_the_momentum() {
    for (name, model) in grounds() {
        let (weight, dt) = (model.total_mass() * sandgait_sand::GRAVITY, model.scene.dt);
        let mut engine = sandgait_sim::tree::engine(Isa::F64, &model, 1).unwrap();
        let mut state = standing(&quadruped());
        engine.set_state(0, &state);
        let (mut largest, mut worst) = (0.0_f64, 0.0_f64);
        for step in 0..40 {
            engine.command(0, &trot(0, step));
            engine.advance(20);
            engine.state(0, &mut state);
            let (before, force) = (conserved(&model, &state).0, sum(&model, &state));
            engine.advance(1);
            engine.state(0, &mut state);
            let change = (conserved(&model, &state).0 - before) / dt;
            largest = largest.max(force.norm() / weight);
            worst = worst.max((change - force - model.gravity * model.total_mass()).norm() / weight);
        }
        // The momentum after a step is computed for the bodies' new poses, which differ in the order of the time step.
        assert!(largest > 0.9 && worst < 0.02, "{name}: {largest} {worst}");
    }
}

/// The load on a foot that an engine keeps is the sum of the forces on the foot in the last time step, in every lane.
#[test]
fn foot_loads_are_the_forces_on_the_feet() {
    for (name, model) in grounds() {
        let weight = model.total_mass() * sandgait_sand::GRAVITY;
        let feet = model.tree.as_ref().unwrap().stance.feet.clone();
        for (isa, within) in [(Isa::F64, 1e-3), (Isa::Baseline, 5e-3)] {
            let mut engine = sandgait_sim::tree::engine(isa, &model, 2).unwrap();
            let mut state = standing(&quadruped());
            let mut loads = Vec::new();
            (0..2).for_each(|i| engine.set_state(i, &state));
            let (mut largest, mut least) = (0.0_f64, f64::INFINITY);
            for step in 0..40 {
                (0..2).for_each(|i| engine.command(i, &trot(0, step)));
                engine.advance(19);
                engine.state(1, &mut state);
                let pushes = pushes(&model, &state);
                engine.advance(1);
                engine.foot_loads(1, &mut loads);
                assert_eq!(loads.len(), feet.len());
                for (load, foot) in loads.iter().zip(&feet) {
                    let force: f64 = pushes.iter().filter(|p| p.body == *foot).map(|p| p.force.z).sum();
                    assert!((load - force).abs() < within * weight, "{name}, {isa:?}: {load} {force}");
                    (largest, least) = (largest.max(force / weight), least.min(force.abs() / weight));
                }
            }
            // The trot loads feet and lifts them.
            assert!(largest > 0.3 && least < 0.02, "{name}: {least} to {largest}");
        }
    }
}

/// The ground carries a standing robot at its feet.
#[test]
fn forces_carry_a_standing_robot() {
    for (name, model) in grounds() {
        let state = run(Isa::Baseline, &model, &standing(&quadruped()), 3.0);
        let weight = -model.gravity * model.total_mass();
        let (all, sum) = (pushes(&model, &state), sum(&model, &state));
        assert!((sum - weight).norm() < 0.02 * weight.norm(), "{name}: {sum} of {weight}");
        let bodies = touching(&model);
        assert!(all.iter().all(|p| bodies.contains(&p.body)), "{name}");
        for foot in [3, 6, 9, 12] {
            let own: V = all.iter().filter(|p| p.body == foot).map(|p| p.force).sum();
            assert!(own.dot(&weight) > 0.05 * weight.norm_squared(), "{name}, {foot}: {own} of {weight}");
        }
        for push in all {
            assert!(push.at.z < model.surface_height(push.at.x, push.at.y) + 0.02, "{name}: {push:?}");
        }
        let air = State { position: [0.0, 0.0, 5.0], ..state };
        assert!(pushes(&model, &air).is_empty(), "{name}");
    }
}

/// Pictures draw hard ground where the engine has it: a small ball is pushed just below the ground's top, and not just above it.
#[test]
fn hard_ground_is_where_it_is_drawn() {
    let mut tree = block([0.001; 3], 1.0, 0.5);
    tree.bodies[0].shapes[0].geometry = Geometry::Sphere { radius: 0.001 };
    let road = HardGround { center: [0.2, -0.3], size: [0.5, 0.3], every: [0.9, 0.0], depth: 0.02, grip: 1.0 };
    let step = HardGround { center: [-0.4, 0.5], size: [0.3, 0.4], every: [0.0; 2], depth: -0.05, grip: 1.0 };
    let model = Model::of_tree(
        TreeModel::new(tree, vec![Vec::new()]).unwrap(),
        &Scene { hard: vec![road, step], ..scene(1e-3) },
    );
    let (model, mut draw) = (model.unwrap(), SignedDraw::new(5));
    for _ in 0..200 {
        let [x, y] = [2.0 * draw.number(), 2.0 * draw.number()];
        let top = road.top([x, y]).min(step.top([x, y]));
        for (above, touches) in [(1e-5, false), (-1e-5, true)] {
            let state = State { position: [x, y, 0.001 - top + above], ..State::at_rest(0.0, &[]) };
            assert_eq!(!pushes(&model, &state).is_empty(), touches, "{x} {y} {top}");
        }
    }
}
