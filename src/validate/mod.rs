//! The scoreboard: predictions of the model compared with independent measurements.

pub mod data;
pub mod fit;
pub mod others;
pub mod page;
pub mod robots;
pub mod score;

/// Bulk density of the wheels' sand [kg/m³], documented with the data.
pub const DENSITY: f64 = 1330.0;
