//! The standing pose of a tree robot: its legs, its feet, and its joints. Where the file gives no pose, the joints are
//! searched: each leg stands under its hip, in the middle of the heights that it can use.

use super::Tree;
use super::contact::ContactPoint;
use super::free_joints::FreeJoints;
use super::kinematics::{chain, lowest};
use super::limbs::{Limb, limbs};
use super::plain_gait::alternate;
use super::reach::{Reached, STEPS};
use super::symmetry::{Sides, Symmetry};
use nalgebra::{Isometry3, Vector3};

type V = Vector3<f64>;

/// Least distance of a standing leg's foot from the hip, as a part of the leg's longest reach. Our choice, because the
/// middle between this and the longest reach is then 0.7. In the usual poses of A1, Aliengo, HyQ, Mini Cheetah, Solo
/// and Spot it is 0.70 to 0.73, in Go1's 0.64.
const FOLDED: f64 = 0.4;
/// Part of its longest reach to which a leg of a robot with fewer than four feet is extended: our choice, because such
/// a robot stands with its feet flat, and knees that bend more need more torque. Unitree's H1 stands at 0.92 and
/// G1 at 0.98 (Isaac Lab 2.0).
const UPRIGHT: f64 = 0.9;
/// Number of heights of a leg that are tried: our choice, which finds the usable heights to 1/18 of the leg's length.
/// More take longer.
const HEIGHTS: usize = 18;
/// Number of start positions of a search: our choice, because a knee can bend in several ways, and one start finds one
/// of them. More take longer.
const STARTS: usize = 12;
/// A foot counts as at its place if its distance from the place is below this part of the leg's length: our choice,
/// more than a search's own error. A larger value counts heights that the leg does not reach.
const REACHED: f64 = 0.01;
/// A limb is a leg if its end is in the lowest three tenths of the robot's height, and can move up and down by at
/// least a tenth of the limb's length: our choice. Arms and tails do not reach so low, wheels and propellers do not move their
/// lowest point.
const LOWEST: f64 = 0.3;
const TRAVEL: f64 = 0.1;
/// A body of a leg belongs to the foot if it is nearer to the ground than this part of the robot's height: our choice.
/// With a smaller value a sole that is not quite level loses its heel or toes, with a larger one shanks may be feet.
const NEAR: f64 = 0.02;
/// Feet are moved forward or back toward the point under the centre of mass, if that point is farther from the middle
/// of the feet than this part of the distance of the farthest foot from the middle. They are moved by at most this part
/// of the leg's length. Our choice: nearer points leave the weight well between the feet, and longer ways tilt the
/// legs.
const OFF_CENTER: f64 = 0.25;

/// Largest number of body frames that all searches of a robot compute together: our choice, which takes about a second.
/// For a robot with many limbs of hundreds of joints, searches begin from fewer positions.
const MOST_FRAMES: usize = 10_000_000;

/// A leg stands on the far half of its last body, not on that body's end at the knee: our choice. `KNEELS` is the penalty
/// for kneeling, larger than any other difference between two solutions.
const FAR_HALF: f64 = 0.5;
const KNEELS: f64 = 1e3;
/// A leg kneels, too, if its knee is less than this part of its length above its foot: our choice, more than the thickness of
/// a knee.
const KNEE: f64 = 0.1;

/// A leg is drawn level if its foot is less than this part of its length below its hip: our choice. The last body of such a
/// leg with two joints stands at about 45°; a ball at its end moves the foot by its radius, which is less than this part, too.
const LEVEL: f64 = 0.1;
const SLANT: f64 = std::f64::consts::FRAC_1_SQRT_2;

/// Lengths of limbs that are built alike differ by less than this part: our choice, more than the errors of drawings.
const ALIKE: f64 = 0.02;

/// Axes count as parallel if the cosine of their angle is above this: our choice, 2.6°, more than the rounding of
/// files.
const PARALLEL: f64 = 0.999;

/// A robot's standing pose.
#[derive(Clone, Debug, PartialEq)]
pub struct Stance {
    /// Positions of the joints: from the file, or searched.
    pub angles: Vec<f64>,
    /// Feet: bodies that stand on the ground, each the last of its branch with points of contact.
    pub feet: Vec<usize>,
    /// For each leg the bodies from the base outward, without the base.
    pub legs: Vec<Vec<usize>>,
    /// Bodies that are neither base nor part of a leg: trunk, arms, head.
    pub upper: Vec<usize>,
    /// Height of the base's origin above the lowest point [m].
    pub height: f64,
    /// The middle of the legs' hips, in the base's frame [m]. It does not depend on where a file has the base's origin,
    /// so it stands for the body where heights are compared.
    pub hips: V,
    /// Mean height of the hips above the feet [m].
    pub leg_length: f64,
}

impl Stance {
    pub fn of(tree: &Tree, contacts: &[Vec<ContactPoint>]) -> Self {
        let limbs = limbs(tree, contacts);
        let known: Option<Vec<f64>> = tree.joints().map(|j| j.rest).collect();
        let angles = known.unwrap_or_else(|| {
            let search = Search::of(tree, contacts, &limbs);
            let start = search.joints.preferred.clone();
            even(tree, contacts, &limbs, &start, search.pose(&limbs))
        });
        Self::with(tree, contacts, &limbs, angles)
    }

    /// The stance with joints at `angles`.
    pub fn at(tree: &Tree, contacts: &[Vec<ContactPoint>], angles: Vec<f64>) -> Self {
        Self::with(tree, contacts, &limbs(tree, contacts), angles)
    }

    fn with(tree: &Tree, contacts: &[Vec<ContactPoint>], limbs: &[Limb], angles: Vec<f64>) -> Self {
        let frames = chain(tree, Isometry3::identity(), &angles);
        let height_of = |body: usize| lowest(&frames[body], &contacts[body]).z;
        let low = (0..frames.len()).map(height_of).fold(f64::INFINITY, f64::min);
        let height = if low.is_finite() { -low } else { 0.0 };
        let free = FreeJoints::free(tree);
        let hips = limbs.iter().map(|l| frames[l.hip].translation.vector.z);
        let span = (hips.fold(f64::NEG_INFINITY, f64::max) - low).max(0.0);
        let is_low = |end: usize| height_of(end) < low + LOWEST * span;
        let under_base = |end: usize| height_of(end) < height_of(0);
        let mut legs: Vec<&Limb> = limbs
            .iter()
            .filter(|l| l.ends.iter().any(|end| is_low(*end) && under_base(*end)))
            .filter(|l| l.travel(tree, contacts, &free) > TRAVEL * l.length)
            .collect();
        beside(&mut legs, &frames);
        let stands = |body: &usize| height_of(*body) < low + NEAR * span;
        let mut feet = Vec::new();
        for leg in &legs {
            let own = leg.path.iter().filter(|i| !leg.ends.contains(i) && stands(i));
            for body in leg.ends.iter().filter(|end| is_low(**end)).chain(own) {
                if !feet.contains(body) {
                    feet.push(*body);
                }
            }
        }
        let of_leg =
            |i: &usize| legs.iter().any(|l| l.path.contains(i) || l.ends.iter().any(|end| is_under(tree, *end, *i, l)));
        let upper = (1..frames.len()).filter(|i| !of_leg(i)).collect();
        let lengths = legs.iter().map(|l| frames[l.hip].translation.vector.z - height_of(l.end()));
        let leg_length = lengths.sum::<f64>() / legs.len().max(1) as f64;
        let hips = legs.iter().map(|l| frames[l.hip].translation.vector).sum::<V>() / legs.len().max(1) as f64;
        let legs = legs.iter().map(|l| l.path.clone()).collect();
        Self { angles, feet, legs, upper, height, hips, leg_length }
    }

    /// For each foot: does its leg step half a stride after the first one?
    pub fn second(&self, tree: &Tree) -> Vec<bool> {
        let frames = chain(tree, Isometry3::identity(), &self.angles);
        let ends: Vec<_> =
            self.legs.iter().filter_map(|leg| leg.last()).map(|end| frames[*end].translation.vector).collect();
        let of_legs = alternate(&ends);
        let above = |foot: usize| {
            std::iter::successors(Some(foot), |body| Some(tree.bodies[*body].parent)).take_while(|body| *body > 0)
        };
        let leg_of = |foot: &usize| above(*foot).find_map(|body| self.legs.iter().position(|leg| leg.contains(&body)));
        self.feet.iter().map(|foot| leg_of(foot).is_some_and(|leg| of_legs[leg])).collect()
    }

    /// Height of the hips above the lowest point [m].
    pub fn hips_height(&self) -> f64 {
        self.height + self.hips.z
    }
}

/// The pose that was found, or its mean with its mirror image if the robot is symmetric at `start` and not in this pose: one
/// mesh for the legs of both sides turns all of them the same way. The feet stay as high. Straight legs whose knees bend
/// across the mirror look symmetric, too, as those of a robot whose file has its front along y; their mean would not bend.
fn even(tree: &Tree, contacts: &[Vec<ContactPoint>], limbs: &[Limb], start: &[f64], found: Vec<f64>) -> Vec<f64> {
    let at = |angles: &[f64]| Symmetry::at(tree, contacts, angles, Sides::LeftRight).ok();
    let Some(symmetry) = at(start).filter(|_| at(&found).is_none()) else { return found };
    let evened = symmetry.evened(start, &found);
    let risen = |l: &Limb| (l.tip(tree, contacts, &evened).z - l.tip(tree, contacts, &found).z).abs();
    if limbs.iter().all(|l| risen(l) < NEAR * l.length) { evened } else { found }
}

/// Is `body` between the limb `of` and its further end `end`?
fn is_under(tree: &Tree, end: usize, body: usize, of: &Limb) -> bool {
    let mut at = end;
    while at > 0 && !of.path.contains(&at) {
        if at == body {
            return true;
        }
        at = tree.bodies[at].parent;
    }
    false
}

/// Removes limbs in the middle of a robot if at least two other limbs are at its sides: a neck, an arm or a tail. Limbs
/// built as those at the sides stay: a robot whose legs are on a circle may have one in front and one behind.
fn beside(legs: &mut Vec<&Limb>, frames: &[Isometry3<f64>]) {
    let aside = |l: &Limb| frames[l.hip].translation.vector.y.abs() > 0.05 * l.length;
    let sides: Vec<(usize, f64)> = legs.iter().filter(|l| aside(l)).map(|l| (l.path.len(), l.length)).collect();
    if sides.len() >= 2 && sides.len() < legs.len() {
        let alike = |l: &Limb| sides.iter().any(|s| s.0 == l.path.len() && (s.1 / l.length - 1.0).abs() < ALIKE);
        legs.retain(|l| aside(l) || alike(l));
    }
}

/// The search for a standing pose.
struct Search<'a> {
    tree: &'a Tree,
    contacts: &'a [Vec<ContactPoint>],
    joints: FreeJoints,
    /// Number of start positions of a search.
    starts: usize,
}

/// A leg's place, and the heights that it can use.
struct LegReach<'a> {
    limb: &'a Limb,
    /// Horizontal place of the foot, and height of the hip [m].
    place: V,
    /// Least and greatest usable depth of the foot under the hip, and the one that is wanted [m].
    depths: [f64; 2],
    wanted: f64,
}

impl<'a> Search<'a> {
    fn of(tree: &'a Tree, contacts: &'a [Vec<ContactPoint>], limbs: &[Limb]) -> Self {
        let frames_of_a_start: usize = limbs.iter().map(|l| 2 * HEIGHTS * STEPS * l.path.len()).sum();
        let starts = (MOST_FRAMES / frames_of_a_start.max(1)).clamp(1, STARTS);
        Self { tree, contacts, joints: FreeJoints::of(tree), starts }
    }

    /// A pose with each foot under its hip, in the middle of the heights that the leg can use. Joints with a position in
    /// the file keep it.
    fn pose(mut self, limbs: &[Limb]) -> Vec<f64> {
        let start = self.joints.preferred.clone();
        let frames = chain(self.tree, Isometry3::identity(), &start);
        let free = FreeJoints::free(self.tree);
        let mut candidates: Vec<&Limb> =
            limbs.iter().filter(|l| l.travel(self.tree, self.contacts, &free) > TRAVEL * l.length).collect();
        beside(&mut candidates, &frames);
        self.hold_shared(&candidates);
        let many = candidates.len() >= 4;
        let mut legs: Vec<LegReach> = candidates.iter().filter_map(|l| self.leg(l, &frames, many)).collect();
        let deepest = |l: &LegReach| l.place.z - l.depths[1];
        let low = legs.iter().map(deepest).fold(f64::INFINITY, f64::min);
        let top = legs.iter().map(|l| l.place.z).fold(f64::NEG_INFINITY, f64::max);
        legs.retain(|l| deepest(l) < low + LOWEST * (top - low));
        let upright = legs.len() < 4;
        for leg in &mut legs {
            let [least, most] = leg.depths;
            leg.wanted = if upright { UPRIGHT * most } else { (most + least.max(FOLDED * most)) / 2.0 }.max(least);
        }
        let mut angles = self.standing(&legs, &start, V::zeros());
        for _ in 0..2 {
            let shift = self.off_center(&legs, &angles, upright);
            angles = self.standing(&legs, &angles, shift);
        }
        for f in
            self.tree.followers().iter().filter(|f| self.joints.ranges[f.joint][0] == self.joints.ranges[f.joint][1])
        {
            angles[f.joint] = f.ratio * angles[f.leader] + f.offset;
        }
        angles
    }

    /// Holds the joints that carry several of the legs, such as a waist: a search for one leg would move the other legs, too.
    fn hold_shared(&mut self, legs: &[&Limb]) {
        for body in 1..self.tree.bodies.len() {
            if legs.iter().filter(|leg| leg.path.contains(&body)).count() > 1 {
                self.joints.ranges[body - 1] = [self.joints.preferred[body - 1]; 2];
            }
        }
    }

    /// The place of a limb's foot and its heights, if the limb may be a leg; None if the foot would not be below the
    /// hip.
    fn leg<'l>(&self, limb: &'l Limb, frames: &[Isometry3<f64>], many: bool) -> Option<LegReach<'l>> {
        let (tree, contacts) = (self.tree, self.contacts);
        let hip = frames[limb.hip].translation.vector;
        let tip = limb.tip(tree, contacts, &self.joints.preferred);
        let length = limb.length_behind_hip(tree, contacts);
        let mut place = hip;
        // A leg whose knee is beside its hip, as a spider's, stands as far out as its knee. It points to the side, or, as the legs of
        // a hexagon, anywhere: then one of its first joints turns about a vertical axis. A dog's leg that is drawn level points ahead.
        let to_hip = limb.path.iter().position(|i| *i == limb.hip).map_or(0, |k| k + 1);
        let upright = |i: &usize| tree.bodies[*i].turns_about_vertical(&frames[*i]);
        let turns = limb.path[..to_hip].iter().any(upright);
        let knee = limb.path.iter().skip_while(|i| **i != limb.hip).nth(1);
        let out = knee.and_then(|i| {
            let (_, axis) = tree.bodies[*i].axis(&frames[*i])?;
            let out = V::new(axis.y, -axis.x, 0.0).try_normalize(0.5)?;
            let away = (tip - hip).xy().norm() > (hip.z - tip.z);
            (many && away && (turns || out.y.abs() > out.x.abs())).then_some(out * (tip - hip).dot(&out).signum())
        });
        if let (Some(out), Some(knee)) = (out, knee) {
            place += out * tree.bodies[*knee].origin.translation.vector.norm();
        }
        place += self.beside_plane(limb, frames, tip - hip);
        let (mut depths, mut last): (Option<[f64; 2]>, Option<Vec<f64>>) = (None, None);
        for k in (2..=HEIGHTS).rev() {
            let depth = length * k as f64 / HEIGHTS as f64;
            let target = place - V::z() * depth;
            let mut found = self.reach(limb, target, last.as_deref(), depths.is_none());
            if found.off >= REACHED && last.is_some() {
                // A search that begins with a straight leg does not bend it.
                found = self.reach(limb, target, last.as_deref(), true);
            }
            if found.off < REACHED {
                depths = Some([depth, depths.map_or(depth, |d| d[1])]);
                last = Some(found.angles);
            } else if depths.is_some() {
                break;
            }
        }
        if depths.is_none() && many {
            // Too few joints to reach such a place. If the leg is drawn level, its last body leads down and outward.
            let end = frames[limb.end()].translation.vector;
            let outward = (tip - end).xy().push(0.0).try_normalize(1e-9).unwrap_or_default();
            let slanted = end + (outward - V::z()) * ((tip - end).norm() * SLANT);
            let is_level = hip.z - tip.z < LEVEL * length && self.reach(limb, slanted, None, true).off < LEVEL;
            let foot = if is_level { slanted } else { tip };
            (place, depths) = (V::new(foot.x, foot.y, hip.z), Some([hip.z - foot.z; 2]));
        }
        // A limb that has too few joints to reach such a place stands as it is.
        let depths = depths.unwrap_or([hip.z - tip.z; 2]);
        (depths[1] > 0.0).then_some(LegReach { limb, place, depths, wanted: depths[1] })
    }

    /// The part of `to_foot` perpendicular to the plane in which the foot moves, if all hinges of the leg have parallel axes.
    /// Such a leg cannot change this part. In other legs it is the way along the hip's axis to the thigh, which joints may
    /// separate from the hip.
    fn beside_plane(&self, limb: &Limb, frames: &[Isometry3<f64>], to_foot: V) -> V {
        let mut axes = limb.path.iter().filter_map(|i| self.tree.bodies[*i].hinge_axis(&frames[*i]));
        let Some(axis) = axes.next() else { return V::zeros() };
        if axes.all(|other| axis.dot(&other).abs() > PARALLEL) {
            return axis * axis.dot(&to_foot);
        }
        let to_thigh = frames[limb.long].translation.vector - frames[limb.hip].translation.vector;
        let axis = self.tree.bodies[limb.hip].hinge_axis(&frames[limb.hip]);
        axis.map_or(V::zeros(), |axis| (axis * axis.dot(&to_thigh)).xy().push(0.0))
    }

    fn reach(&self, limb: &Limb, target: V, first: Option<&[f64]>, widely: bool) -> Reached {
        let hip = limb.hip;
        // Of several solutions, the one that is less bent and has its knee farther back is preferred.
        let worth = |r: &Reached| {
            let (knee, from) = (limb.knee(self.tree, &r.angles), limb.frame(self.tree, &r.angles, hip));
            let tip = limb.tip(self.tree, self.contacts, &r.angles);
            let low = (KNEE - (knee.z - tip.z) / limb.length).max(0.0);
            let near = (FAR_HALF - limb.tip_distance(self.tree, self.contacts, &r.angles)).max(0.0);
            let kneels = KNEELS * (near + low);
            r.bent + 3.0 * (knee.x - from.translation.vector.x) / limb.length + kneels
        };
        let starts = if widely || first.is_none() { self.starts } else { 0 };
        limb.reach(self.tree, self.contacts, &self.joints, target, first, starts, &worth)
    }

    /// Joint angles that put all feet on one level; the feet are moved along x and y by `shift`.
    fn standing(&self, legs: &[LegReach], start: &[f64], shift: V) -> Vec<f64> {
        let mut angles = start.to_vec();
        let ground = legs.iter().map(|l| l.place.z - l.wanted).sum::<f64>() / legs.len().max(1) as f64;
        // The level that all legs can reach, if there is one.
        let [mut low, mut high] = [f64::NEG_INFINITY, f64::INFINITY];
        for leg in legs {
            low = low.max(leg.place.z - leg.depths[1]);
            high = high.min(leg.place.z - leg.depths[0]);
        }
        let ground = if low <= high { ground.clamp(low, high) } else { ground };
        for leg in legs {
            let target = V::new(leg.place.x + shift.x, leg.place.y + shift.y, ground);
            let found = self.reach(leg.limb, target, Some(&angles), true);
            leg.limb.path.iter().for_each(|i| angles[i - 1] = found.angles[i - 1]);
        }
        angles
    }

    /// The way from the middle of the feet to the point under the centre of mass, if that is far.
    fn off_center(&self, legs: &[LegReach], angles: &[f64], upright: bool) -> V {
        let frames = chain(self.tree, Isometry3::identity(), angles);
        let center = self.tree.center_of_mass(&frames);
        let count = legs.len().max(1) as f64;
        let middle = legs.iter().map(|l| l.place).sum::<V>() / count;
        let reach = legs.iter().map(|l| (l.place.x - middle.x).abs()).fold(0.0, f64::max);
        let length = legs.iter().map(|l| l.limb.length).sum::<f64>() / count;
        let off = center.x - middle.x;
        if !upright && off.abs() < OFF_CENTER * reach {
            return V::zeros();
        }
        V::new(off.clamp(-OFF_CENTER * length, OFF_CENTER * length), 0.0, 0.0)
    }
}
