//! Ratios of two series that should be equal, and the units that explain them.

use crate::table::Quantity;

/// A ratio counts as a unit's ratio if the two differ by less than this share: our choice, less than the distance
/// between most units of a quantity; of two such units the nearer one counts.
pub const NEAR: f64 = 0.2;
/// Least correlation for which a ratio is evaluated: our choice, because a ratio of unrelated signals has no meaning.
pub const CLEAR: f64 = 0.7;

/// The sums of a², a b and b².
pub fn products(pairs: impl Iterator<Item = (f64, f64)>) -> (f64, f64, f64) {
    pairs.fold((0.0, 0.0, 0.0), |(aa, ab, bb), (a, b)| (aa + a * a, ab + a * b, bb + b * b))
}

/// The ratio of the rms of `b` to the rms of `a`, with the sign of their correlation; None if the correlation is weaker than [`CLEAR`].
pub fn proportion(pairs: impl Iterator<Item = (f64, f64)>) -> Option<f64> {
    let (aa, ab, bb) = products(pairs);
    (ab.abs() > CLEAR * (aa * bb).sqrt() && aa > 0.0 && bb > 0.0).then(|| ab.signum() * (bb / aa).sqrt())
}

/// [`proportion`] of the differences of `a` and `b` from their means.
pub fn proportion_of_changes(pairs: &[(f64, f64)]) -> Option<f64> {
    let n = pairs.len() as f64;
    let (a, b) = pairs.iter().fold((0.0, 0.0), |(a, b), pair| (a + pair.0 / n, b + pair.1 / n));
    proportion(pairs.iter().map(|pair| (pair.0 - a, pair.1 - b)))
}

/// The unit in which a quantity was logged, if its numbers are `ratio` times those in SI units. The SI unit itself does not count.
pub fn unit(quantity: Quantity, ratio: f64) -> Option<&'static str> {
    nearest(quantity, ratio).filter(|(_, off)| *off < f64::ln(1.0 + NEAR)).map(|(unit, _)| unit)
}

/// The unit whose ratio is nearest to `ratio`, and the distance of the two logarithms.
pub fn nearest(quantity: Quantity, ratio: f64) -> Option<(&'static str, f64)> {
    let off = |factor: f64| (ratio * factor).ln().abs();
    let other = quantity.units().iter().filter(|u| u.1 != 1.0).map(|u| (u.0, off(u.1)));
    other.filter(|u| u.1.is_finite()).min_by(|a, b| a.1.total_cmp(&b.1))
}
