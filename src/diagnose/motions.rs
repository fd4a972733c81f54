//! What other coefficients change, in words that need no names of coefficients: the stress on a plate in a few motions.

use super::fit::COEFFICIENTS;
use super::words::LEAST_PERCENT;
use crate::number::Vec3;
use crate::sand::Coefficients;
use crate::sand::law::{Motion, PlanarTable, StressLaw};
use std::collections::BTreeMap;

/// Names of the stress coefficients in sand.toml, in the order of [`Coefficients::to_array`].
pub const COEFFICIENT_NAMES: [&str; COEFFICIENTS] = ["a00", "a10", "b11", "b01", "bm11", "c11", "c01", "cm11", "d10"];

/// A plate's normal and its direction of motion (x, z). Our choice: each of them shows one of the law's extremes.
const MOTIONS: [(&str, [f64; 2], [f64; 2]); 4] = [
    ("a level plate pushed down", [0.0, 1.0], [0.0, -1.0]),
    ("a level plate pulled up", [0.0, 1.0], [0.0, 1.0]),
    ("an upright plate that is dragged", [1.0, 0.0], [1.0, 0.0]),
    ("an upright plate pushed down", [1.0, 0.0], [0.0, -1.0]),
];

/// Stress per depth against the motion [N/m³].
fn resistance(c: &Coefficients, [nx, nz]: [f64; 2], [vx, vz]: [f64; 2]) -> f64 {
    let v = Vec3::new(vx, 0.0, vz);
    let motion = Motion { v, inverse_speed: 1.0, moving: 1.0, inverse_square: 1.0 };
    -PlanarTable::splat(c).stress(Vec3::new(nx, 0.0, nz), &motion).dot(v)
}

/// The motion whose stress differs most between the stated and the fitted coefficients, and by which share. None if it differs by less
/// than a headline shows, and without coefficients.
pub fn most_changed(coefficients: &BTreeMap<String, [f64; 3]>) -> Option<(&'static str, f64)> {
    let all: Option<Vec<[f64; 3]>> = COEFFICIENT_NAMES.iter().map(|name| coefficients.get(*name).copied()).collect();
    let all: [[f64; 3]; COEFFICIENTS] = all?.try_into().ok()?;
    let [stated, fitted] = [0, 1].map(|which| Coefficients::from_array(all.map(|c| c[which])));
    let change = |(name, normal, v): (&'static str, [f64; 2], [f64; 2])| {
        (name, resistance(&fitted, normal, v) / resistance(&stated, normal, v) - 1.0)
    };
    let most = MOTIONS.map(change).into_iter().max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))?;
    (most.1.is_finite() && 100.0 * most.1.abs() >= LEAST_PERCENT).then_some(most)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_most_changed_motion_is_found() {
        let stated = Coefficients::GENERIC.to_array();
        let of = |fitted: [f64; COEFFICIENTS]| {
            let each = COEFFICIENT_NAMES.iter().zip(stated.iter().zip(fitted));
            most_changed(&each.map(|(name, (s, f))| (name.to_string(), [*s, f, 0.0])).collect())
        };
        assert_eq!(of(stated), None);
        // An upright plate that is dragged feels C01 − C11 − C₋₁₁, so a tenth of C01 more is 0.0253 of 0.37 more.
        let mut dragged = stated;
        dragged[6] *= 1.1;
        let (motion, change) = of(dragged).unwrap();
        assert_eq!(motion, "an upright plate that is dragged");
        assert!((change - 0.0253 / 0.370).abs() < 1e-9, "{change}");
        assert_eq!(most_changed(&BTreeMap::new()), None);
    }
}
