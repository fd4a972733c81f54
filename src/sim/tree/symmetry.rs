//! The left–right symmetry of a robot, from its geometry in the standing pose. A robot is symmetric if each joint and each
//! body has a mirror image across the base's x–z plane: another joint or body, or itself. Names and masses are not used.
//!
//! The mirror S = diag(1, −1, 1) takes a point p to S p. A hinge's axis is a pseudovector: its image is −S a. So if a
//! hinge with axis a has the image hinge with axis b = −s S a, s = ±1, the positions off the standing pose mirror as
//! q_b = s q_a. For a slide, whose axis is a vector, b = s S a.

use super::flight::{TreePose, accelerations};
use super::kinematics::{frames, lowest};
use super::{JointKind, Tree, TreeModel};
use crate::State;
use crate::error::{Error, Result};
use crate::sand::GRAVITY;
use nalgebra::{Isometry3, Vector3};

type V = Vector3<f64>;

/// Largest distance between a joint's axis and the mirrored axis of its image, and between the heights of their bodies' lowest
/// points, as a share of the robot's size: our choice, some millimetres, more than the errors of drawings.
const PLACE: f64 = 0.02;
/// Least cosine of the angle between axes: our choice, 2.6°, more than the rounding of files.
const ALONG: f64 = 0.999;
/// Difference between the accelerations of a mirrored robot and the mirrored accelerations, as a share of them, from which on
/// the robot counts as lopsided: our choice. Real robots carry their computers and batteries away from the middle plane; a
/// symmetric policy suits them, too, because it feels how they lean.
const ACCELERATIONS: f64 = 0.25;
/// Poses in which accelerations are compared: our choice. In each pose all joints are turned, moving and driven, so few
/// suffice.
const POSES: usize = 4;

/// For each joint the joint on the other side, or itself, and the sign of its position.
#[derive(Clone, Debug, PartialEq)]
pub struct LeftRight {
    pub joints: Vec<usize>,
    pub signs: Vec<f64>,
}

/// A body in the standing pose.
struct StandingBody {
    /// Direction of the joint's axis; zero for the base.
    axis: V,
    /// A point of the axis.
    at: V,
    center: V,
    /// Height of the body's lowest point, if the body has points of contact. The horizontal position of this point is
    /// not compared, because any point of a level side may be the lowest.
    low: Option<f64>,
}

/// The largest distance of a joint or a body's centre from the base's origin [m].
fn size(all: &[StandingBody]) -> f64 {
    all.iter().flat_map(|s| [s.at, s.center]).map(|p| p.norm()).fold(1e-9, f64::max)
}

fn mirrored(v: V) -> V {
    V::new(v.x, -v.y, v.z)
}

fn standing(robot: &TreeModel) -> Vec<StandingBody> {
    let level = State::at_rest(0.0, &robot.stance.angles);
    let one = |((body, frame), points): ((&super::TreeBody, &Isometry3<f64>), &Vec<super::contact::ContactPoint>)| {
        let low = lowest(frame, points).z;
        StandingBody {
            axis: body.axis(frame).map_or(V::zeros(), |(_, axis)| axis),
            at: frame.translation.vector,
            center: frame.transform_point(&body.center.into()).coords,
            low: low.is_finite().then_some(low),
        }
    };
    robot.tree.bodies.iter().zip(&frames(&robot.tree, &level)).zip(robot.contacts.iter()).map(one).collect()
}

impl LeftRight {
    /// Finds the symmetry; the error names what has no mirror image.
    pub fn of(robot: &TreeModel) -> Result<Self> {
        let (tree, all) = (&robot.tree, standing(robot));
        let size = size(&all);
        let mut images: Vec<Option<(usize, f64)>> = vec![None; tree.bodies.len()];
        let mut taken = vec![false; tree.bodies.len()];
        (images[0], taken[0]) = (Some((0, 1.0)), true);
        for (i, body) in tree.bodies.iter().enumerate().skip(1) {
            let parent = images[body.parent].map_or(0, |(image, _)| image);
            let candidates = (1..tree.bodies.len()).filter(|k| !taken[*k] && tree.bodies[*k].parent == parent);
            let fits = candidates.filter_map(|k| Some((k, sign(tree, &all, [i, k], PLACE * size)?)));
            // Several bodies may fit, because two wheels on one axle have the same axis; the image is the nearest of them.
            let off = |k: usize| (mirrored(all[i].center) - all[k].center).norm();
            let best = fits.min_by(|a, b| off(a.0).total_cmp(&off(b.0)));
            let (image, sign) = best.ok_or_else(|| {
                let joint = body.joint.as_ref().map_or("", |j| &j.name);
                none(&format!("in the standing pose joint {joint:?} has no mirror image on the other side"))
            })?;
            (images[i], taken[image]) = (Some((image, sign)), true);
        }
        let pairs: Vec<(usize, f64)> = images.into_iter().flatten().skip(1).map(|(i, sign)| (i - 1, sign)).collect();
        let found = Self { joints: pairs.iter().map(|p| p.0).collect(), signs: pairs.iter().map(|p| p.1).collect() };
        if let Some(k) = (0..pairs.len()).find(|k| found.joints[found.joints[*k]] != *k) {
            let name = tree.joints().nth(k).map_or("", |j| &j.name);
            return Err(none(&format!("the mirror image of joint {name:?} is not mirrored back to it")));
        }
        Ok(found)
    }

    /// How much the accelerations of the mirrored robot differ from the mirrored accelerations because of its masses, as
    /// a share of them, if they differ clearly.
    pub fn lopsided(&self, robot: &TreeModel) -> Option<f64> {
        Some(self.off(robot, size(&standing(robot)))).filter(|off| *off > ACCELERATIONS)
    }

    /// The mirror image of a position and motion whose joints stand at `rest` in the standing pose.
    pub fn pose(&self, rest: &[f64], pose: &TreePose) -> TreePose {
        let [w, x, y, z] = pose.quat;
        let ([vx, vy, vz], [wx, wy, wz]) = (pose.v, pose.w);
        let off: Vec<f64> = pose.q.iter().zip(rest).map(|(q, rest)| q - rest).collect();
        TreePose {
            quat: [w, -x, y, -z],
            v: [vx, -vy, vz],
            w: [-wx, wy, -wz],
            q: self.swap(&off).iter().zip(rest).map(|(off, rest)| off + rest).collect(),
            qd: self.swap(&pose.qd),
            tau: self.swap(&pose.tau),
        }
    }

    /// The mirror image of one number for each joint, which is zero in the standing pose.
    pub fn swap(&self, values: &[f64]) -> Vec<f64> {
        let mut out = vec![0.0; values.len()];
        for ((value, image), sign) in values.iter().zip(&self.joints).zip(&self.signs) {
            out[*image] = sign * value;
        }
        out
    }

    /// Largest difference of the accelerations of mirrored robots in some poses, as a share of the accelerations.
    fn off(&self, robot: &TreeModel, size: f64) -> f64 {
        let (rest, torque) = (&robot.stance.angles, 0.05 * robot.mass() * GRAVITY * size);
        // Multiples of the golden ratio without their whole part are spread evenly; scaled to [−1, 1).
        let mut k = 0.0;
        let mut draw = || {
            k += 1.0;
            2.0 * (k * 0.618_033_988_749_895_f64).fract() - 1.0
        };
        let one = || {
            let w: [f64; 3] = std::array::from_fn(|_| draw());
            let all: Vec<[f64; 3]> = rest.iter().map(|_| [0.3 * draw(), 3.0 * draw(), torque * draw()]).collect();
            let part = |i: usize| all.iter().map(|x| x[i]).collect::<Vec<_>>();
            let q = part(0).iter().zip(rest).map(|(off, rest)| off + rest).collect();
            let pose = TreePose { quat: [1.0, 0.0, 0.0, 0.0], v: [0.0; 3], w, q, qd: part(1), tau: part(2) };
            let (here, there) =
                (accelerations(&robot.tree, &pose), accelerations(&robot.tree, &self.pose(rest, &pose)));
            let ([ax, ay, az], [bx, by, bz]) = (here.a, here.alpha);
            let share = |wanted: &[f64], got: &[f64]| {
                let square = |x: &[f64]| x.iter().map(|x| x * x).sum::<f64>();
                let apart: Vec<f64> = wanted.iter().zip(got).map(|(a, b)| a - b).collect();
                (square(&apart) / square(wanted).max(1e-12)).sqrt()
            };
            let joints = share(&self.swap(&here.qdd), &there.qdd);
            joints.max(share(&[ax, -ay, az], &there.a)).max(share(&[-bx, by, -bz], &there.alpha))
        };
        std::iter::repeat_with(one).take(POSES).fold(0.0, f64::max)
    }
}

/// The factor, 1 or −1, from the position of body i's joint to the mirrored position of body k's joint; None if the
/// bodies are not mirror images of each other within `most` [m].
fn sign(tree: &Tree, all: &[StandingBody], [i, k]: [usize; 2], most: f64) -> Option<f64> {
    let (a, b) = (tree.bodies[i].joint.as_ref()?, tree.bodies[k].joint.as_ref()?);
    let turn = if a.kind == JointKind::Hinge { -1.0 } else { 1.0 };
    let along = all[k].axis.dot(&(turn * mirrored(all[i].axis)));
    let apart = mirrored(all[i].at) - all[k].at;
    // The position of a hinge along its axis has no effect, and neither has any part of a slide's position.
    let off = if a.kind == JointKind::Hinge { (apart - all[k].axis * apart.dot(&all[k].axis)).norm() } else { 0.0 };
    let low = match (all[i].low, all[k].low) {
        (Some(a), Some(b)) => (a - b).abs(),
        (None, None) => 0.0,
        _ => f64::INFINITY,
    };
    let fits = a.kind == b.kind && along.abs() > ALONG && off < most && low < most;
    fits.then(|| along.signum())
}

fn none(why: &str) -> Error {
    Error::invalid("robot", format!("it is not symmetric in left and right: {why}"))
}
