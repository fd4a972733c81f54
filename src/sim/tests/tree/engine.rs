//! The engine: laws of free flight, precision, independence of lanes, servos and stops.

use super::models::*;
use super::*;
use sandgait_number::Isa;
use sandgait_sim::engine::{Command, Integrator as _};
use sandgait_sim::model::Scene;
use sandgait_sim::{Model, State};
use std::sync::Arc;

/// Momentum, angular momentum about the centre of mass, and energy.
pub fn conserved(model: &Model, state: &State) -> (V, V, f64) {
    let (tree, pose) = (&model.tree.as_ref().unwrap().tree, pose_of(state));
    let none = TreeAccelerations { a: [0.0; 3], alpha: [0.0; 3], qdd: vec![0.0; pose.q.len()] };
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

/// [`conserved`] of a robot before and after `time` [s] under gravity alone.
fn flown(tree: &Tree, pose: &TreePose, dt: f64, time: f64) -> [(V, V, f64); 2] {
    let model = loosened(&model_of(tree.clone(), dt));
    let mut engine = sandgait_sim::tree::engine(Isa::F64, &model, 1).unwrap();
    let mut state = state_of(pose, 100.0);
    engine.set_state(0, &state);
    let before = conserved(&model, &state);
    engine.advance((time / dt).round() as usize);
    engine.state(0, &mut state);
    [before, conserved(&model, &state)]
}

/// In free flight momentum changes by gravity alone, and angular momentum about the centre of mass and energy are
/// constant. The error falls with the time step.
#[test]
fn free_flight_conserves() {
    let mut draw = SignedDraw::new(3);
    for count in [1, 4, 13] {
        let tree = random_tree(&mut draw, count);
        let pose = random_pose(&mut draw, count - 1);
        let errors = [2e-4, 1e-4].map(|dt| {
            let [(p0, l0, e0), (p1, l1, e1)] = flown(&tree, &pose, dt, 0.2);
            let fallen = V::z() * (-0.2 * tree.mass() * sandgait_sand::GRAVITY);
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

const ISAS: [Isa; 2] = [Isa::F64, Isa::Baseline];

/// Below tan⁻¹ μ a block sticks, above it slides downhill with g (sin − μ cos).
#[test]
fn a_block_on_a_slope_sticks_or_slides() {
    let friction: f64 = 0.4; // tan⁻¹ 0.4 = 21.8°
    for isa in ISAS {
        for slope in [5.0_f64, 15.0, 21.0, 23.0, 30.0] {
            let model = on_hard(block([0.1, 0.1, 0.05], 2.0, friction), slope, 1e-3);
            let settled = run(isa, &model, &State::at_rest(0.05, &[]), 0.5);
            let later = run(isa, &model, &settled, 1.0);
            let [dx, dv] = [later.position[0] - settled.position[0], later.velocity[0] - settled.velocity[0]];
            let angle = slope.to_radians();
            let expected = -sandgait_sand::GRAVITY * (angle.sin() - friction * angle.cos());
            if expected >= 0.0 {
                // It creeps with 1e-5 m/s times the share of its weight along the slope.
                assert!(dx.abs() < 1e-5, "{isa:?} {slope}: {dx}");
            } else {
                assert!((dv / expected - 1.0).abs() < 2e-3, "{isa:?} {slope}: {dv}, {expected}");
            }
        }
    }
}

/// A block that is thrown onto level ground comes to rest and does not drift, and the ground carries its weight.
#[test]
fn what_rests_stays() {
    for isa in ISAS {
        let model = on_hard(block([0.1, 0.07, 0.05], 2.0, 0.6), 0.0, 1e-3);
        let mut start = State::at_rest(0.2, &[]);
        (start.velocity, start.angular_velocity) = ([0.5, 0.2, 0.0], [1.0, -2.0, 3.0]);
        let rest = run(isa, &model, &start, 3.0);
        let later = run(isa, &model, &rest, 10.0);
        for k in 0..3 {
            assert!((later.position[k] - rest.position[k]).abs() < 1e-6, "{isa:?}: {rest:?} {later:?}");
            assert!((later.orientation[k] - rest.orientation[k]).abs() < 1e-6, "{isa:?}: {rest:?} {later:?}");
        }
        // The ground is so stiff that the whole weight on one point would sink it by 1 mm; four corners share it: 0.25 mm.
        assert!((later.position[2] - (0.05 - 0.25e-3)).abs() < 2e-6, "{isa:?}: {later:?}");
    }
}

/// A ball without damping returns to its first height. With damping ratio ζ it returns to the height that a linear
/// spring and damper give that only push (Schwager & Pöschel 2007).
#[test]
fn a_ball_bounces() {
    let ball = |zeta: f64, dt: f64| {
        let mut tree = block([0.05; 3], 1.0, 0.5);
        tree.bodies[0].shapes[0].geometry = Geometry::Sphere { radius: 0.05 };
        let mut model = on_hard(tree, 0.0, dt);
        let mut own = (**model.tree.as_ref().unwrap()).clone();
        own.compliance.stiffness = 1e5;
        own.compliance.damping = 2.0 * zeta * 1e5_f64.sqrt();
        model = Model::of_tree(own, &model.scene).unwrap();
        let mut engine = sandgait_sim::tree::engine(Isa::F64, &model, 1).unwrap();
        let mut state = State::at_rest(0.05 + 0.1, &[]);
        engine.set_state(0, &state);
        // The largest speed after the bounce.
        let mut fastest = 0.0_f64;
        for _ in 0..(0.3 / dt) as usize {
            engine.advance(1);
            engine.state(0, &mut state);
            fastest = fastest.max(state.velocity[2]);
        }
        fastest / (2.0 * sandgait_sand::GRAVITY * 0.1).sqrt()
    };
    for zeta in [0.0_f64, 0.1, 0.5] {
        let root = (1.0 - zeta * zeta).sqrt();
        // The force vanishes before the spring is fully extended.
        let time = std::f64::consts::PI - (2.0 * zeta * root / (1.0 - 2.0 * zeta * zeta)).atan();
        let expected = (-zeta / root * time).exp();
        let [coarse, fine] = [1e-4, 1e-5].map(|dt| ball(zeta, dt));
        assert!((fine - expected).abs() < 0.01, "{zeta}: {fine}, {expected}");
        assert!((coarse - expected).abs() < 0.03, "{zeta}: {coarse}, {expected}");
    }
}

/// Four feet on hard ground carry the weight, and nothing creeps.
#[test]
fn a_quadruped_stands_on_its_feet() {
    for isa in ISAS {
        let model = on_hard(quadruped(), 0.0, 1e-3);
        // Dry friction lets joints creep until their servos carry the load: e-folding time F/(kp v₀) = 1.7 s.
        let rest = run(isa, &model, &standing(&quadruped()), 15.0);
        let later = run(isa, &model, &rest, 10.0);
        let moved: f64 = (0..3).map(|k| (later.position[k] - rest.position[k]).powi(2)).sum::<f64>().sqrt();
        // In single precision rounding of positions and angles moves the feet.
        assert!(moved < if isa == Isa::F64 { 2e-5 } else { 2e-4 }, "{isa:?}: {moved}");
        assert!(later.position[2] > 0.2 && later.rotation()[2][2] > 0.99, "{isa:?}: {later:?}");
        // Depth of the feet times the stiffness is the weight.
        let tree = model.tree.as_ref().unwrap();
        let none = TreeAccelerations { a: [0.0; 3], alpha: [0.0; 3], qdd: vec![0.0; 12] };
        let bodies = motions(&tree.tree, &pose_of(&later), &none);
        let depth = |m: &Moving| 0.02 - (m.at + m.turn * V::new(0.0, 0.0, -0.2)).z - later.position[2];
        let carried: f64 = bodies.iter().skip(3).step_by(3).map(|m| depth(m) * tree.compliance.stiffness).sum();
        let weight = tree.tree.mass() * sandgait_sand::GRAVITY;
        assert!((carried / weight - 1.0).abs() < 1e-3, "{isa:?}: {carried} N of {weight}");
    }
}

/// Robot `k` of `count` after a second of trotting; if `count` is 1, it is alone.
fn trotted(isa: Isa, model: &Model, count: usize, k: usize) -> State {
    let mut engine = sandgait_sim::tree::engine(isa, model, count).unwrap();
    let starts = |i: usize| {
        let mut start = standing(&quadruped());
        start.position = [0.1 * i as f64, -0.05 * i as f64, 0.33];
        start
    };
    // A robot that is computed alone also gets the commands of robot `k`.
    let named = |i: usize| if count == 1 { k } else { i };
    (0..count).for_each(|i| engine.set_state(i, &starts(named(i))));
    for step in 0..50 {
        (0..count).for_each(|i| engine.command(i, &trot(named(i), step)));
        sandgait_number::flushed(|| engine.advance(20));
    }
    let mut state = starts(k);
    engine.state(if count == 1 { 0 } else { k }, &mut state);
    state
}

/// Results are bit-identical in every lane and with every neighbour.
#[test]
fn lanes_do_not_see_each_other() {
    for isa in Isa::ALL.into_iter().filter(|isa| isa.available()) {
        for slabs in [None, Some(0.01)] {
            let model = on_sand(slabs);
            for k in [0, 3, 17] {
                let (alone, among) = (trotted(isa, &model, 1, k), trotted(isa, &model, 20, k));
                assert!(alone.is_sound(), "{isa:?} {slabs:?}: {alone:?}");
                assert_eq!(alone, among, "{isa:?} {slabs:?} {k}");
            }
        }
    }
}

/// A state that is read as a row and set again goes on bit-identically.
#[test]
fn states_go_on_with_the_same_bits() {
    let model = on_sand(Some(0.0));
    let isa = Isa::choose().unwrap();
    let mut engine = sandgait_sim::tree::engine(isa, &model, 1).unwrap();
    let mut state = standing(&quadruped());
    engine.set_state(0, &state);
    let mut other = sandgait_sim::tree::engine(isa, &model, 1).unwrap();
    for step in 0..50 {
        engine.state(0, &mut state);
        other.set_state(0, &State::from_row(12, &state.row()).unwrap());
        for e in [&mut engine, &mut other] {
            e.command(0, &trot(0, step));
            sandgait_number::flushed(|| e.advance(20));
        }
        let mut again = state.clone();
        engine.state(0, &mut state);
        other.state(0, &mut again);
        assert_eq!(state, again, "{step}");
    }
}

/// The walks in both precisions agree for some time, before chaotic motion separates them.
#[test]
fn precisions_agree() {
    let model = on_sand(None);
    let [single, double] = [Isa::Baseline, Isa::F64].map(|isa| run(isa, &model, &standing(&quadruped()), 1.0));
    for k in 0..3 {
        assert!((single.position[k] - double.position[k]).abs() < 1e-4, "{single:?} {double:?}");
    }
    // Balls of 2 cm sink deep under 12 kg.
    assert!(double.rotation()[2][2] > 0.98 && double.position[2] > 0.05, "{double:?}");
}

/// A robot on an inclined plane of heights under vertical gravity moves as on level ground under inclined gravity,
/// in sand and on hard ground.
#[test]
fn a_plane_of_heights_is_a_slope() {
    let angle = 10f64.to_radians();
    let rows = vec![(0..40).map(|i| angle.tan() * 0.5 * f64::from(i)).collect::<Vec<f64>>(); 40];
    let plane = Arc::new(sandgait_sim::tree::relief::Relief::new(0.5, &rows).unwrap());
    let turn = UnitQuaternion::from_axis_angle(&V::y_axis(), -angle);
    // A point of the plane.
    let origin = V::new(10.0, 10.0, 10.0 * angle.tan());
    for hard in [false, true] {
        let ground = if hard { vec![HardGround::everywhere()] } else { Vec::new() };
        let model = |slope_deg: f64, relief| {
            let scene = Scene { slope_deg, relief, hard: ground.clone(), ..scene(1e-3) };
            let tree = quadruped();
            let plates = plates(&tree);
            Model::of_tree(TreeModel::new(tree, plates).unwrap(), &scene).unwrap()
        };
        let flat = run(Isa::F64, &model(10.0, None), &standing(&quadruped()), 0.6);
        let mut start = standing(&quadruped());
        start.position = (origin + turn * V::from(start.position)).into();
        start.orientation = [turn.w, turn.i, turn.j, turn.k];
        let tilted = run(Isa::F64, &model(0.0, Some(plane.clone())), &start, 0.6);
        let back = turn.inverse() * (V::from(tilted.position) - origin);
        // The heights of the nodes are in single precision.
        assert!((back - V::from(flat.position)).norm() < 2e-5, "{hard}: {back} {flat:?}");
        let moved = (V::from(flat.position) - V::new(0.0, 0.0, 0.35)).norm();
        assert!(moved > 0.01, "{hard}: {flat:?}");
    }
}

/// A servo reaches its target, gives no more than its torque limit, and stays within its range.
#[test]
fn servos_and_stops() {
    let tree = quadruped();
    // The trunk has a mass of a hundred tonnes, so that it hardly moves in the air.
    let mut heavy = tree.clone();
    heavy.bodies[0].mass = 1e5;
    heavy.bodies[0].inertia *= 1e5;
    let mut model = model_of(heavy, 1e-3);
    model.gravity = V::zeros();
    let target = |q: f64| Command { targets: vec![q; 12], ..Command::still(12) };
    let after = |command: &Command, time: f64| {
        let mut engine = sandgait_sim::tree::engine(Isa::F64, &model, 1).unwrap();
        let mut state = standing(&tree);
        engine.set_state(0, &state);
        engine.command(0, command);
        let mut most = 0.0_f64;
        for _ in 0..(time / 1e-3) as usize {
            engine.advance(1);
            engine.state(0, &mut state);
            most = state.torques.iter().fold(most, |m, t| m.max(t.abs()));
        }
        (state, most)
    };
    let (state, most) = after(&target(0.5), 2.0);
    assert!((most - 20.0).abs() < 1e-9, "{most}");
    for i in 0..12 {
        let [low, high] = tree.joints().nth(i).unwrap().range.unwrap();
        let expected = 0.5_f64.clamp(low, high);
        // Dry friction of 0.1 N·m leaves an error of up to 0.1/60 rad; a stop gives way in proportion to its load.
        assert!((state.angles[i] - expected).abs() < 4e-3, "{i}: {} {expected}", state.angles[i]);
    }
    // Without a servo, dry friction holds a torque of 0.05 N·m, apart from creep. A torque of 0.3 N·m overcomes it.
    let mut loose = (**model.tree.as_ref().unwrap()).clone();
    loose.motors.iter_mut().for_each(|m| (m.kp, m.kd) = (0.0, 0.0));
    let mut free = Model::of_tree(loose, &model.scene).unwrap();
    free.gravity = V::zeros();
    for (torque, moves) in [(0.05, false), (0.3, true)] {
        let mut engine = sandgait_sim::tree::engine(Isa::F64, &free, 1).unwrap();
        let mut state = standing(&tree);
        engine.set_state(0, &state);
        engine.command(0, &Command { torques: vec![torque; 12], ..Command::still(12) });
        engine.advance(200);
        engine.state(0, &mut state);
        let moved = state.angles[2] + 1.5;
        assert!(if moves { moved > 1e-2 } else { moved.abs() < 2e-4 }, "{torque}: {moved}");
    }
}
