//! Limbs of a robot (legs, arms, tails): the branches of its tree that end in a shape, and how each one moves.

use super::contact::ContactPoint;
use super::kinematics::{Low, moved};
use super::{JointKind, Tree};
use nalgebra::{DMatrix, DVector, Isometry3, Vector3};

type V = Vector3<f64>;

/// Largest number of limbs that are searched. The second constant is the largest number of joints of a limb that a
/// search moves, counted from the limb's end. Our choice: both are above those of any robot we know, and bound the time
/// of a search.
pub const MOST_LIMBS: usize = 32;
const MOST_MOVING: usize = 8;
/// Farthest position of a joint in a search [rad or m], for joints that turn without limits: our choice, less than half
/// a turn, so that no pose is found twice.
const FARTHEST: f64 = 2.8;
/// Two branches are one limb (a hand with fingers, a foot with toes) if they share more than this part of their
/// length: our choice, because fingers and toes are short, and legs share little of a trunk.
const SHARED: f64 = 0.5;
/// Steps of Levenberg and Marquardt's method: our choice; most searches need ten.
pub const STEPS: usize = 40;
/// Weight of a joint's distance from its preferred position [1/rad], relative to distances of the tip in lengths of the
/// limb: our choice. The weight selects among the solutions; it shifts the foot by less than a thousandth of the limb's
/// length.
const PREFERENCE: f64 = 0.02;
/// Weight of the sole's tilt [1/rad]: our choice, so that a search reaches tilt and position equally well.
const LEVEL: f64 = 0.3;
/// Points less than this part of the limb's length above the lowest point belong to the sole. A sole must extend by
/// more than this in both horizontal directions. Our choice: a sole's rounded edges count, and a point or ball is no
/// sole.
const SOLE: f64 = 0.03;

/// A branch of the tree from the base to its last body with a shape.
#[derive(Clone, Debug)]
pub struct Limb {
    /// From the base outward, without the base.
    pub path: Vec<usize>,
    /// The limb's last body, and the last bodies of branches that part from the limb.
    pub ends: Vec<usize>,
    /// The part of `path` that a search moves.
    moving: Vec<usize>,
    /// Sum of the distances between joints, and from the last one to its farthest point [m].
    pub length: f64,
    /// The first joint that a long part of the limb follows (more than a quarter of its length): the hip of a leg, the shoulder of an arm.
    pub hip: usize,
    sole: Option<Sole>,
}

/// The flat underside of a foot, in the frame of its body.
#[derive(Clone, Copy, Debug)]
struct Sole {
    center: V,
    up: V,
}

/// A solution of [`Limb::reach`].
#[derive(Clone, Debug)]
pub struct Reached {
    /// Positions of all joints of the robot; those of other limbs are unchanged.
    pub angles: Vec<f64>,
    /// Distance of the tip from the wanted position, as a part of the limb's length.
    pub off: f64,
    /// Sum of the squared distances of joints from their preferred positions.
    pub bent: f64,
}

/// Joints that a search may move, and where it begins.
pub struct FreeJoints {
    pub ranges: Vec<[f64; 2]>,
    pub preferred: Vec<f64>,
}

impl FreeJoints {
    /// A joint with a position in the file keeps it. A joint that follows a leader keeps the position that the leader's
    /// preferred position gives. All other joints are free in their range, and their preferred position is 0.
    pub fn of(tree: &Tree) -> Self {
        let mut all = Self::free(tree);
        for f in tree.followers() {
            let at = f.ratio * all.preferred[f.leader] + f.offset;
            (all.ranges[f.joint], all.preferred[f.joint]) = ([at; 2], at);
        }
        for (i, rest) in tree.joints().enumerate().filter_map(|(i, j)| Some((i, j.rest?))) {
            (all.ranges[i], all.preferred[i]) = ([rest; 2], rest);
        }
        all
    }

    /// All joints are free in their range, also joints with a position in the file.
    pub fn free(tree: &Tree) -> Self {
        let range =
            |j: &super::TreeJoint| j.range.unwrap_or([-FARTHEST, FARTHEST]).map(|end| end.clamp(-FARTHEST, FARTHEST));
        let ranges: Vec<[f64; 2]> = tree.joints().map(range).collect();
        let preferred = ranges.iter().map(|[low, high]| 0.0_f64.clamp(*low, *high)).collect();
        Self { ranges, preferred }
    }

    /// Start `k` of a search: the preferred position, then positions spread over the ranges (Halton's sequence).
    fn start(&self, k: usize, moving: &[usize]) -> Vec<f64> {
        // The first primes, as Halton's sequence needs: one for each joint.
        const BASES: [usize; MOST_MOVING] = [2, 3, 5, 7, 11, 13, 17, 19];
        let mut angles = self.preferred.clone();
        for (base, body) in BASES.iter().zip(moving.iter().rev()).filter(|_| k > 0) {
            let [low, high] = self.ranges[body - 1];
            angles[body - 1] = low + (high - low) * halton(k, *base);
        }
        angles
    }
}

fn halton(mut k: usize, base: usize) -> f64 {
    let (mut part, mut sum) = (1.0, 0.0);
    while k > 0 {
        part /= base as f64;
        sum += part * (k % base) as f64;
        k /= base;
    }
    sum
}

/// All limbs of a robot, in the order of their ends.
pub fn limbs(tree: &Tree, contacts: &[Vec<ContactPoint>]) -> Vec<Limb> {
    let carries = |i: usize| tree.bodies.iter().skip(1).any(|b| b.parent == i);
    let step = |i: usize| tree.bodies[i].origin.translation.vector.norm();
    let mut all: Vec<Limb> = Vec::new();
    for leaf in (1..tree.bodies.len()).filter(|i| !carries(*i)) {
        let mut end = leaf;
        while end > 0 && contacts[end].is_empty() {
            end = tree.bodies[end].parent;
        }
        let path = path(tree, end);
        let length = path.iter().skip(1).map(|i| step(*i)).sum::<f64>() + farthest(&contacts[end]);
        let shared = |other: &Limb| {
            let common = other.path.iter().zip(&path).take_while(|(a, b)| a == b);
            common.skip(1).map(|(i, _)| step(*i)).sum::<f64>() > SHARED * length.min(other.length)
        };
        if end == 0 {
            continue;
        }
        if let Some(other) = all.iter_mut().find(|other| other.ends.contains(&end) || shared(other)) {
            if !other.ends.contains(&end) {
                other.ends.push(end);
            }
        } else if all.len() < MOST_LIMBS {
            let moving = path[path.len().saturating_sub(MOST_MOVING)..].to_vec();
            let hip = path[0];
            all.push(Limb { path, ends: vec![end], moving, length, hip, sole: None });
        }
    }
    let joints = FreeJoints::of(tree);
    for limb in &mut all {
        limb.complete(tree, contacts, &joints.preferred);
    }
    all
}

fn path(tree: &Tree, end: usize) -> Vec<usize> {
    let mut path = Vec::new();
    let mut at = end;
    while at > 0 {
        path.push(at);
        at = tree.bodies[at].parent;
    }
    path.reverse();
    path
}

fn farthest(points: &[ContactPoint]) -> f64 {
    points.iter().map(|p| p.center.norm() + p.radius).fold(0.0, f64::max)
}

impl Limb {
    pub fn end(&self) -> usize {
        self.ends[0]
    }

    /// Finds hip and sole, with joints at `angles`.
    fn complete(&mut self, tree: &Tree, contacts: &[Vec<ContactPoint>], angles: &[f64]) {
        let next = |k: usize| {
            self.path
                .get(k + 1)
                .map_or(farthest(&contacts[self.end()]), |i| tree.bodies[*i].origin.translation.vector.norm())
        };
        let long = (0..self.path.len()).find(|k| next(*k) > 0.25 * self.length);
        self.hip = self.path[long.unwrap_or(0)];
        let points = &contacts[self.end()];
        let frame = self.frame(tree, angles, self.end());
        if self.path.len() < 4 {
            return;
        }
        let at = |p: &ContactPoint| frame.transform_point(&p.center.into()).coords - V::z() * p.radius;
        let low = points.iter().map(|p| at(p).z).fold(f64::INFINITY, f64::min);
        let under: Vec<V> = points.iter().map(at).filter(|p| p.z < low + SOLE * self.length).collect();
        let [least, most] =
            under.iter().fold([V::repeat(f64::MAX), V::repeat(f64::MIN)], |[a, b], p| [a.inf(p), b.sup(p)]);
        if (most - least).xy().min() > SOLE * self.length {
            let center = V::new((least.x + most.x) / 2.0, (least.y + most.y) / 2.0, low);
            let center = frame.inverse_transform_point(&center.into()).coords;
            self.sole = Some(Sole { center, up: frame.rotation.inverse_transform_vector(&V::z()) });
        }
    }

    /// Length from the hip to the farthest point [m].
    pub fn length_behind_hip(&self, tree: &Tree, contacts: &[Vec<ContactPoint>]) -> f64 {
        let behind = self.path.iter().filter(|i| **i > self.hip);
        behind.map(|i| tree.bodies[*i].origin.translation.vector.norm()).sum::<f64>() + farthest(&contacts[self.end()])
    }

    /// Position of the knee in the base's frame [m]. The knee is the first joint after the hip that is far from the
    /// joint before it; if there is none, it is the joint of the last body.
    pub fn knee(&self, tree: &Tree, angles: &[f64]) -> V {
        let after = self
            .path
            .iter()
            .find(|i| **i > self.hip && tree.bodies[**i].origin.translation.vector.norm() > 0.25 * self.length);
        self.frame(tree, angles, after.copied().unwrap_or(self.end())).translation.vector
    }

    /// Frame of a body of the limb, with the base at the origin.
    pub fn frame(&self, tree: &Tree, angles: &[f64], body: usize) -> Isometry3<f64> {
        let along = self.path.iter().take_while(|i| **i <= body);
        along.fold(Isometry3::identity(), |at, i| at * moved(&tree.bodies[*i], angles[i - 1]))
    }

    /// The point that is to stand on the ground: the middle of the sole, or the lowest point.
    pub fn tip(&self, tree: &Tree, contacts: &[Vec<ContactPoint>], angles: &[f64]) -> V {
        self.tip_of(&self.frame(tree, angles, self.end()), contacts).0
    }

    /// Distance of the tip from the joint of the limb's last body, as a part of the distance of that body's farthest
    /// point; 1 for a flat sole.
    pub fn tip_distance(&self, tree: &Tree, contacts: &[Vec<ContactPoint>], angles: &[f64]) -> f64 {
        let (frame, farthest) = (self.frame(tree, angles, self.end()), farthest(&contacts[self.end()]));
        if self.sole.is_some() || farthest == 0.0 {
            return 1.0;
        }
        (self.tip_of(&frame, contacts).0 - frame.translation.vector).norm() / farthest
    }

    /// The tip, and the point of the foot whose velocity the tip has. A ball's lowest point has the velocity of the
    /// ball's centre, because another point is the lowest when the foot turns.
    fn tip_of(&self, frame: &Isometry3<f64>, contacts: &[Vec<ContactPoint>]) -> (V, V) {
        if let Some(sole) = &self.sole {
            let at = frame.transform_point(&sole.center.into()).coords;
            return (at, at);
        }
        let low = Low::of(frame, &contacts[self.end()]);
        (low.at, low.center)
    }

    /// For each joint of the limb: its body, and the tip's velocity when it moves with 1 rad/s or 1 m/s.
    pub fn velocities(&self, tree: &Tree, contacts: &[Vec<ContactPoint>], angles: &[f64]) -> Vec<(usize, V)> {
        let (_, point) = self.tip_of(&self.frame(tree, angles, self.end()), contacts);
        let mut at = Isometry3::identity();
        let mut all = Vec::with_capacity(self.path.len());
        for &i in &self.path {
            at *= moved(&tree.bodies[i], angles[i - 1]);
            let velocity = tree.bodies[i].axis(&at).map(|(kind, axis)| velocity(kind, axis, &at, &point));
            all.push((i, velocity.unwrap_or_default()));
        }
        all
    }

    /// Moves the tip to `target` (in the base's frame) and levels the sole. Searches from `first`, if given, and from
    /// `starts` other positions. Returns the solution with the least sum of `worth` and a large penalty for missing the
    /// target.
    #[allow(clippy::too_many_arguments)] // the robot, the range of the search, and what is wanted
    pub fn reach(
        &self,
        tree: &Tree,
        contacts: &[Vec<ContactPoint>],
        joints: &FreeJoints,
        target: V,
        first: Option<&[f64]>,
        starts: usize,
        worth: &impl Fn(&Reached) -> f64,
    ) -> Reached {
        let mut best: Option<(f64, Reached)> = None;
        let mut consider = |found: Reached| {
            let value = worth(&found) + 1e4 * (found.off - 1e-3).max(0.0);
            if best.as_ref().is_none_or(|(least, _)| value < *least) {
                best = Some((value, found));
            }
        };
        if let Some(first) = first {
            consider(self.descend(tree, contacts, joints, target, first.to_vec()));
        }
        for k in 0..starts {
            let mut start = first.map_or_else(|| joints.preferred.clone(), <[f64]>::to_vec);
            let own = joints.start(k, &self.moving);
            self.moving.iter().for_each(|i| start[i - 1] = own[i - 1]);
            consider(self.descend(tree, contacts, joints, target, start));
        }
        best.map_or_else(|| Reached { angles: joints.preferred.clone(), off: f64::INFINITY, bent: 0.0 }, |b| b.1)
    }

    /// Levenberg and Marquardt's method from one start. Joints at the end of their range stay there while the step
    /// would move them outward.
    fn descend(
        &self,
        tree: &Tree,
        contacts: &[Vec<ContactPoint>],
        joints: &FreeJoints,
        target: V,
        mut angles: Vec<f64>,
    ) -> Reached {
        let (mut damping, count) = (1e-3, self.moving.len());
        let mut now = self.errors(tree, contacts, joints, target, &angles);
        for _ in 0..STEPS {
            let (residual, jacobian) = (&now.residual, &now.jacobian);
            let gradient = jacobian.transpose() * residual;
            let mut free: Vec<usize> = (0..count).collect();
            free.retain(|k| {
                let ([low, high], q) = (joints.ranges[self.moving[*k] - 1], angles[self.moving[*k] - 1]);
                !(q <= low && gradient[*k] > 0.0 || q >= high && gradient[*k] < 0.0)
            });
            let part = jacobian.select_columns(&free);
            let normal = part.transpose() * &part;
            let damped = &normal + DMatrix::from_diagonal(&(normal.diagonal() * damping).add_scalar(1e-9));
            let Some(solved) = damped.cholesky() else { break };
            let step = solved.solve(&DVector::from_iterator(free.len(), free.iter().map(|k| -gradient[*k])));
            let mut trial = angles.clone();
            for (k, by) in free.iter().zip(step.iter()) {
                let i = self.moving[*k] - 1;
                trial[i] = (trial[i] + by.clamp(-0.5, 0.5)).clamp(joints.ranges[i][0], joints.ranges[i][1]);
            }
            let next = self.errors(tree, contacts, joints, target, &trial);
            let (old, new) = (residual.norm_squared(), next.residual.norm_squared());
            if new < old {
                (angles, now, damping) = (trial, next, damping * 0.3);
                if old - new < 1e-12 {
                    break;
                }
            } else if damping > 1e6 {
                break;
            } else {
                damping *= 4.0;
            }
        }
        let off = (self.tip(tree, contacts, &angles) - target).norm() / self.length;
        let bent = self.moving.iter().map(|i| (angles[i - 1] - joints.preferred[i - 1]).powi(2)).sum();
        Reached { off: off + now.tilt, angles, bent }
    }

    fn errors(
        &self,
        tree: &Tree,
        contacts: &[Vec<ContactPoint>],
        joints: &FreeJoints,
        target: V,
        angles: &[f64],
    ) -> PoseErrors {
        let count = self.moving.len();
        let (mut residual, mut jacobian) = (DVector::zeros(6 + count), DMatrix::zeros(6 + count, count));
        let frame = self.frame(tree, angles, self.end());
        let (tip, point) = self.tip_of(&frame, contacts);
        residual.fixed_rows_mut::<3>(0).copy_from(&((tip - target) / self.length));
        let up = self.sole.map(|sole| frame.rotation * sole.up);
        if let Some(up) = up {
            residual.fixed_rows_mut::<3>(3).copy_from(&((up - V::z()) * LEVEL));
        }
        let mut at = Isometry3::identity();
        for &i in &self.path {
            at *= moved(&tree.bodies[i], angles[i - 1]);
            let Some(k) = self.moving.iter().position(|m| *m == i) else { continue };
            let Some((kind, axis)) = tree.bodies[i].axis(&at) else { continue };
            jacobian.fixed_view_mut::<3, 1>(0, k).copy_from(&(velocity(kind, axis, &at, &point) / self.length));
            if let (Some(up), JointKind::Hinge) = (up, kind) {
                jacobian.fixed_view_mut::<3, 1>(3, k).copy_from(&(axis.cross(&up) * LEVEL));
            }
            residual[6 + k] = PREFERENCE * (angles[i - 1] - joints.preferred[i - 1]);
            jacobian[(6 + k, k)] = PREFERENCE;
        }
        let tilt = up.map_or(0.0, |up| ((up - V::z()).norm() - 0.01).max(0.0));
        PoseErrors { residual, jacobian, tilt }
    }

    /// How far the tip moves up and down when the joints move [m].
    pub fn travel(&self, tree: &Tree, contacts: &[Vec<ContactPoint>], joints: &FreeJoints) -> f64 {
        // Our choice: enough to see whether a limb's end moves by a tenth of its length; more take longer.
        const SAMPLES: usize = 32;
        let height = |k: usize| self.tip(tree, contacts, &joints.start(k, &self.moving)).z;
        let [low, high] = (0..SAMPLES).map(height).fold([f64::MAX, f64::MIN], |[a, b], z| [a.min(z), b.max(z)]);
        high - low
    }
}

struct PoseErrors {
    /// Position, tilt of the sole, preference.
    residual: DVector<f64>,
    jacobian: DMatrix<f64>,
    /// Tilt of the sole beyond 0.01 rad [rad].
    tilt: f64,
}

/// Velocity of a point when the joint at `at` moves with 1 rad/s or 1 m/s.
fn velocity(kind: JointKind, axis: V, at: &Isometry3<f64>, point: &V) -> V {
    match kind {
        JointKind::Hinge => axis.cross(&(point - at.translation.vector)),
        JointKind::Slide => axis,
    }
}
