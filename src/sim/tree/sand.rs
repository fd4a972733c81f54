//! Sand on plates that face any direction, fixed to the bodies of a tree.
//!
//! Plates are one-sided with the leading-edge rule. The scheme in time is that of [`crate::lanes`]: the force is
//! linearly implicit, f⁺ = f − C (v⁺ − v), and in smooth motion the velocities are expected to change as in the last
//! step. The law is evaluated once a patch ([`super::patches`]), for those of its plates that lead in the sand.

use super::dynamics::{LinkFrame, LinkLoad};
use super::patches::{BodyPatches, Facet, Panel, Patch, Tile};
use super::terrain::{Local, Surface};
use crate::number::{Mat3, Real, Vec3};
use crate::sand::intruder::IntruderPlate;
use crate::sand::law::{Normals, StressLaw};
use crate::sand::{LawCoefficients, Plain, SandBed, SegmentState, StressModel};
use crate::spatial::{Inertia, PointMasses, Twist, Wrench};
use crate::used::{LanePiece, Surfaces};
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
            least.min(trust(frame, place))
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
        // f + C w Δv, with the drags as masses dt C.
        let held = drag.apply(&expected.scaled(-(R::one() / dt)));
        bias.add(&held);
        load.inertia.add(&drag);
        load.bias = bias;
    }
}

/// A piece of a body's surface that moves sand: plates that are close together and face alike, taken together.
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

/// Lists the pieces of all bodies that may move sand, for [`crate::used`].
#[inline(always)]
pub fn pieces<R: Real>(
    feelers: &[Feeler],
    bodies: &[BodyPatches],
    frames: &[LinkFrame<R>],
    from: Vec3<R>,
    tops: R,
    pieces: &mut Vec<LanePiece<R>>,
) {
    pieces.clear();
    let mut all = feelers;
    for plates in bodies {
        let skipped = all.iter().take_while(|feeler| feeler.body < plates.body).count();
        let own = all[skipped..].iter().take_while(|feeler| feeler.body == plates.body).count();
        let (own, rest) = all[skipped..].split_at(own);
        all = rest;
        let frame = &frames[plates.body];
        let center = from + frame.point(Vec3::splat(plates.ball.center));
        if R::any((center.z - R::splat(plates.ball.reach)).lt(tops)) {
            own.iter().for_each(|feeler| feeler.place(frame, from, pieces));
        }
    }
}

impl Feeler {
    #[inline(always)]
    fn place<R: Real>(&self, frame: &LinkFrame<R>, from: Vec3<R>, pieces: &mut Vec<LanePiece<R>>) {
        let feeler = self;
        let at = frame.point(Vec3::splat(feeler.center));
        pieces.push(LanePiece {
            body: feeler.body,
            place: from + at,
            normal: frame.rotation.apply(Vec3::splat(feeler.normal)),
            velocity: frame.velocity.at(at),
            area: R::splat(feeler.area),
            one_sided: true,
            cells: 1,
        });
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

/// Weight w at `place`: near 1 in smooth motion, in which the next change of velocity is about the last one, and 0 if
/// the place sticks; see [`crate::lanes`].
#[inline(always)]
fn trust<R: Real>(frame: &LinkFrame<R>, place: Vec3<R>) -> R {
    let (speed, change) = (frame.velocity.at(place).norm_squared(), frame.change.at(place).norm_squared());
    let share = speed / change.mul_add(R::splat(4.0), speed + R::splat(1e-30));
    share * share
}

/// The sand's effect on one body at rest or in motion with `velocity`, about the base's origin at `place`; None if no
/// plate is in the sand. `travel`: horizontal velocity of the robot. With `SECANT` the slopes of
/// leading edges add nothing to the drag along the motion ([`Total::add_slope`]); those of engine `tree` do.
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
    match (&ground.law, &ground.mechanisms) {
        (LawCoefficients::Li2013(law), None) => {
            by::<R, _, SECANT>(law, &Plain, ground, plates, frame, velocity, place, travel, under, strength, dt)
        }
        (law, None) => {
            by::<R, _, SECANT>(law, &Plain, ground, plates, frame, velocity, place, travel, under, strength, dt)
        }
        (law, Some(mechanisms)) => {
            by::<R, _, SECANT>(law, mechanisms, ground, plates, frame, velocity, place, travel, under, strength, dt)
        }
    }
}

/// A body's velocity, and the surface, in the body's frame.
struct Own<R> {
    linear: Vec3<R>,
    angular: Vec3<R>,
    up: Vec3<R>,
    /// Height of the body's origin above the surface [m].
    height: R,
}

impl BodyPatches {
    /// Horizontal extent of the box around the plates, across the velocity of the box's centre [m]. If the body moves
    /// up or down, this is the extent along its own y: legs swing in their x-z plane.
    #[inline(always)]
    fn width<R: Real>(&self, own: &Own<R>) -> R {
        let middle = Vec3::splat(self.ball.center);
        let speed = own.linear + own.angular.cross(middle);
        let y = Vec3::splat([0.0, 1.0, 0.0]);
        let level = y - own.up * own.up.y;
        let still = speed.norm_squared().mul_add(R::splat(1e-6), R::splat(1e-12)).sqrt();
        let across = level.scale_add(still, own.up.cross(speed));
        let length = across.norm_squared().max(R::splat(1e-20)).sqrt();
        let [low, high] = [self.corners[0], self.corners[7]];
        let extent = |k: usize, along: R| along.abs() * R::splat(high[k] - low[k]);
        (extent(0, across.x) + extent(1, across.y) + extent(2, across.z)) / length
    }
}

/// The leading part of a patch in the sand, as sums over its plates.
struct Leading<R> {
    /// [m²]
    area: R,
    /// ∫ depth dA [m³], and the same times depth, normal, its products (xx, yy, zz; yz, xz, xy) and place.
    load: R,
    deep: R,
    normal: Vec3<R>,
    squares: Vec3<R>,
    products: Vec3<R>,
    place: Vec3<R>,
    /// Derivative of `load` by n·v̂ [m³].
    growth: R,
}

/// The hottest loop in simulations of robots on sand.
#[inline(always)]
fn leading<R: Real, M: StressModel<R>>(patch: &Patch, own: &Own<R>, inverse_speed: R) -> Leading<R> {
    let (zero, one) = (R::zero(), R::one());
    let own = Own { linear: own.linear * inverse_speed, angular: own.angular * inverse_speed, ..*own };
    let mut sum = Leading::none();
    for facet in &patch.facets {
        let normal: Vec3<R> = lanes(&facet.normal);
        let growth: R = lane(facet.growth);
        let share = facet.along(&own).mul_add(growth, lane(facet.begun));
        let depth = -(own.up.dot(lanes(&facet.center)) + own.height);
        // √(1 − x²) with an error below 0.05.
        let x = normal.dot(own.up);
        let flat = x * x;
        let rise = lane::<R>(facet.rise) * (one - flat) * flat.mul_add(R::splat(0.6), one);
        let (low, high) = (depth + rise, depth - rise);
        let part = share.clamp(zero, one) * lane::<R>(facet.area);
        let half = part * R::splat(0.5);
        let (lower, upper) = (low.max(zero), high.max(zero));
        if !M::BY_LOAD {
            sum.deep = half.mul_add(lower.mul_add(lower, upper * upper), sum.deep);
            sum.area += R::select(zero.lt(low), half, zero) + R::select(zero.lt(high), half, zero);
        }
        sum.add(facet, normal, half * (lower + upper));
        sum.grow(share, lane(facet.edge), depth);
    }
    for panel in &patch.panels {
        panel.press::<R, M>(&own, &mut sum);
    }
    for tile in &patch.tiles {
        tile.press::<R, M>(&own, &mut sum);
    }
    // Normals are unit vectors, also for bent plates.
    sum.squares.z = sum.load - sum.squares.x - sum.squares.y;
    sum
}

impl Facet {
    /// n·v̂ of its centre.
    #[inline(always)]
    fn along<R: Real>(&self, own: &Own<R>) -> R {
        lanes::<R>(&self.normal).dot(own.linear) + lanes::<R>(&self.moment).dot(own.angular)
    }
}

impl Tile {
    /// Adds its leading part in the sand, with the distribution of depths of [`Panel::press`].
    #[inline(always)]
    fn press<R: Real, M: StressModel<R>>(&self, own: &Own<R>, sum: &mut Leading<R>) {
        let (zero, one, facet) = (R::zero(), R::one(), &self.facet);
        let slopes = [0, 1].map(|k| lanes::<R>(&self.half[k]).dot(own.up));
        // n·v̂ differs by at most ± `spread` from that of the centre, because the body turns.
        let turning = own.angular.cross(lanes(&facet.normal));
        let [a, b] = [0, 1].map(|k| lanes::<R>(&self.half[k]).dot(turning).abs());
        let spread = a + b;
        let growth =
            one / spread.mul_add(R::splat(2.0), R::splat(crate::sand::Regularization::SOLID.leading_edge_gate));
        let share = (facet.along(own) + spread) * growth;
        let rise = slopes[0].mul_add(slopes[0], slopes[1].mul_add(slopes[1], R::splat(1e-20))).sqrt();
        let depth = -(own.up.dot(lanes(&facet.center)) + own.height);
        let low = (depth + rise).max(zero);
        let wet = (R::splat(0.5) * low / rise).min(one);
        let range = rise * wet;
        let mean = low - range;
        let part = share.clamp(zero, one) * lane::<R>(facet.area) * wet;
        if !M::BY_LOAD {
            sum.area += part;
            sum.deep = part.mul_add(mean.mul_add(mean, range * range * R::splat(1.0 / 3.0)), sum.deep);
        }
        sum.add(facet, lanes(&facet.normal), part * mean);
        sum.grow(share, growth * lane(facet.area), depth);
    }
}

impl Panel {
    /// Adds its leading part in the sand. The depth of that part is taken as evenly distributed between its lowest and
    /// its highest point, which is exact if the depth changes in one direction only.
    #[inline(always)]
    fn press<R: Real, M: StressModel<R>>(&self, own: &Own<R>, sum: &mut Leading<R>) {
        let (zero, one, facet) = (R::zero(), R::one(), &self.facet);
        let sides: [Vec3<R>; 2] = [0, 1].map(|k| lanes(&self.half[k]));
        let [bent, straight] = sides.map(|side| side.dot(own.up));
        let turn: Vec3<R> = lanes(&self.turn);
        // n·v̂ changes by ± `spread` towards the edges of the bent side. Lengths ending in `_s` are multiplied by it, so
        // that one division suffices.
        let turning = turn.dot(own.linear);
        let spread = turning.abs().max(R::splat(crate::sand::Regularization::SOLID.leading_edge_gate / 2.0));
        let (half, third) = (R::splat(0.5), R::splat(1.0 / 3.0));
        let leads_s = (half * (facet.along(own) + spread)).clamp(zero, spread);
        // The plate leads with the part that is turned towards the velocity: its middle and its share of the length.
        let ahead_s = R::select(turning.lt(zero), leads_s - spread, spread - leads_s);
        let rise_s = leads_s * bent;
        let flat = spread * spread * straight.mul_add(straight, R::splat(1e-20));
        let rise_s = rise_s.mul_add(rise_s, flat).sqrt();
        let depth = -(own.up.dot(lanes(&facet.center)) + own.height);
        let low_s = depth.mul_add(spread, rise_s - ahead_s * bent).max(zero);
        let inverse = one / (spread * rise_s);
        let (per_spread, per_rise_s) = (inverse * rise_s, inverse * spread);
        // The part in the sand: its share, half the range of its depths, and their mean.
        let wet = (half * low_s * per_rise_s).min(one);
        let range_s = rise_s * wet;
        let mean_s = low_s - range_s;
        let leads = leads_s * per_spread;
        let (mean, ahead) = (mean_s * per_spread, ahead_s * per_spread);
        let part = leads * lane::<R>(facet.area) * wet;
        let load = part * mean;
        if !M::BY_LOAD {
            let range = range_s * per_spread;
            sum.area += part;
            sum.deep = part.mul_add(mean.mul_add(mean, range * range * third), sum.deep);
        }
        sum.add(facet, turn.scale_add(ahead, lanes(&facet.normal)), load);
        // The load lies below the middle of the part.
        let below = part * (mean_s * per_rise_s).mul_add(wet - one, -(wet * wet * third));
        sum.place = sides[1].scale_add(below * straight, sum.place);
        sum.place = sides[0].scale_add(load.mul_add(ahead, below * leads * leads * bent), sum.place);
        let edge = half * per_spread * lane(facet.area);
        sum.grow(leads, edge, ahead.mul_add(-bent, depth));
    }
}

impl<R: Real> Leading<R> {
    #[inline(always)]
    fn none() -> Self {
        let (zero, none) = (R::zero(), Vec3::zero());
        Self {
            area: zero,
            load: zero,
            deep: zero,
            normal: none,
            squares: none,
            products: none,
            place: none,
            growth: zero,
        }
    }

    /// Adds a plate with this mean normal and load [m³].
    #[inline(always)]
    fn add(&mut self, facet: &Facet, normal: Vec3<R>, load: R) {
        self.load += load;
        self.normal = normal.scale_add(load, self.normal);
        self.squares.x = load.mul_add(lane(facet.squares[0]), self.squares.x);
        self.squares.y = load.mul_add(lane(facet.squares[1]), self.squares.y);
        self.products = lanes(&facet.products).scale_add(load, self.products);
        self.place = lanes(&facet.center).scale_add(load, self.place);
    }

    /// Adds the derivative by n·v̂ of the load of a plate at `depth`, of which the share `leads` leads. `edge` is its
    /// area times the derivative of that share.
    #[inline(always)]
    fn grow(&mut self, leads: R, edge: R, depth: R) {
        let (zero, one) = (R::zero(), R::one());
        let inside = R::select(leads.lt(one), edge * depth.max(zero), zero);
        self.growth += R::select(zero.lt(leads), inside, zero);
    }
}

#[inline(always)]
#[allow(clippy::too_many_arguments)] // all arguments stay in registers
fn by<R: Real, M: StressModel<R>, const SECANT: bool>(
    law: &impl StressLaw<R>,
    stress_model: &M,
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
    let (zero, tiny) = (R::zero(), R::splat(1e-20));
    let (mut total, mut wet) = (Total::none(), false);
    // Rows of the surface's own axes in the world: z along its normal, x along the world's x.
    let axes = under.axes();
    let turn = axes.as_ref().map_or(frame.rotation, |axes| axes.transposed().compose(&frame.rotation));
    let own = Own {
        linear: frame.rotation.apply_transposed(velocity.at(frame.origin)),
        angular: frame.rotation.apply_transposed(velocity.angular),
        up: frame.rotation.apply_transposed(under.normal),
        height: under.normal.dot(*place + frame.origin - under.point),
    };
    let width = if M::BY_LOAD { zero } else { plates.width(&own) };
    for patch in &plates.patches {
        let center = Vec3::splat(patch.ball.center);
        let depth = -(own.up.dot(center) + own.height);
        if !R::any(zero.lt(depth + R::splat(patch.ball.reach))) {
            continue;
        }
        let speed = own.linear + own.angular.cross(center);
        let part = leading::<R, M>(patch, &own, ground.inverse_speed(speed));
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
        let (contact, normal) = match &axes {
            None => (ground.leading_part_by(law, stress_model, &site, area, loaded, &normals, v, growth), normals.unit),
            Some(axes) => {
                let v = axes.apply_transposed(v);
                let mut contact = ground.leading_part_by(law, stress_model, &site, area, loaded, &normals, v, growth);
                contact.force = axes.apply(contact.force);
                (contact, axes.apply(normals.unit))
            }
        };
        wet = true;
        total.wrench.force += contact.force;
        total.wrench.moment += at.cross(contact.force);
        let mass = contact.drag * dt;
        let first = at * mass;
        total.drag.mass += mass;
        total.drag.first += first;
        total.drag.second.add_product(at, first);
        if R::any(zero.lt(contact.edge)) {
            let edge = contact.edge * dt;
            if SECANT {
                total.add_slope(at, normal, v * ground.inverse_speed(v), edge, mass);
            } else {
                total.edge.add_outer(edge, &Wrench { moment: at.cross(normal), force: normal });
            }
        }
    }
    wet.then_some(total)
}

/// `x` in all lanes.
#[inline(always)]
fn lane<R: Real>(x: f32) -> R {
    R::splat(f64::from(x))
}

#[inline(always)]
fn lanes<R: Real>(v: &[f32; 3]) -> Vec3<R> {
    Vec3::new(lane(v[0]), lane(v[1]), lane(v[2]))
}

impl<R: Real> Total<R> {
    #[inline(always)]
    pub fn none() -> Self {
        Self { wrench: Wrench::zero(), drag: PointMasses::zero(), edge: Inertia::points(&PointMasses::zero()) }
    }

    /// Adds the slope e of the force along n by n·v, at a plate with the drag c that moves along v̂:
    /// e (q qᵀ − κ² v̂v̂ᵀ) with q = n − (n·v̂ − κ) v̂. A change along v does not turn v̂ and moves no leading edge, so
    /// the part along v̂ is taken out. κ is n·v̂, and then q is n, but |κ| ≤ √(c/e), so that c I and this are together
    /// positive semidefinite.
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
    /// Columns x, y, z of the surface's axes, z its normal; None where it is level in all lanes.
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
