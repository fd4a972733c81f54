//! Profile likelihood of fitted values: the objective at finite steps of a value, with everything else fitted again
//! (e.g. Venzon & Moolgavkar 1988).
//!
//! If a gait sticks or stalls, the objective is rough: slopes are valid only locally, and a fit may end in a local
//! minimum. So each value is changed by finite steps, and the runs are simulated with it. The fit moves to the lowest
//! point. The interval reaches from the first to the last point at which the objective exceeds the lowest one by at
//! most the tolerance `allowed`, which the noise determines.

use super::fit::Fit;
use super::study::FitInputs;
use crate::sand::mechanism::CATALOG;
use nalgebra::{DMatrix, DVector};

/// Steps on either side, in standard deviations of the slope-based interval. Our choice: close together where a smooth
/// objective crosses the tolerance, and some farther out, because a rough objective may cross the tolerance again.
const STEPS: [f64; 11] = [0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 6.0, 9.0, 13.0, 20.0];

/// Largest number of rounds: our choice, because each round simulates all runs with [`STEPS`] on both sides. If the
/// scans of a round find a lower point, the next round scans from there.
const ROUNDS: usize = 3;
/// If a point is lower than the fit by more than this [χ²], it belongs to another minimum: our choice, a quarter of the effect of one σ.
const LOWER: f64 = 0.25;

/// The lowest point in scans of each value about `fit`, and the first and last coordinate of each value at which
/// the objective is within `allowed` of it.
pub fn explore(study: &FitInputs, fit: &Fit, allowed: f64) -> (Fit, Vec<[f64; 2]>) {
    let mut best = fit.clone();
    let mut round = 1;
    loop {
        let scans: Vec<Vec<Fit>> = (0..best.ids.len()).map(|k| scan(study, &best, k)).collect();
        let lowest = scans.iter().flatten().min_by(|a, b| a.objective.total_cmp(&b.objective));
        let lower = lowest.filter(|l| round < ROUNDS && l.objective < best.objective - LOWER).cloned();
        let Some(lower) = lower else {
            let intervals = scans.iter().enumerate().map(|(k, scan)| interval(&best, scan, k, allowed)).collect();
            return (if best.objective < fit.objective { study.with_slopes(best) } else { best }, intervals);
        };
        best = lower;
        round += 1;
    }
}

fn interval(fit: &Fit, scan: &[Fit], k: usize, allowed: f64) -> [f64; 2] {
    if scan.is_empty() {
        return [f64::NAN; 2]; // only the slope-based interval remains
    }
    let place = |fit: &Fit| (fit.coordinates()[k], fit.objective);
    let mut all: Vec<(f64, f64)> = scan.iter().map(place).chain([place(fit)]).collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    let least = all.iter().map(|p| p.1).fold(f64::MAX, f64::min);
    let [low, high] = within(&all, least, allowed);
    [low.min(place(fit).0), high.max(place(fit).0)]
}

/// First and last point of a scan (coordinate, objective) with an objective of at most `allowed` above `least`.
/// Between a point inside and its neighbour outside, a quadratic rise is assumed, as for a smooth objective.
fn within(scan: &[(f64, f64)], least: f64, allowed: f64) -> [f64; 2] {
    let inside: Vec<usize> = (0..scan.len()).filter(|&k| scan[k].1 <= least + allowed).collect();
    let (Some(&first), Some(&last)) = (inside.first(), inside.last()) else { return [f64::NAN; 2] };
    let root = |k: usize| (scan[k].1 - least).max(0.0).sqrt();
    let edge = |k: usize, beyond: usize| {
        let share = (allowed.sqrt() - root(k)) / (root(beyond) - root(k)).max(1e-12);
        scan[k].0 + share.clamp(0.0, 1.0) * (scan[beyond].0 - scan[k].0)
    };
    let low = if first == 0 { scan[0].0 } else { edge(first, first - 1) };
    let high = if last + 1 == scan.len() { scan[last].0 } else { edge(last, last + 1) };
    [low, high]
}

/// Fits with value `k` fixed at several points about its value in `fit`. The other values first change as the slopes at
/// `fit` predict, and then by a Gauss-Newton step from the residual, if the step reduces the objective.
fn scan(study: &FitInputs, fit: &Fit, k: usize) -> Vec<Fit> {
    let (at, bounds) = (fit.coordinates()[k], CATALOG[fit.ids[k]].coordinate_bounds());
    let sd = study.covariance(fit)[(k, k)].sqrt();
    let places = STEPS.iter().rev().map(|s| -s).chain(STEPS).map(|s| (at + s * sd).clamp(bounds[0], bounds[1]));
    let mut places: Vec<f64> = places.filter(|p| p.is_finite() && *p != at).collect();
    places.dedup();
    let information = study.normal_equations(fit).information;
    let others: Vec<usize> = (0..information.nrows()).filter(|&i| i != k).collect();
    let block = DMatrix::from_fn(others.len(), others.len(), |i, j| information[(others[i], others[j])]);
    let Some(inverse) = block.try_inverse() else { return Vec::new() };
    let cross = DVector::from_fn(others.len(), |i, _| information[(others[i], k)]);
    let first = places.iter().map(|place| (fit, whole(&others, &(&inverse * &cross * (at - place)), k, place - at)));
    let moved = study.moved_by(&first.collect::<Vec<_>>());
    let again = moved.iter().map(|there| {
        let score = study.normal_equations(there).score;
        let step = &inverse * DVector::from_fn(others.len(), |i, _| score[others[i]]);
        (there, whole(&others, &step, k, 0.0))
    });
    let second = study.moved_by(&again.collect::<Vec<_>>());
    moved.into_iter().zip(second).map(|(a, b)| if b.objective < a.objective { b } else { a }).collect()
}

/// A step of all parameters, made of the `step` of the `others` and the step `own` of parameter `k`.
fn whole(others: &[usize], step: &DVector<f64>, k: usize, own: f64) -> Vec<f64> {
    let mut all = vec![0.0; others.len() + 1];
    others.iter().zip(step.iter()).for_each(|(&i, s)| all[i] = *s);
    all[k] = own;
    all
}

#[cfg(test)]
mod tests {
    use super::within;

    #[test]
    fn a_level_set_reaches_from_the_first_to_the_last_place() {
        let smooth: Vec<(f64, f64)> = (-8..=8).map(|i| (f64::from(i), 5.0 + 0.25 * f64::from(i * i))).collect();
        let [low, high] = within(&smooth, 5.0, 3.84);
        assert!(
            (low + 2.0 * 3.84f64.sqrt()).abs() < 1e-9 && (high - 2.0 * 3.84f64.sqrt()).abs() < 1e-9,
            "{low} {high}"
        );
        // In this rough scan the objective falls again at 6, so the last point is inside.
        let rough = [(0.0, 1.0), (1.0, 9.0), (2.0, 1.0), (3.0, 50.0), (6.0, 4.0)];
        assert_eq!(within(&rough, 1.0, 3.84), [0.0, 6.0]);
    }
}
