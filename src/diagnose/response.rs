//! How the data answer to the stress coefficients: the force is linear in them, so one walk along the tracks tells it for all.

use super::fit::COEFFICIENTS;
use crate::number::add_scaled;
use crate::sand::Coefficients;
use crate::sand::mechanism::Mechanisms;
use std::sync::{Arc, Mutex, PoisonError};

/// Coefficient [N/m³] at which a column is taken: any of their usual size.
const UNIT: f64 = 1e5;
/// Responses kept: our choice. Fits take slopes and predictions about few states at a time, and a response is ten stacks.
const KEPT: usize = 8;

/// Is the force linear in the coefficients? A cap of friction compares two parts of it, and a leg that yields goes elsewhere.
pub fn is_linear(m: &Mechanisms) -> bool {
    [m.friction_clip, m.compliance, m.skid_loss, m.slip_bearing] == [0.0; 4]
}

/// A prediction under given mechanisms by the coefficients.
pub struct Response {
    rest: Vec<f64>,
    by: Vec<Vec<f64>>,
}

impl Response {
    /// From predictions in several sands.
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

/// Responses made last. A clone has none: what it belongs to may be changed.
#[derive(Default)]
pub struct Responses(Mutex<Vec<(Mechanisms, Arc<Response>)>>);

impl Clone for Responses {
    fn clone(&self) -> Self {
        Self::default()
    }
}

impl Responses {
    pub fn known(&self, m: &Mechanisms) -> Option<Arc<Response>> {
        let known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        known.iter().find(|k| k.0 == *m).map(|k| k.1.clone())
    }

    /// The one for `m`, made where it is not known; others wait for it meanwhile, for they mostly want the same.
    pub fn of(&self, m: &Mechanisms, make: impl FnOnce() -> Response) -> Arc<Response> {
        let mut known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, response)) = known.iter().find(|k| k.0 == *m) {
            return response.clone();
        }
        let made = Arc::new(make());
        // The plain model's comes first and is wanted again and again.
        if known.len() == KEPT {
            known.remove(1);
        }
        known.push((*m, made.clone()));
        made
    }
}
