//! What lies on the sand of HexapodRocks.

use crate::error::{Result, check_range};
use crate::sim::obstacle::FRICTION;
use serde::{Deserialize, Serialize};

/// What lies on the sand.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RockOptions {
    /// How many obstacles an episode has; fewer where no free place is found.
    pub count: usize,
    /// Diameter of a rock, length and width of a step [m]: drawn from this range. Our choice 2 to 6 cm: half to one and
    /// a half times the reference robot's leg.
    pub size: [f64; 2],
    /// Height of a step over the sand [m]: drawn from this range. Our choice: up to half a leg.
    pub step_height: [f64; 2],
    /// Share of obstacles that are loose rocks; the others are fixed, half of them rocks and half steps.
    pub dynamic_fraction: f64,
    /// Of loose rocks [kg/m³]; granite's is 2,650.
    pub density: f64,
    /// Coulomb coefficient between robot and rock.
    pub friction: f64,
    /// Length and width of the field [m]; it begins [`BEHIND`] behind the start and the start is in its middle line.
    pub field: [f64; 2],
}

impl Default for RockOptions {
    fn default() -> Self {
        Self {
            count: 16,
            size: [0.02, 0.06],
            step_height: [0.0, 0.02],
            dynamic_fraction: 0.5,
            density: 2650.0,
            friction: FRICTION,
            field: [1.6, 0.8],
        }
    }
}

impl RockOptions {
    pub fn validate(&self) -> Result<()> {
        check_range("rocks.count", self.count as f64, 0.0..=64.0)?;
        check_range("rocks.size[0]", self.size[0], 5e-3..=0.5)?;
        check_range("rocks.size[1]", self.size[1], self.size[0]..=0.5)?;
        check_range("rocks.step_height[0]", self.step_height[0], 0.0..=0.5)?;
        check_range("rocks.step_height[1]", self.step_height[1], self.step_height[0]..=0.5)?;
        check_range("rocks.dynamic_fraction", self.dynamic_fraction, 0.0..=1.0)?;
        check_range("rocks.density", self.density, 100.0..=2e4)?;
        check_range("rocks.friction", self.friction, 0.0..=10.0)?;
        check_range("rocks.field[0]", self.field[0], 0.5..=100.0)?;
        check_range("rocks.field[1]", self.field[1], 0.4..=100.0).map(drop)
    }
}
