//! The number ξ_n of a medium (Agarwal, Goldman & Kamrin, PNAS 120:e2214017120 (2023)), from its friction and density.

/// α_z(0, π/2, 0)/ξ_n for a horizontal plate pushed straight down; from the paper's table.
pub const PENETRATION: f64 = 0.87574;

/// ξ_n [N/m³] from the internal friction μ and the critical density ρ_c [kg/m³]: ρ_c g (894μ³ − 386μ² + 89μ), fitted
/// for μ in [`FITTED_FRICTION`] (same paper).
pub fn from_friction(mu: f64, density: f64) -> f64 {
    density * crate::GRAVITY * (894.0 * mu * mu * mu - 386.0 * mu * mu + 89.0 * mu)
}

/// Range of μ in which [`from_friction`] was fitted.
pub const FITTED_FRICTION: std::ops::RangeInclusive<f64> = 0.3..=0.9;
