//! The engine `rapier`: physical laws first, then converged reference walks.

#[path = "../testbed/long.rs"]
mod long;
mod walks;

use sandgait::sand::{Mechanisms, Medium};
use sandgait::sim::engine::{Command, Engine, EngineKind, Integrator as _};
use sandgait::sim::model::Scene;
use sandgait::sim::rapier::RapierEngine;
use sandgait::sim::walk::{WalkResult, WalkTrial, walk_many};
use sandgait::sim::{Model, Robot, State};

type V = nalgebra::Vector3<f64>;
type Q = nalgebra::UnitQuaternion<f64>;

fn scene() -> Scene {
    let flat = Scene::flat(Medium::named("poppy-loose").unwrap());
    Scene { dt: EngineKind::Rapier.default_dt(), ..flat }
}

fn model_of(robot: &str, leg: &str, scene: &Scene, change: impl Fn(&mut Robot)) -> Model {
    let mut robot = Robot::load(robot).unwrap().with_leg_shape(leg).unwrap();
    change(&mut robot);
    Model::new(&robot, scene).unwrap()
}

fn walk(trials: &[WalkTrial]) -> Vec<WalkResult> {
    walk_many(EngineKind::Rapier, trials, &|_| Ok(())).unwrap()
}

/// Total energy [J], momentum [kg·m/s] and angular momentum about the world's origin [kg·m²/s] of a state.
fn mechanics(model: &Model, state: &State) -> (f64, V, V) {
    let [w, x, y, z] = state.orientation;
    let rotation = Q::from_quaternion(nalgebra::Quaternion::new(w, x, y, z));
    let (position, velocity) = (V::from(state.position), V::from(state.velocity));
    let omega = V::from(state.angular_velocity);
    let mut sum = (0.0, V::zeros(), V::zeros());
    let mut add = |mass: f64, inertia: nalgebra::Matrix3<f64>, turn: &Q, at: V, v: V, omega: V| {
        let spin = turn * (inertia * (turn.inverse() * omega));
        sum.0 += 0.5 * (mass * v.norm_squared() + omega.dot(&spin)) - mass * model.gravity.dot(&at);
        sum.1 += v * mass;
        sum.2 += spin + at.cross(&v) * mass;
    };
    let base_inertia = nalgebra::Matrix3::from_diagonal(&model.base_inertia);
    add(model.base_mass, base_inertia, &rotation, position, velocity, omega);
    let mut rotors = 0.0;
    let mut joint = 0;
    for chain in &model.legs {
        let (mut turn, mut origin, mut v, mut w) = (rotation, position, velocity, omega);
        for body in chain {
            let arm = turn * body.joint;
            v += w.cross(&arm);
            origin += arm;
            w += turn * body.axis * state.rates[joint];
            turn *= Q::from_axis_angle(&nalgebra::Unit::new_normalize(body.axis), state.angles[joint]);
            let center = turn * body.center;
            add(body.mass, body.inertia, &turn, origin + center, v + w.cross(&center), w);
            rotors += 0.5 * body.armature * state.rates[joint].powi(2);
            joint += 1;
        }
    }
    sum.0 += rotors;
    sum
}

/// A state in which everything moves.
fn tumbling(model: &Model, height: f64) -> State {
    let n = model.joints();
    let mut state = State::at_rest(height, &(0..n).map(|i| 0.7 * i as f64 - 1.0).collect::<Vec<_>>());
    let q = Q::from_euler_angles(0.3, -0.4, 0.9);
    state.orientation = [q.w, q.i, q.j, q.k];
    state.velocity = [0.2, -0.1, 0.3];
    state.angular_velocity = [2.0, -3.0, 1.5];
    state.rates = (0..n).map(|i| [8.0, -7.0, 5.0, -3.0, 6.0][i % 5]).collect();
    state
}

fn passive(robot: &mut Robot) {
    robot.servo.kp = 0.0;
    robot.servo.kd = 0.0;
    // Stops take energy.
    robot.leg.link.iter_mut().for_each(|link| link.range = None);
}

/// Advances one robot from `state` by `time` [s].
fn run(model: &Model, state: &State, command: &Command, time: f64) -> State {
    let mut engine = RapierEngine::new(model, 1);
    engine.set_state(0, state);
    engine.command(0, command);
    engine.advance((time / model.scene.dt).round() as usize);
    let mut out = state.clone();
    engine.state(0, &mut out);
    out
}

fn hips(model: &Model, frequency: f64) -> Command {
    let mut command = Command::still(model.joints());
    command.rates.fill(std::f64::consts::TAU * frequency);
    command
}

fn advance(engine: &mut RapierEngine, steps: usize, state: &State) -> State {
    engine.advance(steps);
    let mut out = state.clone();
    engine.state(0, &mut out);
    out
}

#[test]
fn free_flight_keeps_energy_and_momentum() {
    for (robot, leg) in [("xplorer", "L"), ("xplorer18", "flat")] {
        // Relative change over 0.5 s without gravity; moments about the starting point.
        let drift = |dt: f64| {
            let mut model = model_of(robot, leg, &Scene { dt, ..scene() }, passive);
            model.gravity *= 0.0;
            let mut start = tumbling(&model, 100.0);
            let mut end = run(&model, &start, &Command::still(model.joints()), 0.5);
            start.position[2] -= 100.0;
            end.position[2] -= 100.0;
            let (a, b) = (mechanics(&model, &start), mechanics(&model, &end));
            [(b.0 - a.0).abs() / a.0, (b.1 - a.1).norm() / a.1.norm(), (b.2 - a.2).norm() / a.2.norm()]
        };
        let (coarse, fine) = (drift(5e-4), drift(1e-4));
        // The error is of first order in the time step, as expected of semi-implicit Euler.
        for ((coarse, fine), limit) in coarse.into_iter().zip(fine).zip([3e-3, 5e-4, 3e-2]) {
            assert!(coarse < limit && fine < limit / 4.0, "{robot}: {coarse:e} {fine:e}");
        }
    }
}

#[test]
fn a_falling_robot_gains_the_momentum_of_its_weight() {
    let model = model_of("xplorer", "L", &Scene { slope_deg: 20.0, ..scene() }, passive);
    let start = tumbling(&model, 100.0);
    let end = run(&model, &start, &Command::still(6), 0.5);
    let gained = mechanics(&model, &end).1 - mechanics(&model, &start).1;
    let impulse = model.gravity * (model.total_mass() * 0.5);
    assert!((gained - impulse).norm() < 1e-4 * impulse.norm(), "{gained} {impulse}");
}

/// The servo of a leg on a fixed base: one step agrees with the equation kp(θ_ref⁺ − θ⁺) + kd(ω_ref − ω⁺) = torque,
/// solved by hand for the leg's inertia about its hinge, with the torque limit.
#[test]
fn servo_is_implicit_armature_counts_and_the_limit_holds() {
    for limit in [None, Some(2e-3)] {
        let mut model = model_of("xplorer", "L", &scene(), |r| {
            r.servo.torque_limit = limit;
            r.base.mass = 1e3;
        });
        model.gravity *= 0.0;
        let dt = model.scene.dt;
        let (kp, kd) = (model.motor.kp, model.motor.kd);
        let body = &model.legs[0][0];
        let center = body.center.norm_squared() - body.center.dot(&body.axis).powi(2);
        let inertia = body.axis.dot(&(body.inertia * body.axis)) + body.mass * center + body.armature;
        let mut state = State::at_rest(10.0, &[0.0; 6]);
        let mut engine = RapierEngine::new(&model, 1);
        engine.set_state(0, &state);
        let mut command = hips(&model, 2.0);
        command.torques.fill(1e-3);
        engine.command(0, &command);
        let (mut angle, mut rate, mut reference, mut clipped) = (0.0, 0.0, 0.0, 0);
        for step in 0..200 {
            reference += command.rates[0] * dt;
            let pull = kp * (reference - angle) + kd * command.rates[0] + command.torques[0];
            let yielding = kd + dt * kp;
            let free = (inertia * rate + dt * pull) / (inertia + dt * yielding);
            let torque: f64 = (pull - yielding * free)
                .clamp(-model.motor.actuator.torque_limit.unwrap(), model.motor.actuator.torque_limit.unwrap());
            clipped += usize::from(torque.abs() == model.motor.actuator.torque_limit.unwrap());
            rate += dt * torque / inertia;
            angle += dt * rate;
            state = advance(&mut engine, 1, &state);
            assert!((state.rates[0] - rate).abs() < 2e-3, "step {step}: {} is not {rate}", state.rates[0]);
            assert!((state.torques[0] - torque).abs() < 2e-5, "step {step}: {} is not {torque}", state.torques[0]);
            assert!(state.torques.iter().all(|t| t.abs() <= model.motor.actuator.torque_limit.unwrap()));
        }
        assert_eq!(clipped > 3, limit.is_some());
    }
}

#[test]
fn sand_adds_no_energy() {
    for leg in ["L", "revL"] {
        let model = model_of("xplorer", leg, &scene(), passive);
        let mut state = tumbling(&model, 0.03);
        let mut engine = RapierEngine::new(&model, 1);
        engine.set_state(0, &state);
        let mut energy = mechanics(&model, &state).0;
        let first = energy;
        for step in 0..2000 {
            state = advance(&mut engine, 1, &state);
            let now = mechanics(&model, &state).0;
            // 1e-6 J are allowed for the rounding of f32 velocities; the whole energy is 0.05 J.
            assert!(now < energy + 1e-6, "{leg} step {step}: {energy} J -> {now} J");
            energy = now;
        }
        assert!(energy < 0.2 * first, "{leg}: the sand took too little, {first} -> {energy} J");
    }
}

/// A robot with mirrored angles and velocities follows the mirrored path.
#[test]
fn mirror_symmetry() {
    let model = model_of("xplorer", "L", &scene(), |_| ());
    let mut state = State::at_rest(0.02, &[0.0, 0.1, 0.2, 0.3, 0.4, 0.5]);
    state.velocity = [0.1, 0.05, 0.0];
    state.angular_velocity = [0.5, 0.2, -0.3];
    let mut mirrored = State::at_rest(0.02, &[0.3, 0.4, 0.5, 0.0, 0.1, 0.2]);
    mirrored.velocity = [0.1, -0.05, 0.0];
    mirrored.angular_velocity = [-0.5, 0.2, 0.3];
    let command = hips(&model, 2.0);
    let (a, b) = (run(&model, &state, &command, 1.0), run(&model, &mirrored, &command, 1.0));
    assert!(a.position[1].abs() > 1e-3, "the run must turn to one side to show anything: {:?}", a.position);
    for (axis, sign) in [1.0, -1.0, 1.0].into_iter().enumerate() {
        assert!((a.position[axis] - sign * b.position[axis]).abs() < 1e-6, "{:?} {:?}", a.position, b.position);
    }
}

#[test]
fn translation_changes_nothing() {
    let model = model_of("xplorer", "L", &scene(), |_| ());
    let here = State::at_rest(0.03, &model.tripod_angles());
    let mut there = here.clone();
    (there.position[0], there.position[1]) = (4096.0, -512.0);
    let command = hips(&model, 3.0);
    let (a, b) = (run(&model, &here, &command, 1.0), run(&model, &there, &command, 1.0));
    assert_eq!((a.orientation, a.velocity, &a.angles), (b.orientation, b.velocity, &b.angles));
    assert!((a.position[0] + 4096.0 - b.position[0]).abs() < 1e-9);
    assert!(a.position[0] > 0.1);
}

#[test]
fn turning_the_start_about_the_vertical_turns_the_path() {
    let model = model_of("xplorer", "L", &scene(), |_| ());
    let state = State::at_rest(0.03, &model.tripod_angles());
    let turn = Q::from_axis_angle(&V::z_axis(), 1.0);
    let mut turned = state.clone();
    turned.orientation = [turn.w, turn.i, turn.j, turn.k];
    let command = hips(&model, 2.0);
    let (a, b) = (run(&model, &state, &command, 1.0), run(&model, &turned, &command, 1.0));
    assert!((turn * V::from(a.position) - V::from(b.position)).norm() < 1e-5, "{:?} {:?}", a.position, b.position);
}

#[test]
fn a_state_resumes_with_the_same_bits() {
    for robot in ["xplorer", "xplorer18"] {
        let model = model_of(robot, "L", &scene(), |_| ());
        let start = State::at_rest(0.03, &vec![0.2; model.joints()]);
        let command = hips(&model, 2.0);
        let (half, whole) = (run(&model, &start, &command, 0.4), run(&model, &start, &command, 0.8));
        assert_eq!(run(&model, &half, &command, 0.4), whole);
    }
}

#[test]
fn a_robot_that_diverges_stays_alone_and_can_be_set_again() {
    let model = model_of("xplorer", "L", &scene(), |_| ());
    let start = State::at_rest(0.03, &model.tripod_angles());
    let command = hips(&model, 2.0);
    let alone = run(&model, &start, &command, 0.2);
    let broken = [
        State { velocity: [f64::NAN; 3], ..start.clone() },
        State { angular_velocity: [0.0, f64::INFINITY, 0.0], ..start.clone() },
        State { orientation: [0.0; 4], ..start.clone() },
        State { position: [0.0, 0.0, -9e3], ..start.clone() },
        State { rates: vec![9e3; 6], ..start.clone() },
        State { angles: Vec::new(), rates: vec![0.0; 99], ..start.clone() },
    ];
    let mut engine = RapierEngine::new(&model, broken.len() + 1);
    for (i, state) in broken.iter().enumerate() {
        engine.set_state(i, state);
    }
    let nan = Command { rates: vec![f64::NAN; 6], torques: vec![1e300; 6], targets: vec![] };
    engine.command(0, &nan);
    engine.set_state(broken.len(), &start);
    engine.command(broken.len(), &command);
    engine.advance(400);
    let mut out = start.clone();
    engine.state(broken.len(), &mut out);
    assert_eq!(out, alone);
    engine.state(0, &mut out);
    assert!(!out.is_sound());
    for i in 0..broken.len() {
        engine.command(i, &command);
        engine.set_state(i, &start);
    }
    engine.advance(400);
    for i in 0..broken.len() {
        engine.state(i, &mut out);
        assert_eq!(out, alone, "robot {i}");
    }
}

#[test]
fn a_new_model_is_used_from_the_next_state_on() {
    let light = model_of("xplorer", "L", &scene(), |_| ());
    let heavy = model_of("xplorer", "L", &Scene { payload: 0.1, ..scene() }, |_| ());
    let start = State::at_rest(0.03, &light.tripod_angles());
    let command = hips(&light, 2.0);
    let mut engine = RapierEngine::new(&light, 1);
    engine.set_state(0, &start);
    engine.command(0, &command);
    engine.set_model(0, &heavy);
    assert_eq!(advance(&mut engine, 400, &start), run(&light, &start, &command, 0.2));
    engine.set_state(0, &start);
    let loaded = advance(&mut engine, 400, &start);
    assert_eq!(loaded, run(&heavy, &start, &command, 0.2));
    assert!(loaded.position[2] < run(&light, &start, &command, 0.2).position[2] - 1e-4);
}

/// Many turns cost no accuracy: a state whose angles are 1,000 turns larger gives the same steps.
#[test]
fn angles_keep_their_precision() {
    let model = model_of("xplorer", "L", &scene(), |_| ());
    let start = State::at_rest(0.03, &model.tripod_angles());
    let mut later = start.clone();
    for angle in later.angles.iter_mut().chain(&mut later.references) {
        *angle += 1000.0 * std::f64::consts::TAU;
    }
    let command = hips(&model, 5.0);
    let (a, b) = (run(&model, &start, &command, 0.5), run(&model, &later, &command, 0.5));
    assert!((V::from(a.position) - V::from(b.position)).norm() < 1e-6, "{:?} {:?}", a.position, b.position);
    assert!(b.angles.iter().all(|angle| angle.abs() < 7.0), "{:?}", b.angles);
}
