//! Terms of the stress that a diagnosis found (`[[term]]` in `sand.toml`): both engines compute them as documented.

use sandgait::number::{Portable, Real, Vec3};
use sandgait::progress::Silent;
use sandgait::sand::mechanism_laws::SegmentState;
use sandgait::sand::{Law, Mechanisms, Regularization, SandBed, SandDescription};
use sandgait::sim::engine::EngineKind;
use sandgait::sim::model::Scene;
use sandgait::sim::walk::WalkTrial;
use sandgait::sim::{Model, Robot};
use sandgait::sweep::walk_all;

const TERM: &str = "\n[[term]]\non = \"normal\"\ncoefficient = 30.0\ngroups = { froude = 0.75, depth_over_width = -0.25 }\n\
    range = { froude = [0.0, 50.0], depth_over_width = [0.05, 4.0] }\n";

fn sand(more: &str) -> SandDescription {
    let plain = SandDescription::named("poppy-loose", "li2013").unwrap().to_toml().unwrap();
    SandDescription::from_toml(&format!("{plain}{more}")).unwrap()
}

fn trial(sand: &SandDescription) -> WalkTrial {
    let mut scene = Scene::flat(sand.medium());
    scene.set_sand(sand);
    let robot = Robot::load("xplorer").unwrap().with_leg_shape("L").unwrap();
    WalkTrial::new(Model::new(&robot, &scene).unwrap(), 3.0)
}

/// Both engines agree on a walk with a term, and the term slows the robot down.
#[test]
fn both_engines_walk_on_a_sand_with_a_term() {
    let trials = [trial(&sand("")), trial(&sand(TERM))];
    let speeds = [EngineKind::Lanes, EngineKind::Rapier].map(|engine| {
        let walked = walk_all(engine, &trials, &Silent).unwrap();
        [walked[0].speed, walked[1].speed]
    });
    let [ours, oracle] = speeds;
    assert!((ours[1] / ours[0] - 1.0).abs() > 0.03, "the term does nothing: {ours:?}");
    assert!((ours[1] / oracle[1] - 1.0).abs() < 0.03, "{ours:?} {oracle:?}");
}

/// The stress equals the formula, in lanes and for a single number. The result of a lane without the term is
/// bit-identical to that of sand without the term.
#[test]
fn a_term_is_its_formula_in_every_lane() {
    let (with, without) = (sand(TERM), sand(""));
    let (n, v) = (Vec3::new(0.6, 0.0, -0.8), Vec3::new(0.3, 0.0, -0.4));
    let site = SegmentState { width: 0.02, ..SegmentState::fresh(0.03, 0.0) };
    let one = |sand: &SandDescription| {
        let medium = sand.medium();
        let ground = SandBed::<f64>::new(Law::Li2013, &medium, &Regularization::BARE).with(&Mechanisms::PLAIN, &medium);
        ground.thin_plate(&site, 1e-4, n, v).force
    };
    let extra = one(&with) - one(&without);
    let froude: f64 = 0.25 / (9.80665 * 0.03);
    let expected = 30.0 * with.bulk_density * 9.80665 * 0.03 * froude.powf(0.75) * 1.5f64.powf(-0.25) * 1e-4;
    assert!((-extra.dot(n) / expected - 1.0).abs() < 1e-6, "{extra:?} {expected}");
    let plain = SandBed::<Portable>::new(Law::Li2013, &without.medium(), &Regularization::BARE);
    let mut mixed = plain;
    mixed.set_lane(1, &with.medium(), &Mechanisms::PLAIN);
    let lanes =
        SegmentState { width: Portable::splat(0.02), ..SegmentState::fresh(Portable::splat(0.03), Portable::zero()) };
    let wide = |v: Vec3<f64>| Vec3::splat([v.x, v.y, v.z]);
    let force = |ground: &SandBed<Portable>| ground.thin_plate(&lanes, Portable::splat(1e-4), wide(n), wide(v)).force;
    let (mixed, plain) = (force(&mixed), force(&plain));
    assert_eq!(mixed.x.lane(0), plain.x.lane(0));
    assert!((mixed.z.lane(1) / one(&with).z - 1.0).abs() < 1e-5);
}

#[test]
fn a_file_with_an_impossible_term_is_refused_in_one_line() {
    let plain = SandDescription::named("poppy-loose", "li2013").unwrap().to_toml().unwrap();
    for (from, to) in [
        ("30.0", "-30.0"),
        ("[0.05, 4.0]", "[-1.0, 4.0]"),
        ("froude = 0.75", "speed = 0.75"),
        ("[0.0, 50.0]", "[5.0, 1.0]"),
    ] {
        let error = SandDescription::from_toml(&format!("{plain}{}", TERM.replace(from, to))).unwrap_err().to_string();
        assert!(error.lines().count() == 1 && !error.is_empty(), "{error}");
    }
}
