//! Force on one segment, and the derivatives that an implicit integrator needs.
//!
//! Resistive force theory depends on the direction of the velocity only: it is dry friction, undefined at rest and
//! stiff. The parameters in [`Regularization`] make it usable in dynamics.

use super::law::{Law, Motion, Normals, PenetrationDrag, PlanarTable, SpatialTable, StressLaw};
use super::mechanism::Mechanisms;
use super::mechanism_laws::{Plain, SandMechanisms, SegmentState, SlidingFace, StressModel};
use super::media::Medium;
use crate::number::{Real, Vec3};
use serde::{Deserialize, Serialize};

/// How the force law is regularised.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Regularization {
    /// Speed scale v0 [m/s] below which the force falls to zero: the direction v/|v| becomes v/√(v²+v0²). Under a
    /// constant load a body creeps with about this speed. Our choice 1e-5, because the reference robot then sinks by
    /// less than 0.02 mm in 10 s.
    pub rest_speed: f64,
    /// Gate of a one-sided surface. The surface pushes with the share clamp(n·v̂ / gate, 0, 1) of its force. The share
    /// is zero when the surface moves away from the sand, and 1 when it leads. Our choice 0.2, because a hard test (0)
    /// converges badly in the time step (7-12 % error at 1 ms).
    pub leading_edge_gate: f64,
    /// Gate of `penetration-drag-1d`, whose force depends on the signs of v_z and v_x; each sign is smoothed to
    /// clamp(v̂_i / gate, −1, 1). Our choice 0.02 (1.1°), the sharpest gate that a time step of 0.5 ms still resolves.
    pub sign_gate: f64,
    /// Friction coefficient μ_s of the intruder's surface, for `agarwal2023`: caps its tangential stress. None: no cap.
    pub friction: Option<f64>,
}

impl Regularization {
    /// No regularisation: for the law itself, not for dynamics. Our choice of numbers too small to change a force.
    pub const BARE: Self = Self { rest_speed: 1e-30, leading_edge_gate: 1e-20, sign_gate: 1e-20, friction: None };
    /// For solid bodies with many plates in all directions: a sharper leading edge. Our choice 0.02, because forces on
    /// rounded bodies then differ by at most 1 % from forces with a sharp edge, and walks at 1 ms by at most 1 % from
    /// walks at 0.125 ms. A flat face that moves within 1.1° of its own plane differs by up to its whole force; a sharp edge
    /// counts it fully (docs/physics.md has an example).
    pub const SOLID: Self = Self { leading_edge_gate: 0.02, ..Self::DEFAULT };
    /// The regularisation for dynamics; each field gives the reason for its number.
    pub const DEFAULT: Self = Self { rest_speed: 1e-5, leading_edge_gate: 0.2, sign_gate: 0.02, friction: None };
}

impl Default for Regularization {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// The coefficients of the chosen law. Hot loops match on this once, and then have the law as a type parameter.
#[derive(Clone, Copy)]
pub enum LawCoefficients<R> {
    Li2013(PlanarTable<R>),
    PenetrationDrag1d(PenetrationDrag<R>),
    Agarwal2023(SpatialTable<R>),
}

/// Matches on the law at every call, for code outside the hot loops.
impl<R: Real> StressLaw<R> for LawCoefficients<R> {
    fn set_lane(&mut self, lane: usize, medium: &Medium) {
        match self {
            LawCoefficients::Li2013(law) => law.set_lane(lane, medium),
            LawCoefficients::PenetrationDrag1d(law) => law.set_lane(lane, medium),
            LawCoefficients::Agarwal2023(law) => law.set_lane(lane, medium),
        }
    }

    #[inline(always)]
    fn stress(&self, n: Vec3<R>, motion: &Motion<R>) -> Vec3<R> {
        match self {
            LawCoefficients::Li2013(law) => law.stress(n, motion),
            LawCoefficients::PenetrationDrag1d(law) => law.stress(n, motion),
            LawCoefficients::Agarwal2023(law) => law.stress(n, motion),
        }
    }

    #[inline(always)]
    fn mean_stress(&self, normals: &Normals<R>, motion: &Motion<R>) -> Vec3<R> {
        match self {
            LawCoefficients::Li2013(law) => law.mean_stress(normals, motion),
            LawCoefficients::PenetrationDrag1d(law) => law.mean_stress(normals, motion),
            LawCoefficients::Agarwal2023(law) => law.mean_stress(normals, motion),
        }
    }
}

/// Sand under one environment (or one per lane), ready for evaluation.
#[derive(Clone, Copy)]
pub struct SandBed<R> {
    pub law: LawCoefficients<R>,
    /// The mechanisms that act in the sand; None if no lane has any.
    pub mechanisms: Option<SandMechanisms<R>>,
    rest_speed_squared: R,
    inverse_gate: R,
}

/// The force of the sand on a segment at its present velocity v, and its change with v: f(v + Δv) ≈ force − drag Δv
/// − edge (n·Δv) n.
#[derive(Clone, Copy)]
pub struct Contact<R> {
    /// [N]
    pub force: Vec3<R>,
    /// Force against the motion divided by the speed, −f·v/v² [N·s/m], never negative: the slope of the straight line
    /// from rest to the present velocity (secant). Near rest the regularised force is linear in v, and the secant
    /// equals its slope. For this the denominator must be v² itself, and not v² + v0².
    pub drag: R,
    /// Slope of the leading-edge gate along the normal [N·s/m], never negative; 0 for two-sided segments.
    pub edge: R,
}

impl<R: Real> SandMechanisms<R> {
    /// Stress [Pa] on a submerged thin segment with unit normal `n` and velocity `v`, both in the surface's frame.
    #[inline(always)]
    pub fn stress(&self, ground: &SandBed<R>, n: Vec3<R>, v: Vec3<R>, site: &SegmentState<R>) -> Vec3<R> {
        self.force(ground.stress(n, &ground.motion(v)), n, v, site, R::one())
    }
}

impl<R: Real> SandBed<R> {
    pub fn new(law: Law, medium: &Medium, surface: &Regularization) -> Self {
        let law = match law {
            Law::Li2013 => LawCoefficients::Li2013(PlanarTable::splat(&medium.coefficients)),
            Law::PenetrationDrag1d => {
                LawCoefficients::PenetrationDrag1d(PenetrationDrag::splat(&medium.coefficients, surface.sign_gate))
            }
            Law::Agarwal2023 => {
                LawCoefficients::Agarwal2023(SpatialTable::splat(medium, surface.friction, surface.leading_edge_gate))
            }
        };
        Self {
            law,
            mechanisms: None,
            rest_speed_squared: R::splat(surface.rest_speed * surface.rest_speed),
            inverse_gate: R::splat(1.0 / surface.leading_edge_gate),
        }
    }

    /// The same sand with `mechanisms` switched on.
    pub fn with(mut self, mechanisms: &Mechanisms, medium: &Medium) -> Self {
        self.mechanisms = (!mechanisms.sand_is_plain() || !medium.terms.is_empty()).then(|| {
            let mut acting = SandMechanisms::new(mechanisms, medium.bulk_density);
            (0..R::LANES).for_each(|lane| {
                acting.set_penetration(lane, medium.coefficients.penetration());
                acting.set_terms(lane, &medium.terms, medium.bulk_density);
            });
            acting
        });
        self
    }

    /// Sets the medium and mechanisms of lane `lane`.
    pub fn set_lane(&mut self, lane: usize, medium: &Medium, mechanisms: &Mechanisms) {
        self.law.set_lane(lane, medium);
        if self.mechanisms.is_some() || !mechanisms.sand_is_plain() || !medium.terms.is_empty() {
            let plain = || SandMechanisms::new(&Mechanisms::PLAIN, 0.0);
            let acting = self.mechanisms.get_or_insert_with(plain);
            acting.set_lane(lane, mechanisms, medium.bulk_density);
            acting.set_penetration(lane, medium.coefficients.penetration());
            acting.set_terms(lane, &medium.terms, medium.bulk_density);
        }
    }

    /// Stress per depth [N/m³] of the law alone, on a segment with unit normal `n` in this motion.
    #[inline(always)]
    pub fn stress(&self, n: Vec3<R>, motion: &Motion<R>) -> Vec3<R> {
        self.law.stress(n, motion)
    }

    /// The factor [m] with which the law's stress per depth is multiplied: the depth, unless `depth_power` is on.
    #[inline(always)]
    pub fn grown(&self, depth: R) -> R {
        self.mechanisms.as_ref().map_or(depth, |mechanisms| mechanisms.depth(depth))
    }

    /// 1/√(v² + v0²) [s/m].
    #[inline(always)]
    pub fn inverse_speed(&self, v: Vec3<R>) -> R {
        R::one() / (v.norm_squared() + self.rest_speed_squared).sqrt()
    }

    #[inline(always)]
    pub fn motion(&self, v: Vec3<R>) -> Motion<R> {
        let squared = v.norm_squared();
        let (speed, finite) = ((squared + self.rest_speed_squared).sqrt(), squared + R::splat(1e-24));
        // One division gives both reciprocals.
        let inverse = R::one() / (speed * finite);
        let (inverse_speed, inverse_square) = (finite * inverse, speed * inverse);
        Motion { v, inverse_speed, moving: squared * inverse_speed * inverse_speed, inverse_square }
    }

    /// The sand's force on both sides together of a thin plate: `area` [m²], unit normal `n`, velocity `v` [m/s].
    #[inline(always)]
    pub fn thin_plate(&self, site: &SegmentState<R>, area: R, n: Vec3<R>, v: Vec3<R>) -> Contact<R> {
        match (&self.law, &self.mechanisms) {
            (LawCoefficients::Li2013(law), None) => self.thin_plate_by(law, &Plain, site, area, n, v),
            (law, None) => self.thin_plate_by(law, &Plain, site, area, n, v),
            (law, Some(mechanisms)) => self.thin_plate_by(law, mechanisms, site, area, n, v),
        }
    }

    /// The same as [`Self::thin_plate`], for loops that have already matched on law and mechanisms.
    #[inline(always)]
    pub fn thin_plate_by(
        &self,
        law: &impl StressLaw<R>,
        stress_model: &impl StressModel<R>,
        site: &SegmentState<R>,
        area: R,
        n: Vec3<R>,
        v: Vec3<R>,
    ) -> Contact<R> {
        let motion = self.motion(v);
        let force = stress_model.force(law.stress(n, &motion), n, v, site, area);
        Contact { force, drag: secant(force, &motion), edge: R::zero() }
    }

    /// The sand's force on a face of a solid body with outward normal `n`. The sand is on one side only, and pushes but never pulls.
    #[inline(always)]
    pub fn one_sided(&self, site: &SegmentState<R>, area: R, n: Vec3<R>, v: Vec3<R>) -> Contact<R> {
        match (&self.law, &self.mechanisms) {
            (LawCoefficients::Li2013(law), None) => self.one_sided_by(law, &Plain, site, area, n, v),
            (law, None) => self.one_sided_by(law, &Plain, site, area, n, v),
            (law, Some(mechanisms)) => self.one_sided_by(law, mechanisms, site, area, n, v),
        }
    }

    /// The same as [`Self::one_sided`], for loops that have already matched on law and mechanisms.
    #[inline(always)]
    pub fn one_sided_by(
        &self,
        law: &impl StressLaw<R>,
        stress_model: &impl StressModel<R>,
        site: &SegmentState<R>,
        area: R,
        n: Vec3<R>,
        v: Vec3<R>,
    ) -> Contact<R> {
        let motion = self.motion(v);
        let full = stress_model.force(law.stress(n, &motion), n, v, site, area);
        let along = n.dot(v) * motion.inverse_speed;
        let sliding = stress_model.sliding();
        let inverse_gate = sliding.map_or(self.inverse_gate, |face| face.inverse_range(self.inverse_gate));
        let gate = (along * inverse_gate).clamp(R::zero(), R::one());
        let force = full * gate;
        let rising = (-full.dot(n)).max(R::zero()) * motion.inverse_speed * inverse_gate;
        let inside = R::select(R::zero().lt(gate), R::select(gate.lt(R::one()), rising, R::zero()), R::zero());
        let Some(face) = sliding else {
            return Contact { force, drag: secant(force, &motion), edge: inside };
        };
        let resting = face.resting(along, R::zero());
        let load = site.depth.max(R::zero()) * area * SlidingFace::pressure(n.z);
        let still = self.resting(face, n * (load * resting.share), load * resting.share, load * resting.slope, v);
        let force = force + still.force;
        Contact { force, drag: secant(force, &motion), edge: (inside + still.edge).max(R::zero()) }
    }

    /// `sliding_face`, if at least one lane has it.
    #[inline(always)]
    pub fn sliding(&self) -> Option<&SlidingFace<R>> {
        self.mechanisms.as_ref().and_then(StressModel::sliding)
    }

    /// The force of sand at rest on faces that slide along themselves; for `normal` and `load` see
    /// [`SlidingFace::force`]. `slope`: the derivative of `load` with respect to n·v̂ [m³]; the edge has its sign.
    #[inline(always)]
    pub fn resting(&self, face: &SlidingFace<R>, normal: Vec3<R>, load: R, slope: R, v: Vec3<R>) -> Contact<R> {
        let motion = self.motion(v);
        let force = face.force(normal, load, v * motion.inverse_speed, motion.moving);
        let edge = face.weight * slope * motion.inverse_speed * motion.moving;
        Contact { force, drag: secant(force, &motion), edge }
    }

    /// Force on the leading part of a curved face. `area`: area of this part [m²]; `loaded`: its mean depth, weighted
    /// by depth [m]; `growth`: relative growth of its force for each unit of n·v̂.
    #[inline(always)]
    #[allow(clippy::too_many_arguments)] // all arguments stay in registers
    pub fn leading_part_by(
        &self,
        law: &impl StressLaw<R>,
        stress_model: &impl StressModel<R>,
        site: &SegmentState<R>,
        area: R,
        loaded: R,
        normals: &Normals<R>,
        v: Vec3<R>,
        growth: R,
    ) -> Contact<R> {
        let (motion, n) = (self.motion(v), normals.unit);
        let per_depth = law.mean_stress(normals, &motion) * stress_model.by_depths(site.depth, loaded);
        let force = stress_model.force(per_depth, n, v, site, area);
        let edge = (-force.dot(n)).max(R::zero()) * motion.inverse_speed * growth;
        Contact { force, drag: secant(force, &motion), edge }
    }
}

/// −f·v/v², or 0 if the force does not resist the motion or the segment is at rest.
#[inline(always)]
fn secant<R: Real>(force: Vec3<R>, motion: &Motion<R>) -> R {
    (-force.dot(motion.v)).max(R::zero()) * motion.inverse_square
}
