//! What an episode of HexapodTerrain draws.

use crate::error::{Error, Result, check_range};
use crate::sim::model::Scene;
use serde::{Deserialize, Serialize};

/// Ranges [low, high] that an episode's quantities are drawn from, uniformly; changes to what the other options say.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Randomize {
    /// ζ of each patch over the medium's own. Our choice: on poppy seeds from plastic pellets to twice as stiff as close
    /// packing makes them; batches alone differ by 20-40 % (Li, Zhang & Goldman 2013).
    pub zeta: [f64; 2],
    /// Length of a patch along x [m]. Our choice: one to four body lengths.
    pub patch_length: [f64; 2],
    /// Added to `slope_deg` [°]. Our choice.
    pub slope_deg: [f64; 2],
    /// Added to `payload` [kg]. Our choice: up to a third of the robot's mass.
    pub payload: [f64; 2],
    /// Share of `torque_limit` that the motors have. Our choice.
    pub torque_limit: [f64; 2],
    /// κ of re-used ground; see mechanism `footprint`. Our choice: no published law found.
    pub footprint: [f64; 2],
    /// Distance after which the robot is sent back, and again when it is back at the start [m]. Our choice.
    pub turning_point: [f64; 2],
}

impl Default for Randomize {
    fn default() -> Self {
        Self {
            zeta: [0.45, 2.0],
            patch_length: [0.15, 0.6],
            slope_deg: [-10.0, 10.0],
            payload: [0.0, 0.05],
            torque_limit: [0.4, 1.0],
            footprint: [0.0, 0.5],
            turning_point: [0.3, 1.2],
        }
    }
}

/// One quantity that is drawn.
pub(crate) struct Quantity {
    pub name: &'static str,
    /// What an episode draws from.
    pub range: [f64; 2],
    /// What the range must lie in.
    pub guard: [f64; 2],
    /// The value that leaves everything as the other options say, if `difficulty` scales the range.
    pub neutral: Option<f64>,
}

impl Randomize {
    /// `slope_deg` [°] and `payload` [kg]: what drawn ones are added to, so that their sums stay within a scene's bounds.
    pub(crate) fn quantities(&self, slope_deg: f64, payload: f64) -> [Quantity; 7] {
        let slope = [-Scene::MAX_SLOPE_DEG, Scene::MAX_SLOPE_DEG].map(|most| most - slope_deg);
        let load = [0.0, (Scene::MAX_PAYLOAD - payload).min(10.0)];
        let quantity = |name, range, guard, neutral| Quantity { name, range, guard, neutral };
        [
            quantity("zeta", self.zeta, [0.1, 10.0], Some(1.0)),
            quantity("patch_length", self.patch_length, [0.02, 100.0], None),
            quantity("slope_deg", self.slope_deg, slope, Some(0.0)),
            quantity("payload", self.payload, load, Some(0.0)),
            quantity("torque_limit", self.torque_limit, [0.01, 1.0], Some(1.0)),
            quantity("footprint", self.footprint, [-2.0, 1.0], Some(0.0)),
            quantity("turning_point", self.turning_point, [0.05, 1e3], None),
        ]
    }

    /// The arguments are those of [`Self::quantities`].
    pub fn validate(&self, slope_deg: f64, payload: f64) -> Result<()> {
        for Quantity { name, range: [low, high], guard: [least, most], .. } in self.quantities(slope_deg, payload) {
            let added = match name {
                "slope_deg" => format!(" (it is added to slope_deg = {slope_deg})"),
                "payload" => format!(" (it is added to payload = {payload})"),
                _ => String::new(),
            };
            let check = |end: usize, value: f64, low: f64| {
                let field = format!("randomize.{name}[{end}]");
                let why = |e: Error| match e {
                    Error::Invalid { field, reason } => Error::invalid(field, reason + &added),
                    other => other,
                };
                check_range(&field, value, low..=most).map_err(why)
            };
            check(0, low, least)?;
            check(1, high, low)?;
        }
        Ok(())
    }
}
