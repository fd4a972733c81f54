//! Evaluates the force law for each plate separately. For plates that the leading edge or the surface of the sand
//! crosses, the rules are those of `sandgait intrude`.
//!
//! In `sandgait intrude` a flat plate either leads or does not. Here its force rises over a small range of n·v̂, which
//! [`crate::sand::Regularization::leading_edge_gate`] gives, because an integrator needs a force without jumps. For a
//! flat plate the range begins at n·v̂ = 0. For a bent plate the range is symmetric about 0, because on average half of
//! a bent plate leads at n·v̂ = 0.
//!
//! The drag D of a body is the sum of two parts over its plates (or patches).
//!
//! First, the plate's force F falls to zero with the speed. Its slope along v, taken as the secant from rest, is c =
//! −F·v/v². This part of the drag acts against changes of v in all directions.
//!
//! Second, the share s(n·v̂) of the plate that leads changes with the direction of motion. So the force along n changes
//! by e = −F·n s'/(s √(v² + v0²)) for each unit of n·v.
//!
//! Both parts together would count a change along v twice. So the second part has no effect along v
//! ([`Total::add_slope`]): D = Σ Jᵀ(c I + e (q qᵀ − κ² v̂v̂ᵀ))J. D is symmetric and positive semidefinite, and along
//! the motion ξ it equals the secant: ξᵀDξ = −ξᵀf. Near rest v̂ = v/√(v² + v0²) is 0 and so q = n: there a change of v
//! increases the force through both parts.

use super::part::BodyPlate;
use crate::number::{Real, Vec3};
use crate::sand::mechanism_laws::SlidingFace;
use crate::sand::{Contact, SandBed, SegmentState};
use crate::sim::blocks::LinkFrame;
use crate::sim::spatial::Twist;
use crate::sim::tree::sand::Total;
use crate::sim::tree::terrain::Local;

/// A normal's z below this counts as 0, so that rounding does not decide which side of a vertical plate is the lower
/// side. The value is that of `sandgait intrude`.
const UPRIGHT: f64 = 1e-12;

/// The data that all plates of a body share.
struct PlateScene<'a, R> {
    bed: &'a SandBed<R>,
    frame: &'a LinkFrame<R>,
    velocity: &'a Twist<R>,
    place: &'a Vec3<R>,
    travel: [R; 2],
    under: &'a Local<R>,
    gate: R,
}

/// Force and drag on a plate whose centre is `at` from the body's common point, with its normal and velocity in the
/// world's axes. `edge` is the e of the module's text.
struct PlateForce<R> {
    force: Vec3<R>,
    drag: R,
    edge: R,
    at: Vec3<R>,
    normal: Vec3<R>,
    v: Vec3<R>,
}

/// The same as [`crate::sim::tree::sand::on_body`], with `dt` = 1 s: the masses in the result are the drags [N·s/m].
#[inline(always)]
#[allow(clippy::too_many_arguments)] // all arguments stay in registers
pub fn on_plates<R: Real>(
    bed: &SandBed<R>,
    pieces: &[BodyPlate],
    frame: &LinkFrame<R>,
    velocity: &Twist<R>,
    place: &Vec3<R>,
    travel: [R; 2],
    under: &Local<R>,
    gate: f64,
) -> Option<Total<R>> {
    let setting = PlateScene { bed, frame, velocity, place, travel, under, gate: R::splat(gate) };
    let mut total = Total::none();
    let mut wet = false;
    for piece in pieces {
        let Some(pushed) = setting.on(piece) else { continue };
        wet = true;
        let PlateForce { force, drag, edge, at, normal, v } = pushed;
        total.wrench.force += force;
        total.wrench.moment += at.cross(force);
        let first = at * drag;
        total.drag.mass += drag;
        total.drag.first += first;
        total.drag.second.add_product(at, first);
        if R::any(R::zero().lt(edge)) {
            total.add_slope(at, normal, v * bed.inverse_speed(v), edge, drag);
        }
    }
    wet.then_some(total)
}

impl<R: Real> PlateScene<'_, R> {
    #[inline(always)]
    fn on(&self, piece: &BodyPlate) -> Option<PlateForce<R>> {
        let (zero, one, half) = (R::zero(), R::one(), R::splat(0.5));
        let (plate, under) = (&piece.plate, self.under);
        let turned = |v: Vec3<f64>| self.frame.rotation.apply(Vec3::splat(v.lane(0)));
        let at = self.frame.origin + turned(plate.center);
        let sides = plate.half.map(turned);
        let depth = under.depth(*self.place + at);
        let rise = under.normal.dot(sides[0]).abs() + under.normal.dot(sides[1]).abs();
        let low = depth + rise;
        if !R::any(zero.lt(low)) {
            return None;
        }
        // Mean depth of the part of the plate in the sand, and this part's share of the plate; 1e-30 prevents 0 / 0.
        let low = low.max(zero);
        let covered = depth.lt(rise);
        let mean = R::select(covered, low * half, depth);
        let wet = R::select(covered, low / (rise + rise).max(R::splat(1e-30)), one);

        let v = self.velocity.at(at);
        let mut normal = turned(plate.normal);
        normal.z = R::select(normal.z.abs().lt(R::splat(UPRIGHT)), zero, normal.z);
        let area = R::splat(plate.area) * wet;
        let site = SegmentState::fresh(mean, self.place.x + at.x).travelling(self.travel);
        if piece.thin {
            let (force, drag) = self.law(&site, area, normal, v, v);
            return Some(PlateForce { force, drag, edge: zero, at, normal, v });
        }
        let along = normal.dot(v);
        let uneven = (0..2).fold(zero, |sum, k| {
            let turning = normal.dot(self.velocity.angular.cross(sides[k]));
            sum + sides[k].dot(v).mul_add(R::splat(plate.bend[k]), turning).abs()
        });
        // The leading share of the plate rises from 0 at n·v = −`before` to 1 at n·v = `after`. With `sliding_face` it
        // rises later by the mechanism's range.
        let sliding = self.bed.sliding();
        let gate = sliding.map_or(self.gate, |face| face.range(self.gate));
        let range = gate / self.bed.inverse_speed(v);
        let bent = plate.bend != [0.0; 2] && sliding.is_none();
        let before = if bent { uneven.max(range * half) } else { uneven };
        let after = if bent { before } else { uneven + range };
        let growth = one / (before + after);
        let leads = ((along + before) * growth).clamp(zero, one);
        let resting = self.resting(mean * area, normal, v, uneven);
        if !R::any(zero.lt(leads)) {
            return resting.map(|Contact { force, drag, edge }| PlateForce {
                force,
                drag,
                edge: edge.max(zero),
                at,
                normal,
                v,
            });
        }
        // If only a part of the plate leads, n·v ranges from 0 to `along + uneven` in this part, so its mean is half of
        // `along + uneven`.
        let toward = along.max((along + uneven) * half).max(zero);
        let (full, drag) = self.law(&site, area, normal, normal.scale_add(toward - along, v), v);
        let rising = (-full.dot(normal)).max(zero) * growth;
        let edge = R::select(zero.lt(leads), R::select(leads.lt(one), rising, zero), zero);
        let mut pushed = PlateForce { force: full * leads, drag: drag * leads, edge, at, normal, v };
        if let Some(resting) = resting {
            pushed.force += resting.force;
            pushed.drag += resting.drag;
            pushed.edge = (edge + resting.edge).max(zero);
        }
        Some(pushed)
    }

    /// The force of sand at rest on a plate with `load` = area times depth [m³] that slides along itself; None unless
    /// `sliding_face` is on and acts.
    #[inline(always)]
    fn resting(&self, load: R, normal: Vec3<R>, v: Vec3<R>, uneven: R) -> Option<Contact<R>> {
        let face = self.bed.sliding()?;
        let inverse_speed = self.bed.inverse_speed(v);
        let at = face.resting(normal.dot(v) * inverse_speed, uneven * inverse_speed);
        let load = load * SlidingFace::pressure(normal.dot(self.under.normal));
        let share = load * at.share;
        R::any(R::zero().lt(share)).then(|| self.bed.resting(face, normal * share, share, load * at.slope, v))
    }

    /// The law's force on a plate that moves with `v`, in the world's axes, and its drag −f·u/u² against the plate's
    /// own velocity u = `own`.
    #[inline(always)]
    fn law(&self, site: &SegmentState<R>, area: R, normal: Vec3<R>, v: Vec3<R>, own: Vec3<R>) -> (Vec3<R>, R) {
        let force = match self.under.axes() {
            None => self.bed.thin_plate(site, area, normal, v).force,
            Some(axes) => {
                let [normal, v] = [normal, v].map(|u| axes.apply_transposed(u));
                axes.apply(self.bed.thin_plate(site, area, normal, v).force)
            }
        };
        let drag = (-force.dot(own)).max(R::zero()) * self.bed.motion(own).inverse_square;
        (force, drag)
    }
}
