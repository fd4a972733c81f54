//! Carriage and constraint of LegStroke.

use crate::error::{Error, Result, check_range};
use crate::sim::Model;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// Carriage, leg and constraint.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct StrokeOptions {
    /// The carriage goes toward +x at this speed [m/s]. Our choice 0.2: over a stroke two lengths of the leg, with which
    /// constant-rate strokes do best near the middle of the range of joint speeds.
    pub carriage_speed: f64,
    /// Height of the hip over the sand [m]: 2 cm as in Li et al. 2012, section 3.
    pub height: f64,
    /// Hip and knee angle at the start [rad], with the leg out of the sand. As in the paper the tip points forward, and
    /// 1.75 rad from straight down.
    pub start: [f64; 2],
    /// Least mean lift over the stroke [N]. Our choice 1.7: a sixth of the weight of the reference hexapod grown to this
    /// leg (lengths × 1.9, mass × 1.9³).
    pub lift: f64,
    /// Penalty of a stroke without any lift. Our choice 2: more than the greatest efficiency there can be.
    pub lift_weight: f64,
    /// Penalty of a stroke that leaves the leg 1 cm or more in the sand. Our choice 1.
    pub exit_weight: f64,
}

impl Default for StrokeOptions {
    fn default() -> Self {
        Self { carriage_speed: 0.2, height: 0.02, start: [-1.75, 0.0], lift: 1.7, lift_weight: 2.0, exit_weight: 1.0 }
    }
}

impl StrokeOptions {
    /// `model`: the leg.
    pub fn validate(&self, model: &Model) -> Result<()> {
        // Below the slowest, thrust per work says nothing (see the task's page); the fastest is where RFT ends.
        check_range("stroke.carriage_speed", self.carriage_speed, 0.01..=0.5)?;
        check_range("stroke.height", self.height, 0.0..=0.1)?;
        check_range("stroke.lift", self.lift, 1e-3..=1e3)?;
        check_range("stroke.lift_weight", self.lift_weight, 0.0..=1e3)?;
        check_range("stroke.exit_weight", self.exit_weight, 0.0..=1e3)?;
        let range = |i: usize| model.legs[0][i].range.unwrap_or([-TAU, TAU]);
        for (i, angle) in self.start.iter().enumerate() {
            check_range(&format!("stroke.start[{i}]"), *angle, range(i)[0]..=range(i)[1])?;
        }
        let deepest = self.deepest(model, &self.start);
        if deepest > 1e-9 {
            let reason = format!("{:?} begins {:.1} mm in the sand", self.start, 1e3 * deepest);
            return Err(Error::invalid("stroke.start", reason));
        }
        Ok(())
    }

    /// Depth of the leg's deepest joint or tip [m], 0 if it is out of the sand.
    pub(crate) fn deepest(&self, model: &Model, angles: &[f64]) -> f64 {
        (model.standing_height(angles) - self.height).max(0.0)
    }
}
