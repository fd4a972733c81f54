//! Contact between parts of one robot: a leg that meets another leg or the base.
//!
//! A body has a capsule inside the box around its points of contact, the base up to three. Two capsules are not to
//! overlap; where they do, they part with the speed δ/τ, where δ is the overlap. There is no friction: the force acts
//! along the line between the nearest points of the two axes. The force follows from the robot's accelerations under a
//! unit force ([`dynamics::respond`]), with motors, sand and ground as they are in this step. So the contact has no
//! stiffness, and is stable with every time step. Several contacts are solved one after the other, twice, and none
//! pulls (projected Gauss-Seidel; E. Catto, Iterative Dynamics with Temporal Coherence, 2005).

use super::Tree;
use super::contact::ContactPoint;
use super::dynamics::{self, Folded};
use super::free_joints::FreeJoints;
use super::kinematics::chain;
use super::stance::Stance;
use crate::blocks::LinkFrame;
use crate::number::{Real, Vec3};
use crate::spatial::{Twist, Wrench};
use crate::stop::NO_LIMIT;
use nalgebra::{Isometry3, Matrix3, Vector3};

type V = Vector3<f64>;

/// τ, the time in which capsules that overlap part [s]: our choice, a control step. A shorter time throws bodies apart,
/// and with a longer one they stay in each other.
const LEAVES: f64 = 0.02;
/// Number of times that all contacts are solved: our choice. The second time corrects contacts that later ones have
/// disturbed; more sweeps cost time.
const SWEEPS: usize = 2;
/// Largest number of capsules of the base: our choice, because one leaves out the sides of a flat base, and each costs
/// time. Other bodies have one.
const MOST_CAPSULES: f64 = 3.0;
/// Bodies that are nearer than this in the standing pose never meet [m]: our choice, because the shapes of neighbours
/// overlap.
const NEIGHBOURS: f64 = 5e-3;
/// Number of poses that are tried to find which bodies can meet: our choice, because more find rarer meetings and take
/// longer. It is a prime, so that each joint has another place in each pose.
const POSES: usize = 499;
/// Generates the lattice of these poses: our choice, because its powers repeat only after 249 joints.
const GENERATOR: usize = 331;
/// Two bodies can meet if, over these poses, their least distance is below this times the range of their distances. Our
/// choice: it is above 0, because bodies may come nearer between the poses, and larger ones add pairs that never meet.
const NEAR: f64 = 0.1;
/// Largest speed at which bodies that meet are stopped before they overlap [m/s]: our choice. Faster ones overlap first
/// and then part; with a larger value each step looks at more pairs.
const CLOSING: f64 = 5.0;
/// Axes that are nearer than this have no direction in which to part [m]: our choice, far above the rounding of `f32`
/// and far below a link's radius.
const CROSSING: f64 = 1e-4;
/// Axes whose angle has a smaller squared sine are parallel: our choice, above the rounding of `f32`.
const PARALLEL: f64 = 1e-4;

/// All points that are within `radius` of a line.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Capsule {
    /// Ends of the line in the body's frame [m].
    ends: [V; 2],
    radius: f64,
}

/// The capsules of a body.
#[derive(Clone, Debug, PartialEq)]
struct BodyCapsules {
    body: usize,
    /// A ball that contains all capsules, in the body's frame [m].
    center: V,
    reach: f64,
    capsules: Vec<Capsule>,
}

/// The bodies of a robot that can meet.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SelfContact {
    bodies: Vec<BodyCapsules>,
    /// Indices of two of `bodies`.
    pairs: Vec<[usize; 2]>,
}

/// Two capsules that overlap in some lane, or may do so after this step.
#[derive(Clone, Copy)]
struct Overlap<R> {
    bodies: [usize; 2],
    /// Middle of the overlap, from the base's origin [m].
    at: Vec3<R>,
    /// From the second body to the first one.
    normal: Vec3<R>,
    /// Least speed with which the two capsules must part [m/s]; −[`NO_LIMIT`] in lanes in which they are too far apart to meet.
    wanted: R,
    /// Force so far [N].
    force: R,
    /// Speed with which the two capsules part after a time step with a force of 1 N [m/(N·s)].
    mobility: R,
}

/// Work space of a step; its contents are not kept.
pub struct SelfContactScratch<R> {
    centers: Vec<Vec3<R>>,
    overlaps: Vec<Overlap<R>>,
    wrenches: Vec<Wrench<R>>,
    /// Accelerations of bodies and joints by a unit force of each overlap.
    accelerations: Vec<Twist<R>>,
    joints: Vec<R>,
}

/// Accelerations of bodies and joints in a step.
pub struct StepAccelerations<'a, R> {
    pub bodies: &'a mut [Twist<R>],
    pub joints: &'a mut [R],
}

impl SelfContact {
    /// Finds the pairs that can meet within the ranges of the joints: bodies of different legs, and the last body of a leg with the base.
    pub fn of(tree: &Tree, contacts: &[Vec<ContactPoint>], stance: &Stance) -> Self {
        let leg_of = |body: usize| stance.legs.iter().position(|leg| leg.contains(&body));
        let is_last = |body: usize| stance.legs.iter().any(|leg| leg.last() == Some(&body));
        let bodies: Vec<BodyCapsules> = (0..tree.bodies.len())
            .filter(|body| *body == 0 || leg_of(*body).is_some())
            .filter_map(|body| BodyCapsules::around(body, &contacts[body]))
            .collect();
        let frames = chain(tree, Isometry3::identity(), &stance.angles);
        let apart = |a: &BodyCapsules, b: &BodyCapsules| a.gap(b, &frames) > NEIGHBOURS;
        let mut candidates = Vec::new();
        for (a, one) in bodies.iter().enumerate() {
            for (b, other) in bodies.iter().enumerate().skip(a + 1) {
                let related = if one.body == 0 { !is_last(other.body) } else { leg_of(one.body) == leg_of(other.body) };
                if !related && apart(one, other) {
                    candidates.push([a, b]);
                }
            }
        }
        let ranges = FreeJoints::free(tree).ranges;
        let poses: Vec<_> = (0..POSES).map(|k| chain(tree, Isometry3::identity(), &pose(&ranges, k))).collect();
        let can_meet = |[a, b]: &[usize; 2]| {
            let gaps = poses.iter().map(|frames| bodies[*a].gap(&bodies[*b], frames));
            let [least, most] = gaps.fold([f64::MAX, f64::MIN], |[low, high], gap| [low.min(gap), high.max(gap)]);
            least < NEAR * (most - least)
        };
        candidates.retain(can_meet);
        Self { bodies, pairs: candidates }
    }

    /// Changes the accelerations so that bodies stay apart.
    #[inline(always)]
    pub fn keep_apart<R: Real>(
        &self,
        folded: &Folded<R>,
        found: &mut StepAccelerations<R>,
        scratch: &mut SelfContactScratch<R>,
        dt: R,
    ) {
        self.find(folded.frames, scratch, dt);
        let count = folded.bodies.len();
        let SelfContactScratch { overlaps, wrenches, accelerations, joints, .. } = scratch;
        if overlaps.is_empty() {
            return;
        }
        wrenches.resize(count, Wrench::zero());
        accelerations.resize(count * overlaps.len(), Twist::zero());
        joints.resize((count - 1) * overlaps.len(), R::zero());
        for (k, overlap) in overlaps.iter_mut().enumerate() {
            let own = &mut accelerations[k * count..][..count];
            let push = Wrench { moment: overlap.at.cross(overlap.normal), force: overlap.normal };
            let joints = &mut joints[k * (count - 1)..][..count - 1];
            dynamics::respond(folded, overlap.bodies, &push, wrenches, own, joints);
            let [first, second] = overlap.bodies;
            overlap.mobility =
                (overlap.speed(&own[first], &own[second]) * dt).max(R::splat(f64::from(f32::MIN_POSITIVE)));
        }
        for _ in 0..SWEEPS {
            for (k, overlap) in overlaps.iter_mut().enumerate() {
                let [first, second] = overlap.bodies;
                let one = found.bodies[first].scale_add(dt, &folded.frames[first].velocity);
                let other = found.bodies[second].scale_add(dt, &folded.frames[second].velocity);
                let speed = overlap.speed(&one, &other);
                let force = (overlap.force + (overlap.wanted - speed) / overlap.mobility).max(R::zero());
                let more = force - overlap.force;
                let changes = R::zero().lt(more.abs());
                for (total, unit) in found.bodies.iter_mut().zip(&accelerations[k * count..][..count]) {
                    total.angular = selected(changes, unit.angular.scale_add(more, total.angular), total.angular);
                    total.linear = selected(changes, unit.linear.scale_add(more, total.linear), total.linear);
                }
                for (total, unit) in found.joints.iter_mut().zip(&joints[k * (count - 1)..]) {
                    *total = R::select(changes, unit.mul_add(more, *total), *total);
                }
                overlap.force = force;
            }
        }
    }

    #[inline(always)]
    fn find<R: Real>(&self, frames: &[LinkFrame<R>], scratch: &mut SelfContactScratch<R>, dt: R) {
        let SelfContactScratch { centers, overlaps, .. } = scratch;
        overlaps.clear();
        centers.clear();
        for own in &self.bodies {
            centers.push(frames[own.body].point(Vec3::splat(own.center.into())));
        }
        // Largest distance by which two bodies come closer in this step.
        let soon = CLOSING * dt.lane(0);
        for &[a, b] in &self.pairs {
            let (one, other) = (&self.bodies[a], &self.bodies[b]);
            let within = one.reach + other.reach + soon;
            if !R::any((centers[a] - centers[b]).norm_squared().lt(R::splat(within * within))) {
                continue;
            }
            for p in &one.capsules {
                let line = p.line(&frames[one.body]);
                if !R::any(distance_squared(&line, centers[b]).lt(R::splat((p.radius + other.reach + soon).powi(2)))) {
                    continue;
                }
                for q in &other.capsules {
                    let lines = [line, q.line(&frames[other.body])];
                    let found = Overlap::of(lines, [p.radius, q.radius], [one.body, other.body], dt);
                    if R::any(R::splat(-NO_LIMIT).lt(found.wanted)) {
                        overlaps.push(found);
                    }
                }
            }
        }
    }
}

/// Pose `k` of [`POSES`] in the `ranges` of the joints: a lattice rule (N. M. Korobov 1959), whose generator is our choice.
fn pose(ranges: &[[f64; 2]], k: usize) -> Vec<f64> {
    let mut place = k;
    let angle = |&[low, high]: &[f64; 2]| {
        place = place * GENERATOR % POSES;
        low + (high - low) * place as f64 / POSES as f64
    };
    ranges.iter().map(angle).collect()
}

impl<R: Real> SelfContactScratch<R> {
    pub fn new() -> Self {
        let (centers, overlaps, wrenches) = (Vec::new(), Vec::new(), Vec::new());
        Self { centers, overlaps, wrenches, accelerations: Vec::new(), joints: Vec::new() }
    }
}

impl BodyCapsules {
    /// Capsules inside the box around the points, along its longest side; None without points.
    fn around(body: usize, points: &[ContactPoint]) -> Option<Self> {
        let middle = points.iter().map(|p| p.center).sum::<V>() / points.len().max(1) as f64;
        let spread: Matrix3<f64> = points.iter().map(|p| (p.center - middle) * (p.center - middle).transpose()).sum();
        let mut axes: Vec<(V, f64, f64)> = Vec::with_capacity(3);
        for axis in spread.symmetric_eigen().eigenvectors.column_iter() {
            let ends = |sign: f64| points.iter().map(|p| p.reach(&(axis * sign))).fold(f64::NEG_INFINITY, f64::max);
            let (high, low) = (ends(1.0), -ends(-1.0));
            axes.push((axis.into_owned(), (high + low) / 2.0, (high - low) / 2.0));
        }
        axes.sort_by(|a, b| b.2.total_cmp(&a.2));
        let [(along, _, long), (across, _, wide), (_, _, radius)] = axes[..] else { return None };
        if points.is_empty() || radius <= 0.0 {
            return None;
        }
        let center: V = axes.iter().map(|(axis, at, _)| axis * *at).sum();
        let count = if body == 0 { (wide / radius).ceil().clamp(1.0, MOST_CAPSULES) } else { 1.0 };
        let capsule = |k: f64| {
            let aside =
                if count > 1.0 { across * ((2.0 * k / (count - 1.0) - 1.0) * (wide - radius)) } else { V::zeros() };
            Capsule { ends: [-1.0, 1.0].map(|end| center + aside + along * (end * (long - radius))), radius }
        };
        let capsules: Vec<Capsule> = (0..count as usize).map(|k| capsule(k as f64)).collect();
        let far = |c: &Capsule| (c.ends[0] - center).norm().max((c.ends[1] - center).norm()) + c.radius;
        let reach = capsules.iter().map(far).fold(0.0, f64::max);
        Some(Self { body, center, reach, capsules })
    }

    /// Least distance of the capsules of two bodies [m]; negative if they overlap.
    fn gap(&self, other: &Self, frames: &[Isometry3<f64>]) -> f64 {
        let line = |of: usize, capsule: &Capsule| {
            capsule.ends.map(|p| Vec3::<f64>::splat(frames[of].transform_point(&p.into()).coords.into()))
        };
        let mut least = f64::INFINITY;
        for p in &self.capsules {
            for q in &other.capsules {
                let [on_p, on_q] = nearest([line(self.body, p), line(other.body, q)]);
                least = least.min((on_p - on_q).norm_squared().sqrt() - p.radius - q.radius);
            }
        }
        least
    }
}

impl Capsule {
    #[inline(always)]
    fn line<R: Real>(&self, frame: &LinkFrame<R>) -> [Vec3<R>; 2] {
        // This is no closure, because a closure would be compiled without the instruction set.
        let [a, b] = self.ends;
        [frame.point(Vec3::splat(a.into())), frame.point(Vec3::splat(b.into()))]
    }
}

impl<R: Real> Overlap<R> {
    #[inline(always)]
    fn of(lines: [[Vec3<R>; 2]; 2], radii: [f64; 2], bodies: [usize; 2], dt: R) -> Self {
        let (zero, [one, other]) = (R::zero(), nearest(lines));
        let between = one - other;
        let distance = between.norm_squared().sqrt();
        let normal = between * (R::one() / distance.max(R::splat(CROSSING)));
        let depth = R::splat(radii[0] + radii[1]) - distance;
        let wanted = R::select(zero.lt(depth), depth * R::splat(1.0 / LEAVES), depth / dt);
        let wanted = R::select(distance.lt(R::splat(CROSSING)), R::splat(-NO_LIMIT), wanted);
        let wanted = R::select(depth.lt(R::splat(-0.99 * CLOSING) * dt), R::splat(-NO_LIMIT), wanted);
        let at = normal.scale_add(R::splat(radii[1]) - depth * R::splat(0.5), other);
        Self { bodies, at, normal, wanted, force: zero, mobility: zero }
    }

    /// Speed with which two bodies with these motions part.
    #[inline(always)]
    fn speed(&self, first: &Twist<R>, second: &Twist<R>) -> R {
        self.normal.dot(first.at(self.at) - second.at(self.at))
    }
}

/// In each lane: `yes` if `mask` is true, else `no`.
#[inline(always)]
fn selected<R: Real>(mask: R::Mask, yes: Vec3<R>, no: Vec3<R>) -> Vec3<R> {
    Vec3::new(R::select(mask, yes.x, no.x), R::select(mask, yes.y, no.y), R::select(mask, yes.z, no.z))
}

/// Squared distance of a point from a line segment.
#[inline(always)]
fn distance_squared<R: Real>(line: &[Vec3<R>; 2], point: Vec3<R>) -> R {
    let (along, to) = (line[1] - line[0], point - line[0]);
    let s = (along.dot(to) / along.norm_squared().max(R::splat(1e-12))).clamp(R::zero(), R::one());
    along.scale_add(-s, to).norm_squared()
}

/// The nearest points of two line segments (C. Ericson, Real-Time Collision Detection, 2005, section 5.1.9). For
/// parallel segments these are points near the middle.
#[inline(always)]
fn nearest<R: Real>([p, q]: [[Vec3<R>; 2]; 2]) -> [Vec3<R>; 2] {
    let (zero, one, tiny) = (R::zero(), R::one(), R::splat(1e-12));
    let (u, v, between) = (p[1] - p[0], q[1] - q[0], p[0] - q[0]);
    let (uu, vv, uv) = (u.norm_squared().max(tiny), v.norm_squared().max(tiny), u.dot(v));
    let (on_u, on_v) = (u.dot(between), v.dot(between));
    let determinant = uu * vv - uv * uv;
    let skew = (R::splat(PARALLEL) * (uu * vv)).lt(determinant);
    let free = (uv * on_v - on_u * vv) / R::select(skew, determinant, one);
    let s = R::select(skew, free.clamp(zero, one), R::splat(0.5));
    let t = (s.mul_add(uv, on_v) / vv).clamp(zero, one);
    let s = ((t * uv - on_u) / uu).clamp(zero, one);
    let t = (s.mul_add(uv, on_v) / vv).clamp(zero, one);
    [u.scale_add(s, p[0]), v.scale_add(t, q[0])]
}
