//! Compares cylinders and boxes with a second implementation that was written from the published equations alone. It
//! sums over many small cells on each surface and computes the angles β, γ and ψ by trigonometry. It shares no code
//! with the program.

#[path = "testbed/long.rs"]
mod long;

use rand::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use sandgait::sand::intruder::{BodyShape, DepthOrLoad, PlatedBody, Trial, compute};
use sandgait::sand::{Law, Mechanisms, Medium, SandDescription};
use std::f64::consts::{PI, TAU};

type V = [f64; 3];

fn dot(a: V, b: V) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: V, b: V) -> V {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn sum(a: V, b: V, share: f64) -> V {
    [0, 1, 2].map(|k| a[k] + share * b[k])
}

fn norm(a: V) -> f64 {
    dot(a, a).sqrt()
}

/// Agarwal, Goldman & Kamrin, PNAS 2023, supplementary table: powers of x1, x2, x3, then c1, c2, c3.
#[rustfmt::skip]
const TABLE: [([i32; 3], V); 20] = [
    ([0, 0, 0], [0.00212, -0.06796, -0.02634]), ([3, 0, 0], [0.01992, -0.00736, 0.02927]),
    ([1, 0, 0], [-0.02320, -0.10941, -0.03436]), ([0, 3, 0], [-0.45961, 0.63758, 0.95406]),
    ([0, 1, 0], [-0.20890, 0.04725, 0.45256]), ([0, 0, 3], [0.40799, 0.08997, -0.00131]),
    ([0, 0, 1], [-0.43083, -0.06914, 0.00835]), ([1, 2, 0], [-0.10107, 0.21069, -0.11028]),
    ([2, 0, 0], [-0.00259, -0.05835, 0.02553]), ([2, 1, 0], [-0.06576, 0.04748, 0.01487]),
    ([0, 2, 0], [0.48872, -0.65880, -1.31290]), ([0, 1, 2], [0.05664, 0.20406, -0.02730]),
    ([0, 0, 2], [-0.00415, -0.11985, -0.05532]), ([0, 2, 1], [-0.09269, 0.18519, 0.10911]),
    ([1, 1, 0], [0.07204, -0.25739, 0.06790]), ([2, 0, 1], [0.01892, 0.04934, -0.04097]),
    ([0, 1, 1], [-0.02750, -0.26834, -0.16404]), ([1, 0, 2], [0.01033, 0.13527, 0.07881]),
    ([1, 0, 1], [-0.08772, 0.02692, 0.02287]), ([1, 1, 1], [0.15120, -0.33207, -0.27519]),
];

/// Stress per depth over ξ_n on a face with outward normal `n` and velocity `v`.
fn alpha(n: V, v: V, mu: f64) -> V {
    let speed = norm(v);
    let u = v.map(|x| x / speed);
    if dot(u, n) < -1e-12 {
        return [0.0; 3];
    }
    let level = u[0].hypot(u[1]);
    let r = if level > 1e-12 { [u[0] / level, u[1] / level] } else { [1.0, 0.0] };
    // The law depends on β modulo π only, so the downward normal is taken.
    let down = if n[2] > 1e-12 { n.map(|x| -x) } else { n };
    let beta = (-down[2]).clamp(-1.0, 1.0).acos();
    let psi = (r[0] * down[1] - r[1] * down[0]).atan2(r[0] * down[0] + r[1] * down[1]);
    let gamma = (-u[2]).atan2(level);
    let x = [gamma.sin(), beta.cos(), psi.cos() * gamma.cos() * beta.sin() + gamma.sin() * beta.cos()];
    let mut f = [0.0; 3];
    for (powers, c) in TABLE {
        let term = x[0].powi(powers[0]) * x[1].powi(powers[1]) * x[2].powi(powers[2]);
        f = sum(f, c, term);
    }
    let along = f[0] * beta.sin() * psi.cos() + f[1] * gamma.cos();
    let across = f[0] * beta.sin() * psi.sin();
    let up = -f[0] * beta.cos() - f[1] * gamma.sin() - f[2];
    let a = [along * r[0] - across * r[1], along * r[1] + across * r[0], up];
    let normal = dot(a, n);
    let tangential = sum(a, n, -normal);
    let kept = (mu * normal.abs() / norm(tangential).max(1e-300)).min(1.0);
    sum(n.map(|x| -x * normal.abs()), tangential, kept)
}

/// Middle, outward normal and area of a cell.
type Cell = (V, V, f64);

fn cylinder(radius: f64, width: f64, cells: usize) -> Vec<Cell> {
    let mut all = Vec::new();
    let (around, across, rings) = (12 * cells, cells, 2 * cells);
    for i in 0..around {
        let (sin, cos) = (TAU * (i as f64 + 0.5) / around as f64).sin_cos();
        for j in 0..across {
            let y = width * ((j as f64 + 0.5) / across as f64 - 0.5);
            let area = TAU * radius * width / (around * across) as f64;
            all.push(([radius * sin, y, -radius * cos], [sin, 0.0, -cos], area));
        }
        for j in 0..rings {
            let at = radius * (j as f64 + 0.5) / rings as f64;
            let area = at * radius / rings as f64 * TAU / around as f64;
            for side in [-1.0, 1.0] {
                all.push(([at * sin, side * width / 2.0, -at * cos], [0.0, side, 0.0], area));
            }
        }
    }
    all
}

fn cuboid(sides: V, cells: usize) -> Vec<Cell> {
    let mut all = Vec::new();
    let at = |i: usize| (i as f64 + 0.5) / cells as f64 - 0.5;
    for axis in 0..3 {
        let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
        for (side, i) in [-1.0, 1.0].into_iter().flat_map(|s| (0..cells).map(move |i| (s, i))) {
            for j in 0..cells {
                let (mut middle, mut normal) = ([0.0; 3], [0.0; 3]);
                (middle[axis], normal[axis]) = (side * sides[axis] / 2.0, side);
                (middle[a], middle[b]) = (at(i) * sides[a], at(j) * sides[b]);
                all.push((middle, normal, sides[a] * sides[b] / (cells * cells) as f64));
            }
        }
    }
    all
}

struct Motion {
    v: V,
    w: V,
    /// Height of the surface over the body's origin [m].
    surface: f64,
    mu: f64,
}

/// Force and torque, for ξ_n = 1 N/m³.
fn load(cells: &[Cell], m: &Motion) -> [V; 2] {
    let mut total = [[0.0; 3]; 2];
    for (at, n, area) in cells {
        let depth = m.surface - at[2];
        if depth > 0.0 {
            let force = alpha(*n, sum(m.v, cross(m.w, *at), 1.0), m.mu);
            total = [sum(total[0], force, depth * area), sum(total[1], cross(*at, force), depth * area)];
        }
    }
    total
}

const XI: f64 = 1e6;

fn sand(mu: f64) -> SandDescription {
    let mechanisms = Mechanisms { friction_clip: 1.0 / mu, ..Mechanisms::PLAIN };
    // ξ_n is the medium's penetration stress divided by 0.87574.
    let plain = SandDescription::plain(&Medium::generic(0.87574e-6 * XI).unwrap());
    SandDescription { law: Law::Agarwal2023, mechanisms, ..plain }
}

/// The relative difference of the forces, and that of the torques relative to force times half the body's length.
fn off(found: [V; 2], expected: [V; 2], arm: f64) -> f64 {
    let [force, torque] = [0, 1].map(|k| norm(sum(found[k], expected[k], -1.0)));
    (force / norm(expected[0])).max(torque / (norm(expected[0]) * arm))
}

/// Bodies with their cells, the depth of their lowest point below the origin, and half their length.
fn bodies(cells: usize) -> Vec<(String, Vec<Cell>, f64, f64)> {
    let mut all = Vec::new();
    for (radius, width) in [(0.0625, 0.06), (0.03, 0.1), (0.1, 0.03)] {
        let name = format!("cylinder:radius={radius},width={width}");
        all.push((name, cylinder(radius, width, cells), radius, radius));
    }
    for sides in [[0.1, 0.06, 0.04], [0.03, 0.1, 0.12], [0.08, 0.02, 0.05]] {
        let name = format!("box:length={},width={},height={}", sides[0], sides[1], sides[2]);
        all.push((name, cuboid(sides, 2 * cells), sides[2] / 2.0, sides[0] / 2.0));
    }
    all
}

/// 300 random motions: wheels with any spin and boxes without spin, with any velocity (some components are 0) and any
/// friction.
#[test]
fn three_hundred_rows_agree_with_a_second_implementation() {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(17);
    let mut errors = [Vec::new(), Vec::new()];
    for (name, cells, low, arm) in bodies(60) {
        let shape = BodyShape::named(&name).unwrap();
        let coarse = PlatedBody::cut(&shape, None).unwrap();
        let fine = PlatedBody::cut(&shape, Some(coarse.plate_size / 2.0)).unwrap();
        for row in 0..50 {
            let mut v = [0; 3].map(|_| random.random_range(-0.03..0.03));
            if row % 3 > 0 {
                v[2] = -f64::abs(v[2]) * f64::from(row % 3 - 1);
            }
            if row % 5 == 0 {
                v[row as usize / 5 % 2] = 0.0;
            }
            let spin = if name.starts_with("cyl") { random.random_range(-1.5..1.5) } else { 0.0 };
            let (depth, mu) = (random.random_range(0.004..1.9 * low), random.random_range(0.15..0.8));
            let trial = Trial { velocity: v, spin: [0.0, spin, 0.0], given: DepthOrLoad::Depth(depth) };
            let expected = load(&cells, &Motion { v, w: [0.0, spin, 0.0], surface: depth - low, mu });
            let expected = expected.map(|f| f.map(|x| XI * x));
            if norm(expected[0]) < 0.01 {
                // A body that is drawn straight up has nearly no force, so its relative error says nothing.
                continue;
            }
            for (body, errors) in [&coarse, &fine].into_iter().zip(&mut errors) {
                let found = compute(body, &sand(mu), &trial);
                errors.push(off([found.force, found.torque], expected, arm));
                assert!(errors[errors.len() - 1] < 0.02, "{name} {trial:?} {mu}: {found:?} {expected:?}");
            }
            if row % long::either(4, 1) == 0 && expected[0][2] > 0.5 * norm(expected[0]) {
                // At the depth found for a load, the second implementation must give this load.
                let loaded = Trial { given: DepthOrLoad::Load(expected[0][2]), ..trial };
                let found = compute(&fine, &sand(mu), &loaded);
                let there = load(&cells, &Motion { v, w: [0.0, spin, 0.0], surface: found.depth - low, mu });
                let miss = (XI * there[0][2] - expected[0][2]).abs() / norm(expected[0]);
                assert!(miss < 8e-3, "{name} {loaded:?}: {found:?} {expected:?}");
            }
        }
    }
    let worst = |errors: &[f64]| errors.iter().copied().fold(0.0, f64::max);
    assert!(errors[0].len() > 280, "{}", errors[0].len());
    // Four times as many plates. In a few rows the body is drawn out and only a narrow strip is loaded.
    let mut sorted = errors[1].clone();
    sorted.sort_by(f64::total_cmp);
    println!("worst {} and {}, 98 % {}", worst(&errors[0]), worst(&errors[1]), sorted[sorted.len() * 98 / 100]);
    assert!(sorted[sorted.len() * 98 / 100] < 3e-3 && worst(&errors[1]) < 8e-3, "{} {sorted:?}", worst(&errors[1]));
}

/// Bodies that spin about any axis: the means over a period agree. The depth is that of the lowest point of the whole
/// turn.
#[test]
fn turning_bodies_agree_with_a_second_implementation() {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(4);
    for (name, cells, ..) in bodies(24).into_iter().step_by(3) {
        let body = PlatedBody::cut(&BodyShape::named(&name).unwrap(), None).unwrap();
        let ends: Vec<V> = match name.starts_with("cyl") {
            true => (0..720)
                .flat_map(|k| {
                    let (sin, cos) = (PI * f64::from(k) / 360.0).sin_cos();
                    [-0.03, 0.03].map(|y| [0.0625 * sin, y, 0.0625 * cos])
                })
                .collect(),
            false => {
                (0..8).map(|k| [0, 1, 2].map(|i| [0.05, 0.03, 0.02][i] * f64::from(2 * (k >> i & 1) - 1))).collect()
            }
        };
        for _ in long::first(2, 0..6) {
            let [v, w] = [0.03, 1.0].map(|most| [0; 3].map(|_| random.random_range(-most..most)));
            let v = [v[0], v[1], -f64::abs(v[2])];
            let depth = random.random_range(0.01..0.04);
            let axis = w.map(|x| x / norm(w));
            let turned = |p: V, angle: f64| {
                let (sin, cos) = angle.sin_cos();
                let along = dot(axis, p) * (1.0 - cos);
                sum(sum(p.map(|x| x * cos), cross(axis, p), sin), axis, along)
            };
            let angles: Vec<f64> = (0..150).map(|k| TAU * (f64::from(k) + 0.3) / 150.0).collect();
            let heights = (0..1440).flat_map(|k| ends.iter().map(move |p| (k, *p)));
            let low = heights.map(|(k, p)| turned(p, TAU * f64::from(k) / 1440.0)[2]).fold(f64::MAX, f64::min);
            let mut mean = [[0.0; 3]; 2];
            for angle in &angles {
                let there: Vec<Cell> =
                    cells.iter().map(|(at, n, area)| (turned(*at, *angle), turned(*n, *angle), *area)).collect();
                let load = load(&there, &Motion { v, w, surface: depth + low, mu: 0.4 });
                mean = [0, 1].map(|k| sum(mean[k], load[k], XI / angles.len() as f64));
            }
            let trial = Trial { velocity: v, spin: w, given: DepthOrLoad::Depth(depth) };
            let found = compute(&body, &sand(0.4), &trial);
            let miss = off([found.force, found.torque], mean, 0.06);
            assert!(miss < 0.02, "{name} {trial:?}: {miss} {found:?} {mean:?}");
        }
    }
}
