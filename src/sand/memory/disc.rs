//! The disc ahead of a body, or around it, over which the sand that the body pushes is distributed.

use super::grid::GridFrame;
use super::heap::{Pushing, Taken};
use std::sync::LazyLock;

/// A disc of cells.
#[derive(Clone, Copy, Debug)]
pub(super) struct Disc {
    pub center: [f64; 2],
    pub radius: f64,
    /// Unit vector.
    pub along: [f64; 2],
    /// The halves of the disc on both sides of this direction are so far from its line [m].
    pub gap: f64,
}

/// The disc that gets the sand: around a body that presses, ahead of one that ploughs and holds the sand, in two halves beside the way of one
/// that does not. A body that holds a share of it does the one or the other in this share of the turns.
#[inline(always)]
pub(super) fn receiving(taken: &Taken, pushing: &Pushing, reach: f64, size: f64, least: f64, turns: u32) -> Disc {
    let ([x, y], [px, py]) = (taken.place, taken.push);
    let length = (px * px + py * py).sqrt();
    let share = length.min(1.0);
    let around = reach + size;
    let radius = (around + (before(reach, size) - around) * share).max(SMALLEST * least);
    // Multiples of the golden section are evenly distributed between 0 and 1.
    if pushing.length > 0.0 && (f64::from(turns) * GOLDEN).fract() >= pushing.holds {
        return Disc { center: [x, y], radius, along: pushing.along, gap: share * pushing.half_width };
    }
    // The disc of a shorter push is around the body, so its direction hardly matters.
    let along = if length > 1e-6 { [px / length, py / length] } else { [1.0, 0.0] };
    Disc { center: [x + radius * share * along[0], y + radius * share * along[1]], radius, along, gap: 0.0 }
}

/// Radius of the disc ahead of a body that ploughs: its far edge is at `reach`, and it is not smaller than the body.
#[inline(always)]
pub(super) fn before(reach: f64, size: f64) -> f64 {
    (0.5 * reach).max(size)
}
/// Smallest radius of a disc, in units of `MemorySettings::least`: our choice, so that a disc has more than one cell.
pub(super) const SMALLEST: f64 = 1.5;

/// Largest number of pairs of places in a disc, and the number that robots use in one turn (`FEW`): our choice. The pairs
/// differ from turn to turn, so that after a few turns all parts of the disc have got their share.
pub const PAIRS: usize = 64;
pub(super) const FEW: usize = 6;

/// Places in the unit disc, evenly distributed with the density 1 − r²: r² = 1 − √(1 − u), at angles that differ by the
/// golden angle. Each place stands for a pair, mirrored about the first axis.
static PLACES: LazyLock<[[f64; 2]; PAIRS]> = LazyLock::new(|| {
    std::array::from_fn(|k| {
        // The order of bits reversed: any few of them in a row are evenly spread.
        let u = (f64::from((k as u32).reverse_bits() >> 26) + 0.5) / PAIRS as f64;
        let (radius, angle) = ((1.0 - (1.0 - u).sqrt()).sqrt(), std::f64::consts::PI * (k as f64 * GOLDEN).fract());
        [radius * angle.cos(), radius * angle.sin()]
    })
});
/// The golden section.
const GOLDEN: f64 = 0.618_033_988_749_895;

impl Disc {
    /// Visits cells of some places of the disc, mirrored about its direction.
    #[inline(always)]
    pub fn visit(&self, frame: GridFrame, pairs: usize, turns: u32, mut visit: impl FnMut(usize)) {
        let Self { center: [x, y], radius, along: [ux, uy], gap } = *self;
        let (table, first) = (&*PLACES, turns as usize % PAIRS * pairs);
        for k in first..first + pairs {
            let [a, b] = table[k % PAIRS].map(|c| c * radius);
            let b = b + gap;
            for b in [b, -b] {
                if let Some(at) = frame.index_at([x + a * ux - b * uy, y + a * uy + b * ux]) {
                    visit(at);
                }
            }
        }
    }
}
