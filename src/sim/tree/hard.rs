//! Hard ground: everywhere, a road, or slabs that repeat; flush with the sand, above it or buried.

use crate::error::{Result, check_range};
use serde::{Deserialize, Serialize};

/// A rectangle of hard ground along the surface. Beyond its edges it falls at a slope of 2 (63°): our choice, so
/// that a foot that meets an edge is not thrown upward.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct HardGround {
    /// Centre [m].
    pub center: [f64; 2],
    /// Length along x and width along y [m].
    pub size: [f64; 2],
    /// Distance after which the rectangle repeats, along x and y [m]; 0: never.
    pub every: [f64; 2],
    /// Depth of the top below the surface [m]; negative if the top is above the sand.
    pub depth: f64,
    /// Factor on the friction of the shape that touches it.
    pub grip: f64,
}

impl HardGround {
    /// A rectangle at least this long or wide [m] is endless for a walking robot: our choice, 100 km, farther than any
    /// episode leads.
    pub const ENDLESS: f64 = 1e5;
    /// Largest number of pieces in a scene: our choice, because each makes a step slower.
    pub const MOST: usize = 8;
    /// Slope beyond the edges: the ground falls by this times the distance. Our choice; [`HardGround`] says why.
    pub const EDGE: f64 = 2.0;

    /// Hard ground everywhere, in place of sand.
    pub fn everywhere() -> Self {
        Self::default()
    }

    /// Is hard ground everywhere?
    pub fn is_everything(&self) -> bool {
        self.size.iter().all(|s| *s >= Self::ENDLESS) && self.depth <= 0.0
    }

    /// Distances along x and y from the nearest copy of the rectangle [m]; 0 on it.
    pub fn outside(&self, place: [f64; 2]) -> [f64; 2] {
        std::array::from_fn(|k| {
            let x = place[k] - self.center[k];
            let copy = if self.every[k] > 0.0 { (x / self.every[k]).round() * self.every[k] } else { 0.0 };
            ((x - copy).abs() - self.size[k] / 2.0).max(0.0)
        })
    }

    /// Depth of the top below the surface at a place [m], as in the engine.
    pub fn top(&self, place: [f64; 2]) -> f64 {
        let [x, y] = self.outside(place);
        self.depth + Self::EDGE * (x + y)
    }

    pub fn validate(&self) -> Result<()> {
        for k in 0..2 {
            check_range("hard.center", self.center[k], -Self::ENDLESS..=Self::ENDLESS)?;
            check_range("hard.size", self.size[k], 1e-3..=Self::ENDLESS)?;
            if self.every[k] != 0.0 {
                check_range("hard.every", self.every[k], self.size[k]..=Self::ENDLESS)?;
            }
        }
        check_range("hard.depth", self.depth, -1.0..=10.0)?;
        check_range("hard.grip", self.grip, 0.0..=10.0).map(drop)
    }
}

impl Default for HardGround {
    fn default() -> Self {
        Self { center: [0.0; 2], size: [Self::ENDLESS; 2], every: [0.0; 2], depth: 0.0, grip: 1.0 }
    }
}
