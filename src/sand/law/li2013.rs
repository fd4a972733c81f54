//! Resistive force theory: Li, Zhang & Goldman, Science 339:1408 (2013), eq. S1-S2 and table S2.
//!
//! Valid for slow motion (below 0.5 m/s inertia of the grains stays under 10 % of the force; Li et al. 2012, section 2)
//! in dry, uniform media.

use super::{Motion, Normals, StressLaw};
use crate::media::{Coefficients, Medium};
use crate::number::{Real, Vec3};

/// Coefficients of `li2013` [N/m³], combined as the form without trigonometry needs them.
#[derive(Clone, Copy)]
pub struct PlanarTable<R> {
    a00: R,
    a10: R,
    b_difference: R,
    b_sum: R,
    b01: R,
    c_sum: R,
    c_difference: R,
    c01: R,
    d10: R,
}

impl<R: Real> PlanarTable<R> {
    pub fn splat(c: &Coefficients) -> Self {
        let s = R::splat;
        Self {
            a00: s(c.a00),
            a10: s(c.a10),
            b_difference: s(c.b11 - c.bm11),
            b_sum: s(c.b11 + c.bm11),
            b01: s(c.b01),
            c_sum: s(c.c11 + c.cm11),
            c_difference: s(c.cm11 - c.c11),
            c01: s(c.c01),
            d10: s(c.d10),
        }
    }
}

impl<R: Real> StressLaw<R> for PlanarTable<R> {
    fn set_lane(&mut self, lane: usize, medium: &Medium) {
        let one = PlanarTable::<f64>::splat(&medium.coefficients);
        self.a00.set_lane(lane, one.a00);
        self.a10.set_lane(lane, one.a10);
        self.b_difference.set_lane(lane, one.b_difference);
        self.b_sum.set_lane(lane, one.b_sum);
        self.b01.set_lane(lane, one.b01);
        self.c_sum.set_lane(lane, one.c_sum);
        self.c_difference.set_lane(lane, one.c_difference);
        self.c01.set_lane(lane, one.c01);
        self.d10.set_lane(lane, one.d10);
    }

    /// With attack angle β, intrusion angle γ (v = |v|(cos γ e − sin γ ẑ), e horizontal):
    ///
    /// α_z = A00 + A10 cos 2β + B11 sin(2β+γ) + B01 sin γ + B₋₁₁ sin(−2β+γ),
    /// α_x = C11 cos(2β+γ) + C01 cos γ + C₋₁₁ cos(−2β+γ) + D10 sin 2β, force = −α_x e + α_z ẑ.
    ///
    /// In space, N the normal: cos 2β → N_z² − (N·e)², sin 2β → −2 N_z (N·e), cos γ = |v_h|/|v|, sin γ = −v_z/|v|. For
    /// vertical motion e is the horizontal direction of the normal, the limit of motion in the normal's plane.
    #[inline(always)]
    fn stress(&self, n: Vec3<R>, m: &Motion<R>) -> Vec3<R> {
        let along = n.x.mul_add(m.v.x, n.y * m.v.y);
        let [ex, ey] = heading(n, along, m);
        let normal_along = n.x.mul_add(ex, n.y * ey);
        let squared = ex.mul_add(ex, ey.mul_add(ey, R::splat(1e-36))); // never 0; 1e-36 is not denormal in `f32`
        let ratio = normal_along / squared; // (N·e)/|v_h|
        let cos_2b = n.z.mul_add(n.z, -(normal_along * ratio));
        let minus_2nz = n.z * R::splat(-2.0);
        let sin_2b_over_h = minus_2nz * ratio; // times (ex, ey): sin 2β e

        let sin_2b_cos_g = minus_2nz * along * m.inverse_speed;
        self.planar(cos_2b, sin_2b_over_h, sin_2b_cos_g, [ex, ey], m)
    }

    /// Exact, because the stress is of second degree in the normal. For vertical motion, e is the horizontal direction
    /// of the mean normal.
    #[inline(always)]
    fn mean_stress(&self, normals: &Normals<R>, m: &Motion<R>) -> Vec3<R> {
        let (n, s, p) = (normals.unit, normals.squares, normals.products);
        let along = n.x.mul_add(m.v.x, n.y * m.v.y);
        let [ex, ey] = heading(n, along, m);
        let inverse = R::one() / ex.mul_add(ex, ey.mul_add(ey, R::splat(1e-36))); // see `stress`
        let two_xy = p.z + p.z;
        let along_e = ex.mul_add(ex.mul_add(s.x, ey * two_xy), ey * ey * s.y);
        let cos_2b = s.z - along_e * inverse;
        let sin_2b_over_h = R::splat(-2.0) * p.y.mul_add(ex, p.x * ey) * inverse; // times (ex, ey): sin 2β e
        let sin_2b_cos_g = R::splat(-2.0) * p.y.mul_add(m.v.x, p.x * m.v.y) * m.inverse_speed;
        self.planar(cos_2b, sin_2b_over_h, sin_2b_cos_g, [ex, ey], m)
    }
}

impl<R: Real> PlanarTable<R> {
    /// The law, as a function of cos 2β, sin 2β / |v_h| and sin 2β cos γ.
    #[inline(always)]
    fn planar(&self, cos_2b: R, sin_2b_over_h: R, sin_2b_cos_g: R, [ex, ey]: [R; 2], m: &Motion<R>) -> Vec3<R> {
        let sin_g = -(m.v.z * m.inverse_speed);
        let along_v = self.c_sum.mul_add(cos_2b, self.c01) * m.inverse_speed;
        let along_e = self.c_difference.mul_add(sin_g, self.d10 * m.moving) * sin_2b_over_h;
        let vertical = self
            .a10
            .mul_add(cos_2b, self.a00)
            .mul_add(m.moving, self.b_sum.mul_add(cos_2b, self.b01).mul_add(sin_g, self.b_difference * sin_2b_cos_g));
        Vec3::new(-along_v.mul_add(m.v.x, along_e * ex), -along_v.mul_add(m.v.y, along_e * ey), vertical)
    }
}

/// A vector along e, about as long as the horizontal velocity; `along` is its product with the normal.
#[inline(always)]
fn heading<R: Real>(n: Vec3<R>, along: R, m: &Motion<R>) -> [R; 2] {
    // Adds 1e-6 of the vertical speed along the normal. This has an effect on e only if the horizontal speed is not far
    // above 1e-6 of the vertical speed.
    let nudge = R::splat(1e-6) * m.v.z.abs();
    let nudge = R::select(along.lt(R::zero()), -nudge, nudge);
    [n.x.mul_add(nudge, m.v.x), n.y.mul_add(nudge, m.v.y)]
}
