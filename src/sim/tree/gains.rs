//! Servo gains of joints for which the file has none, from the robot's weight, the length of its legs, and the wanted
//! natural frequency of the robot on its legs.
//!
//! A robot of weight W stands on n legs of length ℓ. On its legs it is to be a mass on a spring with ω² = 20 g/ℓ, so
//! its weight lowers it by ℓ/20. Joint i of a leg moves the foot up and down with the lever rᵢ. If all joints of the
//! leg have the gain kp, the leg's stiffness is kp/Σrᵢ², so
//!
//! ```text
//!  kp = (W/n) max(20 Σ rᵢ²/ℓ, p),   kd = 2 ζ kp/ω,   ζ = 0.3
//! ```
//!
//! The term p is for a leg that stands straight and so has small levers. With at least four feet a robot can sway to
//! the side on legs that stay parallel: if it moves by x, each hip turns by x/ℓ, and the weight does the work W
//! x²/(2ℓ). It comes back if turning the hips takes more work than this, n kp x²/(2ℓ²), so kp must be above (W/n) ℓ. A leg
//! also buckles at its joints: if they turn by q, the load does the work (W/n) qᵀHq/2, where H has the second derivatives
//! of the foot's height by the joints' angles, so kp must be above (W/n) λ, λ the largest eigenvalue of H. A straight leg
//! of two equal links has λ = 1.31 ℓ, one whose knees stand above the hips has more. We take p = 1.5 times the larger of
//! ℓ and λ. Other robots can tip over about their feet. If the centre of mass, at the height h, moves aside by
//! x, the weight turns each joint, at the height yᵢ, by W x/(n kp). These turns together move the centre of mass by Σ
//! (h − yᵢ) W x/(n kp). The robot falls if this is more than x, so kp must be above (W/n) Σ (h − yᵢ). p is 3 times this
//! sum, over the joints whose axes are horizontal, for motions forward or to the side, whichever is larger. A joint
//! outside of the legs carries a mass m with its centre at the distance r: kp = 10 m g r, so gravity moves the joint by
//! at most 0.1 rad, and ω² = 10 g/r. All numbers are our choice. For A1, W/n = 29 N, ℓ = 0.3 m and Σr² = 0.02 m² they
//! give 39 N·m/rad and 0.9 N·m·s/rad; legged_gym takes 20 and 0.5, under which A1 sinks twice as far.

use super::contact::ContactPoint;
use super::kinematics::{chain, lowest};
use super::stance::Stance;
use super::{JointKind, Tree, TreeJoint};
use crate::actuator::Actuator;
use nalgebra::{DMatrix, Isometry3, Vector2, Vector3};

type V = Vector3<f64>;

/// ω² ℓ/g of a robot on its legs: our choice, because its weight then lowers it by some ℓ/20. Larger ones make stiff
/// legs.
const LEGS: f64 = 20.0;
/// ω² r/g of other joints: our choice, because gravity then moves the joint by at most 0.1 rad.
const OTHERS: f64 = 10.0;
/// ζ, damping ratio: our choice, because kd/kp of A1 is then nearly that of legged_gym: 0.023 s, and 0.5/20 = 0.025 s.
const DAMPING: f64 = 0.3;
/// A joint that follows another is stiffer by this factor, with the same damping ratio: our choice, because the load of
/// a robot that stands then moves the joint by at most some 2 mrad.
const FOLLOWING: f64 = 100.0;
/// Ratio of kp to the kp at which a robot with at least four feet sways, or its legs buckle: our choice.
const POSTURE: f64 = 1.5;
/// Ratio of kp to the kp at which a robot with fewer than four feet tips over: our choice. Near 1 it comes back slowly
/// from a push, and larger values make stiff legs.
const UPRIGHT: f64 = 3.0;
/// Smallest distance of a centre of mass from its joint, and smallest length of a leg [m]: our choice, because a part
/// that is balanced about its joint would have no gain, and a leg without length an infinite one.
const NEAREST: f64 = 0.01;

/// A joint's motor and servo.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TreeMotor {
    /// [N·m/rad]
    pub kp: f64,
    /// [N·m·s/rad]
    pub kd: f64,
    /// Largest speed of the reference [rad/s]; None: no known limit.
    pub speed_limit: Option<f64>,
    pub actuator: Actuator,
}

/// kp and kd of a joint without known gains [N·m/rad, N·m·s/rad].
#[derive(Clone, Copy, Debug, PartialEq)]
struct Gains {
    kp: f64,
    kd: f64,
}

impl Gains {
    /// `softness`: g/ω² [m].
    fn of(kp: f64, softness: f64, gravity: f64) -> Self {
        let omega = (gravity / softness).sqrt();
        Self { kp, kd: 2.0 * DAMPING * kp / omega }
    }
}

/// The motors of all joints.
pub fn motors(tree: &Tree, contacts: &[Vec<ContactPoint>], stance: &Stance) -> Vec<TreeMotor> {
    let frames = chain(tree, Isometry3::identity(), &stance.angles);
    let mut found = carriers(tree, &frames, stance);
    for leg in &stance.legs {
        let gains = of_leg(tree, contacts, &frames, stance, leg);
        leg.iter().for_each(|i| {
            if gains.kp > found[i - 1].kp {
                found[i - 1] = gains;
            }
        });
    }
    for follower in tree.followers() {
        let own = &mut found[follower.joint];
        *own = Gains { kp: own.kp * FOLLOWING, kd: own.kd * FOLLOWING.sqrt() };
    }
    let motor = |(joint, own): (&TreeJoint, &Gains)| {
        let kp = joint.kp.unwrap_or(own.kp);
        TreeMotor {
            kp,
            kd: joint.kd.unwrap_or(if own.kp > 0.0 { kp * own.kd / own.kp } else { 0.0 }),
            speed_limit: joint.speed_limit,
            actuator: Actuator {
                torque_limit: joint.torque_limit,
                no_load_speed: joint.motor.no_load_speed.or(joint.speed_limit),
                ..joint.motor
            },
        }
    };
    tree.joints().zip(&found).map(motor).collect()
}

/// Gains of the joints of one leg; sliding joints get the gains of the whole leg, in N/m and N·s/m.
fn of_leg(
    tree: &Tree,
    contacts: &[Vec<ContactPoint>],
    frames: &[Isometry3<f64>],
    stance: &Stance,
    leg: &[usize],
) -> Gains {
    let (end, count) = (leg[leg.len() - 1], stance.legs.len());
    let tip = standing_point(&frames[end], &contacts[end], stance.hips_height());
    let square = |i: &usize| {
        let axis = tree.bodies[*i].hinge_axis(&frames[*i])?;
        Some(axis.cross(&(tip - frames[*i].translation.vector)).z.powi(2))
    };
    let length = stance.leg_length.max(NEAREST);
    let load = tree.mass() * tree.gravity() / count as f64;
    let posture = match count {
        ..4 => UPRIGHT * tipping(tree, frames, leg, tip.z),
        _ => POSTURE * length.max(buckling(tree, frames, leg, tip)),
    };
    let levers: f64 = leg.iter().filter_map(square).sum();
    Gains::of(load * (LEGS * levers / length).max(posture), length / LEGS, tree.gravity())
}

/// Largest eigenvalue of the second derivatives of the foot's height by the angles of the leg's hinges [m/rad²].
fn buckling(tree: &Tree, frames: &[Isometry3<f64>], leg: &[usize], tip: V) -> f64 {
    let hinge = |i: &usize| Some((tree.bodies[*i].hinge_axis(&frames[*i])?, tip - frames[*i].translation.vector));
    let hinges: Vec<(V, V)> = leg.iter().filter_map(hinge).collect();
    if hinges.is_empty() {
        return 0.0; // all joints slide
    }
    // A hinge that is nearer to the base turns what another one does to the foot.
    let by = |i: usize, j: usize| {
        let (near, (axis, arm)) = (hinges[i.min(j)].0, hinges[i.max(j)]);
        near.cross(&axis.cross(&arm)).z
    };
    DMatrix::from_fn(hinges.len(), hinges.len(), by).symmetric_eigenvalues().iter().copied().fold(0.0, f64::max)
}

/// Σ (h − yᵢ) over the hinges of a leg, about the horizontal axis for which it is larger [m]. `ground`: height of the foot.
fn tipping(tree: &Tree, frames: &[Isometry3<f64>], leg: &[usize], ground: f64) -> f64 {
    let center = tree.center_of_mass(frames).z;
    let arms = leg.iter().filter_map(|i| {
        let axis = tree.bodies[*i].hinge_axis(&frames[*i])?;
        let arm = center - frames[*i].translation.vector.z.max(ground);
        Some(axis.xy().map(|a| a * a) * arm.max(0.0))
    });
    arms.sum::<Vector2<f64>>().max()
}

/// The middle of a foot's points that are on the ground.
fn standing_point(frame: &Isometry3<f64>, points: &[ContactPoint], height: f64) -> V {
    let low = lowest(frame, points);
    let single = points.iter().map(|p| lowest(frame, std::slice::from_ref(p)));
    let near: Vec<V> = single.filter(|p| p.z < low.z + 0.02 * height).collect();
    if near.is_empty() { low } else { near.iter().sum::<V>() / near.len() as f64 }
}

/// Gains of each joint from the masses that it carries.
fn carriers(tree: &Tree, frames: &[Isometry3<f64>], stance: &Stance) -> Vec<Gains> {
    let mut sums: Vec<(f64, V)> = frames.iter().zip(&tree.bodies).map(|(f, b)| (b.mass, b.moment(f))).collect();
    for i in (1..tree.bodies.len()).rev() {
        let (mass, moment) = sums[i];
        let parent = &mut sums[tree.bodies[i].parent];
        (parent.0, parent.1) = (parent.0 + mass, parent.1 + moment);
    }
    let gains = |i: usize| {
        let (mass, moment) = sums[i];
        let Some((kind, axis)) = tree.bodies[i].axis(&frames[i]).filter(|_| mass > 0.0) else {
            return Gains { kp: 0.0, kd: 0.0 };
        };
        match kind {
            JointKind::Hinge => {
                let arm = (moment / mass - frames[i].translation.vector).cross(&axis).norm().max(NEAREST);
                Gains::of(OTHERS * mass * tree.gravity() * arm, arm / OTHERS, tree.gravity())
            }
            JointKind::Slide => {
                let length = stance.leg_length.max(NEAREST);
                Gains::of(LEGS * mass * tree.gravity() / length, length / LEGS, tree.gravity())
            }
        }
    };
    (1..tree.bodies.len()).map(gains).collect()
}
