//! Tests the form of the named law: the exponent of the speed is fitted together with everything else.
//!
//! A wrong exponent is a small misfit that lack of fit alone may not show: over a narrow range of speeds λ v² and
//! λ' v^1.5 are similar. So the objective is scanned over exponents. The report states which exponents are
//! excluded, and whether the law's own is.

use super::chi_squared;
use super::fit::Fit;
use super::lack_of_fit;
use super::profile::within;
use super::study::Study;
use crate::parallel;
use crate::sand::mechanism::CATALOG;
use serde::Serialize;

/// Exponents that are tried: our choice, from 0, as in Coulomb friction, to 4.
const EXPONENTS: [f64; 9] = [0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0];
/// Further exponents about the best one, at distances that bracket the interval's ends for a smooth objective.
const FINER: [f64; 7] = [-1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 1.5];
/// An exponent nearer than this to the law's counts as the law's: over a decade of speed the stress then differs by
/// a quarter at most, as much as other small errors of a model. Our choice.
const SAME: f64 = 0.1;
/// Exponents further than this from the law's are other laws; if the interval contains one, the data do not decide.
/// Our choice: half a power, as between the drag of grains that is cited with 2 and laws measured with 1.5.
const OTHER: f64 = 0.5;
/// Largest difference of the objectives of the law and of another exponent that chance causes once in a thousand; the
/// same probability as for causes in the ambiguity set.
const EXCLUDED: f64 = chi_squared::AT_999_PER_MILLE;
/// Rise of the objective at the ends of the 95 % interval.
const INTERVAL: f64 = chi_squared::AT_95_PERCENT;

/// Results on the exponent of the speed in a law.
#[derive(Clone, Debug, Serialize, PartialEq)]
pub struct SpeedExponent {
    pub id: String,
    /// The law's own exponent.
    pub law: f64,
    /// The exponent that fits best.
    pub found: f64,
    /// 95 % interval; limited to the exponents that were tried.
    pub ci95: [f64; 2],
    /// Do the data exclude the law's exponent?
    pub excluded: bool,
    /// Do the data exclude the law's exponent, or those half a power away from it?
    pub told_apart: bool,
    /// Mean square of the smooth whitened residual with the exponent found.
    pub lack_of_fit: f64,
    /// Objective of the fit with the exponent found, in units of χ².
    #[serde(skip)]
    pub objective: f64,
}

impl SpeedExponent {
    /// A clause for the report's sentence; empty if the data agree with the law.
    pub fn said(&self) -> String {
        let SpeedExponent { id, law, found, ci95: [low, high], .. } = self;
        if self.excluded {
            format!(
                "; the data ask for the power {found:.2} of the speed (95 % interval {low:.2} to {high:.2}) where {id} has {law}"
            )
        } else if !(low..=high).contains(&law) {
            format!(
                "; the data prefer the power {found:.2} of the speed (95 % interval {low:.2} to {high:.2}) to the {law} of {id}, \
                 without excluding that"
            )
        } else if !self.told_apart {
            format!("; of the speed in {id} these data allow every power from {low:.1} to {high:.1}, not only {law}")
        } else {
            String::new()
        }
    }
}

/// A law whose exponent can be tested.
#[derive(Clone, Copy)]
pub struct SpeedLaw {
    /// Index in the catalogue.
    id: usize,
    /// The law's own exponent.
    law: f64,
}

impl SpeedLaw {
    /// The first cause of `fit` that the study's model can predict with other exponents.
    pub fn of(study: &Study, fit: &Fit) -> Option<Self> {
        let laws = fit.ids.iter().filter_map(|&id| Some(Self { id, law: CATALOG[id].exponent? }));
        laws.into_iter().find(|asked| study.model.with_exponent(asked.id, asked.law).is_some())
    }

    /// Is this the only cause of `fit`?
    pub fn alone(&self, fit: &Fit) -> bool {
        fit.ids == [self.id]
    }
}

/// Scans the exponent of the given law about `fit`; `inflation` is the factor on χ² differences.
pub fn check(study: &Study, fit: &Fit, SpeedLaw { id, law }: SpeedLaw, inflation: f64) -> Option<SpeedExponent> {
    let fitted = |exponent: f64| {
        let model = study.model.with_exponent(id, exponent)?;
        Some(study.with_model(&*model).fit_near(fit))
    };
    let at = |exponents: &[f64]| -> Option<Vec<(f64, f64)>> {
        let place = |&exponent: &f64| Some((exponent, fitted(exponent)?.objective));
        parallel::map(exponents, place).into_iter().collect()
    };
    let mut scan = at(&EXPONENTS)?;
    let (found, curvature) = minimum(&scan);
    let reach = (INTERVAL * inflation / curvature.max(1e-9)).sqrt().min(OTHER);
    let (low, high) = (EXPONENTS[0], EXPONENTS[EXPONENTS.len() - 1]);
    let finer = FINER.map(|step| (found + step * reach).clamp(low, high));
    scan.extend(at(&[&finer[..], &[law - SAME, law + SAME]].concat())?);
    scan.sort_by(|a, b| a.0.total_cmp(&b.0));
    scan.dedup_by(|a, b| a.0 - b.0 < 1e-6);
    let (found, _) = minimum(&scan);
    let best = fitted(found)?;
    scan.push((found, best.objective));
    scan.sort_by(|a, b| a.0.total_cmp(&b.0));
    let objective = scan.iter().map(|s| s.1).fold(f64::MAX, f64::min);
    let near = scan.iter().filter(|s| (s.0 - law).abs() <= SAME + 1e-9).map(|s| s.1).fold(f64::MAX, f64::min);
    let ci95 = within(&scan, objective, INTERVAL * inflation);
    let excluded = near - objective > EXCLUDED * inflation;
    Some(SpeedExponent {
        id: CATALOG[id].id.into(),
        law,
        found,
        ci95,
        excluded,
        told_apart: excluded || (ci95[0] > law - OTHER && ci95[1] < law + OTHER),
        lack_of_fit: lack_of_fit::statistic(study.observations, &best.white).mean,
        objective,
    })
}

/// Minimum of the parabola through the least value of the scan and its neighbours, and half its second derivative.
fn minimum(scan: &[(f64, f64)]) -> (f64, f64) {
    let best = (0..scan.len()).min_by(|a, b| scan[*a].1.total_cmp(&scan[*b].1)).unwrap_or(0);
    let k = best.clamp(1, scan.len() - 2);
    let ((x0, y0), (x1, y1), (x2, y2)) = (scan[k - 1], scan[k], scan[k + 1]);
    let (left, right) = ((y1 - y0) / (x1 - x0), (y2 - y1) / (x2 - x1));
    let curvature = (right - left) / (x2 - x0);
    if curvature <= 0.0 {
        return (scan[best].0, 0.0);
    }
    // Newton's form: y0 + left (x − x0) + curvature (x − x0)(x − x1)
    ((0.5 * (x0 + x1) - 0.5 * left / curvature).clamp(x0, x2), curvature)
}
