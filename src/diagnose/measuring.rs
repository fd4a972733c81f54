//! What a change of the apparatus does to a force log.

use super::nuisance::Nuisance;
use super::track::Wrench;
use crate::sand::mechanism::Mechanisms;
use std::sync::{Mutex, PoisonError};

/// Effects on the data per unit, for one state of the sand.
pub struct Measuring {
    /// Tilt, offsets and filter of the sensor in this state.
    pub mechanisms: Mechanisms,
    pub here: Vec<f64>,
    pub late: Vec<f64>,
    pub deep: Vec<f64>,
    pub tilted: Vec<f64>,
    /// Changes by the attitude of all plates, by that of all legs, and by the size of all intruders. A trial feels that of its own
    /// intruder only.
    pub plates: Vec<f64>,
    pub legs: Vec<f64>,
    pub larger: Vec<f64>,
    /// Loads of each track at the steps of a filter.
    pub steps: Vec<Vec<[Wrench; 1]>>,
    /// Nuisances at estimates near 0 in this state, which are asked for again and again.
    pub near: Mutex<Vec<Nuisance>>,
}

impl Measuring {
    /// The nuisance at an estimate near 0, made if it is not known.
    pub fn near(&self, id: &str, of: Option<&str>, make: impl FnOnce() -> Nuisance) -> Nuisance {
        let all = || self.near.lock().unwrap_or_else(PoisonError::into_inner);
        let known = all().iter().find(|n| n.id == id && n.of.as_deref() == of).cloned();
        known.unwrap_or_else(|| {
            let made = make();
            let made = match of {
                Some(of) => made.of(of),
                None => made,
            };
            all().push(made.clone());
            made
        })
    }
}
