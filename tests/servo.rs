//! Servos at their torque limit: how far the target runs ahead, and what happens when the command changes. Joints at the ends of their
//! ranges.

use sandgait::env::random::Random;
use sandgait::env::registry::Blueprint;
use sandgait::sand::Medium;
use sandgait::sim::engine::{Command, Engine, EngineKind};
use sandgait::sim::model::Scene;
use sandgait::sim::{Model, Robot, State};
use serde_json::json;
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

/// The lag limit changes no bit in the motion of a standing robot, because its motors are below their torque limit.
#[test]
fn the_lag_limit_does_not_affect_unsaturated_motors() {
    for kind in EngineKind::ALL {
        let [with, without] = [true, false].map(|a| drive(kind, &model(1.0, a), &[(0.0, 0.5)]));
        assert_eq!(with, without, "{}", kind.name());
    }
}

/// The hexapod with three joints a leg, with and without ranges.
fn ranged(kind: EngineKind, torque_limit: Option<f64>) -> [Model; 2] {
    let mut robot = Robot::built_in("xplorer18").unwrap();
    robot.servo.torque_limit = torque_limit;
    let scene = Scene { dt: kind.default_dt(), ..Scene::flat(Medium::named("poppy-loose").unwrap()) };
    let own = Model::new(&robot, &scene).unwrap();
    robot.leg.link.iter_mut().for_each(|link| link.range = None);
    [own, Model::new(&robot, &scene).unwrap()]
}

/// Largest distance of a joint beyond its range [rad].
fn beyond(ranges: &[[f64; 2]], state: &State) -> f64 {
    state.angles.iter().zip(ranges).map(|(x, [low, high])| (x - high).max(low - x)).fold(0.0, f64::max)
}

/// Pulls the joints of a robot in the air to `to` for 0.3 s. Returns the states after each time step.
fn pulled(kind: EngineKind, model: &Model, start: &State, to: f64) -> Vec<State> {
    let mut engine = Engine::new(kind, model, 1).unwrap();
    engine.set_state(0, &State { references: vec![to; model.joints()], ..start.clone() });
    engine.command(0, &Command::still(model.joints()));
    let steps = (0.3 / model.scene.dt).round() as usize;
    let mut state = start.clone();
    let step = |_| {
        engine.advance(1);
        engine.state(0, &mut state);
        state.clone()
    };
    (0..steps).map(step).collect()
}

/// A command that pulls every joint far beyond its range: the joints stop within 0.02 rad of it, in both engines, and
/// come back when the command does. Joints that stay within their range move bit-identically to joints without a range.
///
/// These motors have no speed limit and turn joints by up to 0.3 rad in a time step, so that the stops need some steps.
#[test]
fn joints_stop_at_the_ends_of_their_ranges() {
    for kind in EngineKind::ALL {
        for limit in [None, Some(0.05), Some(0.005)] {
            let [own, endless] = ranged(kind, limit);
            let ranges: Vec<_> = own.legs.iter().flatten().map(|body| body.range.unwrap()).collect();
            let start = State::at_rest(5.0, &[0.0; 18]);
            let what = format!("{} {limit:?}", kind.name());
            for to in [-4.0, 4.0] {
                let settled = (0.1 / own.scene.dt) as usize;
                let of = |state: &State| beyond(&ranges, state);
                let most = |states: &[State]| states[settled..].iter().map(of).fold(0.0, f64::max);
                let (held, free) = (pulled(kind, &own, &start, to), pulled(kind, &endless, &start, to));
                println!("{what}: {} rad beyond its range, {} rad without", most(&held), most(&free));
                assert!(held.iter().all(State::is_sound) && most(&held) < 0.02, "{what}: {}", most(&held));
                assert!(most(&free) > 0.2, "{what}: nothing pulled");
                let last = held.last().unwrap();
                let at_end = |(x, [low, high]): (&f64, &[f64; 2])| (x - high).max(low - x) > -0.05;
                assert!(last.angles.iter().zip(&ranges).all(at_end), "{what}: {:?}", last.angles);
                let back = pulled(kind, &own, last, 0.0);
                let returns = |joint: usize| back.iter().any(|state| state.angles[joint].abs() < 0.1);
                assert!(most(&back) < 0.02 && (0..18).all(returns), "{what}: held back");
            }
            assert_eq!(pulled(kind, &own, &start, 0.5), pulled(kind, &endless, &start, 0.5), "{what}");
        }
    }
}

/// The states of an episode of HexapodLegs, one for each control step, with the action `size` in turns of 0.5 s.
fn episode(version: &str, kind: EngineKind, size: f32) -> (Model, Vec<State>) {
    let options = json!({"engine": kind.name()});
    let blueprint = Blueprint::new(&format!("sandgait/HexapodLegs-{version}"), options).unwrap();
    let (task, model) = (&blueprint.task, blueprint.task.model());
    let (mut state, _) = task.begin(None, &mut Random::new(3, 0));
    let mut engine = Engine::new(kind, model, 1).unwrap();
    engine.set_state(0, &state);
    let mut command = Command::still(18);
    let step = |time: usize| {
        let action: Vec<f32> = (0..18).map(|k| if (time / 25 + k).is_multiple_of(2) { size } else { -size }).collect();
        task.command(&action, &state, &mut command);
        engine.command(0, &command);
        engine.advance((0.02 / model.scene.dt).round() as usize);
        engine.state(0, &mut state);
        state.clone()
    };
    let states = (0..100).map(step).collect();
    ((**model).clone(), states)
}

/// HexapodLegs-v2 differs from -v1 only where a stop acts.
#[test]
fn versions_of_hexapod_legs_differ_only_at_stops() {
    for kind in EngineKind::ALL {
        let what = kind.name();
        let ranges = episode("v2", kind, 0.0).0.legs.into_iter().flatten().map(|body| body.range.unwrap());
        let ranges: Vec<_> = ranges.collect();
        let most = |states: &[State]| states.iter().map(|state| beyond(&ranges, state)).fold(0.0, f64::max);
        let [old, new] = ["v1", "v2"].map(|version| episode(version, kind, 0.6).1);
        assert!(most(&old) == 0.0 && old == new, "{what}");
        let [old, new] = ["v1", "v2"].map(|version| episode(version, kind, 1.0).1);
        println!("{what}: {} rad beyond the range in v1, {} rad in v2", most(&old), most(&new));
        assert!(most(&old) > 0.01 && most(&new) < 0.005, "{what}: {} {}", most(&old), most(&new));
        let first = old.iter().zip(&new).position(|(old, new)| old != new).unwrap();
        assert!(first > 0 && most(&old[..=first]) > 0.0, "{what}: they differ at step {first}");
    }
}

/// An episode of HexapodLegs-v2 begins within the joints' ranges.
#[test]
fn episodes_begin_within_the_stops() {
    let options = json!({"angle_noise": PI});
    let ranged = Blueprint::new("sandgait/HexapodLegs-v2", options).unwrap();
    let ranges: Vec<_> = ranged.task.model().legs.iter().flatten().map(|body| body.range.unwrap()).collect();
    for seed in 0..20 {
        let (state, _) = ranged.task.begin(None, &mut Random::new(seed, 0));
        assert_eq!(beyond(&ranges, &state), 0.0);
    }
}
