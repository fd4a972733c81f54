//! Faces that slide along themselves: laws that hold for any motion, and bodies in simulated grains (`tests/data/drag`).

use super::*;
use crate::intruder::path::{Path, PathPoint};
use crate::intruder::{BodyShape, DepthOrLoad, PlatedBody, Trial, compute};
use crate::mechanism_laws::SegmentState;
use crate::number::Portable;
use crate::{Law, Medium, Regularization, SandBed, SandDescription};
use rand::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

const KAPPA: f64 = 0.03;

fn sliding(kappa: f64) -> Mechanisms {
    Mechanisms { sliding_face: kappa, ..Mechanisms::PLAIN }
}

fn body(shape: &str, plate: f64) -> PlatedBody {
    PlatedBody::cut(&BodyShape::named(shape).unwrap(), Some(plate)).unwrap()
}

fn unit(random: &mut impl Rng) -> Vec3<f64> {
    let v = Vec3::<f64>::splat([(); 3].map(|()| random.random_range(-1.0..1.0)));
    v * (1.0 / v.norm_squared().sqrt().max(1e-3))
}

/// A random normal, and a random direction of motion that in half of all cases is nearly along the face.
fn normal_and_direction(random: &mut impl Rng) -> [Vec3<f64>; 2] {
    let (n, other) = (unit(random), unit(random));
    let n = n * (1.0 / n.norm_squared().sqrt());
    let along = other - n * n.dot(other);
    let along = along * (1.0 / along.norm_squared().sqrt().max(1e-9));
    let s: f64 = if random.random_bool(0.5) { random.random_range(-0.1..0.1) } else { random.random_range(-1.0..1.0) };
    [n, n.scale_add(s, along * (1.0 - s * s).sqrt())]
}

fn one_sided(law: Law, m: &Mechanisms, surface: &Regularization, n: Vec3<f64>, v: Vec3<f64>) -> crate::Contact<f64> {
    let medium = Medium::named("glass-beads").unwrap();
    let ground = SandBed::<f64>::new(law, &medium, surface).with(m, &medium);
    ground.one_sided(&SegmentState::fresh(0.02, 0.0), 1e-4, n, v)
}

/// A lane without the mechanism beside a lane with it has the bits of a lane beside none; so does the mechanism at 0.
#[test]
fn off_is_off_to_the_last_bit() {
    let medium = Medium::named("glass-beads").unwrap();
    let mut random = Xoshiro256PlusPlus::seed_from_u64(1);
    for law in Law::ALL {
        for surface in [Regularization::DEFAULT, Regularization::SOLID] {
            let plain = SandBed::<Portable>::new(law, &medium, &surface);
            let mut mixed = plain;
            mixed.set_lane(1, &medium, &sliding(KAPPA));
            for _ in 0..2000 {
                let [n, v] = normal_and_direction(&mut random).map(|v| Vec3::splat(v.lane(0)));
                let speed = Portable::splat(10f64.powf(random.random_range(-7.0..0.0)));
                let force = |ground: &SandBed<Portable>| {
                    let site = SegmentState::fresh(Portable::splat(0.02), Portable::zero());
                    let contact = ground.one_sided(&site, Portable::splat(1e-4), n, v * speed);
                    let [x, y, z] = contact.force.lane(0);
                    [x, y, z, contact.drag.lane(0), contact.edge.lane(0)]
                };
                assert_eq!(force(&mixed), force(&plain), "{}", law.name());
            }
        }
        let off = SandDescription { law, ..SandDescription::plain(&medium) };
        assert!(off.mechanisms.sand_is_plain() && SandDescription { mechanisms: sliding(0.0), ..off.clone() } == off);
    }
}

/// The sand never drives the body, with any threshold within bounds and the least friction; drag and edge are never
/// negative. `agarwal2023` itself drives plates in a few directions, by as much as before.
#[test]
fn the_sand_never_drives_a_body() {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(2);
    for law in Law::ALL {
        for surface in [Regularization::BARE, Regularization::DEFAULT, Regularization::SOLID] {
            for _ in 0..20_000 {
                let [n, direction] = normal_and_direction(&mut random);
                let v = direction * 10f64.powf(random.random_range(-8.0..0.0));
                let m = Mechanisms { friction_clip: random.random_range(0.0..10.0), ..sliding(0.0) };
                let on = Mechanisms { sliding_face: random.random_range(0.001..0.09), ..m };
                let [with, without] = [on, m].map(|m| one_sided(law, &m, &surface, n, v));
                let (power, size) = (with.force.dot(v), with.force.norm_squared().sqrt() * v.norm_squared().sqrt());
                let allowed = without.force.dot(v).max(0.0) + 1e-12 * size;
                assert!(power <= allowed, "{} {on:?} n {n:?} v {v:?}: {power} W", law.name());
                assert!(with.drag >= 0.0 && with.edge >= 0.0);
            }
        }
    }
}

/// At rest there is no force. A face that moves by more than κ toward the sand has the law's, and one that recedes by more has none.
#[test]
fn at_rest_there_is_none_and_beyond_the_threshold_the_law() {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(3);
    let surface = Regularization::SOLID;
    for law in Law::ALL {
        let level = Vec3::new(0.0, 0.0, -1.0);
        let resting = one_sided(law, &sliding(KAPPA), &surface, level, Vec3::zero());
        assert_eq!((resting.force, resting.drag, resting.edge), (Vec3::zero(), 0.0, 0.0));
        for _ in 0..2000 {
            let [n, v] = normal_and_direction(&mut random);
            let slow = one_sided(law, &sliding(KAPPA), &surface, n, v * 1e-9).force.norm_squared().sqrt();
            // 1e-4 of the force at 20 mm on 1 cm² at v0.
            assert!(slow < 1e-4 * 0.33e6 * 0.02 * 1e-4 * 2.0, "{n:?} {v:?}: {slow} N");
            if n.dot(v).abs() > KAPPA * 1.001 {
                let [with, without] =
                    [sliding(KAPPA), Mechanisms::PLAIN].map(|m| one_sided(law, &m, &surface, n, v).force);
                assert_eq!(with, without, "{n:?} {v:?}");
            }
        }
    }
}

/// The edge is the slope of the force along the normal, where nothing else changes fast.
#[test]
fn the_edge_is_the_slope_along_the_normal() {
    let surface = Regularization::SOLID;
    let n = Vec3::new(0.0, 0.0, -1.0);
    let push = |s: f64| one_sided(Law::Li2013, &sliding(KAPPA), &surface, n, Vec3::new(0.1, 0.0, -0.1 * s));
    for s in [-0.02, -0.01, 0.005, 0.01, 0.02] {
        let step = 1e-6;
        let slope = (push(s + step).force.z - push(s - step).force.z) / (0.2 * step);
        let edge = push(s).edge;
        // The law's own slope, which counts in neither mode, is 0.4 of the share times 1/κ.
        assert!((slope - edge).abs() < 0.06 * slope.abs() + 0.03 * edge, "s {s}: slope {slope}, edge {edge}");
    }
}

/// The box of docs/physics.md: sunk to its upper face and drawn along itself at 1 m/s. Of the lift, what remains is mostly
/// the weight of the sand that the box displaces, 1.6 N.
#[test]
fn a_box_drawn_along_itself_carries_little() {
    let b = body("box:length=0.1,width=0.05,height=0.05", 0.002);
    let motion = Trial { velocity: [1.0, 0.0, 0.0], spin: [0.0; 3], given: DepthOrLoad::Depth(0.05) };
    for (law, [drag, lift]) in [(Law::Li2013, [0.24, 0.06]), (Law::Agarwal2023, [0.4, 0.27])] {
        let sand = SandDescription { law, ..SandDescription::named("poppy-loose", "li2013").unwrap() };
        let on = SandDescription { mechanisms: sliding(KAPPA), ..sand.clone() };
        let [without, with] = [&sand, &on].map(|sand| compute(&b, sand, &motion).force);
        println!("{}: {without:.3?} {with:.3?}", law.name());
        assert!(with[0] < 0.0 && with[0] > drag * without[0], "{without:?} {with:?}");
        assert!(with[2] > 0.0 && with[2] < lift * without[2], "{without:?} {with:?}");
    }
}

/// A course in grains: body, its file, and the depth of its lowest point [m], or None where the file has it.
const COURSES: [(&str, &str, Option<f64>); 5] = [
    ("sphere:radius=0.02", include_str!("../../../../tests/data/drag/ball_0.02.csv"), Some(0.015)),
    ("box:length=0.005,width=0.05,height=0.04", include_str!("../../../../tests/data/drag/plate_0.05.csv"), Some(0.02)),
    (
        "box:length=0.04,width=0.05,height=0.04",
        include_str!("../../../../tests/data/drag/block_0.04_0.05_20mm.csv"),
        Some(0.02),
    ),
    (
        "box:length=0.04,width=0.05,height=0.006",
        include_str!("../../../../tests/data/drag/flat_0.04_0.05_20mm.csv"),
        Some(0.02),
    ),
    (
        "box:length=0.04,width=0.05,height=0.006",
        include_str!("../../../../tests/data/drag/flat_0.04_0.05_gamma_0.1.csv"),
        None,
    ),
];

/// Means of Fx and Fz over each of the first five 10 mm.
fn tens(rows: &[[f64; 2]]) -> [[f64; 5]; 2] {
    let mean = |c: usize, k: usize| rows[10 * k..10 * (k + 1)].iter().map(|r| r[c]).sum::<f64>() / 10.0;
    [0, 1].map(|c| std::array::from_fn(|k| mean(c, k)))
}

/// A course's rows of the first 50 mm: depth [m], Fx and Fz [N].
fn rows(text: &str, depth: Option<f64>) -> Vec<[f64; 3]> {
    let row = |line: &str| {
        let row: Vec<f64> = line.split(',').map(|c| c.parse().unwrap()).collect();
        [depth.unwrap_or(row[1]), row[row.len() - 2], row[row.len() - 1]]
    };
    text.lines().skip(1).take(50).map(row).collect()
}

/// Errors in % of the grains' largest 10 mm mean of the component, for all courses: Fx and Fz in 5 windows each.
fn errors(sand: &SandDescription) -> Vec<[[f64; 5]; 2]> {
    let course = |(shape, text, depth): &(&str, &str, Option<f64>)| {
        let (b, rows) = (body(shape, 0.002), rows(text, *depth));
        let (sin, cos) = if depth.is_some() { (0.0, 1.0) } else { f64::sin_cos(0.1) };
        let force = |depth: f64| {
            let given = DepthOrLoad::Depth(depth);
            let [x, _, z] =
                compute(&b, sand, &Trial { velocity: [0.1 * cos, 0.0, -0.1 * sin], spin: [0.0; 3], given }).force;
            [x, z]
        };
        let at_once = depth.map(force);
        let ours = tens(&rows.iter().map(|r| at_once.unwrap_or_else(|| force(r[0]))).collect::<Vec<_>>());
        let grains = tens(&rows.iter().map(|r| [r[1], r[2]]).collect::<Vec<_>>());
        [0, 1].map(|c| {
            let largest = grains[c].iter().fold(0.0_f64, |a, x| a.max(x.abs()));
            std::array::from_fn(|k| 100.0 * (ours[c][k] - grains[c][k]) / largest)
        })
    };
    COURSES.iter().map(course).collect()
}

/// How many of the 50 windows are within 20 % of the grains', and the rms error [%], without and with the mechanism. ζ is
/// that of glass beads, or that of slow vertical plates in these grains (`tests/data/grains`). In `agarwal2023` fewer hold at
/// 0.33, because its faces ahead are too weak there, and its faces that slide too strong. The first 10 mm miss the lift of
/// the press before, which passes in some 6 mm.
#[test]
fn windows_of_the_grains_hold_as_measured() {
    for (law, zeta, measured) in [
        (Law::Li2013, 0.33, [(21, 70.0), (33, 28.0)]),
        (Law::Li2013, 0.46, [(4, 116.0), (23, 32.0)]),
        (Law::Agarwal2023, 0.33, [(28, 30.0), (21, 37.0)]),
        (Law::Agarwal2023, 0.46, [(25, 33.0), (22, 32.0)]),
    ] {
        // The density of the grains' bed.
        let medium = Medium { bulk_density: 1467.0, ..Medium::generic(zeta).unwrap() };
        for (mechanisms, (count, rms)) in [Mechanisms::PLAIN, sliding(KAPPA)].into_iter().zip(measured) {
            let all = errors(&SandDescription { law, mechanisms, ..SandDescription::plain(&medium) });
            all.iter().for_each(|e| println!("   Fx {:5.0?} Fz {:5.0?}", e[0], e[1]));
            let each: Vec<f64> = all.into_iter().flatten().flatten().collect();
            let hold = each.iter().filter(|e| e.abs() <= 20.0).count();
            let found = (each.iter().map(|e| e * e).sum::<f64>() / 50.0).sqrt();
            println!("{} ζ {zeta} κ {}: {hold} of 50, rms {found:.1} %", law.name(), mechanisms.sliding_face);
            assert!(hold + 2 >= count && found < rms + 2.0, "{} {zeta}: {hold} {found}", law.name());
        }
    }
}

/// The same courses as paths in sand with memory, from the press on.
fn errors_on_paths(sand: &SandDescription, grains: Option<f64>) -> Vec<[[f64; 5]; 2]> {
    let course = |(shape, text, depth): &(&str, &str, Option<f64>)| {
        let (b, rows) = (body(shape, 0.002), rows(text, *depth));
        let (sin, cos) = if depth.is_some() { (0.0, 1.0) } else { f64::sin_cos(0.1) };
        let mut path = Path::new(&b, sand, None, None).unwrap();
        if let Some(diameter) = grains {
            path = path.in_grains(diameter).unwrap();
        }
        let mut to = |time: f64, x: f64, [vx, vz]: [f64; 2], depth: f64| {
            let trial = Trial { velocity: [vx, 0.0, vz], spin: [0.0; 3], given: DepthOrLoad::Depth(depth) };
            let [x, _, z] = path.step(&PathPoint { time, place: Some([x, 0.0]), trial }).force;
            [x, z]
        };
        let first = rows[0][0];
        to(-1.0, 0.0, [0.0, -0.1], -0.002);
        to(0.0, 0.0, [0.0, -0.1], first);
        let ours: Vec<_> = (0..50)
            .map(|k| {
                let way = 1e-3 * (f64::from(k) + 0.5);
                to(10.0 * way / cos, way, [0.1 * cos, -0.1 * sin], rows[k as usize][0])
            })
            .collect();
        let (ours, grains) = (tens(&ours), tens(&rows.iter().map(|r| [r[1], r[2]]).collect::<Vec<_>>()));
        [0, 1].map(|c| {
            let largest = grains[c].iter().fold(0.0_f64, |a, x| a.max(x.abs()));
            std::array::from_fn(|k| 100.0 * (ours[c][k] - grains[c][k]) / largest)
        })
    };
    COURSES.iter().map(course).collect()
}

#[test]
fn paths() {
    for (law, zeta) in [(Law::Li2013, 0.33), (Law::Li2013, 0.46), (Law::Agarwal2023, 0.33), (Law::Agarwal2023, 0.46)] {
        let medium = Medium { bulk_density: 1467.0, ..Medium::generic(zeta).unwrap() };
        for (kappa, grains) in [(0.0, None), (KAPPA, None), (KAPPA, Some(0.004))] {
            let mechanisms = sliding(kappa);
            let all = errors_on_paths(&SandDescription { law, mechanisms, ..SandDescription::plain(&medium) }, grains);
            all.iter().for_each(|e| println!("   Fx {:5.0?} Fz {:5.0?}", e[0], e[1]));
            let each: Vec<f64> = all.into_iter().flatten().flatten().collect();
            let hold = each.iter().filter(|e| e.abs() <= 20.0).count();
            let found = (each.iter().map(|e| e * e).sum::<f64>() / 50.0).sqrt();
            println!("{} ζ {zeta} κ {kappa} {grains:?}: {hold} of 50, rms {found:.1} %", law.name());
        }
    }
}
