//! Nuisances with nonlinear effects: fit and linearisation are adjusted to each other.

use super::fit::{COEFFICIENTS, Fit};
use super::gauss_newton::{REACH, at_bound};
use super::nuisance::Nuisance;
use super::study::FitInputs;
use super::whiten::Whitener;
use crate::parallel;

/// Largest number of rounds for nuisances with a nonlinear effect: our choice; most fits need two.
const BENDS: usize = 6;
/// A change by less than this share of a prior standard deviation counts as converged: our choice, so that the effect
/// of the nuisance is right to a fiftieth of what its prior allows.
const STRAIGHT: f64 = 0.02;

/// Start values of far fits, in stated standard deviations: our choice; between them Gauss-Newton steps converge.
pub const FAR: [f64; 5] = [0.0, 5.0, -5.0, 10.0, -10.0];

/// Nuisances linearised at `fit` under a whitening. Where nuisances at their bounds only stand in for something else, the fit may be
/// stuck there, so it is made again from the stated apparatus, and from far values of an effect with a wide prior.
pub fn bent(study: &FitInputs, whitener: &Whitener, fit: &Fit) -> Vec<Nuisance> {
    if study.nuisances.is_empty() {
        return Vec::new();
    }
    let from = |start: &Fit| {
        let now = study.under(whitener, study.nuisances_of(fit, start));
        let at = now.fit_from(&[start]).swap_remove(0);
        settled_nuisances(now, fit, at, f64::INFINITY)
    };
    let (near, at) = from(fit);
    if !bound(&at) && !bound(fit) {
        return near;
    }
    let mut still = fit.clone();
    still.deviations[COEFFICIENTS..].fill(0.0);
    let mut starts = vec![still.clone()];
    // Each fit of a rough model takes simulations, so there are no far ones.
    let far = |n: &Nuisance| study.model.roughness().is_none() && n.sd > n.stated_sd && n.nearly_linear.is_finite();
    for (k, n) in study.nuisances.iter().enumerate().filter(|(_, n)| far(n)) {
        starts.extend(FAR[1..].iter().map(|far| {
            let mut start = still.clone();
            start.deviations[COEFFICIENTS + k] = far * n.stated_sd / n.sd;
            start
        }));
    }
    let (mut best, mut least) = (near, at.objective);
    for (fresh, anew) in parallel::map(&starts, from) {
        if anew.objective < least {
            (best, least) = (fresh, anew.objective);
        }
    }
    best
}

/// Is a nuisance of a fit at its bound?
pub fn bound(fit: &Fit) -> bool {
    fit.deviations[COEFFICIENTS..].iter().any(|d| at_bound(*d))
}

/// The nuisances of a study, linearised at their estimates about `fit`, from the fit `at` with them; and the fit there. Fit and
/// nuisances are adjusted to each other in turns, because the first estimate is inaccurate if a filter is slow compared with
/// the fastest trials. A step that does not help is halved. A fit that is unlikely to reach the objective `best` is abandoned.
pub fn settled_nuisances(mut now: FitInputs, fit: &Fit, mut at: Fit, best: f64) -> (Vec<Nuisance>, Fit) {
    let mut least = f64::INFINITY;
    let mut before = fit.clone();
    before.deviations.resize(at.deviations.len(), 0.0);
    for _ in 0..BENDS {
        let moved = now.nuisances.iter().zip(&at.deviations[COEFFICIENTS..]).zip(&before.deviations[COEFFICIENTS..]);
        let curved =
            |n: &Nuisance, d: f64| n.id == "lowpass" || n.id.starts_with("imu") || d.abs() * n.sd > n.nearly_linear;
        let turned = moved.filter(|((n, d), _)| curved(n, **d)).map(|((n, a), b)| (a - b).abs() * n.sd / n.stated_sd);
        if turned.fold(0.0, f64::max) < STRAIGHT {
            break;
        }
        // The effect of a filter depends on its time constant, and hardly on the small changes of the other parameters
        // in these rounds.
        let next = now.with_nuisances(now.nuisances_of(fit, &at));
        let there = next.restated(&at);
        if there.objective > least {
            let half = at.deviations.iter().zip(&before.deviations).map(|(a, b)| 0.5 * (a + b)).collect();
            at = Fit { deviations: half, ..at };
            continue;
        }
        let gained = least - there.objective;
        (least, before) = (there.objective, at);
        if REACH * gained < least - best {
            at = there;
            break;
        }
        at = next.fit_from(&[&there]).swap_remove(0);
        now = next;
    }
    (now.nuisances_of(fit, &at), at)
}
