//! The symmetry of a robot, from its geometry in the standing pose. A robot is symmetric if each joint and each body has a
//! mirror image across a plane of the base: another joint or body, or itself. The plane is x–z, between left and right, or
//! else y–z, between front and back, because some files have a robot's front along y. Names and masses are not used.
//!
//! The mirror S, diag(1, −1, 1) or diag(−1, 1, 1), takes a point p to S p. A hinge's axis is a pseudovector: its image is
//! −S a. So if a hinge with axis a has the image hinge with axis b = −s S a, s = ±1, the positions off the standing pose
//! mirror as q_b = s q_a. For a slide, whose axis is a vector, b = s S a.

use super::contact::ContactPoint;
use super::flight::{TreePose, accelerations};
use super::kinematics::{chain, lowest};
use super::{JointKind, Tree, TreeBody, TreeModel};
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

/// What a mirror exchanges.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sides {
    /// The mirror is the base's x–z plane.
    LeftRight,
    /// The mirror is the base's y–z plane.
    FrontBack,
}

impl Sides {
    /// The coordinate that changes its sign: 0 for x, 1 for y.
    pub fn across(self) -> usize {
        match self {
            Self::LeftRight => 1,
            Self::FrontBack => 0,
        }
    }

    pub fn name(self) -> &'static str {
        match self {
            Self::LeftRight => "left and right",
            Self::FrontBack => "front and back",
        }
    }

    /// The mirror image S v of a vector.
    fn vector(self, mut v: V) -> V {
        v[self.across()] *= -1.0;
        v
    }

    /// The mirror image −S v of a rotation, such as an angular velocity.
    fn rotation(self, v: V) -> V {
        -self.vector(v)
    }
}

/// For each joint the joint on the other side, or itself, and the sign of its position.
#[derive(Clone, Debug, PartialEq)]
pub struct Symmetry {
    pub sides: Sides,
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

fn standing(tree: &Tree, contacts: &[Vec<ContactPoint>], angles: &[f64]) -> Vec<StandingBody> {
    let one = |((body, frame), points): ((&TreeBody, &Isometry3<f64>), &Vec<ContactPoint>)| {
        let low = lowest(frame, points).z;
        StandingBody {
            axis: body.axis(frame).map_or(V::zeros(), |(_, axis)| axis),
            at: frame.translation.vector,
            center: frame.transform_point(&body.center.into()).coords,
            low: low.is_finite().then_some(low),
        }
    };
    tree.bodies.iter().zip(&chain(tree, Isometry3::identity(), angles)).zip(contacts).map(one).collect()
}

impl Symmetry {
    /// Finds the symmetry of left and right, or else that of front and back; the error names what has no mirror image on
    /// the other side.
    pub fn of(robot: &TreeModel) -> Result<Self> {
        let (tree, contacts, angles) = (&robot.tree, &robot.contacts, &robot.stance.angles);
        let apart = match Self::at(tree, contacts, angles, Sides::LeftRight) {
            Ok(found) => return Ok(found),
            Err(apart) => apart,
        };
        Self::at(tree, contacts, angles, Sides::FrontBack).map_err(|_| apart)
    }

    /// The symmetry of a robot with joints at `angles`.
    pub fn at(tree: &Tree, contacts: &[Vec<ContactPoint>], angles: &[f64], sides: Sides) -> Result<Self> {
        let all = standing(tree, contacts, angles);
        let size = size(&all);
        let mut images: Vec<Option<(usize, f64)>> = vec![None; tree.bodies.len()];
        let mut taken = vec![false; tree.bodies.len()];
        (images[0], taken[0]) = (Some((0, 1.0)), true);
        for (i, body) in tree.bodies.iter().enumerate().skip(1) {
            let parent = images[body.parent].map_or(0, |(image, _)| image);
            let candidates = (1..tree.bodies.len()).filter(|k| !taken[*k] && tree.bodies[*k].parent == parent);
            let fits = candidates.filter_map(|k| Some((k, sign(tree, &all, [i, k], PLACE * size, sides)?)));
            // Several bodies may fit, because two wheels on one axle have the same axis; the image is the nearest of them.
            let off = |k: usize| (sides.vector(all[i].center) - all[k].center).norm();
            let best = fits.min_by(|a, b| off(a.0).total_cmp(&off(b.0)));
            let (image, sign) = best.ok_or_else(|| {
                let joint = body.joint.as_ref().map_or("", |j| &j.name);
                none(&format!("in the standing pose joint {joint:?} has no mirror image on the other side"))
            })?;
            (images[i], taken[image]) = (Some((image, sign)), true);
        }
        let pairs: Vec<(usize, f64)> = images.into_iter().flatten().skip(1).map(|(i, sign)| (i - 1, sign)).collect();
        let joints: Vec<usize> = pairs.iter().map(|p| p.0).collect();
        if let Some(k) = (0..pairs.len()).find(|k| joints[joints[*k]] != *k) {
            let name = tree.joints().nth(k).map_or("", |j| &j.name);
            return Err(none(&format!("the mirror image of joint {name:?} is not mirrored back to it")));
        }
        Ok(Self { sides, joints, signs: pairs.iter().map(|p| p.1).collect() })
    }

    /// The mean of a pose and its mirror image; joints are at `rest` where the robot is symmetric.
    pub fn evened(&self, rest: &[f64], angles: &[f64]) -> Vec<f64> {
        let off: Vec<f64> = angles.iter().zip(rest).map(|(q, rest)| q - rest).collect();
        off.iter().zip(self.swap(&off)).zip(rest).map(|((own, other), rest)| rest + (own + other) / 2.0).collect()
    }

    /// How much the accelerations of the mirrored robot differ from the mirrored accelerations because of its masses, as
    /// a share of them, if they differ clearly.
    pub fn lopsided(&self, robot: &TreeModel) -> Option<f64> {
        Some(self.off(robot)).filter(|off| *off > ACCELERATIONS)
    }

    /// The mirror image of a position and motion whose joints stand at `rest` in the standing pose.
    pub fn pose(&self, rest: &[f64], pose: &TreePose) -> TreePose {
        let [w, x, y, z] = pose.quat;
        let [x, y, z] = self.sides.rotation(V::new(x, y, z)).into();
        let off: Vec<f64> = pose.q.iter().zip(rest).map(|(q, rest)| q - rest).collect();
        TreePose {
            quat: [w, x, y, z],
            v: self.sides.vector(pose.v.into()).into(),
            w: self.sides.rotation(pose.w.into()).into(),
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
    fn off(&self, robot: &TreeModel) -> f64 {
        let size = size(&standing(&robot.tree, &robot.contacts, &robot.stance.angles));
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
            let (a, alpha) = (self.sides.vector(here.a.into()), self.sides.rotation(here.alpha.into()));
            let share = |wanted: &[f64], got: &[f64]| {
                let square = |x: &[f64]| x.iter().map(|x| x * x).sum::<f64>();
                let apart: Vec<f64> = wanted.iter().zip(got).map(|(a, b)| a - b).collect();
                (square(&apart) / square(wanted).max(1e-12)).sqrt()
            };
            let joints = share(&self.swap(&here.qdd), &there.qdd);
            joints.max(share(a.as_slice(), &there.a)).max(share(alpha.as_slice(), &there.alpha))
        };
        std::iter::repeat_with(one).take(POSES).fold(0.0, f64::max)
    }
}

/// The factor, 1 or −1, from the position of body i's joint to the mirrored position of body k's joint; None if the
/// bodies are not mirror images of each other within `most` [m].
fn sign(tree: &Tree, all: &[StandingBody], [i, k]: [usize; 2], most: f64, sides: Sides) -> Option<f64> {
    let (a, b) = (tree.bodies[i].joint.as_ref()?, tree.bodies[k].joint.as_ref()?);
    let turned = a.kind == JointKind::Hinge;
    let along = all[k].axis.dot(&if turned { sides.rotation(all[i].axis) } else { sides.vector(all[i].axis) });
    let apart = sides.vector(all[i].at) - all[k].at;
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
