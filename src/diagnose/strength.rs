//! How strong the sand is: the stress of the fitted sand over that of the stated sand.
//!
//! The ratio of measured to predicted forces alone would be exact only if nothing else were wrong: a plate that is 2 % larger than
//! stated, and a load cell with a gain of 1.02, also give forces that are 2 to 4 % greater. So the factor is that of a fit in which
//! effects of measuring and coefficients are marginalised within their priors, and `scale` has no prior, which would pull the factor
//! toward 1. In a robot's log the load is the robot's weight, so forces hardly depend on the sand's strength, but depths and motions do.
//!
//! Let m be the readings, s = ∂m/∂scale, and d_k the deviations of the coefficients. The stated sand has the readings (1 − Σ γ_k d_k) s,
//! where γ_k is the share of s in (∂m/∂d_k)/(1 + scale), the mean over conditions. The fitted sand has (1 + scale) s, so the factor is
//! (1 + scale)/(1 − Σ γ_k d_k). In a force log this is the ratio of both forces, the mean over conditions.

use super::fit::{COEFFICIENTS, Fit};
use super::observations::Observations;
use super::study::FitInputs;
use crate::sand::mechanism::Mechanisms;
use nalgebra::DVector;

/// Number of batches of consecutive trials: our choice. Trials of one day, or of one preparation of the bed, have errors in common, and
/// the file does not say where a day ends. Few batches are as long as days; with fewer of them Student's t would give intervals of no
/// use.
const BATCHES: usize = 5;

/// The factor and its 95 % interval, the wider of those with conditions and with batches of consecutive trials as clusters. It begins at
/// the fit of `scale` among `fits`, or at `base`. None if the strength has no effect on the data.
pub fn factor(study: &FitInputs, base: &Fit, fits: &[Fit], degrees: f64) -> Option<(f64, [f64; 2])> {
    let id = Mechanisms::index("scale").ok().filter(|id| study.model.testable().iter().any(|t| t.0 == *id))?;
    let known = fits.iter().find(|fit| fit.ids == [id]);
    let fit = match known.filter(|_| study.model.roughness().is_some()) {
        Some(fit) => study.restated(fit), // each further step would take many simulations
        None => {
            let begun = Fit { ids: vec![id], slopes: Vec::new(), ..base.clone() };
            study.fit_from(&[known.unwrap_or(&begun)]).swap_remove(0)
        }
    };
    let stronger = 1.0 + fit.values()[0];
    let shares = shares(study.observations, &fit).map(|share| share / stronger);
    let stated = 1.0 - shares.iter().zip(&fit.deviations).map(|(share, d)| share * d).sum::<f64>();
    let factor = stronger / stated;
    // The derivative of the factor's logarithm: factors multiply.
    let mut direction = DVector::zeros(fit.slopes.len());
    direction[0] = stronger.recip();
    shares.iter().enumerate().for_each(|(k, share)| direction[1 + k] = share / stated);
    let half = [study.observations.repetitions(), batches(study.observations.units.len())]
        .iter()
        .map(|clusters| study.reach_along(&fit, &direction, degrees, clusters))
        .fold(0.0, f64::max);
    let ends = [-half, half].map(|half| factor * half.exp());
    (factor > 0.0 && ends.iter().all(|end| end.is_finite())).then_some((factor, ends))
}

/// The share of the effect of `scale` in that of each coefficient: the mean over conditions, over the channels that count.
fn shares(o: &Observations, fit: &Fit) -> [f64; COEFFICIENTS] {
    let groups = o.repetitions();
    std::array::from_fn(|k| {
        let of = |units: &Vec<usize>| {
            let places = o.counted(units.iter().map(|&u| &o.units[u]));
            let [both, own] = places.fold([0.0; 2], |[both, own], i| {
                let (stronger, other) = (fit.slopes[0][i], fit.slopes[1 + k][i]);
                [both + stronger * other, own + stronger * stronger]
            });
            (own > 0.0).then_some(both / own)
        };
        let each: Vec<f64> = groups.iter().filter_map(of).collect();
        each.iter().sum::<f64>() / each.len().max(1) as f64
    })
}

/// Consecutive units, in batches of nearly equal size.
fn batches(units: usize) -> Vec<Vec<usize>> {
    let count = BATCHES.min(units);
    (0..count).map(|b| (b * units / count..(b + 1) * units / count).collect()).collect()
}

#[cfg(test)]
mod tests {
    use super::batches;

    #[test]
    fn batches_have_every_unit_once() {
        for units in [1, 2, 5, 7, 72] {
            let all = batches(units);
            assert_eq!(all.concat(), (0..units).collect::<Vec<_>>());
            assert!(all.len() <= 5 && all.iter().all(|b| b.len() >= units / 5 && !b.is_empty()));
        }
    }
}
