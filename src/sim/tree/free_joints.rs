//! The joints that a search for a pose may move, their ranges, and where the search starts.

use super::kinematics::chain;
use super::{JointKind, Tree, TreeJoint};
use nalgebra::Isometry3;
use std::f64::consts::TAU;

/// Largest number of joints of a limb that a search moves, counted from the limb's end: our choice, more than any limb we
/// know has; it bounds the time of a search.
pub(super) const MOST_MOVING: usize = 8;
/// Farthest position of a joint in a search [rad or m], for joints that turn without limits: our choice, less than half
/// a turn, so that no pose is found twice.
const FARTHEST: f64 = 2.8;
/// A position is at an end of a range if it is nearer to it than this part of the range: our choice, more than the rounding of files.
const AT_END: f64 = 0.05;

/// Joints that a search may move, and where it begins.
pub struct FreeJoints {
    pub ranges: Vec<[f64; 2]>,
    pub preferred: Vec<f64>,
}

impl FreeJoints {
    /// A joint with a position in the file keeps it. A joint that follows a leader keeps the position that the leader's
    /// preferred position gives. All other joints are free in their range, and their preferred position is 0; for those that turn
    /// about a vertical axis, and only to one side of 0, it is the middle of the range, from which a leg swings forward and back.
    pub fn of(tree: &Tree) -> Self {
        let mut all = Self::free(tree);
        let frames = chain(tree, Isometry3::identity(), &all.preferred);
        for (i, joint) in tree.joints().enumerate() {
            // Joint i moves body i + 1.
            let upright = tree.bodies[i + 1].turns_about_vertical(&frames[i + 1]);
            // The joint's own range, of which the search may leave out the ends.
            let Some([low, high]) = joint.range.filter(|_| upright) else { continue };
            let from_ends = (all.preferred[i] - low).min(high - all.preferred[i]);
            if from_ends < AT_END * (high - low) {
                all.preferred[i] = ((low + high) / 2.0).clamp(all.ranges[i][0], all.ranges[i][1]);
            }
        }
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
        let (ranges, preferred) = tree.joints().map(within).unzip();
        Self { ranges, preferred }
    }

    /// Start `k` of a search: the preferred position, then positions spread over the ranges (Halton's sequence).
    pub(super) fn start(&self, k: usize, moving: &[usize]) -> Vec<f64> {
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

/// The positions that a search tries for a joint, and the preferred one of them. A hinge whose whole range lies beyond
/// [`FARTHEST`] is searched as one whose range is whole turns nearer to 0.
fn within(joint: &TreeJoint) -> ([f64; 2], f64) {
    let [low, high] = joint.range.unwrap_or([-FARTHEST, FARTHEST]);
    let middle = (low + high) / 2.0;
    let away = match (low >= FARTHEST || high <= -FARTHEST, joint.kind) {
        (false, _) => 0.0,
        (true, JointKind::Hinge) => (middle / TAU).round() * TAU,
        (true, JointKind::Slide) => middle,
    };
    let range = [low, high].map(|end| (end - away).clamp(-FARTHEST, FARTHEST));
    (range.map(|end| end + away), 0.0_f64.clamp(range[0], range[1]) + away)
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
