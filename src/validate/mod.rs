//! The scoreboard: predictions of the model compared with independent measurements.

use sandgait_base::{error, parallel, progress};
use sandgait_calibrate as calibrate;
use sandgait_number as number;
use sandgait_plot as plot;
use sandgait_reproduce as reproduce;
use sandgait_sand as sand;
use sandgait_sim as sim;
use sandgait_table as table;

pub mod data;
pub mod fit;
pub mod others;
pub mod page;
pub mod robots;
pub mod score;

/// Bulk density of the wheels' sand [kg/m³], documented with the data.
pub const DENSITY: f64 = 1330.0;
