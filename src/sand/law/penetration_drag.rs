//! The baseline of Li, Zhang & Goldman 2012 (section 3) for resistive force theory: a vertical penetration force and a
//! horizontal drag force. Neither force depends on the segment's orientation or on the other force.

use super::{Motion, StressLaw};
use crate::media::{Coefficients, Medium};
use crate::number::{Real, Vec3};

/// Stress per depth of the one-dimensional models; [N/m³].
#[derive(Clone, Copy)]
pub struct PenetrationDrag<R> {
    /// α_z(0, π/2): a horizontal plate pushed down.
    penetration: R,
    /// α_z(0, −π/2): the same plate pulled up; negative.
    extraction: R,
    /// α_x(π/2, 0): a vertical plate dragged. The paper prints α_z there, which would give no drag: a misprint.
    drag: R,
    inverse_gate: R,
}

impl<R: Real> PenetrationDrag<R> {
    /// `sign_gate`: see [`crate::Regularization::sign_gate`].
    pub fn splat(c: &Coefficients, sign_gate: f64) -> Self {
        Self {
            penetration: R::splat(c.penetration()),
            extraction: R::splat(c.extraction()),
            drag: R::splat(c.drag()),
            inverse_gate: R::splat(1.0 / sign_gate),
        }
    }
}

impl<R: Real> StressLaw<R> for PenetrationDrag<R> {
    fn set_lane(&mut self, lane: usize, medium: &Medium) {
        self.penetration.set_lane(lane, medium.coefficients.penetration());
        self.extraction.set_lane(lane, medium.coefficients.extraction());
        self.drag.set_lane(lane, medium.coefficients.drag());
    }

    /// α_z(β, γ>0) = α_z(0, π/2), α_z(β, γ<0) = α_z(0, −π/2), α_x = α_x(π/2, 0) with the sign of v_x, whatever β.
    ///
    /// In three dimensions the drag opposes the horizontal velocity. The sign of a component u of the direction is
    /// smoothed to s(u) = clamp(u / gate, −1, 1), so that an implicit step can cross zero.
    #[inline(always)]
    fn stress(&self, _n: Vec3<R>, m: &Motion<R>) -> Vec3<R> {
        let (zero, one) = (R::zero(), R::one());
        let down = (-(m.v.z * m.inverse_speed) * self.inverse_gate).clamp(-one, one);
        let vertical = self.penetration.mul_add(down.max(zero), self.extraction * (-down).max(zero));
        // s(|v_h|/|v|) v_h/|v_h| = min(1/(gate |v|), 1/|v_h|) v_h; for vertical motion 1/|v_h| is infinite, and the
        // drag is 0.
        let horizontal = m.v.x.mul_add(m.v.x, m.v.y * m.v.y).sqrt();
        let along = self.drag * (m.inverse_speed * self.inverse_gate).min(one / horizontal);
        Vec3::new(-(along * m.v.x), -(along * m.v.y), vertical)
    }
}
