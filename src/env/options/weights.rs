//! Weights of the reward of every task that walks.

use crate::env::spec::Term;
use crate::error::{Result, check_range};
use serde::{Deserialize, Serialize};

/// Weight of each reward term; all terms are of order 1 a step before weighting. Our choice: tracking dominates, the
/// others only break ties between gaits of the same speed. What each term is stands in [`Weights::terms`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Weights {
    pub tracking: f64,
    pub lateral: f64,
    pub turning: f64,
    pub power: f64,
    pub smoothness: f64,
}

/// Name and law of each term, in the order of [`Weights`]; v, ω_z: the base's mean velocity over the step and its yaw
/// speed after it.
const TERMS: [(&str, &str); 5] = [
    ("tracking", "exp(−((v_x − commanded speed) / 0.1 m/s)²)"),
    ("lateral", "−(v_y / 0.1 m/s)², at least −1"),
    ("turning", "−((ω_z − commanded yaw speed) / 1 rad/s)², at least −1"),
    ("power", "−mechanical power Σ|τ ω| / 1 W, at least −1"),
    ("smoothness", "−mean squared change of the action"),
];

impl Default for Weights {
    fn default() -> Self {
        Self { tracking: 1.0, lateral: 0.1, turning: 0.05, power: 0.1, smoothness: 0.05 }
    }
}

impl Weights {
    /// In the order of the info columns.
    pub(in crate::env) fn values(&self) -> [f64; TERMS.len()] {
        [self.tracking, self.lateral, self.turning, self.power, self.smoothness]
    }

    /// The reward's terms, in the order of the info columns.
    pub fn terms(&self) -> Vec<Term> {
        TERMS.iter().zip(self.values()).map(|((name, law), weight)| Term { name, law, weight }).collect()
    }

    pub fn validate(&self) -> Result<()> {
        let mut terms = self.terms().into_iter();
        terms.try_for_each(|t| check_range(&format!("weights.{}", t.name), t.weight, 0.0..=1e3).map(drop))
    }
}
