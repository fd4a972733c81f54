//! The heap that a body pushes ahead, and the part of it that the body's shape holds.
//!
//! **What is held.** Sand ahead resists against the travel. By Coulomb's law it stays on a face if the direction of this
//! resistance is within the face's cone of friction; otherwise it slides along the face, and so around the body or under it. A body is
//! judged by the mean c of the cosine between its faces' normals and its travel, weighted by the sand that they move: it
//! holds the share (c − cos φ)/(1 − cos φ), between 0 and 1. So an upright plate holds everything (c = 1), and a post
//! (π/4), a ball or a wheel nothing (ours, like the friction angle φ, the sand's angle of repose).
//!
//! **How much.** A heap against a face of width w whose sides slope at φ has the mean height w tan φ/4. Such heaps are
//! alike, so their volume grows with w³ tan φ. As an even load on the passive wedge, whose area is w L (L its reach),
//! it has the height h = [`HEAP`] w² tan φ/L. The smaller of both heights counts.
//!
//! **What is missing.** The measured coefficients of the theory contain this heap. The drag of an upright plate grows with the square of
//! its depth D; with the heap with that of D + h. So a body that has just begun to travel lacks the heap, and its
//! depth counts as D²/(D + h). In place of h stands the part that is still missing; this falls within the length L,
//! because after that length the wedge has only sand that the body has pushed.

use super::MemorySettings;
use super::local::LocalSand;

/// Volume of a held heap over w³ tan φ. Fitted on the drag of a plate 50 mm wide in grains (`tests/data/drag/plate_0.05.csv`). Half a cone
/// would have π/48 = 0.07. A plate of 25 mm (`tests/data/memory/plough.csv`) was not used for the fit.
const HEAP: f64 = 0.17;
/// Way within which a body that begins to push loses the missing heap [`MemorySettings::least`]: our choice, so that the creep of a
/// body at rest changes nothing.
const BEGINNING: f64 = 0.25;

/// What a body has taken out of its cells.
#[derive(Default)]
pub(super) struct Taken {
    /// [steps of the grid]
    pub amount: i32,
    pub lost: f64,
    /// Means weighted by the amount: place [m], its variances along x and y and its covariance [m²], and the horizontal part of the
    /// normals.
    pub place: [f64; 2],
    pub spread: [f64; 3],
    pub push: [f64; 2],
    /// Mean velocity along x and y of the pieces in the sand, weighted by their area [m/s].
    pub velocity: [f64; 2],
}

/// How a body has travelled over the sand since sand was moved last, and what it holds.
pub(super) struct Pushing {
    /// [m]
    pub length: f64,
    /// Unit vector; any if the body has not travelled.
    pub along: [f64; 2],
    /// Share of the sand ahead that it holds.
    pub holds: f64,
    /// Half its width across the travel [m].
    pub half_width: f64,
}

impl Pushing {
    #[inline(always)]
    pub fn new(s: &MemorySettings, taken: &Taken, way: [f64; 2]) -> Self {
        let length = (way[0] * way[0] + way[1] * way[1]).sqrt();
        if length == 0.0 {
            return Self { length, along: [1.0, 0.0], holds: 0.0, half_width: 0.0 };
        }
        let along = way.map(|w| w / length);
        let [x, y] = along;
        let steepest = 1.0 / (1.0 + s.repose * s.repose).sqrt();
        let ahead = taken.push[0] * x + taken.push[1] * y;
        let [xx, yy, xy] = taken.spread;
        let across = (xx * y * y + yy * x * x - 2.0 * xy * x * y).max(0.0);
        // An even distribution over a width w has the variance w²/12.
        Self {
            length,
            along,
            holds: ((ahead - steepest) / (1.0 - steepest)).clamp(0.0, 1.0),
            half_width: (3.0 * across).sqrt(),
        }
    }
}

impl LocalSand {
    /// The body has travelled on: the heap grows, and the level falls by what is missing. `low`: height of the body's lowest
    /// piece; `reach`: of the passive wedge [m].
    #[inline(always)]
    pub(super) fn push_heap(&mut self, s: &MemorySettings, pushing: &Pushing, low: f64, reach: f64) {
        let width = 2.0 * pushing.half_width;
        let whole = pushing.holds * width * s.repose * (HEAP * width / reach).min(0.25);
        let grown = (pushing.length / reach).min(1.0);
        let mut ahead = 0.0;
        for k in 0..2 {
            let heap = f64::from(self.heap[k]);
            let heap = heap + (whole * pushing.along[k] - heap) * grown;
            ahead += heap * pushing.along[k];
            self.heap[k] = heap as f32;
        }
        let (ground, missing) = (f64::from(self.ground), (whole - ahead.max(0.0)).max(0.0));
        let depth = (ground - low).max(0.0);
        let lack = if missing > 0.0 { depth * missing / (depth + missing) } else { 0.0 };
        let now = ground - f64::from(self.level);
        let share = if pushing.length > 0.0 { (pushing.length / (BEGINNING * s.least)).min(1.0) } else { 1.0 };
        self.level = (ground - now - (lack - now) * share) as f32;
    }
}
