//! Faces that slide along themselves: laws that hold for any motion. For bodies in simulated grains see
//! `intruder/courses.rs`.

use super::*;
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
