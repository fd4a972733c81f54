//! Reference values for the sand: published stresses, and leg forces from independent programs.

use sandgait::number::Vec3;
use sandgait::sand::intrusion::{Load, rotating_leg};
use sandgait::sand::{Law, LegShape, Medium, Regularization, SandBed};

fn ground(medium: &str) -> SandBed<f64> {
    SandBed::new(Law::Li2013, &Medium::named(medium).unwrap(), &Regularization::default())
}

/// (α_x, α_z) in N/cm³ in the plane: v = (cos γ, −sin γ), n = (sin β, −cos β), F = (−α_x, α_z).
fn alpha(ground: &SandBed<f64>, beta_deg: f64, gamma_deg: f64) -> (f64, f64) {
    let (b, g) = (beta_deg.to_radians(), gamma_deg.to_radians());
    let motion = ground.motion(Vec3::new(g.cos(), 0.0, -g.sin()));
    let f = ground.stress(Vec3::new(b.sin(), 0.0, -b.cos()), &motion);
    (-f.x * 1e-6, f.z * 1e-6)
}

/// Li, Zhang & Goldman 2013 on loose poppy seeds, computed with sines and cosines by independent implementations.
#[test]
fn stresses_of_loose_poppy_seeds() {
    let ground = ground("poppy-loose");
    for (beta, gamma, x, z) in [
        (0.0, 90.0, 0.0, 0.2540),
        (90.0, 0.0, 0.0830, 0.0040),
        (45.0, 45.0, 0.0837, 0.1330),
        (-45.0, 45.0, -0.0031, 0.0864),
        (30.0, 60.0, 0.0632, 0.1923),
        (0.0, -90.0, 0.0, -0.0580),
        (-30.0, -30.0, 0.0277, -0.0100),
    ] {
        let (ax, az) = alpha(&ground, beta, gamma);
        assert!((ax - x).abs() < 1e-4 && (az - z).abs() < 1e-4, "({beta}, {gamma}): {ax:.4} {az:.4}");
    }
}

fn sweep(shape: &str) -> Vec<(f64, Load)> {
    let ground = ground("poppy-loose");
    let segments = LegShape::named(shape).unwrap().segments(0.076, 0.025, 400).unwrap();
    (-175..=175).map(|i| i as f64 * 0.01).map(|t| (t, rotating_leg(&ground, &segments, t, 0.2, 0.02))).collect()
}

fn peak(sweep: &[(f64, Load)], of: impl Fn(&Load) -> f64) -> (f64, f64) {
    let best = sweep.iter().max_by(|a, b| of(&a.1).total_cmp(&of(&b.1))).unwrap();
    (of(&best.1), best.0.to_degrees())
}

/// Leg rotation test of Li et al. 2012, section 3: three independent implementations agree on these to 0.01 N.
#[test]
fn leg_rotation_peaks() {
    for (shape, fz, at_z, fx, at_x, ty) in [
        ("L", 7.49, -41.5, 3.96, -11.0, -0.337),
        ("revL", 3.52, 15.0, 2.48, 38.0, -0.154),
        ("flat", 2.71, -42.0, 3.45, -11.0, -0.211),
    ] {
        let sweep = sweep(shape);
        let (z, angle_z) = peak(&sweep, |l| l.fz);
        let (x, angle_x) = peak(&sweep, |l| l.fx.abs());
        let (t, _) = peak(&sweep, |l| -l.ty);
        assert!((z / fz - 1.0).abs() < 0.01 && (angle_z - at_z).abs() < 2.0, "{shape}: Fz {z:.3} at {angle_z:.0}");
        assert!((x / fx - 1.0).abs() < 0.01 && (angle_x - at_x).abs() < 2.0, "{shape}: Fx {x:.3} at {angle_x:.0}");
        assert!((-t / ty - 1.0).abs() < 0.01, "{shape}: Ty {:.4}", -t);
    }
}
