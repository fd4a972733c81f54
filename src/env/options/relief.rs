//! Ground that is not flat, as a user says it.

use crate::error::{Error, Result};
use crate::sim::tree::relief::Relief;
use serde::{Deserialize, Serialize};

/// Random dunes by a seed, or heights of your own.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ReliefOptions {
    pub seed: u64,
    /// About how far it is from crest to crest [m].
    pub wavelength: f64,
    /// Of the steepest place [°].
    pub slope_deg: f64,
    /// Rows along y of heights along x [m], in place of dunes.
    pub heights: Option<Vec<Vec<f64>>>,
    /// Between two of them [m].
    pub spacing: f64,
}

impl Default for ReliefOptions {
    /// Three lengths of a robot from crest to crest, and steep enough to be felt: our choice.
    fn default() -> Self {
        Self { seed: 0, wavelength: 2.0, slope_deg: 15.0, heights: None, spacing: 0.1 }
    }
}

impl ReliefOptions {
    pub fn relief(&self) -> Result<Relief> {
        match &self.heights {
            Some(rows) => Relief::new(self.spacing, rows),
            None => Relief::dunes(self.seed, self.wavelength, self.slope_deg),
        }
    }

    /// For ground that is loose sand on a level; `slope_deg` [°] is that of the whole.
    pub fn checked(&self, slope_deg: f64) -> Result<Relief> {
        if slope_deg != 0.0 {
            return Err(Error::invalid("slope_deg", "a relief has its own slopes"));
        }
        self.relief()
    }
}
