//! Further causes in addition to a fitted model: the gain, the size, and the upper limit of each.

use super::fit::{Fit, slope};
use super::screen::USUAL;
use super::study::FitInputs;
use crate::parallel;
use crate::sand::mechanism::CATALOG;

/// A further cause in addition to a fitted model, from a linear estimate.
#[derive(Clone, Copy, Debug)]
pub struct Further {
    /// Catalogue index.
    pub id: usize,
    /// Value from which a fit begins: the estimate, or a twentieth of the screen's value if it is 0 (our choice).
    pub start: f64,
    pub gain: f64,
    /// Estimate and its standard deviation, in the mechanism's coordinate; the estimate may have the wrong sign.
    pub estimate: f64,
    pub sd: f64,
}

impl FitInputs<'_> {
    /// Further causes in addition to a fitted model, in order of their gain [χ²], largest first.
    pub fn further(&self, first: &Fit, candidates: &[(usize, f64)]) -> Vec<Further> {
        let normal = self.normal_equations(first);
        let others: Vec<_> = candidates.iter().filter(|c| !first.ids.contains(&c.0)).copied().collect();
        let coefficients = self.coefficients(&first.deviations);
        let states: Vec<_> = others.iter().map(|&(id, v)| (first.mechanisms.with(id, v), coefficients)).collect();
        let moved: Vec<_> = others.into_iter().zip(self.model.predict_many(&states)).collect();
        let mut found: Vec<_> = parallel::map(&moved, |&((id, value), ref moved)| {
            let white = self.whitener.apply(&slope(moved, &first.prediction, value));
            let [score, left] = normal.beside(&white, &first.white).unwrap_or_default();
            let estimate = if left > 1e-12 { score / left } else { 0.0 };
            let entry = &CATALOG[id];
            let held =
                estimate.clamp(entry.bounds[0], entry.bounds[1]).clamp(-USUAL * entry.typical, USUAL * entry.typical);
            let held = if entry.ceiling { value } else { held };
            Further {
                id,
                start: if held == 0.0 { 0.05 * value } else { held },
                gain: if held * estimate > 0.0 { score * estimate } else { 0.0 },
                estimate,
                sd: left.max(1e-300).sqrt().recip(),
            }
        });
        found.sort_by(|a, b| b.gain.total_cmp(&a.gain));
        let mut seen = std::collections::HashSet::new();
        found.retain(|f| seen.insert(f.id));
        found
    }
}
