//! Servos at their torque limit: how far the target runs ahead, and what happens when the command changes.

use sandgait::sand::Medium;
use sandgait::sim::engine::{Command, Engine, EngineKind};
use sandgait::sim::model::Scene;
use sandgait::sim::{Model, Robot, State};
use std::f64::consts::{PI, TAU};

/// Hip speed of 5 Hz [rad/s].
const FAST: f64 = 10.0 * PI;

fn model(torque_limit: f64, anti_windup: bool) -> Model {
    let mut robot = Robot::built_in("xplorer").unwrap();
    (robot.servo.torque_limit, robot.servo.anti_windup) = (Some(torque_limit), anti_windup);
    Model::new(&robot, &Scene::flat(Medium::named("poppy-loose").unwrap())).unwrap()
}

/// Drives a robot, set down in the tripod stance, at each rate [rad/s] for a time [s]. Returns the state at the end of
/// each stretch.
fn drive(kind: EngineKind, model: &Model, stretches: &[(f64, f64)]) -> Vec<State> {
    let angles = model.tripod_angles();
    let mut state = State::at_rest(model.standing_height(&angles), &angles);
    let mut engine = Engine::new(kind, model, 1).unwrap();
    engine.set_state(0, &state);
    let mut ends = Vec::new();
    for (rate, time) in stretches {
        engine.command(0, &Command { rates: vec![*rate; 6], torques: vec![0.0; 6], targets: vec![] });
        // States are read often enough to unwrap the angles below.
        engine.advance((time / model.scene.dt).round() as usize);
        engine.state(0, &mut state);
        ends.push(state.clone());
    }
    ends
}

/// The largest angle [rad] by which a hip turns in the 0.5 s after a full-speed command has ended.
fn overrun(kind: EngineKind, model: &Model) -> f64 {
    let mut stretches = vec![(FAST, 2.0)];
    stretches.extend([(0.0, 0.01); 50]);
    let states = drive(kind, model, &stretches);
    let turned = |hip: usize| -> f64 {
        states.windows(2).map(|w| (w[1].angles[hip] - w[0].angles[hip] + PI).rem_euclid(TAU) - PI).sum()
    };
    (0..6).map(|hip| turned(hip).abs()).fold(0.0, f64::max)
}

/// A motor of 8 mN·m cannot follow 5 Hz in sand. Without the lag limit its target gets turns ahead, and the hips turn
/// on by more than half a radian after the command has ended. With the limit, only their momentum carries them on.
#[test]
fn hips_stop_when_the_command_ends() {
    for kind in EngineKind::ALL {
        let [with, without] = [true, false].map(|anti_windup| overrun(kind, &model(0.008, anti_windup)));
        assert!(without > 0.5, "{}: {without} rad without the limit", kind.name());
        assert!(with < 0.3, "{}: {with} rad with the limit", kind.name());
    }
}

/// After 2 s of full speed forward, the torque reverses within 20 ms of the command.
#[test]
fn torque_follows_the_sign_of_the_command() {
    for kind in EngineKind::ALL {
        let states = drive(kind, &model(0.007, true), &[(FAST, 2.0), (-FAST, 0.02)]);
        assert!(states[1].torques.iter().all(|t| *t < 0.0), "{}: {:?}", kind.name(), states[1].torques);
        let lag = states.iter().flat_map(|s| s.references.iter().zip(&s.angles)).map(|(r, a)| (r - a).abs());
        assert!(lag.fold(0.0, f64::max) < 0.007 + 1e-6, "{}", kind.name());
    }
}

/// The lag limit does not change a bit of a standing robot, whose motors are below their torque limit.
#[test]
fn the_lag_limit_does_not_affect_unsaturated_motors() {
    for kind in EngineKind::ALL {
        let [with, without] = [true, false].map(|a| drive(kind, &model(1.0, a), &[(0.0, 0.5)]));
        assert_eq!(with, without, "{}", kind.name());
    }
}
