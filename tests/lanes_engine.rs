//! Physical laws in the `lanes` engine, and comparisons of its precisions and instruction sets.

use rand::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use sandgait::number::Isa;
use sandgait::sand::{Mechanisms, Medium};
use sandgait::sim::blocks::LaneEngine;
use sandgait::sim::engine::{Command, Integrator as _};
use sandgait::sim::lanes;
use sandgait::sim::model::Scene;
use sandgait::sim::{Model, Robot, State};

const ROBOTS: [&str; 2] = ["xplorer", "xplorer18"];

fn model(robot: &str, change: impl Fn(&mut Scene)) -> Model {
    let mut scene = Scene::flat(Medium::named("poppy-loose").unwrap());
    change(&mut scene);
    Model::new(&Robot::load(robot).unwrap(), &scene).unwrap()
}

fn engine(isa: Isa, model: &Model, states: &[State]) -> LaneEngine {
    let mut engine = lanes::engine(isa, model, states.len()).unwrap();
    for (i, state) in states.iter().enumerate() {
        engine.set_state(i, state);
    }
    engine
}

fn read(engine: &LaneEngine, index: usize, like: &State) -> State {
    let mut state = like.clone();
    engine.state(index, &mut state);
    state
}

/// A state of motion in which every number is random but plausible.
fn random_state(model: &Model, height: f64, random: &mut impl Rng) -> State {
    let mut draw = |scale: f64| random.random_range(-scale..scale);
    let angles: Vec<f64> = (0..model.joints()).map(|_| draw(1.0)).collect();
    let mut state = State::at_rest(height, &angles);
    let q = [1.0, draw(0.3), draw(0.3), draw(0.3)];
    let norm = q.iter().map(|c| c * c).sum::<f64>().sqrt();
    state.orientation = q.map(|c| c / norm);
    state.velocity = [draw(0.5), draw(0.5), draw(0.5)];
    state.angular_velocity = [draw(5.0), draw(5.0), draw(5.0)];
    state.rates.iter_mut().for_each(|r| *r = draw(20.0));
    state
}

fn isas() -> Vec<Isa> {
    Isa::ALL.into_iter().filter(|i| i.available()).collect()
}

/// Linear and angular momentum about the world's origin, and kinetic energy, from the model's bodies alone.
fn mechanics(model: &Model, s: &State) -> ([f64; 6], f64) {
    use nalgebra::{Matrix3, Quaternion, Unit, UnitQuaternion, Vector3};
    let turn = UnitQuaternion::from_quaternion(Quaternion::new(
        s.orientation[0],
        s.orientation[1],
        s.orientation[2],
        s.orientation[3],
    ));
    let (mut p, mut l, mut energy) = (Vector3::zeros(), Vector3::zeros(), 0.0);
    let mut add = |mass: f64, inertia: Matrix3<f64>, x: Vector3<f64>, v: Vector3<f64>, w: Vector3<f64>| {
        p += v * mass;
        l += x.cross(&v) * mass + inertia * w;
        energy += 0.5 * (mass * v.norm_squared() + w.dot(&(inertia * w)));
    };
    let base = (Vector3::from(s.position), turn, Vector3::from(s.velocity), Vector3::from(s.angular_velocity));
    let rotated =
        |q: &UnitQuaternion<f64>, i: Matrix3<f64>| q.to_rotation_matrix() * i * q.to_rotation_matrix().inverse();
    add(model.base_mass, rotated(&base.1, Matrix3::from_diagonal(&model.base_inertia)), base.0, base.2, base.3);
    let mut joints = s.angles.iter().zip(&s.rates);
    for chain in &model.legs {
        let (mut origin, mut q, mut v, mut w) = base;
        for body in chain {
            let (angle, rate) = joints.next().unwrap();
            let arm = q * body.joint;
            (origin, v) = (origin + arm, v + w.cross(&arm));
            q *= UnitQuaternion::from_axis_angle(&Unit::new_normalize(body.axis), *angle);
            w += q * body.axis * *rate;
            let arm = q * body.center;
            add(body.mass, rotated(&q, body.inertia), origin + arm, v + w.cross(&arm), w);
        }
    }
    ([p.x, p.y, p.z, l.x, l.y, l.z], energy)
}

/// In free flight without motors and gravity, momentum and energy are constant. They are computed here from the bodies,
/// so the armature is zero: it would be inertia that belongs to a joint and to no body. Stops take energy, so joints
/// turn freely.
#[test]
fn free_flight_keeps_momentum_and_energy() {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(2);
    for name in ROBOTS {
        let mut robot = Robot::load(name).unwrap();
        (robot.servo.kp, robot.servo.kd) = (0.0, 0.0);
        robot.leg.link.iter_mut().for_each(|l| (l.armature, l.range) = (0.0, None));
        let mut scene = Scene::flat(Medium::named("poppy-loose").unwrap());
        scene.dt = 1e-5;
        let mut model = Model::new(&robot, &scene).unwrap();
        model.gravity = nalgebra::Vector3::zeros();
        let start = random_state(&model, 10.0, &mut random);
        let mut engine = engine(Isa::F64, &model, std::slice::from_ref(&start));
        let (momentum, energy) = mechanics(&model, &start);
        engine.advance(20_000);
        let end = read(&engine, 0, &start);
        assert!((end.angles[0] - start.angles[0]).abs() > 0.1, "{name}: the legs did not move");
        let (after, energy_after) = mechanics(&model, &end);
        let scale = momentum.iter().map(|m| m.abs()).fold(0.0, f64::max);
        for (a, b) in momentum.iter().zip(after) {
            assert!((a - b).abs() < 1e-3 * scale, "{name}: momentum {momentum:?} became {after:?}");
        }
        assert!((energy_after / energy - 1.0).abs() < 1e-3, "{name}: energy {energy} became {energy_after}");
    }
}

/// The centre of mass of a falling robot has the acceleration of gravity, on slopes too, whatever its legs do.
#[test]
fn free_fall_follows_gravity() {
    for name in ROBOTS {
        let model = model(name, |s| (s.slope_deg, s.dt) = (10.0, 1e-4));
        let start = State::at_rest(5.0, &vec![0.0; model.joints()]);
        let mut engine = engine(Isa::F64, &model, std::slice::from_ref(&start));
        engine.command(
            0,
            &Command { rates: vec![6.0; model.joints()], torques: vec![0.0; model.joints()], targets: vec![] },
        );
        engine.advance(3000);
        let (momentum, _) = mechanics(&model, &read(&engine, 0, &start));
        for (axis, p) in momentum.iter().take(3).enumerate() {
            let expected = model.total_mass() * model.gravity[axis] * 0.3;
            assert!((p - expected).abs() < 1e-3 * 0.3, "{name} axis {axis}: {} {expected}", momentum[axis]);
        }
    }
}

/// Every instruction set gives the f64 reference's motion to single precision over a short time on sand.
#[test]
fn instruction_sets_agree() {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(3);
    for name in ROBOTS {
        let model = model(name, |_| ());
        let start = random_state(&model, 0.03, &mut random);
        let run = |isa| {
            let mut engine = engine(isa, &model, std::slice::from_ref(&start));
            engine.command(
                0,
                &Command { rates: vec![3.0; model.joints()], torques: vec![0.0; model.joints()], targets: vec![] },
            );
            engine.advance(100);
            read(&engine, 0, &start)
        };
        let reference = run(Isa::F64);
        for isa in isas() {
            let state = run(isa);
            let far = state.position.iter().zip(reference.position).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(far < 2e-6, "{name} {}: {far} m from f64", isa.name());
        }
    }
}

/// An environment's results depend neither on its lane nor on its neighbours, to the last bit.
#[test]
fn lanes_do_not_affect_each_other() {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(4);
    for name in ROBOTS {
        let model = model(name, |_| ());
        let states: Vec<State> = (0..37).map(|_| random_state(&model, 0.03, &mut random)).collect();
        for isa in isas() {
            let mut together = engine(isa, &model, &states);
            together.advance(200);
            for (i, start) in states.iter().enumerate().step_by(5) {
                let mut alone = engine(isa, &model, std::slice::from_ref(start));
                alone.advance(200);
                assert_eq!(read(&alone, 0, start), read(&together, i, start), "{name} {} lane {i}", isa.name());
            }
        }
    }
}

/// An environment's results do not depend on its neighbours when mechanisms of the sand are switched on and neighbours
/// have other stride frequencies: mechanisms that act at any depth must still not act in the air.
#[test]
fn lanes_do_not_affect_each_other_on_any_sand() {
    use sandgait::sim::engine::EngineKind;
    use sandgait::sim::walk::{WalkTrial, walk, walk_many};
    let trial = |leg: &str, frequency: f64, mechanisms: Mechanisms| {
        let mut scene = Scene::flat(Medium::named("poppy-loose").unwrap());
        scene.mechanisms = mechanisms;
        let robot = Robot::load("xplorer").unwrap().with_leg_shape(leg).unwrap();
        WalkTrial::new(Model::new(&robot, &scene).unwrap(), frequency)
    };
    let sand = Mechanisms { inertial_drag: 1.0, cohesion: 50.0, concave_fill: 0.2, ..Mechanisms::PLAIN };
    let trials = [trial("L", 4.0, sand), trial("revL", 3.0, sand), trial("C", 5.0, Mechanisms::PLAIN)];
    let together = walk_many(EngineKind::Lanes, &trials, &|_| Ok(())).unwrap();
    for (trial, together) in trials.iter().zip(together) {
        assert_eq!(walk(EngineKind::Lanes, trial).unwrap(), together);
    }
}

/// A robot whose state is not finite does not change its neighbours' bits, and walks again after a new state is set.
#[test]
fn a_diverged_lane_does_not_affect_the_others() {
    let model = model("xplorer", |_| ());
    let start = State::at_rest(0.03, &model.tripod_angles());
    let mut broken = start.clone();
    broken.velocity[0] = f64::NAN;
    for isa in isas() {
        let mut clean = engine(isa, &model, &[start.clone(), start.clone()]);
        let mut mixed = engine(isa, &model, &[start.clone(), broken.clone()]);
        clean.advance(100);
        mixed.advance(100);
        assert_eq!(read(&clean, 0, &start), read(&mixed, 0, &start), "{}", isa.name());
        assert!(!read(&mixed, 1, &start).is_sound());
        mixed.set_state(1, &start);
        mixed.advance(100);
        assert_eq!(read(&clean, 1, &start), read(&mixed, 1, &start), "{}", isa.name());
    }
}

/// After its state is read and set again, the simulation continues bit-identically.
#[test]
fn a_state_set_again_gives_the_same_bits() {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(5);
    for name in ROBOTS {
        let model = model(name, |_| ());
        let start = random_state(&model, 0.03, &mut random);
        let command =
            Command { rates: vec![12.0; model.joints()], torques: vec![0.0; model.joints()], targets: vec![] };
        for isa in isas() {
            let mut a = engine(isa, &model, std::slice::from_ref(&start));
            a.command(0, &command);
            a.advance(150);
            let middle = read(&a, 0, &start);
            let mut b = engine(isa, &model, std::slice::from_ref(&middle));
            b.command(0, &command);
            a.advance(150);
            b.advance(150);
            assert_eq!(read(&a, 0, &start), read(&b, 0, &start), "{name} {}", isa.name());
        }
    }
}

/// A robot's motion is bit-identical at every position, with any instruction set and precision, because a lane computes
/// with positions relative to its robot's last position. Only the position itself is rounded, to a double.
#[test]
fn translation_changes_no_bit() {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(6);
    for name in ROBOTS {
        let model = model(name, |_| ());
        let start = random_state(&model, 0.03, &mut random);
        let places = [[0.0, 0.0], [37.3, -0.2], [1e3, 5e3], [-1e6, 1e6]];
        let shifted = places.map(|[x, y]| State { position: [x, y, 0.03], ..start.clone() });
        let command =
            Command { rates: vec![12.0; model.joints()], torques: vec![0.0; model.joints()], targets: vec![] };
        for isa in isas() {
            let mut engine = engine(isa, &model, &shifted);
            (0..places.len()).for_each(|i| engine.command(i, &command));
            // The robot makes control steps. Between them each lane takes its robot's new position as origin.
            (0..20).for_each(|_| engine.advance(20));
            let here = read(&engine, 0, &start);
            assert!(here.position[0].hypot(here.position[1]) > 1e-3, "{name} stands still");
            for (i, place) in places.iter().enumerate() {
                let mut there = read(&engine, i, &start);
                for (k, shift) in place.iter().enumerate().take(2) {
                    let off = there.position[k] - shift - here.position[k];
                    // 20 rounding errors of half a unit in the last place.
                    assert!(off.abs() <= 20.0 * f64::EPSILON * shift.abs().max(1.0), "{name} {}: {off}", isa.name());
                    there.position[k] = here.position[k];
                }
                assert_eq!(there, here, "{name} {} at {place:?}", isa.name());
            }
        }
    }
}

/// A mirrored state has a mirrored motion, to rounding.
#[test]
fn mirror_symmetry() {
    let model = model("xplorer", |_| ());
    let start = State::at_rest(0.03, &[0.3, 0.1, -0.2, 0.0, 1.0, 2.0]);
    let mut mirrored = start.clone();
    mirrored.angles.rotate_left(3);
    mirrored.references.rotate_left(3);
    let mut engine = engine(Isa::F64, &model, &[start.clone(), mirrored]);
    let rates = vec![6.0, 8.0, 10.0, 12.0, 14.0, 16.0];
    let mut swapped = rates.clone();
    swapped.rotate_left(3);
    engine.command(0, &Command { rates, torques: vec![0.0; 6], targets: vec![] });
    engine.command(1, &Command { rates: swapped, torques: vec![0.0; 6], targets: vec![] });
    engine.advance(1000);
    let (a, b) = (read(&engine, 0, &start), read(&engine, 1, &start));
    assert!(a.position[1].abs() > 1e-4, "the gait is not lopsided");
    assert!((a.position[0] - b.position[0]).abs() < 1e-9, "{} {}", a.position[0], b.position[0]);
    assert!((a.position[1] + b.position[1]).abs() < 1e-9, "{} {}", a.position[1], b.position[1]);
    assert!((a.position[2] - b.position[2]).abs() < 1e-9);
}

/// The work of 10⁶ control steps is some kJ. The work of one time step would be lost in an f32 of that size. The
/// accumulated work does not affect the motion.
#[test]
fn accumulated_work_keeps_its_precision() {
    for name in ROBOTS {
        let model = model(name, |_| ());
        let angles = model.tripod_angles();
        let fresh = State::at_rest(model.standing_height(&angles), &angles);
        let late = State { work: 1e5, ..fresh.clone() };
        let mut engine = lanes::engine(Isa::choose().unwrap(), &model, 2).unwrap();
        engine.set_state(0, &fresh);
        engine.set_state(1, &late);
        let command = Command { rates: vec![2.0; model.joints()], torques: vec![0.0; model.joints()], targets: vec![] };
        for _ in 0..50 {
            (0..2).for_each(|i| engine.command(i, &command));
            engine.advance(40);
        }
        let (a, b) = (read(&engine, 0, &fresh), read(&engine, 1, &late));
        assert!(a.work > 1e-3 && (b.work - 1e5 - a.work).abs() < 1e-8, "{} {}", a.work, b.work);
        assert_eq!(State { work: 0.0, ..a }, State { work: 0.0, ..b });
    }
}
