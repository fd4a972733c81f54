//! Motors alone, and in the engines.

use sandgait_sand::Medium;
use sandgait_sim::actuator::{Actuator, LaneActuator};
use sandgait_sim::engine::{Command, Engine, EngineKind};
use sandgait_sim::frame::{BodyFrame, M, V};
use sandgait_sim::model::Scene;
use sandgait_sim::stop::ImplicitTorque;
use sandgait_sim::tree::{TreeModel, of_robot, of_touching, packed};
use sandgait_sim::{Model, Robot, State};

#[test]
fn torque_falls_along_the_line() {
    let motor = Actuator {
        torque_limit: Some(10.0),
        stall_torque: Some(15.0),
        no_load_speed: Some(30.0),
        ..Actuator::default()
    };
    let motor = LaneActuator::<f64>::splat(&motor);
    for (rate, low, high) in [
        (0.0, -10.0, 10.0),
        (10.0, -10.0, 10.0),
        (20.0, -10.0, 5.0),
        (30.0, -10.0, 0.0),
        (40.0, -10.0, 0.0),
        (-20.0, -5.0, 10.0),
    ] {
        let [least, most] = motor.limits(rate);
        assert!((least - low).abs() < 1e-12 && (most - high).abs() < 1e-12, "{rate}: {least} {most}");
    }
    let ideal = LaneActuator::<f32>::splat(&Actuator { torque_limit: Some(0.05), ..Actuator::default() });
    assert_eq!(ideal.limits(40.0), [-0.05_f32, 0.05]);
}

#[test]
fn a_lag_follows_the_servo() {
    let push = ImplicitTorque { torque: 2.0, yielding: 0.5 };
    let at_once = LaneActuator::<f64>::splat(&Actuator::default()).track(push, 1.0, 1e-3);
    assert_eq!((at_once.torque, at_once.yielding), (2.0, 0.5));
    let slow = LaneActuator::<f64>::splat(&Actuator { torque_time: Some(0.02), ..Actuator::default() });
    let mut torque = 0.0;
    for _ in 0..20 {
        torque = slow.track(push, torque, 1e-3).torque;
    }
    assert!((torque / 2.0 - (1.0 - (-1.0_f64).exp())).abs() < 0.02, "{torque}");
}

#[test]
fn a_weak_magnet_gives_less_torque() {
    let push = ImplicitTorque { torque: 2.0, yielding: 0.5 };
    let weak = LaneActuator::<f64>::splat(&Actuator { torque_constant: Some(0.8), ..Actuator::default() });
    let push = weak.track(push, 0.0, 1e-3);
    assert_eq!((push.torque, push.yielding), (1.6, 0.4));
}

/// Uniform random numbers.
struct Draw(u64);

impl Draw {
    fn between(&mut self, low: f64, high: f64) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        low + (high - low) * ((self.0 >> 11) as f64 / (1_u64 << 53) as f64)
    }
}

/// At any acceleration, the gear's friction opposes the speed at the step's end.
#[test]
fn a_gear_takes_energy_at_any_acceleration() {
    let mut draw = Draw(7);
    let mut worked = 0.0;
    for _ in 0..10_000 {
        let gear = LaneActuator::<f64>::splat(&Actuator {
            friction: Some(draw.between(0.0, 1.0)),
            damping: Some(draw.between(0.0, 1.0)),
            efficiency: Some(draw.between(0.1, 1.0)),
            ..Actuator::default()
        });
        let (rate, before, dt) = (draw.between(-30.0, 30.0), draw.between(-5.0, 5.0), draw.between(1e-4, 5e-3));
        let acceleration = draw.between(-1e4, 1e4);
        let power = gear.gear(rate, before, dt).at(acceleration) * (rate + dt * acceleration);
        assert!(power <= 0.0, "{power}");
        worked += power;
    }
    assert!(worked < -1e3);
}

const ENGINES: [EngineKind; 3] = [EngineKind::Lanes, EngineKind::Rapier, EngineKind::Tree];

/// The built-in robot `name` with these motors, for any engine.
fn hexapod(kind: EngineKind, name: &str, change: impl Fn(&mut Robot), motors: &Actuator) -> Model {
    let mut robot = Robot::load(name).unwrap();
    change(&mut robot);
    let medium = Medium::named("poppy-loose").unwrap();
    let scene = Scene { dt: kind.default_dt(), ..Scene::flat(medium) };
    let model = match kind {
        EngineKind::Tree => {
            let tree = of_robot(name, &robot).unwrap();
            let of_body = |b: usize| (0..tree.bodies[b].shapes.len()).map(move |k| (b, k));
            let touching: Vec<_> = (0..tree.bodies.len()).flat_map(of_body).collect();
            let plates = of_touching(&tree, &touching, None).unwrap();
            Model::of_tree(TreeModel::new(tree, plates).unwrap(), &scene).unwrap()
        }
        _ => Model::new(&robot, &scene).unwrap(),
    };
    model.with_motors(motors).unwrap()
}

/// The state in which a robot stands with all angles 0, `above` the sand [m].
fn standing(model: &Model, above: f64) -> State {
    let angles = vec![0.0; model.joints()];
    let height = match &model.tree {
        Some(tree) => tree.standing_height(&angles),
        None => model.standing_height(&angles),
    };
    State::at_rest(height + above, &angles)
}

/// Motors of many strengths drive hexapods to random speeds on sand. No torque is beyond its motor's line at the speed before the step and,
/// in engines `lanes` and `tree`, at the speed after it.
#[test]
fn no_torque_is_beyond_its_line() {
    for kind in ENGINES {
        let mut draw = Draw(kind as u64 + 1);
        let (mut worst, mut at_limit, mut count) = (0.0_f64, 0, 0);
        for round in 0..16 {
            let name = if round % 4 == 3 { "xplorer18" } else { "xplorer" };
            let limit = draw.between(0.005, 0.1);
            let stall = draw.between(0.8, 3.0) * limit;
            let motors = Actuator {
                torque_limit: Some(limit),
                stall_torque: Some(stall),
                no_load_speed: Some(draw.between(2.0, 40.0)),
                torque_time: (round % 2 == 1).then(|| draw.between(0.0, 0.02)),
                friction: (round % 3 == 1).then(|| draw.between(0.0, 0.2) * limit),
                efficiency: (round % 3 == 2).then(|| draw.between(0.5, 1.0)),
                ..Actuator::default()
            };
            let model = hexapod(kind, name, |robot| robot.servo.anti_windup = true, &motors);
            let line = LaneActuator::<f64>::splat(&motors);
            let mut engine = Engine::new(kind, &model, 1).unwrap();
            let mut now = standing(&model, 0.0);
            engine.set_state(0, &now);
            for step in 0..400 {
                if step % 40 == 0 {
                    let rates = (0..model.joints()).map(|_| draw.between(-60.0, 60.0)).collect();
                    let torques = (0..model.joints()).map(|_| draw.between(-0.1, 0.1)).collect();
                    engine.command(0, &Command { rates, torques, targets: vec![] });
                }
                let before = now.clone();
                engine.advance(1);
                engine.state(0, &mut now);
                assert!(now.is_sound());
                for (i, torque) in now.torques.iter().enumerate() {
                    let after = if kind == EngineKind::Rapier { before.rates[i] } else { now.rates[i] };
                    for rate in [before.rates[i], after] {
                        let [low, high] = line.limits(rate);
                        worst = worst.max((torque - high).max(low - torque) / limit.min(stall));
                    }
                    let [low, high] = line.limits(after);
                    at_limit += usize::from((torque - high).max(low - torque) > -1e-6 * limit);
                    count += 1;
                }
            }
        }
        println!("{}: beyond by at most {worst:.1e} of the limit, {at_limit} of {count} at it", kind.name());
        assert!(worst < 1e-5, "{}: {worst}", kind.name());
        assert!(at_limit > count / 50 && at_limit < count, "{}: {at_limit} of {count} at their limit", kind.name());
    }
}

/// A no-load speed needs a torque. Known properties replace the properties in the robot's file.
#[test]
fn motors_are_changed_where_they_are_known() {
    let ideal = hexapod(EngineKind::Lanes, "xplorer", |_| (), &Actuator::default());
    let fast = Actuator { no_load_speed: Some(5.0), ..Actuator::default() };
    let error = ideal.clone().with_motors(&fast).unwrap_err().to_string();
    assert!(error.starts_with("actuator.no_load_speed: it needs a stall_torque"), "{error}");
    let slow = Actuator { torque_limit: Some(0.1), torque_time: Some(0.02), ..Actuator::default() };
    let model = ideal.with_motors(&slow).unwrap().with_motors(&fast).unwrap();
    let quick = model.with_motors(&Actuator { torque_time: Some(0.0), ..Actuator::default() }).unwrap();
    let known = Actuator { stall_torque: Some(0.2), torque_time: Some(0.0), ..fast };
    assert_eq!(quick.motor.actuator, Actuator { torque_limit: Some(0.1), ..known });
    assert_eq!(quick.robot.servo.actuator(), quick.motor.actuator);
}

/// Kinetic energy of a robot with legs [J].
fn energy(model: &Model, state: &State) -> f64 {
    let base = BodyFrame::base(state);
    let of = |frame: &BodyFrame, mass: f64, center: V, inertia: &M| {
        let (velocity, spin) = (frame.velocity_at(frame.rotation * center), frame.angular_velocity);
        let own = frame.rotation.transpose() * spin;
        0.5 * (mass * velocity.norm_squared() + own.dot(&(inertia * own)))
    };
    let mut sum = of(&base, model.base_mass, V::zeros(), &M::from_diagonal(&model.base_inertia));
    let mut joints = state.angles.iter().zip(&state.rates);
    for chain in &model.legs {
        let mut frame = base;
        for (body, (angle, rate)) in chain.iter().zip(&mut joints) {
            frame = frame.child(body, *angle, *rate);
            sum += of(&frame, body.mass, body.center, &body.inertia) + 0.5 * body.armature * rate * rate;
        }
    }
    sum
}

/// Largest torque of [`gears_and_stops_take_energy`] [N·m]: links then turn by at most 0.02 rad in a step.
const TORQUE: f64 = 3e-3;
/// Error of energy that the time steps cause, as a share of the largest energy. Without losses it was 0.7 %; it halves with the time step in
/// all engines, and grows with the angle in a step (6 % at 0.05 rad).
const OWN_ERROR: f64 = 0.02;

/// A robot floats without gravity, and its motors apply random torques. It gains the work of the motors as kinetic
/// energy, less the losses of gears and stops.
#[test]
fn gears_and_stops_take_energy() {
    for kind in ENGINES {
        let mut draw = Draw(kind as u64 + 11);
        for round in 0..12 {
            let stops = round % 4 == 3;
            let loses = stops || round % 3 > 0;
            let motors = Actuator {
                friction: (round % 3 == 1).then(|| draw.between(0.1, 0.4) * TORQUE),
                damping: (round % 3 == 1).then(|| draw.between(1e-5, 1e-4)),
                efficiency: (round % 3 == 2).then(|| draw.between(0.5, 0.9)),
                ..Actuator::default()
            };
            let name = if round % 2 == 1 { "xplorer18" } else { "xplorer" };
            let free = |robot: &mut Robot| {
                (robot.servo.kp, robot.servo.kd) = (0.0, 0.0);
                if !stops {
                    robot.leg.link.iter_mut().for_each(|link| link.range = None);
                }
            };
            let legged = hexapod(EngineKind::Lanes, name, free, &motors);
            let mut model = hexapod(kind, name, free, &motors);
            (model.gravity, model.scene.dt) = (V::zeros(), 1.25e-4);
            let mut engine = Engine::new(kind, &model, 1).unwrap();
            let mut now = standing(&model, 10.0);
            engine.set_model(0, &model);
            engine.set_state(0, &now);
            let (mut work, mut most) = (0.0, 0.0_f64);
            for step in 0..2400 {
                if step % 240 == 0 {
                    let torques = (0..model.joints()).map(|_| draw.between(-TORQUE, TORQUE)).collect();
                    engine.command(0, &Command { rates: vec![0.0; model.joints()], torques, targets: vec![] });
                }
                let before = now.clone();
                engine.advance(1);
                engine.state(0, &mut now);
                let middle = before.rates.iter().zip(&now.rates).map(|(a, b)| 0.5 * (a + b));
                work += now.torques.iter().zip(middle).map(|(t, rate)| t * rate).sum::<f64>() * model.scene.dt;
                let energy = energy(&legged, &now);
                most = most.max(energy);
                let gained = energy - work;
                assert!(gained <= OWN_ERROR * most, "{} round {round}: {energy} J of {work} J", kind.name());
                assert!(loses || gained >= -OWN_ERROR * most, "{} round {round}: {energy} J of {work} J", kind.name());
            }
            let energy = energy(&legged, &now);
            assert!(!loses || energy < 0.9 * work, "{} round {round}: {energy} J of {work} J", kind.name());
        }
    }
}

/// A built-in robot keeps its motors as a tree, and packed for a server.
#[test]
fn trees_keep_the_motors_of_a_file() {
    let mut robot = Robot::built_in("xplorer").unwrap();
    let motors = Actuator {
        torque_limit: Some(0.3),
        stall_torque: Some(0.7),
        no_load_speed: Some(21.0),
        torque_time: Some(0.012),
        torque_constant: Some(1.1),
        friction: Some(0.002),
        damping: Some(0.001),
        efficiency: Some(0.8),
        rotor_inertia: Some(1e-6),
    };
    robot.servo.set_actuator(&motors);
    robot.servo.speed_limit = Some(30.0);
    let tree = of_robot("xplorer", &robot).unwrap();
    let plates = vec![Vec::new(); tree.bodies.len()];
    let packed = packed::pack(&tree, &plates, None).unwrap();
    for model in [TreeModel::new(tree, plates).unwrap(), packed::unpack(&packed).unwrap()] {
        assert!(model.motors.iter().all(|motor| motor.actuator == motors && motor.speed_limit == Some(30.0)));
    }
    let broken = packed.replace("\"efficiency\":0.8", "\"efficiency\":8.0");
    let error = packed::unpack(&broken).unwrap_err().to_string();
    assert!(broken != packed && error.contains("efficiency"), "{error}");
}
