//! Proposes the experiment that would distinguish rivals.

use super::fit::Fit;
use super::forward::Menu;
use super::noise::{Noise, NoiseData, sizes};
use super::observations::Observations;
use super::study::FitInputs;
use super::whiten::Whitener;
use serde::Serialize;

/// A proposed condition.
#[derive(Clone, Debug, Serialize, PartialEq)]
pub struct Proposal {
    pub condition: String,
    pub repetitions: usize,
    /// Whitened distance between the predictions of the two explanations for `REPETITIONS` repetitions of this condition [σ].
    pub expected_separation: f64,
    /// The causes of the two nearest explanations, which this condition separates.
    pub separates: [Vec<String>; 2],
}

/// Number of repetitions that a proposal assumes: our choice, as many as docs/diagnosis.md recommends.
const REPETITIONS: usize = 3;

/// The `count` trials of the menu that best separate the two nearest explanations.
pub fn propose(menu: &Menu, noise: &Noise, study: &FitInputs, set: &[&Fit], count: usize) -> Vec<Proposal> {
    let states: Vec<_> = set.iter().map(|f| study.sand(f)).collect();
    let predictions = menu.model.predict_many(&states);
    let (Some(first), Some(sand)) = (predictions.first(), states.first()) else {
        return Vec::new();
    };
    let observations = Observations { values: first.clone(), ..menu.observations.clone() };
    let mut uncertainty = menu.model.uncertainty(sand, first);
    // One unit represents all repetitions. More repetitions do not reduce the error that they share, so its size is multiplied by √n.
    let errors = uncertainty.common.iter_mut().flatten().chain(&mut uncertainty.own);
    errors.for_each(|e| *e *= (REPETITIONS as f64).sqrt());
    let (sizes, uncertainty) = (&sizes(&observations), &uncertainty);
    let source = NoiseData { observations: &observations, prediction: first, sizes, uncertainty, left_out: &[] };
    let whitener = Whitener::new(&source, noise);
    let separation = |a: usize, b: usize| -> Vec<f64> {
        let difference: Vec<f64> = predictions[a].iter().zip(&predictions[b]).map(|(a, b)| a - b).collect();
        let white = whitener.apply(&difference);
        let of = |u: &super::observations::Unit| white[menu.observations.span(u)].iter().map(|w| w * w).sum::<f64>();
        menu.observations.units.iter().map(|u| (of(u) * REPETITIONS as f64).sqrt()).collect()
    };
    let pairs = (0..set.len()).flat_map(|a| (0..a).map(move |b| (b, a)));
    let closest = pairs.map(|(a, b)| (set[a].distance_squared(set[b]), a, b)).min_by(|a, b| a.0.total_cmp(&b.0));
    let Some((_, a, b)) = closest else { return Vec::new() };
    let separations = separation(a, b);
    let mut order: Vec<usize> = (0..separations.len()).collect();
    order.sort_by(|i, j| separations[*j].total_cmp(&separations[*i]));
    // Trials that differ only in a quantity without effect on both explanations separate these equally, so only one
    // such trial is kept. A thousandth is our choice, above rounding.
    order.dedup_by(|a, b| (separations[*a] / separations[*b] - 1.0).abs() < 1e-3);
    order
        .into_iter()
        .take(count)
        .map(|k| Proposal {
            condition: menu.observations.conditions[k].clone(),
            repetitions: REPETITIONS,
            expected_separation: separations[k],
            separates: [set[a].names(), set[b].names()],
        })
        .collect()
}
