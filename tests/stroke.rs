//! The task LegStroke: its forces are those of the sand, its reward is as documented, and the claims on its page hold.

use sandgait::env::Shard;
use sandgait::env::registry::Blueprint;
use sandgait::sand::{Law, LegShape, Medium, Regularization, SandBed, intrusion};
use sandgait::sim::carriage::CarriageEngine;
use sandgait::sim::engine::{Command, Integrator as _};
use sandgait::sim::model::Scene;
use sandgait::sim::{Model, Robot, State};
use serde_json::{Value, json};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

const ID: &str = "sandgait/LegStroke-v0";

fn medium() -> Medium {
    Medium::named("poppy-loose").unwrap()
}

fn leg(dt: f64) -> Model {
    let robot = Robot::stroke_leg().unwrap().with_leg_shape("flat").unwrap();
    Model::new(&robot, &Scene { dt, ..Scene::flat(medium()) }).unwrap()
}

/// The state after a motion with joint speeds that change every 20 ms, times `scale`, from the angles `start`, with the
/// carriage at `speed` [m/s].
fn driven(model: &Model, start: [f64; 2], speed: f64, rates: &dyn Fn(usize) -> [f64; 2], steps: usize) -> State {
    let mut engine = CarriageEngine::new(model, 1);
    let mut state = State::at_rest(0.02, &start);
    state.velocity[0] = speed;
    engine.set_state(0, &state);
    for k in 0..steps {
        engine.command(0, &Command { rates: rates(k).to_vec(), torques: vec![0.0; 2], targets: vec![] });
        engine.advance((0.02 / model.scene.dt).round() as usize);
    }
    engine.state(0, &mut state);
    state
}

/// Joint speeds of a stroke: the leg enters the sand, pushes, and leaves it.
fn paddle(k: usize) -> [f64; 2] {
    let phase = k as f64 / 50.0 * TAU;
    [4.0 + phase.sin(), 3.0 * (phase + 0.4).cos()]
}

/// With the knee at 90° the leg is the L leg of the paper's experiment; its forces agree with those of other code.
#[test]
fn forces_are_those_of_a_rotating_leg() {
    let surface = Regularization::default();
    let ground = SandBed::<f64>::new(Law::Li2013, &medium(), &surface);
    for (knee, xi) in [(FRAC_PI_2, PI / 4.0), (-FRAC_PI_2, -PI / 4.0)] {
        let mut largest: f64 = 0.0;
        for theta in [-1.0_f64, -0.7, -0.3, 0.1, 0.6] {
            // The paper's angle is that of the line from hip to tip, positive for a tip forward. Ours is that of the
            // upper link, positive for a tip backward.
            let hip = -theta - knee / 2.0;
            let (omega, dt) = (0.2, 1e-5);
            let model = leg(dt);
            let mut engine = CarriageEngine::new(&model, 1);
            let mut state = State::at_rest(0.02, &[hip + omega * dt / 2.0, knee]);
            engine.set_state(0, &state);
            engine.command(0, &Command { rates: vec![-omega, 0.0], torques: vec![0.0; 2], targets: vec![] });
            engine.advance(1);
            engine.state(0, &mut state);
            let segments = LegShape::TwoPiece { xi }.segments(0.076, 0.025, 24).unwrap();
            let load = intrusion::rotating_leg(&ground, &segments, theta, omega, 0.02);
            let force = state.impulse.map(|i| i / dt);
            for (ours, theirs) in [(force[0], load.fx), (force[2], load.fz)] {
                assert!((ours - theirs).abs() < 2e-3 * (1.0 + theirs.abs()), "knee {knee} θ {theta}: {ours} {theirs}");
            }
            // The motor's torque about +y balances the sand's, z·Fx − x·Fz.
            assert!((state.torques[0] - load.ty).abs() < 1e-4, "{} {}", state.torques[0], load.ty);
            largest = largest.max(load.fz.abs());
        }
        assert!(largest > 2.0, "the leg is in the sand");
    }
}

/// A mirrored stroke with a carriage that moves backward has the mirrored force.
#[test]
fn forward_and_backward_strokes_are_mirror_images() {
    let model = leg(4e-3);
    let there = driven(&model, [-1.75, 0.3], 0.2, &paddle, 50);
    let back = driven(&model, [1.75, -0.3], -0.2, &|k| paddle(k).map(|r| -r), 50);
    assert!(there.impulse[0] > 0.1, "it pushes: {:?}", there.impulse);
    assert!((there.impulse[0] + back.impulse[0]).abs() < 1e-9);
    assert!((there.impulse[2] - back.impulse[2]).abs() < 1e-9);
    assert!((there.work - back.work).abs() < 1e-9);
}

/// The sand never adds energy: the leg's work on the carriage is at most the motors' work.
#[test]
fn no_stroke_adds_energy() {
    let model = leg(4e-3);
    for seed in 0..200 {
        let rates =
            |k: usize| [0, 1].map(|j| TAU * ((seed * 31 + j * 17) as f64 + 0.3 * (seed % 7) as f64 * k as f64).sin());
        let state = driven(&model, [-1.75, 0.0], 0.2, &rates, 50);
        assert!(state.impulse[0] * 0.2 <= state.work, "seed {seed}: {:?} {}", state.impulse, state.work);
    }
}

/// On a carriage at rest, the same path at half the speed has twice the impulse for the same work. This is why the
/// carriage moves.
#[test]
fn a_standing_carriage_has_no_best_stroke() {
    let model = leg(1e-3);
    let [fast, slow] =
        [1, 2].map(|n| driven(&model, [-1.75, 0.3], 0.0, &|k| paddle(k / n).map(|r| r / n as f64), 50 * n));
    assert!(fast.impulse[0] > 0.1);
    assert!((slow.impulse[0] / fast.impulse[0] - 2.0).abs() < 0.01, "{:?} {:?}", slow.impulse, fast.impulse);
    assert!((slow.work / fast.work - 1.0).abs() < 0.01, "{} {}", slow.work, fast.work);
}

/// An eighth of the default time step gives the same efficiency.
#[test]
fn the_time_step_is_fine_enough() {
    let [coarse, fine] = [4e-3, 5e-4].map(|dt| driven(&leg(dt), [-1.75, 0.3], 0.2, &paddle, 50));
    let [a, b] = [coarse, fine].map(|s| s.impulse[0] * 0.2 / s.work);
    assert!((a / b - 1.0).abs() < 0.01, "{a} {b}");
}

/// A whole stroke with `options`: rewards, info rows, and the step in which it terminated.
fn stroke(options: Value, action: &dyn Fn(usize) -> [f32; 2]) -> (Vec<f32>, Vec<Vec<f32>>, usize) {
    let blueprint = Blueprint::new(ID, options).unwrap();
    let mut shard = Shard::new(&blueprint, 1).unwrap();
    shard.reset(|_| true, Some(&[0]), |_| None);
    let (mut rewards, mut infos) = (Vec::new(), Vec::new());
    for k in 0..200 {
        shard.step(&action(k));
        rewards.push(shard.rows.rewards[0]);
        infos.push(shard.rows.infos.clone());
        if shard.rows.terminated[0] == 1 {
            assert_eq!(shard.rows.truncated[0], 0);
            return (rewards, infos, k + 1);
        }
    }
    panic!("the stroke does not end");
}

fn column(name: &str) -> usize {
    let blueprint = Blueprint::new(ID, Value::Null).unwrap();
    blueprint.task.spec().info.iter().position(|c| c.name == name).unwrap()
}

fn paddled(k: usize) -> [f32; 2] {
    paddle(k).map(|r| (r / TAU) as f32)
}

/// The return is the efficiency minus the penalties, each as the task's page defines it.
#[test]
fn the_return_is_the_efficiency_less_the_penalties() {
    let [efficiency, mean_lift, thrust, work] = ["efficiency", "mean_lift", "thrust", "work"].map(column);
    for (lift, expect_missing) in [(0.1, false), (50.0, true)] {
        let options = json!({"stroke": {"lift": lift, "start": [-1.75, 0.3]}});
        let (rewards, infos, steps) = stroke(options, &paddled);
        assert_eq!(steps, 50);
        let sum = |i: usize| infos.iter().map(|row| f64::from(row[i])).sum::<f64>();
        let last = infos.last().unwrap().iter().map(|x| f64::from(*x)).collect::<Vec<_>>();
        let own = sum(thrust) / 50.0 * 0.2 / sum(work);
        assert!((own - last[efficiency]).abs() < 1e-4, "{own} {}", last[efficiency]);
        let missing = (1.0 - last[mean_lift] / lift).max(0.0);
        assert_eq!(missing > 0.0, expect_missing);
        let exit = sum(column("reward_exit"));
        let total: f64 = rewards.iter().map(|r| f64::from(*r)).sum();
        assert!((total - (own - 2.0 * missing + exit)).abs() < 1e-4, "{total}");
    }
}

#[test]
fn a_leg_that_stays_in_the_sand_is_penalised() {
    let exit = column("reward_exit");
    let down = |k: usize| if k < 12 { [1.0, 0.0] } else { [0.0, 0.0] };
    let (_, infos, _) = stroke(Value::Null, &down);
    assert_eq!(infos[49][exit], -1.0);
    assert!(infos[..49].iter().all(|row| row[exit] == 0.0));
    let (_, infos, steps) = stroke(json!({"max_episode_steps": 80}), &|_| [0.0, 0.0]);
    assert_eq!((infos[79][exit], steps), (0.0, 80));
}

#[test]
fn wrong_options_are_refused_in_one_line() {
    let refused = |options: Value| Blueprint::new(ID, options).err().unwrap().to_string();
    for (options, said) in [
        (json!({"stroke": {"start": [0.0, 0.0]}}), "stroke.start: [0.0, 0.0] begins 87.5 mm in the sand"),
        (json!({"stroke": {"start": [-1.75, 3.0]}}), "stroke.start[1]: 3 is outside [-2.6, 2.6]"),
        (json!({"stroke": {"carriage_speed": 0.0}}), "stroke.carriage_speed: 0 is outside [0.01, 0.5]"),
        (json!({"stroke": {"speed": 0.1}}), "stroke: key \"speed\" is unknown; known: "),
        (json!({"engine": "lanes"}), "engine: sandgait/LegStroke-v0 has no such option"),
        (json!({"stroke": null}), "stroke: null"),
    ] {
        let error = refused(options);
        assert!(error.starts_with(said), "{error}, not {said}");
    }
    let gait = Blueprint::new("sandgait/HexapodGait-v1", json!({"engine": "carriage"})).err().unwrap().to_string();
    assert_eq!(gait, "engine \"carriage\" is unknown; known: lanes, rapier");
}
