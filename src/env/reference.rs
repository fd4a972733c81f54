//! How the references of servos move.

use super::spec::CONTROL_RATE;
use std::f64::consts::{PI, TAU};

/// Largest speed of a servo's reference [rad/s]: 5 Hz, the highest stride frequency of Li et al. 2012. All control
/// modes have the same limit, so that gaits can be compared.
pub const TOP_SPEED: f64 = 5.0 * TAU;

/// Speed [rad/s] with which a reference reaches `target` [rad] by the shortest way within a control step; at most
/// [`TOP_SPEED`].
pub fn toward(target: f64, reference: f64) -> f64 {
    (wrap_angle(target - reference) * CONTROL_RATE).clamp(-TOP_SPEED, TOP_SPEED)
}

/// An angle [rad] without its whole turns, in [−π, π).
pub fn wrap_angle(angle: f64) -> f64 {
    (angle + PI).rem_euclid(TAU) - PI
}

#[cfg(test)]
mod tests {
    use super::*;

    /// From half a degree past the top to half a degree before it is one degree; and speed is limited.
    #[test]
    fn references_go_by_the_shortest_way() {
        let degree = PI / 180.0;
        assert!((toward(-179.5 * degree, 179.5 * degree) - degree * CONTROL_RATE).abs() < 1e-9);
        assert!((toward(0.1 * degree, 0.3 * degree) + 0.2 * degree * CONTROL_RATE).abs() < 1e-9);
        assert_eq!(toward(2.0, 0.0), TOP_SPEED);
        assert_eq!(toward(2.0, 5.0), -TOP_SPEED);
        // A reference that lags by whole turns is no further away.
        assert!((toward(0.1, -2.0 * TAU) - 0.1 * CONTROL_RATE).abs() < 1e-9);
    }
}
