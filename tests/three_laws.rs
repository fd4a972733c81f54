//! Compares the three stress laws with their printed equations, in sines and cosines, and with values from an
//! independent implementation in another language.

use rand::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use sandgait::number::Vec3;
use sandgait::sand::law::agarwal2023;
use sandgait::sand::{Coefficients, Law, Medium, Regularization, SandBed};
use std::f64::consts::{FRAC_PI_2, PI};

fn plate(beta: f64, psi: f64) -> Vec3<f64> {
    Vec3::new(beta.sin() * psi.cos(), beta.sin() * psi.sin(), -beta.cos())
}

fn direction(gamma: f64) -> Vec3<f64> {
    Vec3::new(gamma.cos(), 0.0, -gamma.sin())
}

/// (α_x, α_z) [N/m³] of Li et al. 2013 as printed.
fn li2013(c: &Coefficients, b: f64, g: f64) -> [f64; 2] {
    let x = c.c11 * (2.0 * b + g).cos() + c.c01 * g.cos() + c.cm11 * (g - 2.0 * b).cos() + c.d10 * (2.0 * b).sin();
    let z =
        c.a00 + c.a10 * (2.0 * b).cos() + c.b11 * (2.0 * b + g).sin() + c.b01 * g.sin() + c.bm11 * (g - 2.0 * b).sin();
    [x, z]
}

/// (α_x, α_z) [N/m³] of the one-dimensional models as printed in Li et al. 2012, section 3.
fn one_dimensional(c: &Coefficients, g: f64) -> [f64; 2] {
    let [drag, _] = li2013(c, FRAC_PI_2, 0.0);
    let [_, penetration] = li2013(c, 0.0, FRAC_PI_2);
    let [_, extraction] = li2013(c, 0.0, -FRAC_PI_2);
    [drag * g.cos().signum(), if g > 0.0 { penetration } else { extraction }]
}

#[test]
fn planar_laws_are_their_printed_equations() {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(7);
    for name in Medium::names() {
        let medium = Medium::named(name).unwrap();
        for _ in 0..20_000 {
            let mut angle = || match random.random_range(0..20) {
                0 => FRAC_PI_2,
                1 => -FRAC_PI_2,
                _ => random.random_range(-FRAC_PI_2..FRAC_PI_2),
            };
            let (b, g) = (angle(), angle());
            for (law, [x, z]) in [
                (Law::Li2013, li2013(&medium.coefficients, b, g)),
                (Law::PenetrationDrag1d, one_dimensional(&medium.coefficients, g)),
            ] {
                let ground = SandBed::new(law, &medium, &Regularization::BARE);
                let f = ground.stress(plate(b, 0.0), &ground.motion(direction(g)));
                // 1 N/m³ is 1e-6 N/cm³.
                let far = (-f.x - x).abs().max((f.z - z).abs());
                assert!(far < 1e-3 && f.y == 0.0, "{name} {} ({b}, {g}): {f:?} for {x} {z}", law.name());
            }
        }
    }
}

/// Checksums of the coefficient table, and the value α_z(0, π/2, 0)/ξ_n = 0.87574, which is minus the sum of all
/// coefficients.
#[test]
fn anchor_and_table_of_agarwal2023() {
    let sum = |i: usize| agarwal2023::COEFFICIENTS.iter().map(|c| c[i]).sum::<f64>();
    for (i, expected) in [-0.27614, -0.31492, -0.28468].into_iter().enumerate() {
        assert!((sum(i) - expected).abs() < 1e-12, "f{}: {}", i + 1, sum(i));
    }
    let [r, t, z] = agarwal2023::components(0.0, FRAC_PI_2, 0.0);
    assert!(r.abs() < 1e-12 && t.abs() < 1e-12 && (z - 0.87574).abs() < 1e-12, "{r} {t} {z}");
}

#[test]
fn components_of_agarwal2023() {
    for (angles, expected) in [
        ([0.3, 0.7, 0.1], [-0.317171358, -0.010025408, 0.696510826]),
        ([-1.2, -0.4, 2.0], [-0.111497614, 0.103593675, 0.001459582]),
        ([FRAC_PI_2, 0.0, 0.0], [-0.191850000, -0.000000000, 0.074620000]),
        ([-FRAC_PI_2, 0.0, 0.0], [-0.229450000, -0.000000000, 0.088700000]),
        ([0.0, 0.0, 0.0], [-0.041930000, -0.000000000, 0.110290000]),
        ([0.0, -FRAC_PI_2, 0.0], [-0.000000000, 0.000000000, -0.078960000]),
        ([0.8, FRAC_PI_2, -0.7], [-0.148935711, 0.125446819, 0.846821538]),
        ([0.386, 0.759, 1.854], [-0.195609444, -0.136147275, 0.701800074]),
        ([1.389, 0.753, 2.652], [-0.251710437, 0.072888404, 0.029326725]),
        ([-1.479, -0.108, 2.784], [-0.247224785, 0.030423136, 0.044102166]),
        ([0.468, 1.259, -2.429], [-0.009511991, 0.101981880, 0.919264269]),
        ([-0.097, -0.796, 0.275], [-0.049038619, -0.002906049, -0.108238046]),
        ([0.232, -1.529, -1.779], [-0.010950420, -0.007318572, -0.086788348]),
        ([-0.692, 1.307, 1.669], [-0.136709396, 0.178090529, 0.871704668]),
        ([-1.069, 0.933, -2.269], [-0.357566121, -0.150317911, 0.530238558]),
    ] {
        let [b, g, p] = angles;
        let got = agarwal2023::components(b, g, p);
        let far = got.iter().zip(expected).map(|(a, b): (&f64, f64)| (a - b).abs()).fold(0.0, f64::max);
        assert!(far < 1e-8, "{angles:?}: {got:?}, expected {expected:?}");
    }
}

/// Our form without trigonometry equals the published components in any horizontal direction, if these push. If they
/// would pull, our normal part has the opposite sign. β counts modulo π.
#[test]
fn spatial_law_is_its_published_components() {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(8);
    let medium = Medium::named("poppy-loose").unwrap();
    let xi = agarwal2023::calibrated(&medium.coefficients);
    assert!((xi * 1e-6 - 0.290).abs() < 1e-3, "{xi}");
    let ground = SandBed::new(Law::Agarwal2023, &medium, &Regularization::BARE);
    let mut pulled = 0;
    for _ in 0..20_000 {
        let mut angle = |a: f64| random.random_range(-a..a);
        let (b, g, p) = (angle(FRAC_PI_2), angle(FRAC_PI_2), angle(PI));
        let (n, u) = (plate(b, p), direction(g));
        let f = ground.stress(n, &ground.motion(u)) * (1.0 / xi);
        let [x, y, z] = agarwal2023::components(b, g, p);
        let mut alpha = Vec3::new(x, y, z);
        let (normal, toward) = (alpha.dot(n), n.dot(u));
        if normal * toward > 0.0 {
            pulled += 1;
            alpha = alpha - n * (2.0 * normal);
        }
        assert!((f - alpha).norm_squared() < 1e-18, "({b}, {g}, {p}): {f:?} {alpha:?}");
        assert!(f.dot(n) * toward <= 1e-12, "the plate is pulled along");
        let turned = agarwal2023::components(b + PI, g, p);
        assert!((turned[0] - x).abs() + (turned[1] - y).abs() + (turned[2] - z).abs() < 1e-9);
    }
    assert!((600..1400).contains(&pulled), "{pulled} of 20000");
}

/// Friction limits the tangential stress and does not change the normal one.
#[test]
fn friction_caps_the_tangential_stress() {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(9);
    let medium = Medium::named("glass-beads").unwrap();
    let surface = Regularization { friction: Some(0.3), ..Regularization::BARE };
    let [free, capped] = [Regularization::BARE, surface].map(|s| SandBed::<f64>::new(Law::Agarwal2023, &medium, &s));
    for _ in 0..5_000 {
        let mut angle = |a: f64| random.random_range(-a..a);
        let (n, u) = (plate(angle(FRAC_PI_2), angle(PI)), direction(angle(FRAC_PI_2)));
        let (a, b) = (free.stress(n, &free.motion(u)), capped.stress(n, &capped.motion(u)));
        let tangential = |f: Vec3<f64>| (f - n * f.dot(n)).norm_squared().sqrt();
        assert!((a.dot(n) - b.dot(n)).abs() < 1e-3);
        let expected = tangential(a).min(0.3 * a.dot(n).abs());
        assert!((tangential(b) - expected).abs() < 1e-3, "{} {expected}", tangential(b));
    }
}

/// The cubic formula for ζ from density and friction. For loose poppy seeds it gives about four times the calibrated
/// 0.290 N/cm³.
#[test]
fn scale_from_friction() {
    // 638 kg/m³ and μ = 0.6: 638 · 9.80665 · (894·0.216 − 386·0.36 + 89·0.6) = 6.7279e5 N/m³
    let xi = agarwal2023::from_friction(0.6, 638.0);
    assert!((xi / 6.7279e5 - 1.0).abs() < 1e-3, "{xi}");
    let medium = Medium::named("mu=0.6,rho=638").unwrap();
    assert!((agarwal2023::calibrated(&medium.coefficients) / xi - 1.0).abs() < 1e-12);
    assert!(Medium::caution("mu=0.6,rho=638").is_none());
    assert!(Medium::caution("mu=0.25,rho=638").unwrap().contains("0.3"));
    for bad in ["mu=0.6", "mu=x,rho=600", "mu=-1,rho=600", "mu=0.5,rho=0", "mu=nan,rho=600"] {
        assert!(Medium::named(bad).is_err(), "{bad}");
    }
}
