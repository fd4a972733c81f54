//! Plain gaits of any robot with an even number of legs, at least four. In the alternating gait neighbouring legs step in turn:
//! with four legs this is a trot, with six an alternating tripod. In a wave gait the legs of a side step one after the other from
//! the back to the front, half a stride after those of the other side (Wilson, Annual Review of Entomology 11:103, 1966), so that
//! more legs carry the robot.

use super::TreeModel;
use super::kinematics::chain;
use super::limbs::limbs;
use nalgebra::{Isometry3, Matrix3, Vector3};
use std::f64::consts::PI;

type V = Vector3<f64>;

/// Damping of the inverse kinematics, as a part of the legs' length: our choice. Directions in which a foot moves by
/// less than this for 1 rad are left out smoothly.
const STIFF: f64 = 0.1;

/// The order in which legs step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StepOrder {
    Alternating,
    Wave,
}

/// Feet that are less far from the middle than this part of the outermost foot are at no side: our choice.
const BESIDE: f64 = 0.1;

/// A wave in which more than one leg is in the air is called a ripple gait.
const RIPPLE: f64 = 0.75;

/// How legs step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LegStride {
    pub order: StepOrder,
    /// Share of a stride in which a foot is on the ground.
    pub duty_factor: f64,
    /// Strides in a second [Hz].
    pub frequency: f64,
    /// Height to which a foot is lifted [m].
    pub lift: f64,
}

impl LegStride {
    /// The gait in the words of the field; with six legs the alternating one is the tripod.
    pub fn name(&self) -> &'static str {
        match (self.order, self.duty_factor > RIPPLE) {
            (StepOrder::Alternating, _) => "alternating gait",
            (StepOrder::Wave, false) => "ripple gait",
            (StepOrder::Wave, true) => "wave gait",
        }
    }
}

/// A leg in the standing pose.
#[derive(Clone, Debug, PartialEq)]
struct SteppingLeg {
    /// The foot in the base's frame [m].
    foot: V,
    /// By which part of a stride it is ahead of the first leg, in either order; None: the robot has no wave gait.
    alternating: f64,
    wave: Option<f64>,
    /// Joints, and the change of each joint's position for a displacement of the foot [rad/m].
    joints: Vec<(usize, V)>,
}

/// The gait, as offsets of the joints from the standing pose.
#[derive(Clone, Debug, PartialEq)]
pub struct PlainGait {
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

/// By which part of a stride each of these feet is ahead in a wave gait; None: the two sides have not equally many.
fn wave(feet: &[V]) -> Option<Vec<f64>> {
    let middle = feet.iter().sum::<V>() / feet.len().max(1) as f64;
    let reach = feet.iter().map(|foot| (foot.y - middle.y).abs()).fold(0.0, f64::max);
    let mut ahead = vec![0.0; feet.len()];
    for (side, start) in [(1.0, 0.0), (-1.0, 0.5)] {
        let beside = |k: &usize| side * (feet[*k].y - middle.y) > BESIDE * reach;
        let mut own: Vec<usize> = (0..feet.len()).filter(beside).collect();
        if 2 * own.len() != feet.len() {
            return None;
        }
        own.sort_by(|a, b| feet[*b].x.total_cmp(&feet[*a].x));
        let count = own.len() as f64;
        own.iter().enumerate().for_each(|(place, k)| ahead[*k] = (start + place as f64 / count) % 1.0);
    }
    Some(ahead)
}

impl PlainGait {
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
            let foot = limb.tip(tree, &robot.contacts, &stance.angles);
            SteppingLeg { foot, alternating: 0.0, wave: None, joints }
        };
        let limbs = limbs(tree, &robot.contacts);
        let mut legs: Vec<SteppingLeg> = limbs.iter().filter(|l| stance.legs.contains(&l.path)).map(leg).collect();
        let feet: Vec<V> = legs.iter().map(|leg| leg.foot).collect();
        let wave = wave(&feet);
        for (k, (leg, second)) in legs.iter_mut().zip(alternate(&feet)).enumerate() {
            leg.alternating = if second { 0.5 } else { 0.0 };
            leg.wave = wave.as_ref().map(|ahead| ahead[k]);
        }
        Some(Self { legs, joints: chain(tree, Isometry3::identity(), &stance.angles).len() - 1 })
    }

    /// Do legs of one group of the alternating gait have mirror images of the other group? `images` has the image of each joint. None: some do.
    pub fn swaps(&self, images: &[usize]) -> Option<bool> {
        let group =
            |joint: usize| self.legs.iter().find(|l| l.joints.iter().any(|(j, _)| *j == joint)).map(|l| l.alternating);
        let mut all = self.legs.iter().filter_map(|leg| {
            let (joint, _) = leg.joints.first()?;
            Some(group(images[*joint])? != leg.alternating)
        });
        let first = all.next()?;
        all.all(|other| other == first).then_some(first)
    }

    /// Can the legs step in a wave?
    pub fn has_wave(&self) -> bool {
        self.legs.iter().all(|leg| leg.wave.is_some())
    }

    /// Fills `out` with the offset of each joint [rad or m] at `phase` of a stride, 0 to 1, for a robot that is to move
    /// with `velocity`: forward, to the left [m/s], yaw [rad/s].
    pub fn offsets(&self, stride: LegStride, velocity: [f64; 3], phase: f64, out: &mut [f64]) {
        let [vx, vy, turn] = velocity;
        out[..self.joints].fill(0.0);
        for leg in &self.legs {
            let stance = stride.duty_factor;
            let half =
                V::new(vx - turn * leg.foot.y, vy + turn * leg.foot.x, 0.0) * (stance / (2.0 * stride.frequency));
            let ahead = leg.wave.filter(|_| stride.order == StepOrder::Wave).unwrap_or(leg.alternating);
            let own = (phase + ahead).rem_euclid(1.0);
            let moved = if own < stance {
                half * (1.0 - 2.0 * own / stance)
            } else {
                let swing = PI * (own - stance) / (1.0 - stance);
                V::z() * (stride.lift * swing.sin()) - half * swing.cos()
            };
            leg.joints.iter().for_each(|(joint, by)| out[*joint] += by.dot(&moved));
        }
    }
}
