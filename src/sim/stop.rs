//! Torques at a joint, linearly implicit in its acceleration, and the stops at the ends of its range.

use crate::number::Real;

/// Stands for "no limit": far above any servo, and finite in `f32`.
pub const NO_LIMIT: f64 = 1e9;
/// Resistance of a stop to acceleration, as a multiple of the joint's inertia: our choice. A load then accelerates a
/// joint at its stop a thousand times less than elsewhere.
const STIFF: f64 = 1e3;
/// Number of time steps in which a stop pushes a joint back into its range: our choice. A return in one step would be
/// eight times as fast.
const RETURN: f64 = 8.0;

/// Torque on a joint that falls with its acceleration q̈: `torque` − `yielding` q̈. Engine `rapier` also uses this type
/// for torques that fall with the rate after the step q̇⁺: `torque` − `yielding` q̇⁺, where `yielding` is in N·m·s/rad.
#[derive(Clone, Copy)]
pub struct ImplicitTorque<R> {
    /// [N·m or N]
    pub torque: R,
    /// [kg·m² or kg]
    pub yielding: R,
}

/// A stop's push, and the least and the greatest torque that it can have. If the stop acts, one of the limits is 0, because it only pushes back.
pub struct Stop<R> {
    pub push: ImplicitTorque<R>,
    pub limits: [R; 2],
}

impl<R: Real> ImplicitTorque<R> {
    #[inline(always)]
    pub fn none() -> Self {
        Self { torque: R::zero(), yielding: R::zero() }
    }

    #[inline(always)]
    pub fn select(mask: R::Mask, yes: Self, no: Self) -> Self {
        Self { torque: R::select(mask, yes.torque, no.torque), yielding: R::select(mask, yes.yielding, no.yielding) }
    }

    #[inline(always)]
    pub fn plus(self, o: Self) -> Self {
        Self { torque: self.torque + o.torque, yielding: self.yielding + o.yielding }
    }

    #[inline(always)]
    pub fn at(&self, acceleration: R) -> R {
        self.torque - self.yielding * acceleration
    }

    /// The acceleration under this push. `own` is the joint's inertia; a push of `load` would give the acceleration 0.
    #[inline(always)]
    pub fn moves(&self, own: R, load: R) -> R {
        (self.torque - load) / (own + self.yielding)
    }

    /// This push or, if its torque at `acceleration` is beyond the limit `low` or `high`, that limit as a constant torque.
    #[inline(always)]
    pub fn within(&self, low: R, high: R, acceleration: R) -> Self {
        let torque = self.at(acceleration);
        let limited = torque.clamp(low, high);
        let free = (limited - torque).abs().lt(R::splat(f64::from(f32::MIN_POSITIVE)));
        Self { torque: R::select(free, self.torque, limited), yielding: R::select(free, self.yielding, R::zero()) }
    }
}

impl<R: Real> Stop<R> {
    /// The stops of a joint with this range, position, rate and inertia `own`; a push of exactly 0 inside the range.
    #[inline(always)]
    pub fn of([least, most]: [R; 2], position: R, rate: R, own: R, dt: R) -> Self {
        let zero = R::zero();
        let stiff = own * R::splat(STIFF);
        let next = rate.mul_add(dt, position);
        // Distance of the joint beyond its range, now or, at its present rate, after the step.
        let beyond = (next - most).max(position - most).max(zero) + (next - least).min(position - least).min(zero);
        let past = (position - most).max(zero) + (position - least).min(zero);
        let out = (past / (dt * R::splat(RETURN)) + rate) * (stiff / dt);
        let acts = zero.lt(beyond.abs());
        let push = ImplicitTorque { torque: R::select(acts, -out, zero), yielding: R::select(acts, stiff, zero) };
        let limits = [
            R::select(beyond.lt(zero), zero, -R::splat(NO_LIMIT)),
            R::select(zero.lt(beyond), zero, R::splat(NO_LIMIT)),
        ];
        Self { push, limits }
    }

    /// The push, 0 where it would pull at this acceleration.
    #[inline(always)]
    pub fn at(&self, acceleration: R) -> ImplicitTorque<R> {
        self.push.within(self.limits[0], self.limits[1], acceleration)
    }
}
