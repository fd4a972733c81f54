//! The experiment that would tell rivals apart.

use super::fit::Fit;
use super::forward::ForwardModel;
use super::noise::Noise;
use super::observations::Observations;
use super::whiten::Whitener;
use serde::Serialize;

/// Trials not yet made.
pub struct Menu {
    pub model: Box<dyn ForwardModel>,
    pub observations: Observations,
    /// What each trial is, in words.
    pub descriptions: Vec<String>,
}

/// A condition worth measuring.
#[derive(Clone, Debug, Serialize, PartialEq)]
pub struct Proposal {
    pub condition: String,
    pub repetitions: usize,
    /// Whitened distance between the two explanations on these repetitions [σ].
    pub expected_separation: f64,
    /// The closest pair of explanations, which this separates.
    pub separates: [Vec<String>; 2],
}

/// Repetitions that a proposal assumes.
const REPETITIONS: usize = 3;

/// The `count` trials of the menu that best separate the two least separated explanations.
pub fn propose(
    menu: &Menu,
    noise: &Noise,
    set: &[&Fit],
    coefficients: impl Fn(&Fit) -> crate::sand::Coefficients,
    count: usize,
) -> Vec<Proposal> {
    let predictions: Vec<Vec<f64>> = set.iter().map(|f| menu.model.predict(&f.mechanisms, &coefficients(f))).collect();
    let Some(first) = predictions.first() else {
        return Vec::new();
    };
    let magnitudes: Vec<Vec<f64>> = menu
        .observations
        .units
        .iter()
        .map(|u| {
            first[u.block(0)]
                .iter()
                .zip(&first[u.block(1.min(menu.observations.channels.len() - 1))])
                .map(|(x, z)| x.hypot(*z))
                .collect()
        })
        .collect();
    let whitener = Whitener::new(&menu.observations, noise, &magnitudes, first);
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
    // Trials that differ only in what neither explanation feels separate equally: one of them is enough.
    order.dedup_by(|a, b| (separations[*a] / separations[*b] - 1.0).abs() < 1e-3);
    let names = |f: &Fit| f.ids.iter().map(|&id| crate::sand::mechanism::CATALOG[id].id.to_string()).collect();
    order
        .into_iter()
        .take(count)
        .map(|k| Proposal {
            condition: menu.descriptions[k].clone(),
            repetitions: REPETITIONS,
            expected_separation: separations[k],
            separates: [names(set[a]), names(set[b])],
        })
        .collect()
}
