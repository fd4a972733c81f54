//! The sand's constants for its memory.

use super::disc::{FEW, PAIRS};
use super::local::LocalSand;
use crate::error::{Result, check_range};
use crate::{GRAVITY, Medium};
use serde::{Deserialize, Serialize};

/// Part of the volume pressed down that is lost to compaction while the sand is loose. Fitted on the grains of
/// `tests/data/memory` (a foot pressed into loosely packed spheres).
pub(super) const LOST: f64 = 0.3;
/// Volume strain from loosely to closely packed: 1 − 0.58/0.62, the volume fractions of the poppy seeds of Li, Zhang &
/// Goldman 2013.
pub(super) const DENSER: f64 = 1.0 - 0.58 / 0.62;
/// Strength of closely packed over that of loosely packed sand: the ratio of ζ of both kinds of poppy seeds (Li, Zhang &
/// Goldman 2013), 0.464/0.254.
const GAIN: f64 = 0.464 / 0.254;
/// A piece that pushes sideways empties its cell this many times as fast as it sweeps: our choice, so that the
/// heap ahead does not slide back through the body within a cell's length. With 4, furrows are 30 % shallower than in grains;
/// with 8 and 16 they are alike. A piece never takes sand from below itself.
pub(super) const CLEARING: f64 = 16.0;
/// Distance from the sand that a body pushes to the middle of the sand that it finds next, in radii of the disc that gets the
/// pushed sand. That disc ends at 2; the sand that the body finds next begins at 3, because some of the pushed sand slides ahead. Our
/// choice: with 3.5, a plate's own heap reaches it after 10 cm, and its drag grows without end.
pub(super) const AHEAD: f64 = 4.0;
/// The level follows the sand that the body finds next as two first-order lags, one after the other; this is the length of each, in the same
/// radii: our choice, so that both together are delayed to a place 1.5 ahead of the sand that the body pushes, within its wedge. One lag of that
/// delay would blur the end of a furrow.
pub(super) const WAY: f64 = 1.25;
/// Angle of repose [°]: our choice from the published 25 to 35° of dry sand, in their lower half, because loose sand rests less
/// steeply than packed sand. Of glass beads: our choice from the published 22 to 26° of smooth spheres.
pub const REPOSE_DEG: f64 = 28.0;
const REPOSE_DEG_OF_BEADS: f64 = 25.0;

/// The sand's constants for its memory.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MemorySettings {
    /// Side of a cell [m].
    pub cell: f64,
    /// The square of heights has 2^bits cells along a side: 6, 7 or 8.
    pub bits: u32,
    /// Tangent of the angle of repose.
    pub repose: f64,
    /// Strength of fully compacted sand over that of the sand as it was.
    pub gain: f64,
    /// Duration of a sweep of sliding [s].
    pub sweep: f64,
    /// Least depth that counts in the reach of pushed sand, unit of the smallest disc, and height of a body's lowest layer [m].
    pub least: f64,
    /// Pairs of places among which a body's sand is distributed in one turn, up to [`PAIRS`].
    pub pairs: usize,
}

impl MemorySettings {
    /// `size`: length of the bodies that press and plough [m]; `repose_deg`: angle of repose [°]; None: that of the medium.
    ///
    /// A sweep takes 2 c²/(√g size^1.5) with cells of side c. So on every grid heaps as large as the body flatten within a few times
    /// √(size/g), about the time in which sand falls as far. Our choice; twice and half that time change the forces on the plates of
    /// `tests/data/memory` by less than 0.2 of the first pass.
    pub fn new(medium: &Medium, cell: f64, bits: u32, size: f64, repose_deg: Option<f64>) -> Self {
        let sweep = 2.0 * cell * cell / (GRAVITY.sqrt() * size.powf(1.5));
        let beads = medium.name == "glass-beads";
        let repose_deg = repose_deg.unwrap_or(if beads { REPOSE_DEG_OF_BEADS } else { REPOSE_DEG });
        Self {
            cell,
            bits,
            repose: repose_deg.to_radians().tan(),
            gain: Self::gain(medium),
            sweep,
            least: cell,
            pairs: FEW,
        }
    }

    /// Media that are closely packed already cannot be compacted. Of the named media, only `poppy-close` is.
    fn gain(medium: &Medium) -> f64 {
        if medium.name == "poppy-close" { 1.0 } else { GAIN }
    }

    /// The same for another medium.
    pub fn on(self, medium: &Medium) -> Self {
        Self { gain: Self::gain(medium), ..self }
    }

    /// Refuses numbers that no sand has, and sizes outside of the intended ranges: our choice, to catch wrong units.
    pub fn validate(&self) -> Result<()> {
        check_range("memory.cell", self.cell, 1e-4..=1.0)?;
        check_range("memory.bits", f64::from(self.bits), 6.0..=8.0)?;
        check_range("memory.repose", self.repose, 0.05..=2.0)?;
        check_range("memory.gain", self.gain, 1.0..=10.0)?;
        check_range("memory.pairs", self.pairs as f64, 1.0..=PAIRS as f64)?;
        check_range("memory.least", self.least, 1e-4..=1.0)?;
        check_range("memory.sweep", self.sweep, 1e-7..=1e3).map(drop)
    }

    /// Factor on the sand's strength where a body has found `found`.
    #[inline(always)]
    pub fn strength(&self, found: &LocalSand) -> f64 {
        1.0 + (self.gain - 1.0) * f64::from(found.packed)
    }

    /// Reach of the passive wedge, divided by the depth: tan(45° + φ/2) = tan φ + 1/cos φ.
    pub(super) fn wedge(&self) -> f64 {
        self.repose + (1.0 + self.repose * self.repose).sqrt()
    }
}
