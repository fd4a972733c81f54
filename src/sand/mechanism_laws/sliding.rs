//! `sliding_face`: a face of a solid body that slides along itself.
//!
//! With s = n·v̂, L the law's stress per depth and G = ρ g (n_z² + K0 (1 − n_z²)), the stress per depth is
//!
//! clamp(s/κ, 0, 1) L − max(1 − |s|/κ, 0) G (n + μ v̂).
//!
//! Derivation, for sand that is elastic and then perfectly plastic, whatever the speed: on its way into fresh sand a face
//! is loaded by L/δ for each unit of way along its normal, up to failure at L. Shear along the face returns the stress to
//! that of sand at rest by (p − G)/ℓ for each unit of way along the face. The steady pressure is then min(L, G + L s/κ)
//! with κ = δ/ℓ; the formula above is its continuous form. Textbooks have the stress of sand at rest, K0, Coulomb's
//! friction and passive failure at L. Ours are the two lengths, and their ratio κ as the threshold: 0.03, from the rate
//! at which the lift of two lying plates fades in simulated grains of 4 mm (`tests/data/drag`, `flat_*.csv`; courses of
//! other bodies give 0.029 to 0.046). The friction acts along v̂ in place of the face's own direction of motion: they
//! differ by less than κ, and the sand then never drives the body as long as κ < μ.

use super::Mechanisms;
use crate::GRAVITY;
use crate::number::{Real, Vec3};

/// K0: horizontal over vertical stress in sand at rest, 1 − sin φ (Jaky 1944) for φ = 30°, a handbook value.
const AT_REST: f64 = 0.5;
/// tan 30°, for the same φ: sand on a rougher surface slides on sand.
const INTERNAL: f64 = 0.577;
/// Friction μ of the body's surface if `friction_clip` is off: that of the simulated grains. With 0.3 or 0.5 the error
/// on their courses changes by 1 %.
const FRICTION: f64 = 0.4;

/// The mechanism's numbers, one lane for each environment.
#[derive(Clone, Copy)]
pub struct SlidingFace<R> {
    /// κ; 0 in lanes without the mechanism, and 1/κ, there a number that has no effect.
    threshold: R,
    inverse: R,
    /// ρ g [N/m³]
    pub(crate) weight: R,
    /// μ
    pub(crate) friction: R,
}

/// The share of the weight of the sand at rest that lies on a face, and its derivative with respect to n·v̂.
#[derive(Clone, Copy)]
pub struct RestingShare<R> {
    pub share: R,
    pub slope: R,
}

impl<R: Real> SlidingFace<R> {
    /// Switched off.
    pub(super) fn none() -> Self {
        let zero = R::zero();
        Self { threshold: zero, inverse: R::splat(1e30), weight: zero, friction: zero }
    }

    pub(super) fn set_lane(&mut self, lane: usize, m: &Mechanisms, bulk_density: f64) {
        let kappa = m.sliding_face;
        let friction = if m.friction_clip > 0.0 { (1.0 / m.friction_clip).min(INTERNAL) } else { FRICTION };
        self.threshold.set_lane(lane, kappa);
        self.inverse.set_lane(lane, if kappa > 0.0 { 1.0 / kappa } else { 1e30 });
        self.weight.set_lane(lane, if kappa > 0.0 { bulk_density * GRAVITY } else { 0.0 });
        self.friction.set_lane(lane, friction);
    }

    /// The range of n·v̂ over which the law's force rises: κ, at least `gate`.
    #[inline(always)]
    pub fn range(&self, gate: R) -> R {
        gate.max(self.threshold)
    }

    /// 1/range, from 1/gate.
    #[inline(always)]
    pub fn inverse_range(&self, inverse_gate: R) -> R {
        inverse_gate.min(self.inverse)
    }

    /// `yes` in the lanes that have the mechanism, `no` in the others.
    #[inline(always)]
    pub fn where_on(&self, yes: R, no: R) -> R {
        R::select(R::zero().lt(self.threshold), yes, no)
    }

    /// max(1 − |s|/κ, 0) at s = n·v̂. If s differs by ± `spread` over the face, the share is lower and reaches farther.
    #[inline(always)]
    pub fn resting(&self, s: R, spread: R) -> RestingShare<R> {
        let (zero, one) = (R::zero(), R::one());
        let inverse = one / (self.threshold + spread).max(R::splat(1e-9)); // finite in lanes without the mechanism
        let height = self.threshold * inverse;
        let share = (one - s.abs() * inverse).max(zero);
        let slope = R::select(zero.lt(s), -(height * inverse), height * inverse);
        RestingShare { share: share * height, slope: R::select(zero.lt(share), slope, zero) }
    }

    /// G/(ρ g) for a normal with the component `up` along the surface's normal.
    #[inline(always)]
    pub fn pressure(up: R) -> R {
        (up * up).mul_add(R::splat(1.0 - AT_REST), R::splat(AT_REST))
    }

    /// The force [N] of sand at rest on faces with Σ load n = `normal` and Σ load = `load` [m³], where a face's load
    /// is its area times its depth, share and [`Self::pressure`]. `unit` is v/√(v² + v0²), `moving` its square.
    #[inline(always)]
    pub fn force(&self, normal: Vec3<R>, load: R, unit: Vec3<R>, moving: R) -> Vec3<R> {
        unit.scale_add(load * self.friction, normal * moving) * -self.weight
    }
}

/// μ_e: drag over lift of the stress that an earlier motion has left on a lying plate, from simulated grains of 4 mm
/// (`tests/data/drag/flat_0.04_0.05_20mm.csv`).
const LEFT_FRICTION: f64 = 0.14;

/// The force of the stress that an earlier motion has left on a plate with outward normal `normal` whose centre moves with `v`, for a
/// pressure times area of `load`, in its unit: −load (n + μ_e t̂), t̂ along the tangential velocity.
pub fn left_force(normal: Vec3<f64>, v: Vec3<f64>, load: f64) -> Vec3<f64> {
    let aside = v - normal * normal.dot(v);
    let length = aside.norm_squared().sqrt();
    // A plate that moves along its normal has no tangential direction; rounding must not give it one.
    let friction = if length > 1e-9 * v.norm_squared().sqrt() { LEFT_FRICTION / length } else { 0.0 };
    aside.scale_add(friction, normal) * -load
}

#[cfg(test)]
mod tests;
