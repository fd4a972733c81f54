//! Inverse kinematics of a limb: the positions of its joints with which the tip is at a given place.

use super::contact::ContactPoint;
use super::free_joints::FreeJoints;
use super::kinematics::moved;
use super::limbs::{Limb, velocity};
use super::{JointKind, Tree};
use nalgebra::{DMatrix, DVector, Isometry3, Vector3};

type V = Vector3<f64>;

/// Steps of Levenberg and Marquardt's method: our choice; most searches need ten.
pub const STEPS: usize = 40;
/// Weight of a joint's distance from its preferred position [1/rad], relative to distances of the tip in lengths of the
/// limb: our choice. The weight selects among the solutions; it shifts the foot by less than a thousandth of the limb's
/// length.
const PREFERENCE: f64 = 0.02;
/// Weight of the sole's tilt [1/rad]: our choice, so that a search reaches tilt and position equally well.
const LEVEL: f64 = 0.3;

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

impl Limb {
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
