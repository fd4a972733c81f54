//! Weights of the reward of every task that walks.

use crate::error::{Result, check_range};
use crate::spec::Term;
use serde::{Deserialize, Serialize};

/// Weight of each reward term; all terms are of order 1 a step before weighting, `termination` once an episode. What each
/// term is stands in [`Weights::terms`]. Our choice: tracking dominates, the costs break ties between gaits of the same speed.
/// `alive` and `termination` make sure that falling never pays: standing is worth `alive` a step, less than it costs on any
/// slope, and a fall costs as much as 4 s of it (tests/falls.rs). gymnasium's Ant has `healthy_reward`, Isaac Lab `is_alive`
/// and `is_terminated`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Weights {
    pub tracking: f64,
    pub lateral: f64,
    pub turning: f64,
    pub power: f64,
    pub smoothness: f64,
    pub alive: f64,
    pub termination: f64,
}

/// Name and law of each term, in the order of [`Weights`]; v_forward, v_left: the base's mean velocity over the step in its
/// heading frame; ω_z: its yaw speed after the step.
const TERMS: [(&str, &str); 7] = [
    ("tracking", "exp(−((v_forward − commanded speed) / 0.1 m/s)²)"),
    ("lateral", "−2 (√(1 + (v_left / 0.1 m/s)²) − 1)"),
    ("turning", "−2 (√(1 + ((ω_z − commanded yaw speed) / 1 rad/s)²) − 1)"),
    ("power", "−mechanical power Σ|τ ω| / 1 W"),
    ("smoothness", "−mean squared change of the action"),
    ("alive", "1 in every step that does not terminate the episode"),
    ("termination", "−1 in the step that terminates it"),
];

impl Default for Weights {
    fn default() -> Self {
        Self { tracking: 1.0, lateral: 0.1, turning: 0.05, power: 0.1, smoothness: 0.05, alive: 0.1, termination: 20.0 }
    }
}

impl Weights {
    /// In the order of the info columns.
    pub(crate) fn values(&self) -> [f64; TERMS.len()] {
        let Self { tracking, lateral, turning, power, smoothness, alive, termination } = *self;
        [tracking, lateral, turning, power, smoothness, alive, termination]
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
