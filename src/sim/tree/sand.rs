//! Sand on plates that face any direction, fixed to the bodies of a tree.
//!
//! Plates are one-sided with the leading-edge rule. The time step works as in [`crate::lanes`]: the force is linearly
//! implicit, f⁺ = f − C (v⁺ − v), and in smooth motion the velocities are expected to change as in the last step. The
//! law is evaluated once for each patch ([`super::patches`]), for those of its plates that lead in the sand.

use super::dynamics::LinkLoad;
use super::leading::{Own, Resting, leading};
use super::patches::{BodyPatches, Patch};
use super::terrain::{Local, Surface};
use crate::blocks::{LaneState, LinkFrame};
use crate::number::{Kernel, Mat3, Real, Spread, Vec3};
use crate::sand::intruder::IntruderPlate;
use crate::sand::law::{Normals, StressLaw};
use crate::sand::mechanism_laws::SlidingFace;
use crate::sand::{Contact, LawCoefficients, Plain, SandBed, SegmentState, StressModel};
use crate::spatial::{Inertia, PointMasses, Twist, Wrench};
use crate::used::{LaneMemory, LanePiece, Surfaces};
use std::collections::BTreeMap;

/// The sand's effect on a body: forces about the base's origin, and its drag as masses. `edge`: how the force changes
/// because leading edges move.
pub struct Total<R> {
    pub wrench: Wrench<R>,
    pub drag: PointMasses<R>,
    pub edge: Inertia<R>,
}

/// Adds the sand's forces on all bodies to their loads; `place` is the position of the base's origin.
#[inline(always)]
#[allow(clippy::too_many_arguments)] // all arguments stay in registers
pub fn press<R: Real>(
    ground: &SandBed<R>,
    bodies: &[BodyPatches],
    frames: &[LinkFrame<R>],
    place: &Vec3<R>,
    surface: &impl Surface<R>,
    found: Option<&Surfaces<R>>,
    loads: &mut [LinkLoad<R>],
    dt: R,
) {
    // Velocity of the base, which is the first frame.
    let base = frames[0].velocity.at(frames[0].origin);
    let travel = [base.x, base.y];
    for plates in bodies {
        let frame = &frames[plates.body];
        let center = *place + frame.point(Vec3::splat(plates.ball.center));
        let mut under = under_body(plates, frame, place, surface);
        if let Some(found) = found {
            under.point.z = found.levels[plates.body];
        }
        let strength = found.map(|found| found.strengths[plates.body]);
        if !R::any(R::zero().lt(under.depth(center) + R::splat(plates.ball.reach))) {
            continue;
        }
        let trusted = plates.corners.iter().fold(R::one(), |least, c| {
            let place = frame.point(Vec3::splat(*c));
            least.min(frame.trust(place))
        });
        let expected = frame.change.scaled(trusted);
        let middle = expected.scale_add(R::splat(0.5), &frame.velocity);
        let Some(total) = on_body::<R, false>(ground, plates, frame, &middle, place, travel, &under, strength, dt)
        else {
            continue;
        };
        let load = &mut loads[plates.body];
        let drag = total.inertia();
        let mut bias = total.wrench.scale_add(-R::one(), &load.bias);
        // The bias becomes −(f + C w Δv): `expected` is w Δv, and `drag` is dt C.
        let held = drag.apply(&expected.scaled(-(R::one() / dt)));
        bias.add(&held);
        load.inertia.add(&drag);
        load.bias = bias;
    }
}

/// A piece of a body's surface that moves sand. It stands for plates that are close together and face about the same way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Feeler {
    pub body: usize,
    center: [f64; 3],
    normal: [f64; 3],
    area: f64,
}

impl Feeler {
    /// The plates of all bodies, gathered in cubes with sides of `size` [m] and by the axis that they face.
    pub fn all(plates: &[Vec<IntruderPlate>], size: f64) -> Vec<Self> {
        let mut all = Vec::new();
        for (body, plates) in plates.iter().enumerate() {
            let mut gathered: BTreeMap<[i32; 4], (f64, Vec3<f64>, Vec3<f64>)> = BTreeMap::new();
            for p in plates {
                let (at, n) = (p.center.lane(0), p.normal.lane(0));
                let axis = (0..3).fold(0, |a, k| if n[k].abs() > n[a].abs() { k } else { a });
                let [x, y, z] = at.map(|c| (c / size).floor() as i32);
                let face = 2 * axis as i32 + i32::from(n[axis] > 0.0);
                let sum = gathered.entry([x, y, z, face]).or_insert((0.0, Vec3::zero(), Vec3::zero()));
                *sum = (sum.0 + p.area, sum.1 + p.center * p.area, sum.2 + p.normal * p.area);
            }
            all.extend(gathered.into_values().map(|(area, center, normal)| {
                let length = normal.norm_squared().sqrt();
                let (center, normal) = (center * (1.0 / area), normal * (1.0 / length));
                Self { body, center: center.lane(0), normal: normal.lane(0), area: length }
            }));
        }
        all
    }
}

/// Moves sand by the bodies near it.
#[inline(always)]
pub fn move_sand<R: Real>(
    feelers: &[Feeler],
    bodies: &[BodyPatches],
    frames: &[LinkFrame<R>],
    state: &LaneState<R>,
    memory: &mut LaneMemory<R>,
) {
    let (from, tops) = (state.position, memory.surfaces.tops);
    let mut turn = memory.turn(&state.origins, from);
    let mut all = feelers;
    for plates in bodies {
        let skipped = all.iter().take_while(|feeler| feeler.body < plates.body).count();
        let own = all[skipped..].iter().take_while(|feeler| feeler.body == plates.body).count();
        let (own, rest) = all[skipped..].split_at(own);
        all = rest;
        let frame = &frames[plates.body];
        let center = from + frame.point(Vec3::splat(plates.ball.center));
        if own.is_empty() || !R::any((center.z - R::splat(plates.ball.reach)).lt(tops)) {
            continue;
        }
        let mut low = R::splat(f64::INFINITY);
        for feeler in own {
            low = low.min(feeler.place(frame, from).z);
        }
        turn.begin(plates.body, low);
        for (number, feeler) in (0..).zip(own) {
            let place = feeler.place(frame, from);
            if turn.reaches(place.z) {
                turn.list(&feeler.piece(number, frame, place));
            }
        }
        turn.move_sand();
    }
    turn.end();
}

impl Feeler {
    #[inline(always)]
    fn place<R: Real>(&self, frame: &LinkFrame<R>, from: Vec3<R>) -> Vec3<R> {
        from + frame.point(Vec3::splat(self.center))
    }

    #[inline(always)]
    fn piece<R: Real>(&self, number: u16, frame: &LinkFrame<R>, place: Vec3<R>) -> LanePiece<R> {
        LanePiece {
            place,
            normal: frame.rotation.apply(Vec3::splat(self.normal)),
            velocity: frame.velocity.at(frame.point(Vec3::splat(self.center))),
            area: R::splat(self.area),
            one_sided: true,
            cells: 1,
            number,
        }
    }
}

/// The surface under a body. If the surface is not flat, this is its tangent plane under the body's lowest corner,
/// which enters the sand first.
#[inline(always)]
pub fn under_body<R: Real>(
    plates: &BodyPatches,
    frame: &LinkFrame<R>,
    place: &Vec3<R>,
    surface: &impl Surface<R>,
) -> Local<R> {
    if surface.is_flat() {
        return surface.under(*place);
    }
    let corner = |c: &[f64; 3]| frame.point(Vec3::splat(*c));
    let mut low = corner(&plates.corners[0]);
    for c in &plates.corners[1..] {
        let other = corner(c);
        let lower = other.z.lt(low.z);
        let least = |a, b| R::select(lower, a, b);
        low = Vec3::new(least(other.x, low.x), least(other.y, low.y), least(other.z, low.z));
    }
    surface.under(*place + low)
}

/// The sand's effect on one body at rest or in motion with `velocity`, about the base's origin at `place`; None if no
/// plate is in the sand. `travel`: horizontal velocity of the robot. With `SECANT` the slopes of leading edges add
/// nothing to the drag along the motion ([`Total::add_slope`]). Without it, as in engine `tree`, they do.
#[inline(always)]
#[allow(clippy::too_many_arguments)] // all arguments stay in registers
pub fn on_body<R: Real, const SECANT: bool>(
    ground: &SandBed<R>,
    plates: &BodyPatches,
    frame: &LinkFrame<R>,
    velocity: &Twist<R>,
    place: &Vec3<R>,
    travel: [R; 2],
    under: &Local<R>,
    strength: Option<R>,
    dt: R,
) -> Option<Total<R>> {
    let mut total = None;
    let kernel =
        OnBody::<R, SECANT> { ground, plates, frame, velocity, place, travel, under, strength, dt, total: &mut total };
    R::dispatch(kernel);
    total
}

/// A call of [`on_body`], the same for steps, pictures and studies.
struct OnBody<'a, R, const SECANT: bool> {
    ground: &'a SandBed<R>,
    plates: &'a BodyPatches,
    frame: &'a LinkFrame<R>,
    velocity: &'a Twist<R>,
    place: &'a Vec3<R>,
    travel: [R; 2],
    under: &'a Local<R>,
    strength: Option<R>,
    dt: R,
    total: &'a mut Option<Total<R>>,
}

impl<R: Real, const SECANT: bool> Kernel for OnBody<'_, R, SECANT> {
    #[inline(always)]
    fn run(self) {
        let Self { ground, plates, frame, velocity, place, travel, under, strength, dt, total } = self;
        let all = (plates, &plates.patches[..]);
        *total = on_patches::<R, _, _, SECANT>(ground, all, frame, velocity, place, travel, under, strength, dt);
    }
}

/// The same as [`on_body`] for a body's patches. Either all lanes share each patch, or each lane has a patch of its
/// own; then the force on the body is the sum over lanes.
#[inline(always)]
#[allow(clippy::too_many_arguments)] // all arguments stay in registers
pub fn on_patches<R: Real, S: Spread<R>, D: Spread<R>, const SECANT: bool>(
    ground: &SandBed<R>,
    plates: (&BodyPatches, &[Patch<S, D>]),
    frame: &LinkFrame<R>,
    velocity: &Twist<R>,
    place: &Vec3<R>,
    travel: [R; 2],
    under: &Local<R>,
    strength: Option<R>,
    dt: R,
) -> Option<Total<R>> {
    match (&ground.law, &ground.mechanisms) {
        (LawCoefficients::Li2013(law), None) => {
            by::<R, S, D, _, SECANT>(law, &Plain, ground, plates, frame, velocity, place, travel, under, strength, dt)
        }
        (law, None) => {
            by::<R, S, D, _, SECANT>(law, &Plain, ground, plates, frame, velocity, place, travel, under, strength, dt)
        }
        (law, Some(mechanisms)) => by::<R, S, D, _, SECANT>(
            law, mechanisms, ground, plates, frame, velocity, place, travel, under, strength, dt,
        ),
    }
}

#[inline(always)]
#[allow(clippy::too_many_arguments)] // all arguments stay in registers
fn by<R: Real, S: Spread<R>, D: Spread<R>, M: StressModel<R>, const SECANT: bool>(
    law: &impl StressLaw<R>,
    stress_model: &M,
    ground: &SandBed<R>,
    (plates, patches): (&BodyPatches, &[Patch<S, D>]),
    frame: &LinkFrame<R>,
    velocity: &Twist<R>,
    place: &Vec3<R>,
    travel: [R; 2],
    under: &Local<R>,
    strength: Option<R>,
    dt: R,
) -> Option<Total<R>> {
    let (zero, tiny) = (R::zero(), R::splat(1e-20));
    let (mut total, mut wet) = (Total::none(), false);
    // The surface's own axes in the world, as columns: z along its normal, x without a part along the world's y.
    let axes = under.axes();
    let turn = axes.as_ref().map_or(frame.rotation, |axes| axes.transposed().compose(&frame.rotation));
    let own = Own {
        linear: frame.rotation.apply_transposed(velocity.at(frame.origin)),
        angular: frame.rotation.apply_transposed(velocity.angular),
        up: frame.rotation.apply_transposed(under.normal),
        height: under.normal.dot(*place + frame.origin - under.point),
    };
    let width = if M::BY_LOAD { zero } else { plates.width(&own) };
    for patch in patches {
        let [x, y, z] = &patch.ball.center;
        let center = Vec3::new(x.spread(), y.spread(), z.spread());
        let depth = -(own.up.dot(center) + own.height);
        if !R::any(zero.lt(depth + patch.ball.reach.spread())) {
            continue;
        }
        let speed = own.linear + own.angular.cross(center);
        let sliding = stress_model.sliding();
        let part = leading::<R, M, S, D>(patch, &own, ground.inverse_speed(speed), sliding);
        if let Some(face) = sliding.filter(|_| R::any(zero.lt(part.resting.load))) {
            let rested = RestingPatch { ground, face, part: &part.resting, frame, velocity, turn: &turn, strength };
            wet = true;
            rested.add_to::<SECANT>(&mut total, axes.as_ref(), dt);
        }
        if !R::any(zero.lt(part.load)) {
            continue;
        }
        let inverse = R::one() / part.load.max(tiny);
        let at = frame.point(part.place * inverse);
        let normals = Normals::turned(part.normal * inverse, part.squares * inverse, part.products * inverse, &turn);
        let v = velocity.at(at);
        // Where only their product counts, the load takes the place of the depth, on 1 m².
        let (area, depth, loaded) = match M::BY_LOAD {
            true => (R::one(), part.load, part.load),
            false => (part.area, part.load / part.area.max(tiny), part.deep * inverse),
        };
        let area = strength.map_or(area, |strength| area * strength);
        let site = SegmentState::fresh(depth, place.x + at.x).travelling(travel).wide(width);
        let growth = part.growth * inverse;
        // The law is in the code once, for level and for tilted surfaces.
        let along = axes.as_ref().map_or(v, |axes| axes.apply_transposed(v));
        let mut contact = ground.leading_part_by(law, stress_model, &site, area, loaded, &normals, along, growth);
        let mut normal = normals.unit;
        if let Some(axes) = &axes {
            (contact.force, normal) = (axes.apply(contact.force), axes.apply(normal));
        }
        wet = true;
        total.add_contact::<SECANT>(&contact, at, normal, v * ground.inverse_speed(v), dt);
    }
    wet.then_some(total)
}

/// The sand at rest on the plates of a patch that slide along themselves ([`crate::sand::mechanism_laws::SlidingFace`]).
struct RestingPatch<'a, R> {
    ground: &'a SandBed<R>,
    face: &'a SlidingFace<R>,
    part: &'a Resting<R>,
    frame: &'a LinkFrame<R>,
    velocity: &'a Twist<R>,
    /// From the body's axes to the surface's.
    turn: &'a Mat3<R>,
    strength: Option<R>,
}

impl<R: Real> RestingPatch<'_, R> {
    /// Adds its force. The edge is only the part that resists: where the share falls with n·v̂, the law's rises more.
    #[inline(always)]
    fn add_to<const SECANT: bool>(&self, total: &mut Total<R>, axes: Option<&Mat3<R>>, dt: R) {
        let Self { ground, face, part, frame, velocity, turn, strength } = *self;
        let at = frame.point(part.place * (R::one() / part.load.max(R::splat(1e-20))));
        let v = velocity.at(at);
        let strength = strength.unwrap_or(R::one());
        let (load, slope) = (part.load * strength, part.slope * strength);
        let mut normal = turn.apply(part.normal * strength);
        if let Some(axes) = axes {
            normal = axes.apply(normal);
        }
        let mut contact = ground.resting(face, normal, load, slope, v);
        contact.edge = contact.edge.max(R::zero());
        let unit = normal * (R::one() / normal.norm_squared().max(R::splat(1e-30)).sqrt());
        total.add_contact::<SECANT>(&contact, at, unit, v * ground.inverse_speed(v), dt);
    }
}

impl<R: Real> Total<R> {
    /// Adds the force on a piece with this normal, and its drags; `unit` is v̂.
    #[inline(always)]
    fn add_contact<const SECANT: bool>(&mut self, contact: &Contact<R>, at: Vec3<R>, n: Vec3<R>, unit: Vec3<R>, dt: R) {
        self.wrench.force += contact.force;
        self.wrench.moment += at.cross(contact.force);
        let mass = contact.drag * dt;
        let first = at * mass;
        self.drag.mass += mass;
        self.drag.first += first;
        self.drag.second.add_product(at, first);
        if R::any(R::zero().lt(contact.edge)) {
            let edge = contact.edge * dt;
            if SECANT {
                self.add_slope(at, n, unit, edge, mass);
            } else {
                self.edge.add_outer(edge, &Wrench { moment: at.cross(n), force: n });
            }
        }
    }

    #[inline(always)]
    pub fn none() -> Self {
        Self { wrench: Wrench::zero(), drag: PointMasses::zero(), edge: Inertia::points(&PointMasses::zero()) }
    }

    /// Adds the slope e of the force along n by n·v, at a plate with the drag c that moves along v̂:
    /// e (q qᵀ − κ² v̂v̂ᵀ) with q = n − (n·v̂ − κ) v̂. A change along v does not turn v̂ and moves no leading edge, so
    /// the part along v̂ is taken out. κ is n·v̂, so that q is n, but at most √(c/e) in size, so that c I and this matrix
    /// together are positive semidefinite.
    #[inline(always)]
    pub fn add_slope(&mut self, at: Vec3<R>, n: Vec3<R>, unit: Vec3<R>, e: R, c: R) {
        let (along, most) = (n.dot(unit), (c / e.max(R::splat(1e-30))).sqrt());
        let kappa = along.max(-most).min(most);
        let q = n - unit * (along - kappa);
        self.edge.add_outer(e, &Wrench { moment: at.cross(q), force: q });
        self.edge.add_outer(-(e * kappa * kappa), &Wrench { moment: at.cross(unit), force: unit });
    }

    /// The drags of plates and of leading edges, with the `dt` of [`on_body`].
    #[inline(always)]
    pub fn inertia(&self) -> Inertia<R> {
        let mut drag = Inertia::points(&self.drag);
        drag.add(&self.edge);
        drag
    }
}

impl<R: Real> Local<R> {
    /// The surface's axes x, y, z as columns, z its normal; None where the surface is level in all lanes.
    #[inline(always)]
    pub fn axes(&self) -> Option<Mat3<R>> {
        let n = self.normal;
        if !R::any(R::zero().lt(n.x.abs() + n.y.abs())) {
            return None;
        }
        let length = R::one() / (n.x * n.x + n.z * n.z).sqrt();
        let x = Vec3::new(n.z * length, R::zero(), -(n.x * length));
        Some(Mat3::new(x, n.cross(x), n))
    }
}
