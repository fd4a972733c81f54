//! Forces equal the forces of `sandgait intrude` and of engine `tree`.

use super::*;
use crate::number::Vec3;
use crate::sand::intruder::{BodyShape, DepthOrLoad, PlatedBody, Trial, compute};
use crate::sand::{Law, Mechanisms, Regularization, SandBed, SandDescription};
use crate::sim::blocks::{LinkFrame, turned_by};
use crate::sim::spatial::Twist;
use crate::sim::tree::dynamics::LinkLoad;
use crate::sim::tree::patches::BodyPatches;
use crate::sim::tree::terrain::Flat;

const SHAPES: [&str; 3] =
    ["sphere:radius=0.03", "cylinder:radius=0.05,width=0.03", "box:length=0.08,width=0.05,height=0.03"];
const SIZE: f64 = 0.002;

fn sand(law: Law) -> SandGround {
    let description = SandDescription::named("poppy-loose", law.name()).unwrap();
    let options = GroundOptions { rest_speed: Regularization::SOLID.rest_speed, ..Default::default() };
    SandGround::new(description, options).unwrap()
}

fn bodies(size: Option<f64>) -> Bodies {
    Bodies::new(SHAPES.map(|s| (s.to_owned(), vec![BodyPart::named(s).unwrap()])).into(), size).unwrap()
}

/// Numbers between −1 and 1, the same on every machine.
fn numbers(seed: u64) -> impl FnMut() -> f64 {
    let mut state = seed;
    move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }
}

/// Wrenches of all bodies at one position and velocity.
fn wrenches(bodies: &Bodies, sand: &SandGround, p: [f64; 3], q: [f64; 4], v: [f64; 3], w: [f64; 3]) -> Vec<f64> {
    with_drag(bodies, sand, p, q, v, w).0
}

/// Wrenches and drag of all bodies at one position and velocity.
fn with_drag(
    bodies: &Bodies,
    sand: &SandGround,
    p: [f64; 3],
    q: [f64; 4],
    v: [f64; 3],
    w: [f64; 3],
) -> (Vec<f64>, Vec<f64>) {
    let count = bodies.len();
    let (p, q, v, w) = (p.repeat(count), q.repeat(count), v.repeat(count), w.repeat(count));
    let rows = |numbers, width: usize| Strided { numbers, steps: [count * width, width] };
    let motions = Motions {
        states: 1,
        position: rows(&p[..], 3),
        quaternion: rows(&q[..], 4),
        velocity: rows(&v[..], 3),
        angular_velocity: rows(&w[..], 3),
        travel: None,
    };
    let (mut out, mut drag) = (vec![0.0; 6 * count], vec![0.0; 36 * count]);
    bodies.wrench(sand, &motions, 1, &mut out, Some(&mut drag)).unwrap();
    (out, drag)
}

/// A change of the velocity within rounding changes the drag within rounding. Panels that lead as a whole had an edge or
/// none, as rounding would have it.
/// Sizes of plates that no body has are refused before any work, as are so many plates that no memory holds them.
#[test]
fn impossible_plates_are_refused() {
    let made = |shape: &str, size: f64| {
        let parts = vec![BodyPart::named(shape).unwrap()];
        Bodies::new(vec![("a".into(), parts)], Some(size)).map(|bodies| bodies.plates(0).len())
    };
    for shape in ["plate:length=10,width=10", "face:length=0.1,width=0.1", "sphere:radius=0.1"] {
        for size in [f64::NAN, -1.0, 0.0, 1e-6, 1e-310, f64::INFINITY, 1e9] {
            let error = made(shape, size).unwrap_err().to_string();
            assert!(error.contains("plate_size: ") && error.contains("is outside [0.0001, 1]"), "{error}");
        }
        let error = made(shape, 1e-4).unwrap_err().to_string();
        assert!(error.contains("are more than 20000"), "{error}");
        assert!(made(shape, 0.1).unwrap() <= 20_000);
    }
    let many = (0..60).map(|k| (k.to_string(), vec![BodyPart::named("box:length=1,width=1,height=1").unwrap()]));
    let error = Bodies::new(many.collect(), Some(0.018)).unwrap_err().to_string();
    assert!(error.contains("more than 1000000 plates"), "{error}");
    let placed = |x: f64| BodyPart::named("sphere:radius=0.1").unwrap().placed([x, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]);
    assert!(placed(1e300).is_err() && placed(f64::NAN).is_err() && placed(-100.0).is_ok());
}

#[test]
fn drag_does_not_depend_on_rounding() {
    let shapes = [
        "cylinder:radius=0.05,width=0.03",
        "capsule:radius=0.03,height=0.1",
        "ellipsoid:length=0.1,width=0.06,height=0.04",
    ];
    let made = shapes.map(|s| (s.to_owned(), vec![BodyPart::named(s).unwrap()])).into();
    let (bodies, sand, mut draw) = (Bodies::new(made, None).unwrap(), sand(Law::Li2013), numbers(3));
    for _ in 0..50 {
        let mut vector = |size: f64| [size * draw(), size * draw(), size * draw()];
        let (v, w, place) = (vector(0.3), vector(2.0), vector(0.02));
        let drag = |factor: f64| {
            with_drag(&bodies, &sand, place, [1.0, 0.0, 0.0, 0.0], v.map(|x| x * factor), w.map(|x| x * factor)).1
        };
        let (one, other) = (drag(1.0), drag(1.0 + 1e-12));
        for (one, other) in one.chunks(36).zip(other.chunks(36)) {
            let size = one.iter().fold(0.0, |most: f64, x| most.max(x.abs()));
            let apart = one.iter().zip(other).fold(0.0, |most: f64, (a, b)| most.max((a - b).abs()));
            assert!(apart <= 1e-8 * size, "{apart} of {size}");
        }
    }
}

#[test]
fn plates_of_a_given_size_are_those_of_intrude() {
    let (bodies, mut draw) = (bodies(Some(SIZE)), numbers(1));
    for law in Law::ALL.into_iter().filter(|law| *law != Law::PenetrationDrag1d) {
        for _ in 0..20 {
            let v = [0.3 + 0.2 * draw(), 0.1 + 0.05 * draw(), -0.3 - 0.2 * draw()];
            let depth = 0.01 * draw();
            let found = wrenches(&bodies, &sand(law), [0.3, -0.2, -depth], [1.0, 0.0, 0.0, 0.0], v, [0.0; 3]);
            for (k, shape) in SHAPES.iter().enumerate() {
                let body = PlatedBody::cut(&BodyShape::named(shape).unwrap(), Some(SIZE)).unwrap();
                let given = DepthOrLoad::Depth(depth - body.heights()[0]);
                let outcome = compute(&body, sand(law).description(), &Trial { velocity: v, spin: [0.0; 3], given });
                let expected = [outcome.force, outcome.torque].concat();
                let size = expected.iter().fold(0.0, |most: f64, x| most.max(x.abs()));
                for (a, b) in found[6 * k..6 * k + 6].iter().zip(&expected) {
                    // The force of plates that move almost along themselves rises over the gate.
                    assert!((a - b).abs() <= 2e-3 * size, "{law:?} {shape}: {found:?} {expected:?}");
                }
            }
        }
    }
}

/// The same with `sliding_face`, for bodies that are drawn level, so that flat faces slide along themselves; and default
/// plates give the force of fine ones.
#[test]
fn faces_slide_along_themselves_as_in_intrude() {
    let (mut draw, made) = (numbers(4), [Some(SIZE), None].map(bodies));
    let cut = SHAPES.map(|shape| PlatedBody::cut(&BodyShape::named(shape).unwrap(), Some(SIZE)).unwrap());
    for law in [Law::Li2013, Law::Agarwal2023] {
        let plain = sand(law).description().clone();
        let mechanisms = Mechanisms { sliding_face: 0.03, ..plain.mechanisms };
        let on = SandDescription { mechanisms, ..plain };
        let options = GroundOptions { rest_speed: Regularization::SOLID.rest_speed, ..Default::default() };
        let sand = SandGround::new(on.clone(), options).unwrap();
        for _ in 0..5 {
            let v = [0.3, 0.005 * draw(), 0.005 * draw()];
            let depth = 0.01 * draw();
            let place = [0.3, -0.2, -depth];
            let found = [&made[0], &made[1]].map(|b| wrenches(b, &sand, place, [1.0, 0.0, 0.0, 0.0], v, [0.0; 3]));
            for (k, body) in cut.iter().enumerate() {
                let given = DepthOrLoad::Depth(depth - body.heights()[0]);
                let expected = compute(body, &on, &Trial { velocity: v, spin: [0.0; 3], given }).force;
                let size = expected.iter().fold(0.0, |most: f64, x| most.max(x.abs()));
                // In `agarwal2023` the mean over a vertical face's normals lies between the two sides of the law's jump there.
                let coarse = if law == Law::Li2013 { 0.015 } else { 0.08 };
                for (found, within) in found.iter().zip([2e-3, coarse]) {
                    let found = &found[6 * k..6 * k + 3];
                    let off = found.iter().zip(expected).fold(0.0, |most: f64, (a, b)| most.max((a - b).abs()));
                    assert!(off <= within * size, "{law:?} {} {v:?}: {found:?} {expected:?}", SHAPES[k]);
                }
            }
        }
    }
}

/// Engine `tree` computes the same numbers from the same patches; it sums them in another order.
#[test]
fn forces_on_default_plates_are_those_of_engine_tree() {
    let (bodies, mut draw) = (bodies(None), numbers(2));
    for law in Law::ALL {
        let sand = sand(law);
        let medium = sand.description().medium();
        let bed = SandBed::<f64>::new(law, &medium, &Regularization::SOLID);
        for _ in 0..20 {
            let mut vector = |size: f64| [size * draw(), size * draw(), size * draw()];
            let (v, w, [a, b, c]) = (vector(0.3), vector(2.0), vector(1.0));
            let norm = (1.0 + a * a + b * b + c * c).sqrt();
            let q = [1.0, a, b, c].map(|x| x / norm);
            let place = [0.3, -0.2, 0.01 * v[0]];
            let found = wrenches(&bodies, &sand, place, q, v, w);
            for k in 0..SHAPES.len() {
                let plates: Vec<_> = bodies.plates(k).iter().map(|p| p.plate).collect();
                let frame = LinkFrame {
                    rotation: turned_by((q[0], Vec3::new(q[1], q[2], q[3]))),
                    velocity: Twist { angular: Vec3::splat(w), linear: Vec3::splat(v) },
                    ..LinkFrame::at_rest()
                };
                let mut loads = [LinkLoad::none()];
                let patches = [BodyPatches::fine(0, &plates, law)];
                crate::sim::tree::sand::press(
                    &bed,
                    &patches,
                    &[frame],
                    &Vec3::splat(place),
                    &Flat,
                    None,
                    &mut loads,
                    1e-3,
                );
                let bias = loads[0].bias;
                let expected = [bias.force.lane(0), bias.moment.lane(0)].concat();
                for (a, b) in found[6 * k..6 * k + 6].iter().zip(&expected) {
                    assert!((a + b).abs() <= 1e-12 * (1.0 + b.abs()), "{law:?} {k}: {found:?} {expected:?}");
                }
            }
        }
    }
}

/// A mesh in millimetres, read as metres, is refused like other shapes that are too large.
#[test]
fn meshes_have_the_bounds_of_other_shapes() {
    let tetrahedron = |side: f64| {
        let [o, x, y, z] = [[0.0; 3], [side, 0.0, 0.0], [0.0, side, 0.0], [0.0, 0.0, side]];
        BodyPart::triangles("foot", &[[o, y, x], [o, x, z], [o, z, y], [x, y, z]])
    };
    tetrahedron(0.1).unwrap();
    for side in [100.0, 1e-5] {
        let said = tetrahedron(side).unwrap_err().to_string();
        assert!(said.contains("foot") && said.contains("meshes are in metres"), "{said}");
    }
}

/// Users make thousands of equal bodies, one by one: each kind is cut once. Names do not matter, sizes and places do.
#[test]
fn equal_bodies_are_cut_once() {
    let body = |name: &str, shape: &str, z: f64| {
        let part = BodyPart::named(shape).unwrap().placed([0.0, 0.0, z], [1.0, 0.0, 0.0, 0.0]).unwrap();
        Bodies::new(vec![(name.to_owned(), vec![part])], None).unwrap()
    };
    let first = body("a", "sphere:radius=0.0123", 0.0);
    let same = |other: &Bodies| std::sync::Arc::ptr_eq(&first.cut()[0], &other.cut()[0]);
    assert!(same(&body("b", "sphere:radius=0.0123", 0.0)));
    assert!(!same(&body("a", "sphere:radius=0.0124", 0.0)) && !same(&body("a", "sphere:radius=0.0123", 0.1)));
}
