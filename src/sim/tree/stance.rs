//! The standing pose of a tree robot: its feet, its joints, and the positions of its points of contact.

use super::contact::ContactPoint;
use super::{JointKind, Tree};
use crate::State;
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};

type V = Vector3<f64>;

/// Share of its longest reach to which a leg is extended if the file gives no pose: our choice, close to Go1's usual
/// stance (0.27 m of 0.43 m, or 0.64; with 0.7 the torques at the knees are smaller).
const REACH: f64 = 0.7;
/// Largest position of a joint that is tried [rad or m].
const FARTHEST: f64 = 2.8;
/// Start positions of each of the last two joints in a search, and rounds of descent: our choice, which converges
/// to 1e-6 m.
const GRID: usize = 12;
const ROUNDS: usize = 60;

/// Largest number of frames that all searches of a robot compute: our choice, about a second. Two thousand times what a
/// quadruped needs; a chain of hundreds of joints gets fewer rounds.
const MOST_FRAMES: usize = 10_000_000;

/// A robot's standing pose.
#[derive(Clone, Debug, PartialEq)]
pub struct Stance {
    /// Positions of the joints: from the file, or searched.
    pub angles: Vec<f64>,
    /// Feet: bodies that stand on the ground, each the last of its branch with points of contact.
    pub feet: Vec<usize>,
}

/// Frames of all bodies in the world.
pub fn frames(tree: &Tree, state: &State) -> Vec<Isometry3<f64>> {
    let [w, x, y, z] = state.orientation;
    let turn = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
    let base = Isometry3::from_parts(Translation3::from(V::from(state.position)), turn);
    chain(tree, base, &state.angles)
}

fn chain(tree: &Tree, base: Isometry3<f64>, angles: &[f64]) -> Vec<Isometry3<f64>> {
    let mut all = Vec::with_capacity(tree.bodies.len());
    all.push(base);
    for (body, q) in (1..tree.bodies.len()).zip(angles) {
        all.push(joined(tree, body, &all[tree.bodies[body].parent], *q));
    }
    all
}

/// The frame of a body whose joint is at `q`, on its parent's frame.
fn joined(tree: &Tree, body: usize, parent: &Isometry3<f64>, q: f64) -> Isometry3<f64> {
    let body = &tree.bodies[body];
    let moved = match &body.joint {
        Some(j) if j.kind == JointKind::Slide => {
            Isometry3::from_parts((j.axis.into_inner() * q).into(), UnitQuaternion::identity())
        }
        Some(j) => Isometry3::from_parts(V::zeros().into(), UnitQuaternion::from_axis_angle(&j.axis, q)),
        None => Isometry3::identity(),
    };
    parent * body.origin * moved
}

/// The lowest of a body's points [m], for a body at `frame`; infinite if it has none.
pub fn lowest(frame: &Isometry3<f64>, points: &[ContactPoint]) -> V {
    // The upward direction in the body's frame; most points need only heights.
    let up = frame.rotation.inverse_transform_vector(&V::z());
    let height = |p: &ContactPoint| {
        let drop = p.axis.map_or(1.0, |axis| (1.0 - axis.dot(&up).powi(2)).max(0.0).sqrt());
        up.dot(&p.center) - p.radius * drop
    };
    let heights = points.iter().map(height).enumerate();
    let low = heights.fold((0, f64::INFINITY), |low, one| if one.1 < low.1 { one } else { low });
    let Some(p) = points.get(low.0) else { return V::new(0.0, 0.0, f64::INFINITY) };
    // Direction to the lowest point of a ball or of a rim.
    let rim = p.axis.map_or(up, |axis| (up - axis * axis.dot(&up)).try_normalize(1e-9).unwrap_or_default());
    frame.transform_point(&(p.center - rim * p.radius).into()).coords
}

impl Stance {
    pub fn of(tree: &Tree, contacts: &[Vec<ContactPoint>]) -> Self {
        let count = tree.bodies.len();
        let carries = |i: usize| tree.bodies.iter().skip(1).any(|b| b.parent == i);
        let mut feet = Vec::new();
        for leaf in (1..count).filter(|i| !carries(*i)) {
            let mut last = leaf;
            while last > 0 && contacts[last].is_empty() {
                last = tree.bodies[last].parent;
            }
            if last > 0 && !feet.contains(&last) {
                feet.push(last);
            }
        }
        let known: Option<Vec<f64>> = tree.joints().map(|j| j.rest).collect();
        let angles = known.unwrap_or_else(|| found(tree, contacts, &feet));
        let frames = chain(tree, Isometry3::identity(), &angles);
        let all = frames.iter().zip(contacts).map(|(f, p)| lowest(f, p).z);
        let low = all.fold(f64::INFINITY, f64::min);
        // Branches that end above the lowest three tenths of the robot's height are arms and tails.
        feet.retain(|foot| lowest(&frames[*foot], &contacts[*foot]).z < low + 0.3 * low.abs());
        Self { angles, feet }
    }
}

/// A pose with each foot below the start of its leg, at [`REACH`] of the leg's full extension. Joints with a
/// position in the file keep it.
fn found(tree: &Tree, contacts: &[Vec<ContactPoint>], feet: &[usize]) -> Vec<f64> {
    let joints: Vec<_> = tree.joints().collect();
    let range = |i: usize| joints[i].range.unwrap_or([-FARTHEST, FARTHEST]).map(|end| end.clamp(-FARTHEST, FARTHEST));
    let start = |i: usize| joints[i].rest.unwrap_or_else(|| 0.0_f64.clamp(range(i)[0], range(i)[1]));
    let mut angles: Vec<f64> = (0..joints.len()).map(start).collect();
    for &foot in feet {
        let mut branch = vec![foot];
        while tree.bodies[branch[0]].parent > 0 {
            branch.insert(0, tree.bodies[branch[0]].parent);
        }
        // The last two joints bend the leg; the leg begins at the first of them.
        let first = branch.len().saturating_sub(2);
        let below = branch[first + 1..].iter().map(|i| tree.bodies[*i].origin.translation.vector.norm());
        let last = contacts[foot].iter().map(|p| p.center.norm()).fold(0.0, f64::max);
        let (root, length) = (branch[first], below.sum::<f64>() + last);
        let cost = |angles: &[f64]| {
            let (mut frame, mut hip) = (Isometry3::identity(), V::zeros());
            for &body in &branch {
                frame = joined(tree, body, &frame, angles[body - 1]);
                if body == root {
                    hip = frame.translation.vector;
                }
            }
            let tip = lowest(&frame, &contacts[foot]);
            let off = tip - hip + V::z() * (REACH * length);
            // Of two solutions, the one with the knee farther back is taken, and among equivalent angles the smallest.
            let knee = frame.translation.vector.x - hip.x + 0.3 * length;
            let turned: f64 = branch.iter().map(|i| angles[i - 1] * angles[i - 1]).sum();
            off.norm_squared() + 1e-3 * knee * knee + 1e-6 * length * length * turned
        };
        let free: Vec<usize> = branch.iter().map(|i| i - 1).filter(|i| joints[*i].rest.is_none()).collect();
        let frames = (2 * free.len() * branch.len()).max(1) * feet.len();
        descend(&mut angles, &free, &range, &cost, ROUNDS.min(MOST_FRAMES / frames));
    }
    angles
}

/// Lowers `cost` over the joints `free`: the best point of a grid over the last two, then one joint at a time in `rounds`
/// rounds.
fn descend(
    angles: &mut Vec<f64>,
    free: &[usize],
    range: &impl Fn(usize) -> [f64; 2],
    cost: &impl Fn(&[f64]) -> f64,
    rounds: usize,
) {
    let ends = &free[free.len().saturating_sub(2)..];
    let mut best = (cost(angles), angles.clone());
    for k in 0..GRID.pow(ends.len() as u32) {
        let mut trial = angles.clone();
        for (place, i) in ends.iter().enumerate() {
            let ([low, high], part) = (range(*i), k / GRID.pow(place as u32) % GRID);
            trial[*i] = low + (high - low) * part as f64 / (GRID - 1) as f64;
        }
        let value = cost(&trial);
        if value < best.0 {
            best = (value, trial);
        }
    }
    *angles = best.1;
    let (mut least, mut step) = (best.0, 0.3);
    for _ in 0..rounds {
        let before = least;
        for i in free {
            let [low, high] = range(*i);
            for move_by in [-step, step] {
                let kept = angles[*i];
                angles[*i] = (kept + move_by).clamp(low, high);
                let value = cost(angles);
                if value < least {
                    least = value;
                } else {
                    angles[*i] = kept;
                }
            }
        }
        if least == before {
            step *= 0.5;
        }
    }
}
