//! Sand on plates in lanes, compared with `sand::intruder`, the program's other code for bodies in sand.

use super::*;
use sandgait_number::{Portable, Real, Vec3};
use sandgait_sand::intruder::{BodyShape, DepthOrLoad, IntruderPlate, PlatedBody, Trial, compute, cut};
use sandgait_sand::term::Term;
use sandgait_sand::{Law, Mechanisms, Medium, Regularization, SandBed, SandDescription};
use sandgait_sim::blocks::LinkFrame;
use sandgait_sim::spatial::Twist;
use sandgait_sim::tree::dynamics::LinkLoad;
use sandgait_sim::tree::patches::BodyPatches;
use sandgait_sim::tree::sand::press;
use sandgait_sim::tree::terrain::Flat;
use std::io::Write;

fn vec3(v: V) -> Vec3<f64> {
    Vec3::new(v.x, v.y, v.z)
}

fn nalgebra_of(v: Vec3<f64>) -> V {
    V::from(v.lane(0))
}

/// A box turned by `turn`, as a mesh for `sand::intruder`.
fn turned_box(half: V, turn: &Rotation3<f64>, folder: &std::path::Path) -> PlatedBody {
    let path = folder.join("box.obj");
    let mut file = std::fs::File::create(&path).unwrap();
    for i in 0..8 {
        let sign = |k: usize| if i >> k & 1 == 1 { 1.0 } else { -1.0 };
        let p = turn * V::new(sign(0) * half.x, sign(1) * half.y, sign(2) * half.z);
        writeln!(file, "v {} {} {}", p.x, p.y, p.z).unwrap();
    }
    for [a, b, c, d] in [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]] {
        writeln!(file, "f {} {} {}\nf {} {} {}", a + 1, b + 1, c + 1, a + 1, c + 1, d + 1).unwrap();
    }
    PlatedBody::cut(&BodyShape::Mesh(path), Some(0.002)).unwrap()
}

/// Force and moment about the body's origin, which is `depth` below the surface, by the lanes' code.
fn by_lanes<R: Real>(
    plates: &[IntruderPlate],
    sand: &SandDescription,
    turn: &Rotation3<f64>,
    depth: f64,
    v: V,
    gate: f64,
) -> (V, V) {
    // Turns plates back into the body's frame, because `sand::intruder` has the plates of the turned body.
    let back = |p: &IntruderPlate| IntruderPlate {
        center: vec3(turn.inverse() * nalgebra_of(p.center)),
        normal: vec3(turn.inverse() * nalgebra_of(p.normal)),
        half: p.half.map(|h| vec3(turn.inverse() * nalgebra_of(h))),
        ..*p
    };
    let plates: Vec<IntruderPlate> = plates.iter().map(back).collect();
    let surface = Regularization { rest_speed: 1e-9, leading_edge_gate: gate, ..Regularization::DEFAULT };
    let medium = sand.medium();
    let ground = SandBed::<R>::new(sand.law, &medium, &surface).with(&sand.mechanisms, &medium);
    let mut frame = LinkFrame::<R>::at_rest();
    let column = |k: usize| Vec3::splat(turn.matrix().column(k).into_owned().into());
    (frame.rotation.x, frame.rotation.y, frame.rotation.z) = (column(0), column(1), column(2));
    frame.velocity = Twist { angular: Vec3::zero(), linear: Vec3::splat(v.into()) };
    let mut loads = [LinkLoad::none()];
    let body = [BodyPatches::of(0, &plates, sand.law)];
    press(&ground, &body, &[frame], &Vec3::splat([0.0, 0.0, -depth]), &Flat, None, &mut loads, R::splat(1e-3));
    let bias = loads[0].bias;
    (-V::from(bias.force.lane(0)), -V::from(bias.moment.lane(0)))
}

/// Force and moment from `sand::intruder`.
fn by_intruder(body: &PlatedBody, sand: &SandDescription, depth: f64, v: V) -> (V, V) {
    let lowest = -body.heights()[0];
    let trial = Trial { velocity: v.into(), spin: [0.0; 3], given: DepthOrLoad::Depth(depth + lowest) };
    let outcome = compute(body, sand, &trial);
    (outcome.force.into(), outcome.torque.into())
}

fn sands() -> [SandDescription; 3] {
    let plain = |name: &str| SandDescription::plain(&Medium::named(name).unwrap());
    let loose = plain("poppy-loose");
    let spatial = SandDescription { law: Law::Agarwal2023, ..plain("poppy-close") };
    let mechanisms = Mechanisms { inertial_drag: 1.1, cohesion: 100.0, depth_power: 0.2, ..loose.mechanisms };
    [loose.clone(), spatial, SandDescription { mechanisms, ..loose }]
}

/// A velocity at which no face of a turned box moves almost along itself. When such a face begins to lead, the engines
/// apply the load gradually, and `sand::intruder` applies it at once.
fn clear_of(turn: &Rotation3<f64>, draw: impl FnMut() -> V) -> V {
    let along = |v: &V| {
        (0..3).any(|k| turn.matrix().column(k).dot(&v.normalize()).abs() < Regularization::SOLID.leading_edge_gate)
    };
    std::iter::repeat_with(draw).find(|v| !along(v)).unwrap()
}

/// Same plates, random poses and velocities, both laws, with mechanisms. Force and moment are equal where plates
/// are flat and the leading edge is sharp. On a ball they differ, because `sand::intruder` divides plates at the
/// leading edge.
#[test]
fn the_force_is_that_of_a_body_in_steady_motion() {
    let folder = tempfile::tempdir().unwrap();
    let mut draw = SignedDraw::new(5);
    for sand in sands() {
        // A patch has one mean depth, which is exact if the stress is linear in depth.
        let part = if sand.mechanisms.depth_power == 0.0 { 5e-3 } else { 2e-2 };
        for _ in 0..6 {
            let turn = Rotation3::from_scaled_axis(draw.vector() * 3.0);
            let body = turned_box(V::new(0.03, 0.02, 0.01), &turn, folder.path());
            // At least half of the body is in the sand, because in slight contact few plates would carry the whole force.
            let (depth, v) = (0.01 * (1.0 + draw.number()), clear_of(&turn, || draw.vector() * 0.3));
            let expected = by_intruder(&body, &sand, depth, v);
            let found = by_lanes::<f64>(&body.plates, &sand, &turn, depth, v, 1e-20);
            assert_near(found, expected, part);
            let single = by_lanes::<Portable>(&body.plates, &sand, &turn, depth, v, 1e-20);
            assert_near(single, expected, part);
        }
        let ball = PlatedBody::cut(&BodyShape::Sphere { radius: 0.02 }, None).unwrap();
        for _ in 0..6 {
            let (depth, v) = (0.01 * (1.0 + draw.number()), draw.vector() * 0.3);
            let found = by_lanes::<f64>(&ball.plates, &sand, &Rotation3::identity(), depth, v, 1e-20);
            // The law is evaluated for a patch's mean normal, not for each plate. The error is no larger than the error
            // of the default plates.
            assert_near(found, by_intruder(&ball, &sand, depth, v), 2e-2);
        }
    }
}

/// With `sliding_face` the force of a face rises over the mechanism's range in both, so they are equal for faces that move
/// along themselves too. The sand at rest on them, with its friction, is in both.
#[test]
fn faces_that_slide_along_themselves_carry_what_they_carry_in_steady_motion() {
    let folder = tempfile::tempdir().unwrap();
    let mut draw = SignedDraw::new(6);
    for sand in sands() {
        let mechanisms = Mechanisms { sliding_face: 0.04, ..sand.mechanisms };
        let sand = SandDescription { mechanisms, ..sand };
        let part = if sand.mechanisms.depth_power == 0.0 { 5e-3 } else { 2e-2 };
        let mut changed = 0;
        for k in 0..8 {
            // Level in half of the cases, except in `agarwal2023`, whose patches take the mean of its jump at vertical faces.
            let level = k < 4 && sand.law == Law::Li2013;
            let turn = Rotation3::from_scaled_axis(draw.vector() * if level { 0.0 } else { 3.0 });
            let body = turned_box(V::new(0.03, 0.02, 0.01), &turn, folder.path());
            // Along the box's own x, up to 0.05 off.
            let v = turn * (V::new(0.3, 0.0, 0.0) + draw.vector() * 0.015);
            let depth = 0.03 + 0.01 * draw.number();
            let expected = by_intruder(&body, &sand, depth, v);
            let found = by_lanes::<f64>(&body.plates, &sand, &turn, depth, v, 1e-20);
            assert_near(found, expected, part);
            assert_near(by_lanes::<Portable>(&body.plates, &sand, &turn, depth, v, 1e-20), expected, part);
            let plain = SandDescription { mechanisms: Mechanisms { sliding_face: 0.0, ..mechanisms }, ..sand.clone() };
            let without = by_intruder(&body, &plain, depth, v).0;
            changed += u32::from((expected.0 - without).norm() > 0.1 * without.norm());
        }
        assert!(changed >= 2, "the mechanism did little: {changed}");
        let ball = PlatedBody::cut(&BodyShape::Sphere { radius: 0.02 }, None).unwrap();
        for _ in 0..6 {
            let (depth, v) = (0.01 * (1.0 + draw.number()), draw.vector() * 0.3);
            let found = by_lanes::<f64>(&ball.plates, &sand, &Rotation3::identity(), depth, v, 1e-20);
            assert_near(found, by_intruder(&ball, &sand, depth, v), 3e-2);
        }
    }
}

#[track_caller]
fn assert_near((f, m): (V, V), (force, moment): (V, V), part: f64) {
    // Arms are up to 4 cm.
    let scale = force.norm() + moment.norm() / 0.04;
    let off = (f - force).norm() + (m - moment).norm() / 0.04;
    assert!(off <= part * scale, "{} of it: {f} {m}\n{force} {moment}", off / scale);
}

/// A term that depends on depth over width uses the body's extent across its horizontal velocity; if the body moves
/// straight down, it uses the extent along the body's y axis.
#[test]
fn a_term_takes_the_width_across_the_motion() {
    let text = "on = \"normal\"\ncoefficient = 1e4\ngroups = { depth_over_width = 1.0 }\n\
                range = { depth_over_width = [0.0, 9.0] }";
    let term = toml::from_str::<Term>(text).unwrap();
    let plain = SandDescription::plain(&Medium::named("poppy-loose").unwrap());
    let with = SandDescription { terms: vec![term], ..plain.clone() };
    let plates = cut::cuboid(0.1, 0.04, 0.002, 0.005, 8);
    let push =
        |sand: &SandDescription, v: V| by_lanes::<f64>(&plates, sand, &Rotation3::identity(), 0.01, v, 1e-20).0.z;
    let [along, across, down] = [V::new(0.05, 0.0, -0.3), V::new(0.0, 0.05, -0.3), V::new(0.0, 0.0, -0.3)]
        .map(|v| push(&with, v) - push(&plain, v));
    assert!(along > 0.0 && (along / across - 2.5).abs() < 1e-2, "{along} {across}");
    assert!((down / along - 1.0).abs() < 1e-2, "{down} {along}");
}
