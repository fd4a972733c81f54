//! The scoreboard: what the model says about measurements that no code of this kind made.

pub mod data;
pub mod fit;
pub mod others;
pub mod page;
pub mod robots;
pub mod score;

/// Bulk density of the wheels' sand [kg/m³], documented with the data.
pub const DENSITY: f64 = 1330.0;
