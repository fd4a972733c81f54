//! Sand on plates that face any way, fixed to the bodies of a tree.
//!
//! One-sided plates with the leading-edge rule, as under the belly of [`crate::lanes`], and its scheme in time: the force
//! is linearly implicit, f⁺ = f − C (v⁺ − v), and expects what the last step added where a motion is smooth. A plate that
//! crosses the surface counts with the part below it, at that part's mean depth.

use super::dynamics::{Frame, Load};
use super::floor::Surface;
use super::model::TreeModel;
use super::terrain::Local;
use crate::number::{Mat3, Real, Vec3};
use crate::sand::intruder::Plate;
use crate::sand::law::StressLaw;
use crate::sand::{Beyond, Form, Ground, Plain, Site};
use crate::spatial::{Inertia, PointMasses, Twist, Wrench};

/// A body's plates, the same in all lanes.
#[derive(Clone)]
pub struct BodyPlates<R> {
    pub body: usize,
    /// Neighbours together, so that most of those in the air are left out at once.
    bunches: Vec<Bunch>,
    /// A ball around all of them, in the body's frame [m].
    ball: Ball,
    /// Corners of a box around them, where the trust in an expected change is judged.
    corners: [[f64; 3]; 8],
    /// Share of the sand's stress that they find, one lane each.
    pub share: R,
}

/// Some plates.
#[derive(Clone)]
struct Bunch {
    plates: Vec<Plate>,
    ball: Ball,
}

/// A ball around plates [m].
#[derive(Clone, Copy)]
struct Ball {
    center: [f64; 3],
    reach: f64,
}

/// Plates in a bunch: our choice, the test for one costs about what two plates in the air do.
const BUNCH: usize = 12;

/// Ends of plates' centres along x, y and z.
fn ends(plates: &[Plate]) -> [[f64; 2]; 3] {
    [0, 1, 2].map(|k| {
        let along = plates.iter().map(|p| p.center.lane(0)[k]);
        along.fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], x| [a.min(x), b.max(x)])
    })
}

impl Ball {
    fn around(plates: &[Plate]) -> Self {
        let center = ends(plates).map(|[a, b]| (a + b) / 2.0);
        let length = |v: Vec3<f64>| v.norm_squared().sqrt();
        let away = |p: &Plate| length(p.center - Vec3::splat(center)) + length(p.half[0]) + length(p.half[1]);
        Self { center, reach: plates.iter().map(away).fold(0.0, f64::max) }
    }
}

/// Splits plates in halves along the longest side until they are few.
fn bunches(mut plates: Vec<Plate>, out: &mut Vec<Bunch>) {
    if plates.len() <= BUNCH {
        let ball = Ball::around(&plates);
        return out.push(Bunch { plates, ball });
    }
    let sides = ends(&plates).map(|[a, b]| b - a);
    let k = (1..3).fold(0, |k, i| if sides[i] > sides[k] { i } else { k });
    plates.sort_by(|a, b| a.center.lane(0)[k].total_cmp(&b.center.lane(0)[k]));
    let rest = plates.split_off(plates.len() / 2);
    bunches(plates, out);
    bunches(rest, out);
}

/// What sand does to a body: forces about the base's origin, and its drag as masses.
struct Total<R> {
    wrench: Wrench<R>,
    drag: PointMasses<R>,
    edge: Inertia<R>,
}

impl<R: Real> BodyPlates<R> {
    pub fn all(model: &TreeModel) -> Vec<Self> {
        let touching = model.plates.iter().enumerate().filter(|(_, p)| !p.is_empty());
        touching.map(|(body, plates)| Self::of(body, plates)).collect()
    }

    pub fn of(body: usize, plates: &[Plate]) -> Self {
        let ends = ends(plates);
        let corners = std::array::from_fn(|i| [0, 1, 2].map(|k| ends[k][i >> k & 1]));
        let mut all = Vec::new();
        bunches(plates.to_vec(), &mut all);
        Self { body, bunches: all, ball: Ball::around(plates), corners, share: R::one() }
    }
}

/// Adds the sand on all bodies to their loads; `place` is where the base's origin is.
#[inline(always)]
pub fn press<R: Real>(
    ground: &Ground<R>,
    bodies: &[BodyPlates<R>],
    frames: &[Frame<R>],
    place: &Vec3<R>,
    surface: &impl Surface<R>,
    loads: &mut [Load<R>],
    dt: R,
) {
    // How the base, which is the first frame, travels.
    let base = frames[0].velocity.at(frames[0].origin);
    let travel = [base.x, base.y];
    for plates in bodies {
        let frame = &frames[plates.body];
        let center = *place + frame.point(Vec3::splat(plates.ball.center));
        let under = surface.under(center);
        if !R::any(R::zero().lt(under.depth(center) + R::splat(plates.ball.reach))) {
            continue;
        }
        let trusted = plates.corners.iter().fold(R::one(), |least, c| {
            let place = frame.point(Vec3::splat(*c));
            least.min(trust(frame, place))
        });
        let expected = frame.change.scaled(trusted);
        let middle = expected.scale_add(R::splat(0.5), &frame.velocity);
        let Some(total) = on_body(ground, plates, frame, &middle, place, travel, &under, dt) else { continue };
        let load = &mut loads[plates.body];
        let mut drag = Inertia::points(&total.drag);
        drag.add(&total.edge);
        let mut bias = total.wrench.scale_add(-R::one(), &load.bias);
        // f + C w Δv, with the drags as masses dt C.
        let held = drag.apply(&expected.scaled(-(R::one() / dt)));
        bias.add(&held);
        load.inertia.add(&drag);
        load.bias = bias;
    }
}

/// How far a body's next change of velocity at `place` can be expected to be its last one; see [`crate::lanes`].
#[inline(always)]
fn trust<R: Real>(frame: &Frame<R>, place: Vec3<R>) -> R {
    let (speed, change) = (frame.velocity.at(place).norm_squared(), frame.change.at(place).norm_squared());
    let share = speed / change.mul_add(R::splat(4.0), speed + R::splat(1e-30));
    share * share
}

#[inline(always)]
#[allow(clippy::too_many_arguments)] // all of them are in registers
fn on_body<R: Real>(
    ground: &Ground<R>,
    plates: &BodyPlates<R>,
    frame: &Frame<R>,
    velocity: &Twist<R>,
    place: &Vec3<R>,
    travel: [R; 2],
    under: &Local<R>,
    dt: R,
) -> Option<Total<R>> {
    match (&ground.form, &ground.beyond) {
        (Form::Li2013(law), None) => by(law, &Plain, ground, plates, frame, velocity, place, travel, under, dt),
        (form, None) => by(form, &Plain, ground, plates, frame, velocity, place, travel, under, dt),
        (form, Some(beyond)) => by(form, beyond, ground, plates, frame, velocity, place, travel, under, dt),
    }
}

/// The hottest loop of robots on sand.
#[inline(always)]
#[allow(clippy::too_many_arguments)] // all of them are in registers
fn by<R: Real>(
    law: &impl StressLaw<R>,
    beyond: &impl Beyond<R>,
    ground: &Ground<R>,
    plates: &BodyPlates<R>,
    frame: &Frame<R>,
    velocity: &Twist<R>,
    place: &Vec3<R>,
    travel: [R; 2],
    under: &Local<R>,
    dt: R,
) -> Option<Total<R>> {
    let (zero, half) = (R::zero(), R::splat(0.5));
    let (mut total, mut wet) = (Total::none(), false);
    // Rows of the surface's own axes in the world: z along its normal, x along the world's x.
    let axes = under.axes();
    // The same in the body's frame, for what only needs heights.
    let up = frame.rotation.apply_transposed(under.normal);
    let height = under.normal.dot(*place + frame.origin - under.point);
    for bunch in &plates.bunches {
        let depth = -(up.dot(Vec3::splat(bunch.ball.center)) + height);
        if !R::any(zero.lt(depth + R::splat(bunch.ball.reach))) {
            continue;
        }
        for plate in &bunch.plates {
            let center = lanes(plate.center);
            let depth = -(up.dot(center) + height);
            let rise = up.dot(lanes(plate.half[0])).abs() + up.dot(lanes(plate.half[1])).abs();
            let below = depth + rise;
            if !R::any(zero.lt(below)) {
                continue;
            }
            let (at, normal) = (frame.point(center), frame.rotation.apply(lanes(plate.normal)));
            let v = velocity.at(at);
            if !R::any(zero.lt(normal.dot(v))) {
                continue;
            }
            let crossing = depth.lt(rise);
            let part = below.max(zero) * half;
            let depth = R::select(crossing, part, depth).max(zero);
            let share = R::select(crossing, part / rise.max(R::splat(1e-9)), R::one());
            let area = R::splat(plate.area) * share * plates.share;
            let site = Site::fresh(depth, place.x + at.x).travelling(travel);
            let contact = match &axes {
                None => ground.one_sided_by(law, beyond, &site, area, normal, v),
                Some(axes) => {
                    let mut contact = ground.one_sided_by(
                        law,
                        beyond,
                        &site,
                        area,
                        axes.apply_transposed(normal),
                        axes.apply_transposed(v),
                    );
                    contact.force = axes.apply(contact.force);
                    contact
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
                total.edge.add_outer(contact.edge * dt, &Wrench { moment: at.cross(normal), force: normal });
            }
        }
    }
    wet.then_some(total)
}

/// The same in all lanes.
#[inline(always)]
fn lanes<R: Real>(v: Vec3<f64>) -> Vec3<R> {
    Vec3::new(R::splat(v.x), R::splat(v.y), R::splat(v.z))
}

impl<R: Real> Total<R> {
    #[inline(always)]
    fn none() -> Self {
        Self { wrench: Wrench::zero(), drag: PointMasses::zero(), edge: Inertia::points(&PointMasses::zero()) }
    }
}

impl<R: Real> Local<R> {
    /// Columns x, y, z of the surface's axes, z its normal; none where it is level in all lanes.
    #[inline(always)]
    fn axes(&self) -> Option<Mat3<R>> {
        let n = self.normal;
        if !R::any(R::zero().lt(n.x.abs() + n.y.abs())) {
            return None;
        }
        let length = R::one() / (n.x * n.x + n.z * n.z).sqrt();
        let x = Vec3::new(n.z * length, R::zero(), -(n.x * length));
        Some(Mat3::new(x, n.cross(x), n))
    }
}
