//! Forces for pictures.

use sandgait_sand::Medium;
use sandgait_sim::Robot;
use sandgait_sim::engine::{Command, Engine, EngineKind};
use sandgait_sim::frame::V;
use sandgait_sim::model::Scene;
use sandgait_sim::pose::*;
use sandgait_sim::{Model, State};

fn model(robot: &str) -> Model {
    Model::new(&Robot::load(robot).unwrap(), &Scene::flat(Medium::named("poppy-loose").unwrap())).unwrap()
}

/// Over several strides, the mean of the sand's forces is the robot's weight.
#[test]
fn the_forces_carry_the_robot() {
    let model = model("xplorer");
    let mut engine = Engine::new(EngineKind::Lanes, &model, 1).unwrap();
    let angles = model.tripod_angles();
    let mut state = State::at_rest(model.standing_height(&angles), &angles);
    engine.set_state(0, &state);
    let command = Command { rates: vec![std::f64::consts::TAU * 2.0; 6], torques: vec![0.0; 6], targets: vec![] };
    engine.command(0, &command);
    engine.advance(2000);
    let (mut sum, mut stances) = (V::zeros(), 0);
    // Eight strides of 0.5 s, sampled every 2 ms.
    for _ in 0..2000 {
        engine.advance(2);
        engine.state(0, &mut state);
        let pose = Pose::of(&model, &state, &[]);
        sum += pose.loads.iter().map(|l| l.force).sum::<V>();
        stances += pose.stance.iter().filter(|s| **s).count();
    }
    let weight = model.total_mass() * sandgait_sand::GRAVITY;
    let mean = sum / 2000.0;
    assert!((mean.z / weight - 1.0).abs() < 0.05, "{mean} of {weight} N");
    assert!(mean.x.abs() < 0.05 * weight && mean.y.abs() < 0.05 * weight, "{mean}");
    // In an alternating tripod about three of six legs stand.
    assert!((2.0..4.0).contains(&(f64::from(stances as u32) / 2000.0)), "{stances}");
}

#[test]
fn a_leg_on_used_ground_finds_its_share() {
    let model = model("xplorer");
    let mut state = State::at_rest(0.03, &model.tripod_angles());
    state.velocity[2] = -0.05;
    let footing = [0.5, 1.0, 1.0, 1.0, 1.0, 1.0];
    let (fresh, used) = (Pose::of(&model, &state, &[]), Pose::of(&model, &state, &footing));
    assert!(fresh.leg_forces[0].norm() > 0.01);
    assert!((used.leg_forces[0] * 2.0 - fresh.leg_forces[0]).norm() < 1e-12);
    assert_eq!(used.leg_forces[2], fresh.leg_forces[2]);
}

#[test]
fn nothing_pushes_in_the_air() {
    for robot in ["xplorer", "xplorer18"] {
        let model = model(robot);
        let state = State::at_rest(0.5, &vec![0.3; model.joints()]);
        let pose = Pose::of(&model, &state, &[]);
        assert_eq!(pose.loads.len(), segments(&model).len());
        assert_eq!(pose.bodies.len(), 1 + model.joints());
        assert!(pose.loads.iter().all(|l| l.force == V::zeros() && l.position.z > 0.3));
        assert!(pose.stance.iter().all(|s| !s));
    }
}
