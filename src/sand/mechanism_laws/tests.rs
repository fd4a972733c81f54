use super::*;
use crate::SandBed;
use crate::{Law, Medium, Regularization};

fn ground() -> SandBed<f64> {
    SandBed::new(Law::Li2013, &Medium::named("poppy-loose").unwrap(), &Regularization::default())
}

fn stress(m: Mechanisms, v: [f64; 3]) -> Vec3<f64> {
    let site = SegmentState {
        depth: 0.03,
        x: 0.05,
        footprint: 1.0,
        width: 0.02,
        normal_acceleration: 0.0,
        passes: 0.0,
        travel: [0.0; 2],
    };
    SandMechanisms::new(&m, 600.0).stress(&ground(), Vec3::new(0.6, 0.0, -0.8), Vec3::splat(v), &site)
}

#[test]
fn drag_is_lambda_rho_v_squared_against_the_motion() {
    let v = [0.6, 0.0, -0.8];
    let extra = stress(Mechanisms { inertial_drag: 2.0, ..Default::default() }, v) - stress(Mechanisms::default(), v);
    // λ ρ v² = 2 · 600 · 1² = 1200 Pa along −n
    assert!((extra.x + 0.6 * 1200.0).abs() < 1e-9 && (extra.z - 0.8 * 1200.0).abs() < 1e-9);
}

#[test]
fn factors_multiply_the_stress() {
    let v = [0.01, 0.0, -0.02];
    let plain = stress(Mechanisms::default(), v);
    let m = Mechanisms { scale: 0.5, packing_grad: 0.2, ..Default::default() };
    // 1.5 · (1 + 0.2 · 0.05/0.1) = 1.65
    assert!((stress(m, v).z / plain.z - 1.65).abs() < 1e-12);
    let power = stress(Mechanisms { depth_power: 1.0, ..Default::default() }, v);
    // (3 cm / 2 cm)^1 times the plain stress
    assert!((power.z / plain.z - 1.5).abs() < 1e-12);
}

#[test]
fn friction_cap_leaves_the_normal_part() {
    // Along the face almost all of the stress is tangential.
    let (v, n) = ([0.04, 0.0, 0.03], Vec3::new(0.6, 0.0, -0.8));
    let (plain, cut) =
        (stress(Mechanisms::default(), v), stress(Mechanisms { friction_clip: 10.0, ..Default::default() }, v));
    assert!((plain.dot(n) - cut.dot(n)).abs() < 1e-9);
    let along = |f: Vec3<f64>| (f - n * f.dot(n)).norm_squared().sqrt();
    assert!(along(plain) > 0.2 * plain.dot(n).abs(), "the cap has nothing to cut");
    let tangential = along(cut);
    assert!((tangential - 0.1 * cut.dot(n).abs()).abs() < 1e-9, "{tangential}");
}

#[test]
fn functions_without_trigonometry() {
    for i in 0..2000 {
        let x = f64::from(i) * 0.01;
        assert!((tanh(x) - x.tanh()).abs() < 1e-7, "tanh {x}: {}", tanh(x));
        let (y, far) = (log_one_plus(x * x * 20.0), x * x * 20.0);
        assert!((y - far.ln_1p()).abs() <= 1e-7 * far.ln_1p(), "ln(1 + {far}): {y}");
    }
}

/// One lane's mechanisms must leave the other lanes bit-identical.
#[test]
fn neutral_lanes_are_plain() {
    use crate::number::Portable;
    let every = Mechanisms {
        inertial_drag: 1.0,
        depth_power: 0.2,
        cohesion: 100.0,
        scale: 0.1,
        packing_grad: 0.2,
        rate_log: 0.1,
        friction_clip: 3.0,
        ..Default::default()
    };
    let mut mechanisms = SandMechanisms::<Portable>::new(&Mechanisms::default(), 600.0);
    mechanisms.set_lane(0, &every, 600.0);
    let medium = Medium::named("poppy-loose").unwrap();
    let ground = SandBed::<Portable>::new(Law::Li2013, &medium, &Regularization::default());
    let (n, v) = (Vec3::splat([0.6, 0.0, -0.8]), Vec3::splat([0.1, 0.02, -0.3]));
    let site = SegmentState::fresh(Portable::splat(0.013), Portable::splat(0.2));
    let plain = Plain.force(ground.stress(n, &ground.motion(v)), n, v, &site, Portable::splat(1.0));
    let stress = mechanisms.stress(&ground, n, v, &site);
    assert_ne!(stress.lane(0), plain.lane(0));
    assert_eq!(stress.lane(1), plain.lane(1));
}

/// A lane in the air gets no force while another lane is in the sand. This needs a check in the code, because inertia
/// and cohesion do not vanish at depth 0 by themselves.
#[test]
fn nothing_pushes_in_the_air() {
    let every = Mechanisms { inertial_drag: 1.0, cohesion: 100.0, added_mass: 1.0, ..Default::default() };
    let site = SegmentState {
        depth: 0.0,
        x: 0.0,
        footprint: 1.0,
        width: 0.02,
        normal_acceleration: 1.0,
        passes: 0.0,
        travel: [0.0; 2],
    };
    let (n, v) = (Vec3::new(0.6, 0.0, -0.8), Vec3::new(0.3, 0.0, -0.4));
    let stress = SandMechanisms::new(&every, 600.0).stress(&ground(), n, v, &site);
    assert_eq!(stress.norm_squared(), 0.0);
}
