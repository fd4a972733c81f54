//! A plain gait of any robot with an even number of legs, at least four: neighbouring legs step in turn. With four legs
//! this is a trot, with six an alternating tripod.

use super::TreeModel;
use super::kinematics::chain;
use super::limbs::limbs;
use nalgebra::{Isometry3, Matrix3, Vector3};
use std::f64::consts::PI;

type V = Vector3<f64>;

/// Share of a stride in which a foot is on the ground: one half, so that one of the two groups always stands.
const STANCE: f64 = 0.5;
/// Damping of the inverse kinematics, as a part of the legs' length: our choice. Directions in which a foot moves by
/// less than this for 1 rad are left out smoothly.
const STIFF: f64 = 0.1;

/// How legs step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LegStride {
    /// Strides in a second [Hz].
    pub frequency: f64,
    /// Height to which a foot is lifted [m].
    pub lift: f64,
}

/// A leg in the standing pose.
#[derive(Clone, Debug, PartialEq)]
struct SteppingLeg {
    /// The foot in the base's frame [m].
    foot: V,
    /// Does the leg step in the second half of a stride?
    second: bool,
    /// Joints, and the change of each joint's position for a displacement of the foot [rad/m].
    joints: Vec<(usize, V)>,
}

/// The gait, as offsets of the joints from the standing pose.
#[derive(Clone, Debug, PartialEq)]
pub struct AlternatingGait {
    legs: Vec<SteppingLeg>,
    joints: usize,
}

/// Which of these feet step half a stride after the others: neighbours, in the order around their middle, alternate.
pub(super) fn alternate(feet: &[V]) -> Vec<bool> {
    let middle = feet.iter().sum::<V>() / feet.len().max(1) as f64;
    let azimuth = |k: &usize| (feet[*k].y - middle.y).atan2(feet[*k].x - middle.x);
    let mut around: Vec<usize> = (0..feet.len()).collect();
    around.sort_by(|a, b| azimuth(a).total_cmp(&azimuth(b)));
    let mut second = vec![false; feet.len()];
    around.iter().skip(1).step_by(2).for_each(|k| second[*k] = true);
    second
}

impl AlternatingGait {
    /// None: the robot has fewer than four legs, or an odd number.
    pub fn of(robot: &TreeModel) -> Option<Self> {
        let (tree, stance) = (&robot.tree, &robot.stance);
        if stance.legs.len() < 4 || stance.legs.len() % 2 == 1 {
            return None;
        }
        let softness = (STIFF * stance.leg_length).powi(2);
        let leg = |limb: &super::limbs::Limb| {
            let moves = limb.velocities(tree, &robot.contacts, &stance.angles);
            let square = moves.iter().map(|(_, v)| v * v.transpose()).sum::<Matrix3<f64>>();
            // Damped least squares (Wampler, IEEE Trans. Syst. Man Cybern. 16 (1986) 93).
            let inverse = (square + Matrix3::identity() * softness).try_inverse().unwrap_or_default();
            let joints = moves.iter().map(|(body, v)| (body - 1, inverse * v)).collect();
            SteppingLeg { foot: limb.tip(tree, &robot.contacts, &stance.angles), second: false, joints }
        };
        let limbs = limbs(tree, &robot.contacts);
        let mut legs: Vec<SteppingLeg> = limbs.iter().filter(|l| stance.legs.contains(&l.path)).map(leg).collect();
        let feet: Vec<V> = legs.iter().map(|leg| leg.foot).collect();
        legs.iter_mut().zip(alternate(&feet)).for_each(|(leg, second)| leg.second = second);
        Some(Self { legs, joints: chain(tree, Isometry3::identity(), &stance.angles).len() - 1 })
    }

    /// Do legs of one group have mirror images of the other group? `images` has the image of each joint. None: some do.
    pub fn swaps(&self, images: &[usize]) -> Option<bool> {
        let group =
            |joint: usize| self.legs.iter().find(|l| l.joints.iter().any(|(j, _)| *j == joint)).map(|l| l.second);
        let mut all = self.legs.iter().filter_map(|leg| {
            let (joint, _) = leg.joints.first()?;
            Some(group(images[*joint])? != leg.second)
        });
        let first = all.next()?;
        all.all(|other| other == first).then_some(first)
    }

    /// Fills `out` with the offset of each joint [rad or m] at `phase` of a stride, 0 to 1, for a robot that is to move
    /// with `velocity`: forward, to the left [m/s], yaw [rad/s].
    pub fn offsets(&self, stride: LegStride, velocity: [f64; 3], phase: f64, out: &mut [f64]) {
        let [vx, vy, turn] = velocity;
        out[..self.joints].fill(0.0);
        for leg in &self.legs {
            let half =
                V::new(vx - turn * leg.foot.y, vy + turn * leg.foot.x, 0.0) * (STANCE / (2.0 * stride.frequency));
            let own = (phase + if leg.second { 0.5 } else { 0.0 }).rem_euclid(1.0);
            let moved = if own < STANCE {
                half * (1.0 - 2.0 * own / STANCE)
            } else {
                let swing = PI * (own - STANCE) / (1.0 - STANCE);
                V::z() * (stride.lift * swing.sin()) - half * swing.cos()
            };
            leg.joints.iter().for_each(|(joint, by)| out[*joint] += by.dot(&moved));
        }
    }
}
