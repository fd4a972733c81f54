//! Bodies drawn through simulated grains (`tests/data/drag`), with and without `sliding_face`.

use super::passing::Passing;
use super::path::{Path, PathPoint};
use super::trials::{bed, compute_with};
use super::*;
use crate::{Law, Mechanisms, Medium, SandDescription};

const KAPPA: f64 = 0.03;
/// Diameter of the grains [m].
const GRAIN: f64 = 0.004;

/// A course in grains: body, its file, and the depth of its lowest point [m], or None where the file has it.
const COURSES: [(&str, &str, Option<f64>); 5] = [
    ("sphere:radius=0.02", include_str!("../../../tests/data/drag/ball_0.02.csv"), Some(0.015)),
    ("box:length=0.005,width=0.05,height=0.04", include_str!("../../../tests/data/drag/plate_0.05.csv"), Some(0.02)),
    (
        "box:length=0.04,width=0.05,height=0.04",
        include_str!("../../../tests/data/drag/block_0.04_0.05_20mm.csv"),
        Some(0.02),
    ),
    (
        "box:length=0.04,width=0.05,height=0.006",
        include_str!("../../../tests/data/drag/flat_0.04_0.05_20mm.csv"),
        Some(0.02),
    ),
    (
        "box:length=0.04,width=0.05,height=0.006",
        include_str!("../../../tests/data/drag/flat_0.04_0.05_gamma_0.1.csv"),
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

/// The force [N] in each row of a course, from its depths and whether the body also sinks.
type Forces<'a> = &'a dyn Fn(&PlatedBody, &[f64], [f64; 2]) -> Vec<[f64; 2]>;

/// Errors in % of the grains' largest 10 mm mean of the component, for all courses: Fx and Fz in 5 windows each.
fn errors(forces: Forces, courses: &[(&str, &str, Option<f64>)]) -> Vec<[[f64; 5]; 2]> {
    let course = |(shape, text, depth): &(&str, &str, Option<f64>)| {
        let body = PlatedBody::cut(&BodyShape::named(shape).unwrap(), Some(0.002)).unwrap();
        let (rows, gamma) = (rows(text, *depth), if depth.is_some() { 0.0 } else { 0.1_f64 });
        let depths: Vec<f64> = rows.iter().map(|r| r[0]).collect();
        let ours = tens(&forces(&body, &depths, [0.1 * gamma.cos(), -0.1 * gamma.sin()]));
        let grains = tens(&rows.iter().map(|r| [r[1], r[2]]).collect::<Vec<_>>());
        [0, 1].map(|c| {
            let largest = grains[c].iter().fold(0.0_f64, |a, x| a.max(x.abs()));
            std::array::from_fn(|k| 100.0 * (ours[c][k] - grains[c][k]) / largest)
        })
    };
    courses.iter().map(course).collect()
}

fn motion([vx, vz]: [f64; 2], depth: f64) -> Trial {
    Trial { velocity: [vx, 0.0, vz], spin: [0.0; 3], given: DepthOrLoad::Depth(depth) }
}

fn planar([x, _, z]: [f64; 3]) -> [f64; 2] {
    [x, z]
}

/// The steady forces. A level course has one force throughout.
fn steady(sand: &SandDescription, body: &PlatedBody, depths: &[f64], v: [f64; 2]) -> Vec<[f64; 2]> {
    let force = |depth: f64| planar(compute(body, sand, &motion(v, depth)).force);
    if v[1] == 0.0 { vec![force(depths[0]); depths.len()] } else { depths.iter().map(|d| force(*d)).collect() }
}

/// With what the press has left on the plates.
fn passing(sand: &SandDescription, body: &PlatedBody, depths: &[f64], v: [f64; 2]) -> Vec<[f64; 2]> {
    let mut left = Passing::new(sand, GRAIN).unwrap();
    left.advance(body, sand, &motion([0.0, -0.1], depths[0]), 0.0);
    let row = |(k, depth): (usize, &f64)| {
        left.advance(body, sand, &motion(v, *depth), if k == 0 { 0.005 } else { 0.01 });
        planar(compute_with(body, sand, &motion(v, *depth), &left.excess).force)
    };
    depths.iter().enumerate().map(row).collect()
}

/// Paths in sand with memory, from the press on.
fn remembered(
    sand: &SandDescription,
    grain: Option<f64>,
    body: &PlatedBody,
    depths: &[f64],
    v: [f64; 2],
) -> Vec<[f64; 2]> {
    let mut path = Path::new(body, sand, None, None).unwrap();
    if let Some(diameter) = grain {
        path = path.in_grains(diameter).unwrap();
    }
    let mut to = |time: f64, x: f64, v: [f64; 2], depth: f64| {
        planar(path.step(&PathPoint { time, place: Some([x, 0.0]), trial: motion(v, depth) }).force)
    };
    to(-1.0, 0.0, [0.0, -0.1], -0.002);
    to(0.0, 0.0, [0.0, -0.1], depths[0]);
    let ways = (0..).map(|k| 1e-3 * (f64::from(k) + 0.5));
    ways.zip(depths).map(|(way, depth)| to(way / v[0], way, v, *depth)).collect()
}

/// Number of windows within 20 %, and the rms error [%].
fn held(all: &[[[f64; 5]; 2]]) -> (usize, f64) {
    all.iter().for_each(|e| println!("   Fx {:5.0?} Fz {:5.0?}", e[0], e[1]));
    let each: Vec<f64> = all.iter().flatten().flatten().copied().collect();
    let rms = (each.iter().map(|e| e * e).sum::<f64>() / each.len() as f64).sqrt();
    (each.iter().filter(|e| e.abs() <= 20.0).count(), rms)
}

/// How many of the 50 windows are within 20 % of the grains', and the rms error [%]: by the law, with the mechanism, and with what
/// the press before has left. ζ is that of glass beads, or that of slow vertical plates in these grains
/// (`tests/data/grains`). In `agarwal2023` fewer hold at 0.33, because its faces ahead are too weak there, and its faces
/// that slide too strong.
#[test]
fn windows_of_the_grains_hold_as_measured() {
    for (law, zeta, measured) in [
        (Law::Li2013, 0.33, [(21, 70.0), (33, 28.0), (39, 16.0)]),
        (Law::Li2013, 0.46, [(4, 116.0), (23, 32.0), (25, 30.0)]),
        (Law::Agarwal2023, 0.33, [(28, 30.0), (21, 37.0), (23, 30.0)]),
        (Law::Agarwal2023, 0.46, [(25, 33.0), (22, 32.0), (29, 31.0)]),
    ] {
        // The density of the grains' bed.
        let medium = Medium { bulk_density: 1467.0, ..Medium::generic(zeta).unwrap() };
        let plain = SandDescription { law, ..SandDescription::plain(&medium) };
        let sliding = Mechanisms { sliding_face: KAPPA, ..Mechanisms::PLAIN };
        let on = SandDescription { mechanisms: sliding, ..plain.clone() };
        let kinds: [Forces; 3] =
            [&|b, d, v| steady(&plain, b, d, v), &|b, d, v| steady(&on, b, d, v), &|b, d, v| passing(&on, b, d, v)];
        for (forces, (count, rms)) in kinds.into_iter().zip(measured) {
            let (hold, found) = held(&errors(forces, &COURSES));
            println!("{} ζ {zeta}: {hold} of 50, rms {found:.1} %", law.name());
            assert!(hold + 2 >= count && found < rms + 2.0, "{} {zeta}: {hold} {found}", law.name());
        }
    }
}

/// On a path with memory, the lift of a lying plate just after the press is a third too low with what the press has left, and almost
/// absent without.
#[test]
fn a_path_in_grains_has_what_the_press_has_left() {
    let medium = Medium { bulk_density: 1467.0, ..Medium::generic(0.33).unwrap() };
    let mechanisms = Mechanisms { sliding_face: KAPPA, ..Mechanisms::PLAIN };
    let on = SandDescription { mechanisms, ..SandDescription::plain(&medium) };
    let lift = |grain: Option<f64>| errors(&|b, d, v| remembered(&on, grain, b, d, v), &COURSES[3..4])[0][1];
    let [with, without] = [Some(GRAIN), None].map(lift);
    println!("{with:.0?} {without:.0?}");
    assert!(with[0].abs() < 40.0 && without[0] < -90.0, "{with:?} {without:?}");
    assert!((with[4] - without[4]).abs() < 2.0, "{with:?} {without:?}");
}

/// Grains have no effect without the mechanism, and so are refused.
#[test]
fn grains_need_the_mechanism() {
    let body = PlatedBody::cut(&BodyShape::Sphere { radius: 0.02 }, None).unwrap();
    let plain = SandDescription::named("glass-beads", "li2013").unwrap();
    assert!(bed(&plain).sliding().is_none());
    let refusal =
        |grain: f64| Path::new(&body, &plain, None, None).unwrap().in_grains(grain).err().map(|e| e.to_string());
    assert!(refusal(GRAIN).is_some_and(|e| e.contains("sliding_face")));
    assert!(refusal(f64::NAN).is_some_and(|e| e.contains("grain-size")));
}
