//! The response of the data to the stress coefficients. The force is linear in them, so one computation along the
//! tracks serves all coefficients.

use super::fit::COEFFICIENTS;
use crate::number::add_scaled;
use crate::sand::Coefficients;
use crate::sand::mechanism::Mechanisms;

/// Coefficient [N/m³] at which a column is computed: our choice, of the usual size; the response is linear.
const UNIT: f64 = 1e5;
/// Is the force linear in the coefficients? It is not with a friction limit, which compares two parts of the force, nor
/// with a leg that bends. `skid_loss` and `slip_bearing` count as nonlinear; they do not act in force logs.
pub fn is_linear(m: &Mechanisms) -> bool {
    [m.friction_clip, m.compliance, m.skid_loss, m.slip_bearing] == [0.0; 4]
}

/// The prediction with given mechanisms as a linear function of the coefficients.
pub struct CoefficientResponse {
    rest: Vec<f64>,
    by: Vec<Vec<f64>>,
}

impl CoefficientResponse {
    /// Computes the response from predictions in several sands.
    pub fn new(predict: impl Fn([Coefficients; COEFFICIENTS + 1]) -> Vec<Vec<f64>>) -> Self {
        let state = |k: usize| {
            let mut c = [0.0; COEFFICIENTS];
            if k < COEFFICIENTS {
                c[k] = UNIT;
            }
            Coefficients::from_array(c)
        };
        let mut by = predict(std::array::from_fn(state));
        let rest = by.pop().unwrap_or_default();
        by.iter_mut().for_each(|column| column.iter_mut().zip(&rest).for_each(|(c, r)| *c = (*c - r) / UNIT));
        Self { rest, by }
    }

    pub fn at(&self, coefficients: &Coefficients) -> Vec<f64> {
        let mut all = self.rest.clone();
        for (column, c) in self.by.iter().zip(coefficients.to_array()) {
            add_scaled(&mut all, c, column);
        }
        all
    }
}
