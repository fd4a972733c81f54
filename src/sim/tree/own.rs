//! Contact between bodies of one robot: each body is a capsule, and capsules that may meet push each other apart.
//!
//! Two capsules that overlap by δ push each other with λ = k δ − (c + ½ dt k) v⁺ along the line between their nearest
//! points, with the speed v⁺ after the step at which they separate and the compliance of hard ground
//! ([`super::floor`]). They have no friction. A step is solved twice: in the first solution each of both bodies meets
//! the resistance as if the other one moved as much as itself. The smaller of the two resulting forces acts on both in
//! the second solution, so that no momentum is made. Our own scheme.

use super::Tree;
use super::contact::ContactPoint;
use super::dynamics::{Frame, Load};
use super::model::TreeModel;
use super::stance::{Stance, frames};
use crate::State;
use crate::number::{Real, Vec3};
use crate::spatial::{Twist, Wrench};
use nalgebra::{Isometry3, Matrix3, SymmetricEigen, Vector3};

type V = Vector3<f64>;

/// Number of random poses in which capsules are compared, and of comparisons of two capsules in all of them: our choice,
/// at most some 50 ms.
const POSES: usize = 512;
const MOST_COMPARED: usize = 1_000_000;
/// Capsules with a distance of less than this times the sum of their radii in one of the poses may meet: our choice, so
/// that few poses suffice.
const NEAR: f64 = 2.0;
/// Largest share of the poses in which a pair that counts may overlap: our choice. Parts that overlap more often are
/// fixed close to each other, and their capsules are larger than the parts.
const MOST_OFTEN: f64 = 0.3;
/// Largest angle of a joint without a range in these poses [rad], and largest position of a slide [m]: our choice.
const FARTHEST: [f64; 2] = [std::f64::consts::PI, 0.2];

/// All points within `radius` of the line from `center` − `half` to `center` + `half`, in the frame of its body [m].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Capsule {
    pub body: usize,
    pub center: V,
    pub half: V,
    pub radius: f64,
}

/// Capsules of a robot's bodies, and pairs of their indices that may meet.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct OwnContacts {
    pub capsules: Vec<Capsule>,
    pub pairs: Vec<[usize; 2]>,
}

impl Capsule {
    /// A capsule along the longest axis of a body's points, with the mean of its other two widths.
    fn around(body: usize, points: &[ContactPoint]) -> Option<Self> {
        let mean = points.iter().map(|p| p.center).sum::<V>() / points.len().max(1) as f64;
        let scatter: Matrix3<f64> = points.iter().map(|p| (p.center - mean) * (p.center - mean).transpose()).sum();
        let axes = SymmetricEigen::new(scatter).eigenvectors;
        let ends = |k: usize| {
            let along = points.iter().map(|p| (axes.column(k).dot(&p.center), p.radius));
            along.fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], (x, r)| [a.min(x - r), b.max(x + r)])
        };
        let ends = [ends(0), ends(1), ends(2)];
        let half = ends.map(|[a, b]| (b - a) / 2.0);
        let long = (0..3).fold(0, |l, k| if half[k] > half[l] { k } else { l });
        let radius = (half[(long + 1) % 3] * half[(long + 2) % 3]).sqrt();
        let center = (0..3).map(|k| axes.column(k) * ((ends[k][0] + ends[k][1]) / 2.0)).sum();
        let half = axes.column(long) * (half[long] - radius).max(0.0);
        (radius > 0.0 && radius.is_finite()).then_some(Self { body, center, half, radius })
    }

    fn placed(&self, frame: &Isometry3<f64>) -> (V, V) {
        (frame.transform_point(&self.center.into()).coords, frame.rotation * self.half)
    }
}

impl OwnContacts {
    /// Capsules of the bodies with points of contact. A pair counts if it is apart in the standing pose, and comes near in
    /// some of the poses that the joints' ranges allow, but seldom overlaps. Neighbours in the tree never count.
    pub fn of(tree: &Tree, contacts: &[Vec<ContactPoint>], stance: &Stance) -> Self {
        let capsules: Vec<Capsule> =
            contacts.iter().enumerate().filter_map(|(body, points)| Capsule::around(body, points)).collect();
        let close = |angles: &[f64], factor: f64| -> Vec<[usize; 2]> {
            let frames = frames(tree, &State::at_rest(0.0, angles));
            let placed: Vec<_> = capsules.iter().map(|c| c.placed(&frames[c.body])).collect();
            let meet = |[i, j]: &[usize; 2]| {
                let reach = factor * (capsules[*i].radius + capsules[*j].radius);
                let ((p, a), (q, b)) = (placed[*i], placed[*j]);
                let vector = |v: V| Vec3::<f64>::splat(v.into());
                let squares = [a.norm_squared(), b.norm_squared()];
                let [p, q] = nearest(vector(p), vector(a), vector(q), vector(b), squares);
                (p - q).norm_squared() < reach * reach
            };
            all_pairs(&capsules, tree).filter(meet).collect()
        };
        let standing = close(&stance.angles, 1.0);
        let poses = (MOST_COMPARED / all_pairs(&capsules, tree).count().max(1)).clamp(1, POSES);
        let mut counted = std::collections::BTreeMap::<[usize; 2], usize>::new();
        for pose in 0..poses {
            let angles = random_pose(tree, pose);
            for pair in close(&angles, NEAR) {
                counted.entry(pair).or_default();
            }
            for pair in close(&angles, 1.0) {
                *counted.entry(pair).or_default() += 1;
            }
        }
        let seldom = |count: usize| count as f64 <= MOST_OFTEN * poses as f64;
        let pairs = counted.into_iter().filter(|(pair, count)| seldom(*count) && !standing.contains(pair));
        Self { pairs: pairs.map(|(pair, _)| pair).collect(), capsules }
    }
}

/// Pairs of capsules whose bodies no joint connects.
fn all_pairs<'a>(capsules: &'a [Capsule], tree: &'a Tree) -> impl Iterator<Item = [usize; 2]> + 'a {
    let pairs = (0..capsules.len()).flat_map(|j| (0..j).map(move |i| [i, j]));
    pairs.filter(|[i, j]| {
        let (a, b) = (capsules[*i].body, capsules[*j].body);
        tree.bodies[a].parent != b && tree.bodies[b].parent != a
    })
}

/// Positions of the joints within their ranges, by the additive recurrence with the golden ratio for joint and pose.
fn random_pose(tree: &Tree, pose: usize) -> Vec<f64> {
    let position = |(i, joint): (usize, &super::TreeJoint)| {
        let farthest = FARTHEST[usize::from(joint.kind == super::JointKind::Slide)];
        let [low, high] = joint.range.unwrap_or([-farthest, farthest]).map(|end| end.clamp(-farthest, farthest));
        // Square roots of different integers without squares are independent over the rationals.
        let part = ((pose + 1) as f64 * (2.0 + (i * i + i) as f64).sqrt()).fract();
        low + (high - low) * part
    };
    tree.joints().enumerate().map(position).collect()
}

/// Nearest points of two lines with the centres `p` and `q` and the half lengths `a` and `b`, whose `squares` are
/// given (Ericson, Real-Time Collision Detection, 2005, section 5.1.9).
#[inline(always)]
fn nearest<R: Real>(p: Vec3<R>, a: Vec3<R>, q: Vec3<R>, b: Vec3<R>, squares: [f64; 2]) -> [Vec3<R>; 2] {
    let (one, tiny) = (R::one(), 1e-12);
    let [aa, bb] = squares.map(|s| R::splat(s.max(tiny)));
    let apart = p - q;
    let (ab, a_apart, b_apart) = (a.dot(b), a.dot(apart), b.dot(apart));
    let across = (aa * bb - ab * ab).max(R::splat(tiny * tiny));
    let s = ((ab * b_apart - a_apart * bb) / across).clamp(-one, one);
    let t = (ab.mul_add(s, b_apart) / bb).clamp(-one, one);
    let s = (ab.mul_add(t, -a_apart) / aa).clamp(-one, one);
    [a.scale_add(s, p), b.scale_add(t, q)]
}

/// The capsules of robots in lanes, which all have the same.
#[derive(Clone)]
pub struct OwnFloor<R> {
    contacts: std::sync::Arc<OwnContacts>,
    /// Squares of the capsules' half lengths [m²].
    squares: Vec<f64>,
    /// [N/m]
    stiffness: R,
    /// [N·s/m]
    damping: R,
}

/// Two capsules that overlap in some lane.
#[derive(Clone, Copy)]
pub struct Meeting<R> {
    bodies: [usize; 2],
    at: Vec3<R>,
    /// From the second body to the first.
    normal: Vec3<R>,
    /// 1 if they push each other, else 0.
    here: R,
    /// Force if the velocities did not change, and then the one that acts [N].
    force: R,
}

/// Work space: centres and half lengths of all capsules.
pub type Placed<R> = Vec<(Vec3<R>, Vec3<R>)>;

impl<R: Real> OwnFloor<R> {
    pub fn new(model: &TreeModel) -> Self {
        let squares = model.own.capsules.iter().map(|c| c.half.norm_squared()).collect();
        let zero = R::zero();
        let mut floor = Self { contacts: model.own.clone(), squares, stiffness: zero, damping: zero };
        (0..R::LANES).for_each(|lane| floor.set_lane(lane, model));
        floor
    }

    pub fn set_lane(&mut self, lane: usize, model: &TreeModel) {
        self.stiffness.set_lane(lane, model.compliance.stiffness);
        self.damping.set_lane(lane, model.compliance.damping);
    }

    /// Decrease of a force with the speed at which bodies separate [N·s/m].
    #[inline(always)]
    fn yielding(&self, dt: R) -> R {
        self.stiffness.mul_add(dt * R::splat(0.5), self.damping)
    }

    /// Finds the capsules that overlap.
    #[inline(always)]
    pub fn find(&self, frames: &[Frame<R>], placed: &mut Placed<R>, meetings: &mut Vec<Meeting<R>>, dt: R) {
        meetings.clear();
        placed.clear();
        if self.contacts.pairs.is_empty() {
            return;
        }
        for capsule in &self.contacts.capsules {
            let frame = &frames[capsule.body];
            let half = frame.rotation.apply(Vec3::splat(capsule.half.into()));
            placed.push((frame.point(Vec3::splat(capsule.center.into())), half));
        }
        for [i, j] in &self.contacts.pairs {
            self.meet([*i, *j], frames, placed, meetings, dt);
        }
    }

    #[inline(always)]
    fn meet(
        &self,
        [i, j]: [usize; 2],
        frames: &[Frame<R>],
        placed: &[(Vec3<R>, Vec3<R>)],
        meetings: &mut Vec<Meeting<R>>,
        dt: R,
    ) {
        let capsules = &self.contacts.capsules;
        let reach = capsules[i].radius + capsules[j].radius;
        let farthest = reach + self.squares[i].sqrt() + self.squares[j].sqrt();
        let ((p, a), (q, b)) = (placed[i], placed[j]);
        if !R::any((p - q).norm_squared().lt(R::splat(farthest * farthest))) {
            return;
        }
        let [p, q] = nearest(p, a, q, b, [self.squares[i], self.squares[j]]);
        let apart = p - q;
        let squared = apart.norm_squared();
        if !R::any(squared.lt(R::splat(reach * reach))) {
            return;
        }
        let distance = squared.max(R::splat(1e-12)).sqrt();
        let normal = apart * (R::one() / distance);
        let depth = (R::splat(reach) - distance).max(R::zero());
        // The middle of the overlap.
        let at = normal.scale_add(R::splat(0.5) * depth - R::splat(capsules[i].radius), p);
        let bodies = [i, j].map(|k| capsules[k].body);
        let [first, second] = bodies.map(|body| frames[body].velocity.at(at));
        let speed = normal.dot(first - second);
        let force = depth * self.stiffness - self.yielding(dt) * speed;
        let push = R::select(R::zero().lt(depth), force, R::zero()).max(R::zero());
        let here = R::select(R::zero().lt(push), R::one(), R::zero());
        meetings.push(Meeting { bodies, at, normal, here, force: push });
    }

    /// Adds to both bodies' loads the resistance of the first solution.
    #[inline(always)]
    pub fn resist(&self, meetings: &[Meeting<R>], loads: &mut [Load<R>], dt: R) {
        let mass = self.yielding(dt) * dt * R::splat(2.0);
        for m in meetings {
            let along = Wrench { moment: m.at.cross(m.normal), force: m.normal };
            for (body, force) in m.bodies.into_iter().zip([m.force, -m.force]) {
                loads[body].inertia.add_outer(mass * m.here, &along);
                loads[body].bias = along.scale_add(-force, &loads[body].bias);
            }
        }
    }

    /// Finds the forces from the bodies' `accelerations` in the first solution.
    #[inline(always)]
    pub fn settle(&self, meetings: &mut [Meeting<R>], accelerations: &[Twist<R>], dt: R) {
        let mass = self.yielding(dt) * dt * R::splat(2.0);
        for m in meetings {
            let [first, second] = m.bodies.map(|body| m.normal.dot(accelerations[body].at(m.at)) * mass);
            m.force = (m.force - first).min(m.force + second).max(R::zero()) * m.here;
        }
    }

    /// Adds the forces to both bodies' loads.
    #[inline(always)]
    pub fn press(&self, meetings: &[Meeting<R>], loads: &mut [Load<R>]) {
        for m in meetings {
            let along = Wrench { moment: m.at.cross(m.normal), force: m.normal };
            for (body, force) in m.bodies.into_iter().zip([m.force, -m.force]) {
                loads[body].bias = along.scale_add(-force, &loads[body].bias);
            }
        }
    }
}
