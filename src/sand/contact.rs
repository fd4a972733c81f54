//! Force on one segment, and the derivatives an implicit integrator needs.
//!
//! Resistive force theory depends on the direction of the velocity only: it is dry friction, undefined at rest and
//! stiff. Two named parameters make it usable in dynamics; both are in [`Surface`].

use super::law::{Law, Motion, PlanarTable};
use super::media::Medium;
use crate::number::{Real, Vec3};
use serde::{Deserialize, Serialize};

/// How the force law is regularised.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Surface {
    /// Speed scale v0 [m/s] below which the force falls to zero: the direction v/|v| becomes v/√(v²+v0²). Creep under
    /// a constant load is of this order; our choice, because 1e-5 lets the reference robot sink 0.03 mm in 10 s.
    pub rest_speed: f64,
    /// A one-sided surface pushes with clamp(n·v̂ / gate, 0, 1) of its force: zero when it leaves the sand, full when
    /// it leads. Our choice 0.2: a hard test (0) converges badly in the time step (7-12 % error at 1 ms).
    pub leading_edge_gate: f64,
}

impl Default for Surface {
    fn default() -> Self {
        Self { rest_speed: 1e-5, leading_edge_gate: 0.2 }
    }
}

/// Sand under one environment (or one per lane), ready for evaluation.
#[derive(Clone, Copy)]
pub struct Ground<R> {
    pub law: Law,
    table: PlanarTable<R>,
    rest_speed_squared: R,
    inverse_gate: R,
}

/// What the sand does to a segment at its present velocity v, and how that changes with v:
/// f(v + Δv) ≈ force − drag Δv − edge (n·Δv) n.
#[derive(Clone, Copy)]
pub struct Contact<R> {
    /// [N]
    pub force: Vec3<R>,
    /// Resisting part of the force over the speed, −f·v/v² [N·s/m], never negative. It is the secant, so that at rest,
    /// where the regularised force is linear in v, it is the true slope: v² + v0² below would leave it far too small.
    pub drag: R,
    /// Slope of the leading-edge gate along the normal [N·s/m], never negative; 0 for two-sided segments.
    pub edge: R,
}

impl<R: Real> Ground<R> {
    pub fn new(law: Law, medium: &Medium, surface: &Surface) -> Self {
        Self {
            law,
            table: PlanarTable::splat(&medium.coefficients),
            rest_speed_squared: R::splat(surface.rest_speed * surface.rest_speed),
            inverse_gate: R::splat(1.0 / surface.leading_edge_gate),
        }
    }

    /// Gives lane `lane` its own medium.
    pub fn set_lane(&mut self, lane: usize, medium: &Medium) {
        self.table.set_lane(lane, &medium.coefficients);
    }

    /// Stress per depth [N/m³] at full speed along `v`; the bare law.
    #[inline(always)]
    pub fn stress(&self, n: Vec3<R>, motion: &Motion<R>) -> Vec3<R> {
        match self.law {
            Law::Li2013 => self.table.stress(n, motion),
        }
    }

    #[inline(always)]
    pub fn motion(&self, v: Vec3<R>) -> Motion<R> {
        let squared = v.norm_squared();
        let inverse_speed = R::one() / (squared + self.rest_speed_squared).sqrt();
        Motion { v, inverse_speed, moving: squared * inverse_speed * inverse_speed }
    }

    /// A thin plate in the sand, both sides together: `depth` ≥ 0 [m] below the surface, `area` [m²].
    #[inline(always)]
    pub fn thin_plate(&self, depth: R, area: R, n: Vec3<R>, v: Vec3<R>) -> Contact<R> {
        let motion = self.motion(v);
        let force = self.stress(n, &motion) * (depth * area);
        Contact { force, drag: secant(force, v), edge: R::zero() }
    }

    /// A face of a solid body with outward normal `n`: the sand is on one side only and can push, not pull.
    #[inline(always)]
    pub fn one_sided(&self, depth: R, area: R, n: Vec3<R>, v: Vec3<R>) -> Contact<R> {
        let motion = self.motion(v);
        let full = self.stress(n, &motion) * (depth * area);
        let leading = n.dot(v) * motion.inverse_speed * self.inverse_gate;
        let gate = leading.clamp(R::zero(), R::one());
        let force = full * gate;
        let rising = (-full.dot(n)).max(R::zero()) * motion.inverse_speed * self.inverse_gate;
        let inside = R::select(R::zero().lt(gate), R::select(gate.lt(R::one()), rising, R::zero()), R::zero());
        Contact { force, drag: secant(force, v), edge: inside }
    }
}

/// −f·v/v², or 0 where the force does not resist or nothing moves (1e-24 is (1e-12 m/s)², far below creep).
#[inline(always)]
fn secant<R: Real>(force: Vec3<R>, v: Vec3<R>) -> R {
    (-force.dot(v)).max(R::zero()) / (v.norm_squared() + R::splat(1e-24))
}
