//! Three-dimensional resistive force theory: Agarwal, Goldman & Kamrin, PNAS 120:e2214017120 (2023).
//!
//! The stress is one polynomial, the same for all media, times one number ξ_n of the medium. In the local frame r̂
//! (horizontal part of the velocity), θ̂, ẑ a segment has tilt β, its velocity the angle γ below the horizontal, its
//! normal the azimuth ψ from r̂:
//!
//! x1 = sin γ, x2 = cos β, x3 = cos ψ cos γ sin β + sin γ cos β, f_i = Σ_k c_ik T_k(x1, x2, x3), α_r = f1 sin β cos
//! ψ + f2 cos γ, α_θ = f1 sin β sin ψ, α_z = −f1 cos β − f2 sin γ − f3.
//!
//! With N = (sin β cos ψ, sin β sin ψ, −cos β), the segment's normal on its lower side (β is defined modulo π), and
//! the direction of motion u = (cos γ, 0, −sin γ) this is x1 = −u_z, x2 = −N_z, x3 = N·u and α = f1 N + f2 u − f3
//! ẑ. This form needs no local frame and no trigonometry.
//!
//! Two properties of the published fit that users should know, both tested in `tests/laws_of_sand.rs`:
//! * a plate drawn upward can gain energy: in 0.08 % of all pairs of directions the stress per depth along the motion
//!   is up to 0.006 ξ_n, and it is above 0.001 ξ_n only where the plate is nearly horizontal (β < 12°);
//! * where a plate passes the vertical and β jumps from π/2 to −π/2, α jumps by up to 0.05 ξ_n.

use super::{Motion, Normals, StressLaw};
use crate::coefficients::Coefficients;
use crate::media::Medium;
use crate::number::{Real, Vec3};

pub use crate::friction::{FITTED_FRICTION, PENETRATION, from_friction};

/// c_1k, c_2k, c_3k of each term, in the order of [`terms`]; PNAS 2023, supplementary table.
pub const COEFFICIENTS: [[f64; 3]; 20] = [
    [0.00212, -0.06796, -0.02634],
    [-0.02320, -0.10941, -0.03436],
    [-0.20890, 0.04725, 0.45256],
    [-0.43083, -0.06914, 0.00835],
    [-0.00259, -0.05835, 0.02553],
    [0.48872, -0.65880, -1.31290],
    [-0.00415, -0.11985, -0.05532],
    [0.07204, -0.25739, 0.06790],
    [-0.02750, -0.26834, -0.16404],
    [-0.08772, 0.02692, 0.02287],
    [0.01992, -0.00736, 0.02927],
    [-0.45961, 0.63758, 0.95406],
    [0.40799, 0.08997, -0.00131],
    [-0.10107, 0.21069, -0.11028],
    [-0.06576, 0.04748, 0.01487],
    [0.05664, 0.20406, -0.02730],
    [-0.09269, 0.18519, 0.10911],
    [0.01892, 0.04934, -0.04097],
    [0.01033, 0.13527, 0.07881],
    [0.15120, -0.33207, -0.27519],
];

/// T_k(x1, x2, x3).
#[inline(always)]
fn terms<R: Real>(x1: R, x2: R, x3: R) -> [R; 20] {
    let (x11, x22, x33) = (x1 * x1, x2 * x2, x3 * x3);
    [
        R::one(),
        x1,
        x2,
        x3,
        x11,
        x22,
        x33,
        x1 * x2,
        x2 * x3,
        x3 * x1,
        x11 * x1,
        x22 * x2,
        x33 * x3,
        x1 * x22,
        x2 * x11,
        x2 * x33,
        x3 * x22,
        x3 * x11,
        x1 * x33,
        x1 * x2 * x3,
    ]
}

/// f1, f2, f3.
#[inline(always)]
fn functions<R: Real>(x1: R, x2: R, x3: R) -> [R; 3] {
    let t = terms(x1, x2, x3);
    let mut f = [R::zero(); 3];
    for k in 0..20 {
        for i in 0..3 {
            f[i] = t[k].mul_add(R::splat(COEFFICIENTS[k][i]), f[i]);
        }
    }
    f
}

/// The even and the odd parts of f1, f2, f3 in (x2, x3). x2 and x3 change their sign with the normal.
#[inline(always)]
fn parts<R: Real>(x1: R, x2: R, x3: R) -> [[R; 3]; 2] {
    let t = terms(x1, x2, x3);
    let mut parts = [[R::zero(); 3]; 2];
    for k in 0..20 {
        let part = &mut parts[usize::from(ODD[k])];
        for i in 0..3 {
            part[i] = t[k].mul_add(R::splat(COEFFICIENTS[k][i]), part[i]);
        }
    }
    parts
}

/// Does the term have an odd degree in (x2, x3)?
const ODD: [bool; 20] = {
    let mut odd = [false; 20];
    let of = [2, 3, 7, 9, 11, 12, 14, 15, 16, 17];
    let mut i = 0;
    while i < of.len() {
        odd[of[i]] = true;
        i += 1;
    }
    odd
};

/// Σ c_ik t over given terms k, for i = 1, 2, 3.
#[inline(always)]
fn sum<R: Real, const N: usize>(terms: [(usize, R); N]) -> [R; 3] {
    let mut f = [R::zero(); 3];
    for (k, t) in terms {
        for i in 0..3 {
            f[i] = t.mul_add(R::splat(COEFFICIENTS[k][i]), f[i]);
        }
    }
    f
}

/// Laplacian of α = f1 N + f2 u − f3 ẑ on the unit sphere of normals N. For a homogeneous polynomial of degree d in N,
/// it is the Laplacian in space minus d (d + 1) times the polynomial; ∇x2 = −ẑ, ∇x3 = u, and their product is x1.
#[inline(always)]
fn laplacian<R: Real>(x1: R, x2: R, x3: R, n: Vec3<R>, u: Vec3<R>) -> Vec3<R> {
    let (x11, x22, x33, x12, x13, x23) = (x1 * x1, x2 * x2, x3 * x3, x1 * x2, x1 * x3, x2 * x3);
    let (one, s) = (R::one(), |x: f64| R::splat(x));
    let two = s(2.0);
    // Parts of degree 1, 2 and 3. The part of degree 0 counts only in f1, because N multiplies f1.
    let zeroth = sum([(0, one), (1, x1), (4, x11), (10, x11 * x1)])[0];
    let first = sum([(2, x2), (3, x3), (7, x12), (9, x13), (14, x2 * x11), (17, x3 * x11)]);
    let second = sum([(5, x22), (6, x33), (8, x23), (13, x1 * x22), (18, x1 * x33), (19, x12 * x3)]);
    let third = sum([(11, x22 * x2), (12, x33 * x3), (15, x2 * x33), (16, x3 * x22)]);
    let by_2 = sum([
        (2, one),
        (5, two * x2),
        (7, x1),
        (8, x3),
        (11, s(3.0) * x22),
        (13, two * x12),
        (14, x11),
        (15, x33),
        (16, two * x23),
        (19, x13),
    ])[0];
    let by_3 = sum([
        (3, one),
        (6, two * x3),
        (8, x2),
        (9, x1),
        (12, s(3.0) * x33),
        (15, two * x23),
        (16, x22),
        (17, x11),
        (18, two * x13),
        (19, x12),
    ])[0];
    let space = sum([
        (5, two),
        (6, two),
        (8, two * x1),
        (11, s(6.0) * x2),
        (12, s(6.0) * x3),
        (13, two * x1),
        (15, two * x2 + s(4.0) * x13),
        (16, two * x3 + s(4.0) * x12),
        (18, two * x1),
        (19, two * x11),
    ]);
    let less = |i: usize, d: [f64; 3]| third[i].mul_add(s(d[2]), second[i].mul_add(s(d[1]), first[i] * s(d[0])));
    let along_n = space[0] - less(0, [6.0, 12.0, 20.0]) - two * zeroth;
    let along_u = two * by_3 + space[1] - less(1, [2.0, 6.0, 12.0]);
    let mut all = n.scale_add(along_n, u * along_u);
    all.z += less(2, [2.0, 6.0, 12.0]) - space[2] - two * by_2;
    all
}

/// Derivative with respect to x2, at x2 = 0, of the part of α that changes its sign with the side of the plate. At x2 =
/// 0, dN = −ẑ dx2 and dx3 = x1 dx2.
#[inline(always)]
fn slope<R: Real>(x1: R, x3: R, even_1: R, n: Vec3<R>, u: Vec3<R>) -> Vec3<R> {
    let (two, x11, x13, x33) = (R::splat(2.0), x1 * x1, x1 * x3, x3 * x3);
    // The component along N contains the even parts, the components along u and ẑ contain the odd parts.
    let along_n = sum([(8, x3), (19, x13), (6, two * x13), (18, two * x1 * x13)])[0];
    let [_, along_u, along_z] = sum([
        (2, R::one()),
        (7, x1),
        (14, x11),
        (15, x33),
        (3, x1),
        (9, x11),
        (12, R::splat(3.0) * x1 * x33),
        (17, x11 * x1),
    ]);
    let mut all = n.scale_add(along_n, u * along_u);
    all.z = all.z - along_z - even_1;
    all
}

/// The published components (α_r, α_θ, α_z)/ξ_n at angles [rad], without the surface's friction. β is taken modulo π
/// into [−π/2, π/2]; a β that rounding has put slightly above π/2 is not reduced.
pub fn components(beta: f64, gamma: f64, psi: f64) -> [f64; 3] {
    use std::f64::consts::{FRAC_PI_2, PI};
    let turns = if beta.abs() <= FRAC_PI_2 + 1e-6 { 0.0 } else { (beta / PI).round() };
    let ((sin_b, cos_b), (sin_g, cos_g), (sin_p, cos_p)) =
        ((beta - turns * PI).sin_cos(), gamma.sin_cos(), psi.sin_cos());
    let [f1, f2, f3] = functions(sin_g, cos_b, cos_p * cos_g * sin_b + sin_g * cos_b);
    [f1 * sin_b * cos_p + f2 * cos_g, f1 * sin_b * sin_p, -f1 * cos_b - f2 * sin_g - f3]
}

/// α with two changes: its normal part acts against the leading side n, and its tangential part is at most μ times the
/// normal part: |α·n|(−n) + min(μ |α_n|/|α_t|, 1) α_t. `leading` is n·u divided by the gate, clamped to ±1.
#[inline(always)]
fn on_surface<R: Real>(alpha: Vec3<R>, n: Vec3<R>, leading: R, friction: Option<R>) -> Vec3<R> {
    let normal = alpha.dot(n);
    // If the fit pulls the plate along (normal·leading > 0; in 5 % of all directions), the pull is replaced by a push:
    // exactly −|normal| on the leading side at leading = ±1, with a gradual change in between.
    let turned = (normal * leading).max(R::zero()) * R::splat(2.0);
    let pushed = n.scale_add(R::select(normal.lt(R::zero()), turned, -turned), alpha);
    let Some(friction) = friction else { return pushed };
    let normal = pushed.dot(n);
    let tangential = pushed - n * normal;
    let size = (tangential.norm_squared() + R::splat(1e-20)).sqrt(); // never 0
    tangential.scale_add((friction * normal.abs() / size).min(R::one()), n * normal)
}

/// The published components at angles [rad], limited by the surface's friction μ_s = `friction`.
pub fn components_on_surface(beta: f64, gamma: f64, psi: f64, friction: f64) -> [f64; 3] {
    let ([r, t, z], n) =
        (components(beta, gamma, psi), Vec3::new(beta.sin() * psi.cos(), beta.sin() * psi.sin(), -beta.cos()));
    let leading = if n.dot(Vec3::new(gamma.cos(), 0.0, -gamma.sin())) < 0.0 { -1.0 } else { 1.0 };
    let alpha = on_surface(Vec3::new(r, t, z), n, leading, Some(friction));
    [alpha.x, alpha.y, alpha.z]
}

/// ξ_n [N/m³] of a medium whose penetration stress is known, from the measured stress.
pub fn calibrated(c: &Coefficients) -> f64 {
    c.penetration() / PENETRATION
}

/// The numbers of the law: ξ_n and the surface's friction.
#[derive(Clone, Copy)]
pub struct SpatialTable<R> {
    /// [N/m³]
    scale: R,
    /// μ_s of the segment's surface; None: the tangential stress as fitted.
    friction: Option<R>,
    inverse_gate: R,
}

impl<R: Real> SpatialTable<R> {
    pub fn splat(medium: &Medium, friction: Option<f64>, leading_edge_gate: f64) -> Self {
        Self {
            scale: R::splat(calibrated(&medium.coefficients)),
            friction: friction.map(R::splat),
            inverse_gate: R::splat(1.0 / leading_edge_gate),
        }
    }
}

impl<R: Real> StressLaw<R> for SpatialTable<R> {
    fn set_lane(&mut self, lane: usize, medium: &Medium) {
        self.scale.set_lane(lane, calibrated(&medium.coefficients));
    }

    #[inline(always)]
    fn stress(&self, n: Vec3<R>, m: &Motion<R>) -> Vec3<R> {
        let lower = R::select(R::zero().lt(n.z), -R::one(), R::one());
        let (n, u) = (n * lower, m.v * m.inverse_speed);
        let toward = n.dot(u);
        let [f1, f2, f3] = functions(-u.z, -n.z, toward);
        let mut alpha = n.scale_add(f1, u * f2);
        alpha.z -= f3;
        self.scaled(alpha, n, toward, m)
    }

    /// The mean of the fit is exact to second order in the deviation from the mean normal, if the deviations are equal
    /// in all directions. The law has a jump where a plate is vertical, so the normals may lie on both sides of it.
    #[inline(always)]
    fn mean_stress(&self, normals: &Normals<R>, m: &Motion<R>) -> Vec3<R> {
        let (n, u, one) = (normals.unit, m.v * m.inverse_speed, R::one());
        let (x1, x2, x3) = (-u.z, -n.z, n.dot(u));
        let lower = R::select(x2.lt(R::zero()), -one, one);
        // Mean sign of the side, if the normals' z is uniformly distributed within ± √1.5 standard deviations: our
        // choice, between √3, which is right for bands of a cylinder, and 0, which suits balls. 1e-12 avoids 0/0.
        let mean = n.z * (one - normals.spread);
        let varies = (normals.squares.z - mean * mean).max(R::splat(1e-12)) * R::splat(1.5);
        let side = (x2 / varies.sqrt()).clamp(-one, one);
        let [even, odd] = parts(x1, x2, x3);
        // α on the two sides is `common` ± `differing`.
        let mut common = n.scale_add(odd[0], u * even[1]);
        common.z -= even[2];
        // σ²/4 of the Laplacian on the sphere, with σ² = 2 · spread.
        common += laplacian(x1, x2 * lower, x3 * lower, n * lower, u) * (normals.spread * R::splat(0.5));
        let mut differing = n.scale_add(even[0], u * odd[1]);
        differing.z -= odd[2];
        let mut alpha = differing.scale_add(side, common);
        let across = one - side * side;
        if R::any(R::zero().lt(across)) {
            // Adds the slope times half the distance of the normals on either side from the mean, weighted by the shares of the sides.
            alpha += slope(x1, x3, even[0], n, u) * (across * varies.sqrt() * R::splat(0.5));
        }
        self.scaled(alpha, n, x3, m)
    }
}

impl<R: Real> SpatialTable<R> {
    #[inline(always)]
    fn scaled(&self, alpha: Vec3<R>, n: Vec3<R>, toward: R, m: &Motion<R>) -> Vec3<R> {
        let leading = (toward * self.inverse_gate).clamp(-R::one(), R::one());
        on_surface(alpha, n, leading, self.friction) * (self.scale * m.moving)
    }
}
