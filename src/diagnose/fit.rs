//! The result of a fit, and the types that fits share.

use crate::sand::mechanism::{CATALOG, Mechanisms};
use std::sync::Arc;

/// Number of the stress coefficients.
pub const COEFFICIENTS: usize = 9;
/// A vector in the order of the measured numbers. Fits share vectors, because vectors use most of the memory, and
/// usually nine columns of each fit are equal to the plain model's.
pub type Stack = Arc<Vec<f64>>;

/// A fitted model.
#[derive(Clone, Debug)]
pub struct Fit {
    /// Catalogue indices of the fitted mechanisms.
    pub ids: Vec<usize>,
    pub mechanisms: Mechanisms,
    /// Deviation of each coefficient, then of each nuisance, in units of its prior sd.
    pub deviations: Vec<f64>,
    /// Prediction of the sand, without nuisances.
    pub prediction: Vec<f64>,
    /// W (y − m): W whitens, y has the measured numbers, and m the prediction with the nuisances.
    pub white: Vec<f64>,
    /// |W (y − m)|² + |d|², where d are the `deviations`.
    pub objective: f64,
    /// ∂m/∂(coordinate of each id, deviation of each coefficient and nuisance), not whitened.
    pub slopes: Vec<Stack>,
}

impl Fit {
    /// Values of the fitted mechanisms.
    pub fn values(&self) -> Vec<f64> {
        self.ids.iter().map(|&id| self.mechanisms.get(id)).collect()
    }

    /// Ids of the fitted mechanisms.
    pub fn names(&self) -> Vec<String> {
        self.ids.iter().map(|&id| CATALOG[id].id.to_string()).collect()
    }

    /// Has one of the fitted mechanisms the value of the plain sand? Then this mechanism explains nothing.
    pub fn is_idle(&self) -> bool {
        self.ids.iter().any(|&id| self.mechanisms.get(id) == Mechanisms::PLAIN.get(id))
    }

    /// Coordinates of the fitted mechanisms: the fit's parameters.
    pub fn coordinates(&self) -> Vec<f64> {
        self.ids.iter().map(|&id| CATALOG[id].coordinate(self.mechanisms.get(id))).collect()
    }

    /// Whitened distance² to another fit, coefficients included.
    pub fn distance_squared(&self, other: &Fit) -> f64 {
        let white: f64 = self.white.iter().zip(&other.white).map(|(a, b)| (a - b) * (a - b)).sum();
        let prior: f64 = self.deviations.iter().zip(&other.deviations).map(|(a, b)| (a - b) * (a - b)).sum();
        white + prior
    }
}

/// Change of a prediction divided by `step`; numbers that are missing because a simulation diverged count as unchanged.
pub fn slope(moved: &[f64], from: &[f64], step: f64) -> Vec<f64> {
    moved.iter().zip(from).map(|(a, b)| (a - b) / step).map(|s| if s.is_finite() { s } else { 0.0 }).collect()
}
