//! The stress laws of the mechanisms that act in the sand, for one number or for lanes with a strength each.
//!
//! With a strength of 0, the stress is bit-identical to that of plain theory. So a lane without a mechanism gives the
//! same results beside lanes that have the mechanism.

mod sliding;

use super::functions::{log_one_plus, tanh};
use super::mechanism::Mechanisms;
use super::term::{LaneTerms, Term, TermArguments};
use crate::number::{Real, Vec3};

pub use sliding::{RestingShare, SlidingFace, left_force};

/// Depth z0 [m] at which `depth_power` does not change the stress: our choice; another z0 has the effect of `scale`.
pub const DEPTH_REFERENCE: f64 = 0.02;
/// Distance [m] over which a footprint fades: our choice, because no published law was found.
const FOOTPRINT_REACH: f64 = 0.03;
/// Size [m] at which `size_power` does not change the stress: our choice, as for the depth.
const SIZE_REFERENCE: f64 = 0.05;
/// Length [m] that `packing_grad` refers to: our choice, because it only fixes the unit of g.
const PACKING_LENGTH: f64 = 0.1;
/// Speed [m/s] that `rate_log` refers to: our choice, about the tip speed in the leg experiment of Li et al. 2012.
const RATE_REFERENCE: f64 = 0.01;
/// Normal speed [m/s] over which cohesion builds up: our choice, because a segment then has none at rest, and all of it
/// at [`RATE_REFERENCE`].
const COHESION_SPEED: f64 = 1e-3;
/// Least factor on the stress that `rate_log` and `packing_grad` may give. Both laws are straight lines fitted over a
/// small range; extrapolated far enough, they would become negative, and the sand would drive the motion. Loosely
/// packed poppy seeds have .254/.464 = 0.55 of the stress of closely packed ones (`sand::media`). Our choice 0.2 is
/// well below 0.55, so the limit only takes effect in extrapolations: with `rate_log` = −0.1 above 30 m/s, with −0.25
/// above 0.24 m/s; with `packing_grad` = ±0.1 beyond 80 cm from the reference, with ±0.3 beyond 27 cm.
pub const LEAST_FACTOR: f64 = 0.2;

/// Speed [m/s] above which a body counts as travelling: our choice, a thirtieth of the slowest wheel that was
/// compared, and faster than the base of a standing robot moves.
const TRAVEL_SPEED: f64 = 3e-4;

/// The data of a segment that the mechanisms use, besides its normal and velocity.
#[derive(Clone, Copy)]
pub struct SegmentState<R> {
    /// Depth below the surface, ≥ 0 [m].
    pub depth: R,
    /// Position in the bed [m]: x_bed + x in force logs, travelled distance in walking.
    pub x: R,
    /// Factor of [`footprint`] for this pass; 1 on fresh ground.
    pub footprint: R,
    /// Width w of the segment across the plane of motion [m].
    pub width: R,
    /// dv_n/dt of the leading face [m/s²].
    pub normal_acceleration: R,
    /// Number of earlier passes over this place.
    pub passes: R,
    /// Horizontal velocity (x, y) [m/s] of the body that the segment belongs to: of a wheel's axle or a robot's base.
    /// Zero if the body does not travel; then `skid_loss`, `slip_bearing` and `graze_loss` have no effect.
    pub travel: [R; 2],
}

impl<R: Real> SegmentState<R> {
    /// A segment on fresh ground, in steady motion.
    #[inline(always)]
    pub fn fresh(depth: R, x: R) -> Self {
        let zero = R::zero();
        Self { depth, x, footprint: R::one(), width: zero, normal_acceleration: zero, passes: zero, travel: [zero; 2] }
    }

    /// The same on a body that travels with velocity (x, y).
    #[inline(always)]
    pub fn travelling(self, travel: [R; 2]) -> Self {
        Self { travel, ..self }
    }

    /// The same on a piece of this width [m].
    #[inline(always)]
    pub fn wide(self, width: R) -> Self {
        Self { width, ..self }
    }
}

/// Computes the stress on a segment from a law's stress per depth. Hot loops take it as a type parameter, so that
/// mechanisms do not make plain theory slower.
pub trait StressModel<R: Real> {
    /// Does the force depend on depth and area only through their product?
    const BY_LOAD: bool = false;

    /// Force [N] on a segment of `area` [m²] with unit normal `n` and velocity `v`, from the law's stress per depth
    /// [N/m³]. Without a mechanism it is bit-identical to that of [`Plain`], so depth times area is computed first.
    fn force(&self, per_depth: Vec3<R>, n: Vec3<R>, v: Vec3<R>, site: &SegmentState<R>, area: R) -> Vec3<R>;

    /// Factor on the law's force for a large piece whose parts lie at different depths: `mean` is their mean depth
    /// over the area, `loaded` the mean weighted by depth.
    #[inline(always)]
    fn by_depths(&self, _mean: R, _loaded: R) -> R {
        R::one()
    }

    /// `sliding_face`, if at least one lane has it. It acts on one-sided faces only, so the callers of
    /// [`Self::force`] apply it.
    #[inline(always)]
    fn sliding(&self) -> Option<&SlidingFace<R>> {
        None
    }
}

/// Plain resistive force theory: the stress is proportional to depth, without any mechanism.
#[derive(Clone, Copy)]
pub struct Plain;

impl<R: Real> StressModel<R> for Plain {
    const BY_LOAD: bool = true;

    #[inline(always)]
    fn force(&self, per_depth: Vec3<R>, _n: Vec3<R>, _v: Vec3<R>, site: &SegmentState<R>, area: R) -> Vec3<R> {
        per_depth * (site.depth * area)
    }
}

/// 1 − κ e^(−pass_dx/3 cm) from the second pass on, 1 before.
pub fn footprint(kappa: f64, pass: u32, pass_dx: f64) -> f64 {
    if pass < 2 { 1.0 } else { 1.0 - kappa * (-pass_dx.abs() / FOOTPRINT_REACH).exp() }
}

/// (w/w0)^q, w = √(length × width) the size of an intruder with these sides [m].
pub fn of_size(power: f64, [length, width]: [f64; 2]) -> f64 {
    if power == 0.0 { 1.0 } else { ((length * width).sqrt() / SIZE_REFERENCE).powf(power) }
}

/// Depth [m] of the point (x, z) below a surface through the origin that rises toward +x by σ, given as (sin σ, cos σ):
/// (x tan σ − z) cos σ.
pub fn slope_depth<R: Real>((sin, cos): (f64, f64), x: R, z: R) -> R {
    x * R::splat(sin) - z * R::splat(cos)
}

/// The laws that at least one lane needs.
#[derive(Clone, Copy, Default)]
struct Active {
    depth_power: bool,
    packing_grad: bool,
    rate_log: bool,
    friction_clip: bool,
    cohesion: bool,
    added_mass: bool,
    skid_loss: bool,
    graze_loss: bool,
    slip_bearing: bool,
    sliding_face: bool,
}

/// The sand side of [`Mechanisms`], ready for evaluation, one lane for each environment.
#[derive(Clone, Copy)]
pub struct SandMechanisms<R> {
    active: Active,
    /// λ ρ [kg/m³]
    drag: R,
    /// C_a ρ [kg/m³]
    added: R,
    cohesion: R,
    depth_excess: R,
    scale: R,
    /// Strength g of `packing_grad` divided by the length [`PACKING_LENGTH`] [1/m].
    packing: R,
    rate: R,
    inverse_friction: R,
    /// Is the motion prescribed? See [`Self::for_prescribed_motion`].
    prescribed: bool,
    skid_loss: R,
    graze_loss: R,
    /// c_b (1 − μ)^1.5 of `slip_bearing`; times ζ it is a stress per depth.
    bearing: R,
    /// ζ [N/m³]
    penetration: R,
    sliding: SlidingFace<R>,
    /// χ: share of the straight chord in the force on a leg whose concave side leads.
    pub fill: R,
    /// The terms of `sand.toml`.
    terms: LaneTerms<R>,
}

impl<R: Real> SandMechanisms<R> {
    /// `bulk_density` ρ in kg/m³.
    pub fn new(mechanisms: &Mechanisms, bulk_density: f64) -> Self {
        let zero = R::zero();
        let mut new = Self {
            active: Active::default(),
            drag: zero,
            added: zero,
            cohesion: zero,
            depth_excess: zero,
            scale: R::one(),
            packing: zero,
            rate: zero,
            inverse_friction: zero,
            prescribed: false,
            skid_loss: zero,
            graze_loss: zero,
            bearing: zero,
            penetration: zero,
            sliding: SlidingFace::none(),
            fill: zero,
            terms: LaneTerms::new(),
        };
        (0..R::LANES).for_each(|lane| new.set_lane(lane, mechanisms, bulk_density));
        new
    }

    /// For bodies that a motor moves on a given path, as in force logs. `friction_clip` is then the limit as its source
    /// defines it, even where the remaining force acts along the motion. A body that moves freely would gain energy
    /// from such a force, so for free bodies the limit is weaker there.
    pub fn for_prescribed_motion(self) -> Self {
        Self { prescribed: true, ..self }
    }

    /// Sets one lane's mechanisms.
    pub fn set_lane(&mut self, lane: usize, m: &Mechanisms, bulk_density: f64) {
        self.active.depth_power |= m.depth_power != 0.0;
        self.active.packing_grad |= m.packing_grad != 0.0;
        self.active.rate_log |= m.rate_log != 0.0;
        self.active.friction_clip |= m.friction_clip != 0.0;
        self.active.cohesion |= m.cohesion != 0.0;
        self.active.added_mass |= m.added_mass != 0.0;
        self.active.skid_loss |= m.skid_loss != 0.0;
        self.active.graze_loss |= m.graze_loss != 0.0;
        self.active.slip_bearing |= m.slip_bearing != 0.0;
        self.active.sliding_face |= m.sliding_face != 0.0;
        self.sliding.set_lane(lane, m, bulk_density);
        self.skid_loss.set_lane(lane, m.skid_loss);
        self.graze_loss.set_lane(lane, m.graze_loss);
        self.bearing.set_lane(lane, m.slip_bearing * inclination(m.friction_clip));
        self.drag.set_lane(lane, m.inertial_drag * bulk_density);
        self.added.set_lane(lane, m.added_mass * bulk_density);
        self.cohesion.set_lane(lane, m.cohesion);
        self.depth_excess.set_lane(lane, m.depth_power);
        self.scale.set_lane(lane, 1.0 + m.scale);
        self.packing.set_lane(lane, m.packing_grad / PACKING_LENGTH);
        self.rate.set_lane(lane, m.rate_log);
        self.inverse_friction.set_lane(lane, m.friction_clip);
        self.fill.set_lane(lane, m.concave_fill);
    }

    /// Sets the medium's terms in one lane.
    pub fn set_terms(&mut self, lane: usize, terms: &[Term], bulk_density: f64) {
        self.terms.set_lane(lane, terms, bulk_density);
    }

    /// Sets the medium's ζ [N/m³] in one lane; `slip_bearing` is a share of it.
    pub fn set_penetration(&mut self, lane: usize, penetration: f64) {
        self.penetration.set_lane(lane, penetration);
    }

    /// The law's stress per depth plus the stress per depth of `slip_bearing`, c (1 − μ)^1.5 ζ s₊ (−m_z)₊. It pushes
    /// against the leading side with normal m, where s₊ is the positive part of the segment's slip ratio.
    #[inline(always)]
    fn carried(&self, per_depth: Vec3<R>, n: Vec3<R>, slip: R, along: R) -> Vec3<R> {
        let down = R::select(along.lt(R::zero()), n.z, -n.z).max(R::zero());
        let push = self.bearing * self.penetration * slip.max(R::zero()) * down;
        n.scale_add(R::select(along.lt(R::zero()), push, -push), per_depth)
    }

    /// `force` with its tangential part limited to 1/`inverse_friction` times its normal part; 0 means no limit. If the
    /// law's normal part drives the motion (plates drawn out at a shallow angle), the tangential part stays large
    /// enough that the whole force still brakes the motion, unless the motion is prescribed. 1e-30 avoids 0/0.
    #[inline(always)]
    fn capped(&self, force: Vec3<R>, n: Vec3<R>, v: Vec3<R>) -> Vec3<R> {
        let normal = force.dot(n);
        let tangential = force - n * normal;
        let size = tangential.norm_squared().sqrt();
        let allowed = (normal.abs() / (self.inverse_friction * size + R::splat(1e-30))).min(R::one());
        let allowed = R::select(R::zero().lt(self.inverse_friction), allowed, R::one());
        if self.prescribed {
            return tangential.scale_add(allowed - R::one(), force);
        }
        let (gained, lost) = ((normal * n.dot(v)).max(R::zero()), (-tangential.dot(v)).max(R::zero()));
        let needed = (gained / (lost + R::splat(1e-30))).min(R::one());
        tangential.scale_add(allowed.max(needed) - R::one(), force)
    }

    /// `force` with its vertical part divided by 1 + κ s₋², where κ is the strength of `skid_loss` and s₋ the negative
    /// part of the slip ratio. If the horizontal part drives the motion, the vertical part brakes it and is not
    /// reduced, so the sand adds no energy.
    #[inline(always)]
    fn skidding(&self, force: Vec3<R>, v: Vec3<R>, slip: R) -> Vec3<R> {
        let skid = slip.min(R::zero());
        let left = R::one() / (self.skid_loss * skid).mul_add(skid, R::one());
        let feeds = R::zero().lt(force.x * v.x + force.y * v.y);
        Vec3::new(force.x, force.y, force.z * R::select(feeds, R::one(), left))
    }

    /// Share of the force that remains on a steep face when the body travels along the face: 1 − κ_g |n_h|⁸ (1 −
    /// |n_h·V̂|/|n_h|), n_h the horizontal part of its normal, V̂ the direction of travel. Never negative, so the sand
    /// adds no energy. 1e-20 avoids 0/0.
    #[inline(always)]
    fn grazing(&self, n: Vec3<R>, [x, y]: [R; 2]) -> R {
        let steep = n.x * n.x + n.y * n.y;
        let travel = x * x + y * y;
        let ahead = (n.x * x + n.y * y).abs() / ((steep * travel).sqrt() + R::splat(1e-20));
        let moves = travel / (travel + R::splat(TRAVEL_SPEED * TRAVEL_SPEED));
        let fourth = steep * steep;
        let aside = (R::one() - ahead).max(R::zero()) * moves;
        (self.graze_loss * fourth * fourth).mul_add(-aside, R::one())
    }

    /// |z| → z0 (|z|/z0)^p
    #[inline(always)]
    pub fn depth(&self, depth: R) -> R {
        if !self.active.depth_power {
            return depth;
        }
        // Powers are computed lane by lane, which is slow, but only while this mechanism is on.
        let mut powered = depth;
        for lane in 0..R::LANES {
            let (d, excess) = (depth.lane(lane), self.depth_excess.lane(lane));
            if excess != 0.0 {
                powered.set_lane(lane, DEPTH_REFERENCE * (d.max(0.0) / DEPTH_REFERENCE).powf(1.0 + excess));
            }
        }
        powered
    }

    /// Product of all factors on the stress that is proportional to depth.
    #[inline(always)]
    fn factor(&self, v: Vec3<R>, site: &SegmentState<R>) -> R {
        let mut factor = site.footprint * self.scale;
        if self.active.packing_grad {
            factor = factor * self.packing.mul_add(site.x, R::one()).max(R::splat(LEAST_FACTOR));
        }
        if self.active.rate_log {
            let speed = v.norm_squared().sqrt() * R::splat(1.0 / RATE_REFERENCE);
            factor = factor * self.rate.mul_add(log_one_plus(speed), R::one()).max(R::splat(LEAST_FACTOR));
        }
        factor
    }
}

impl<R: Real> StressModel<R> for SandMechanisms<R> {
    /// With `depth_power`, the power of the depth is computed at `loaded`. For a piece that reaches the surface the
    /// error is 1.4 % at p = 1.2; with the mean depth it would be 4 %.
    #[inline(always)]
    fn by_depths(&self, mean: R, loaded: R) -> R {
        if !self.active.depth_power {
            return R::one();
        }
        let tiny = R::splat(1e-12); // [m]; avoids 0/0 outside the sand
        let (mean, loaded) = (mean.max(tiny), loaded.max(tiny));
        self.depth(loaded) * mean / (self.depth(mean) * loaded)
    }

    #[inline(always)]
    fn sliding(&self) -> Option<&SlidingFace<R>> {
        self.active.sliding_face.then_some(&self.sliding)
    }

    /// The law's stress per depth plus that of `slip_bearing` is multiplied by the depth and by the factors of `scale`,
    /// `footprint`, `packing_grad` and `rate_log`. Then `friction_clip`, `graze_loss` and `skid_loss` reduce the force.
    /// Further forces are added: inertia, `added_mass`, `cohesion` and the normal terms of `sand.toml` push against the
    /// leading face, and the tangential terms act against the tangential velocity. Terms on the law multiply the law's
    /// force.
    #[inline(always)]
    fn force(&self, per_depth: Vec3<R>, n: Vec3<R>, v: Vec3<R>, site: &SegmentState<R>, area: R) -> Vec3<R> {
        let along = n.dot(v);
        let slips = self.active.skid_loss || self.active.slip_bearing;
        let slip = if slips { slip(v, site.travel) } else { R::zero() };
        let per_depth = if self.active.slip_bearing { self.carried(per_depth, n, slip, along) } else { per_depth };
        let mut force = per_depth * (self.depth(site.depth) * self.factor(v, site) * area);
        if self.active.friction_clip {
            force = self.capped(force, n, v);
        }
        if self.active.graze_loss {
            force = force * self.grazing(n, site.travel);
        }
        if self.active.skid_loss {
            force = self.skidding(force, v, slip);
        }
        let speed = along.abs();
        let mut pressure = self.drag * speed * speed;
        if self.active.added_mass {
            pressure += self.added * site.width * site.normal_acceleration;
        }
        if self.active.cohesion {
            pressure += self.cohesion * tanh(speed * R::splat(1.0 / COHESION_SPEED));
        }
        if self.terms.any() {
            let piece = TermArguments {
                depth: site.depth.max(R::zero()),
                width: site.width,
                normal_speed: speed,
                normal_acceleration: site.normal_acceleration,
                passes: site.passes,
                normal: n,
                velocity: v,
            };
            let (normal, tangential, share) = self.terms.stress(&piece);
            pressure += normal;
            force = force * share;
            force += LaneTerms::against_slip(n, v) * (tangential * area);
        }
        // If only some lanes are in the sand, a lane in the air is computed with depth 0, and gets no force.
        let push = R::select(R::zero().lt(site.depth), pressure * area, R::zero());
        let toward_front = R::select(along.lt(R::zero()), push, -push);
        n.scale_add(toward_front, force)
    }
}

/// Slip ratio of a segment with velocity `v` on a body that travels with V: −v·V̂/max(|V|, |v − V|). It is −1 if the
/// body drags the segment along (a locked wheel), 0 if the segment does not move on the sand (the bottom of a rolling
/// wheel), and near 1 if the segment moves backward fast (a spinning wheel). This is the slip ratio of terramechanics,
/// for each segment by itself. Where the body hardly travels, the ratio goes to 0.
#[inline(always)]
fn slip<R: Real>(v: Vec3<R>, [x, y]: [R; 2]) -> R {
    let squared = x * x + y * y;
    let (dx, dy) = (v.x - x, v.y - y);
    let greater = squared.max(dx * dx + dy * dy + v.z * v.z);
    -(v.x * x + v.y * y) / ((squared * greater).sqrt() + R::splat(TRAVEL_SPEED * TRAVEL_SPEED))
}

/// Share of the bearing capacity that remains under an inclined load, (1 − μ)^1.5: Vesic (1973), for a square footing
/// whose load is inclined by the surface's friction μ. The share is 0 if no friction is given (fully rough).
fn inclination(inverse_friction: f64) -> f64 {
    if inverse_friction > 0.0 { (1.0 - 1.0 / inverse_friction).max(0.0).powf(1.5) } else { 0.0 }
}

#[cfg(test)]
mod tests;
