//! Forward models: predictions of a data set. All statistics use only [`ForwardModel`].

use super::experiment::Experiment;
use super::nuisance::{Nuisance, NuisanceState};
use super::observations::Observations;
use super::shared::Uncertainty;
use crate::sand::mechanism::{CATALOG, Mechanism, Mechanisms};
use crate::sand::{Coefficients, Medium, SandDescription, Term};
use crate::sim::hardware::HardwareDescription;

/// The sand to predict with.
pub type SandParameters = (Mechanisms, Coefficients);

/// The same sand with all stresses increased by a share.
pub fn stronger((mechanisms, coefficients): &SandParameters, share: f64) -> SandParameters {
    (Mechanisms { scale: (1.0 + mechanisms.scale) * (1.0 + share) - 1.0, ..*mechanisms }, *coefficients)
}

/// Mechanisms as indices of the catalogue; where the data cannot test a mechanism, with the reason.
pub type Testable = Vec<(usize, Option<String>)>;

/// The mechanisms of one kind of data. A mechanism whose columns are `missing` cannot be tested.
pub fn testable(kind: impl Fn(&Mechanism) -> bool, missing: &[&str]) -> Testable {
    let why = |m: &Mechanism| {
        let lacking: Vec<_> = m.columns.iter().filter(|c| missing.contains(c)).copied().collect();
        (!lacking.is_empty()).then(|| format!("the data have no column {}", lacking.join(", ")))
    };
    CATALOG.iter().enumerate().filter(|(_, m)| kind(m)).map(|(index, m)| (index, why(m))).collect()
}

/// A feature: a quantity that varies along the data and may be related to a misfit.
#[derive(Clone, Debug, PartialEq)]
pub struct Feature {
    pub name: &'static str,
    pub unit: &'static str,
    /// One value for each sample, unit by unit (not repeated over channels).
    pub values: Vec<Vec<f64>>,
}

/// A division of the data in two.
pub struct Division {
    pub by: &'static str,
    pub names: [String; 2],
    /// The part of each sample, unit by unit; None: in neither.
    pub parts: Vec<Vec<Option<bool>>>,
}

/// Trials that could be made next. Each is a condition, whose name describes it.
pub struct Menu<'a> {
    pub model: Box<dyn ForwardModel + 'a>,
    pub observations: Observations,
}

/// Predicts the stack of [`Observations`] for any mechanisms and coefficients.
pub trait ForwardModel: Sync {
    /// Predicts all numbers, in the order of `Observations::values`, for several sands at once.
    fn predict_many(&self, sands: &[SandParameters]) -> Vec<Vec<f64>>;
    /// The same for one sand.
    fn predict(&self, sand: &SandParameters) -> Vec<f64> {
        self.predict_many(std::slice::from_ref(sand)).swap_remove(0)
    }
    /// Was the work stopped? Predictions after that are NaN.
    fn stopped(&self) -> bool {
        false
    }
    /// A numerical slope is not reliable if its step changes all data together by less than this [σ]; None if
    /// predictions are smooth.
    fn roughness(&self) -> Option<f64> {
        None
    }
    /// Is the prediction linear in the stress coefficients with these mechanisms? Then its slopes by them are the same everywhere.
    fn is_linear(&self, _mechanisms: &Mechanisms) -> bool {
        false
    }
    /// Causes of differences between repetitions, and errors of the model, at the prediction with `sand`.
    fn uncertainty(&self, sand: &SandParameters, prediction: &[f64]) -> Uncertainty;
    /// Nuisances that all data share, computed at the prediction with `sand`; `values` are their present estimates.
    fn nuisances(&self, _sand: &SandParameters, _values: &[NuisanceState]) -> Vec<Nuisance> {
        Vec::new()
    }
    /// A prediction of the simulator, without the corrections of [`Self::predict`].
    fn as_simulated(&self, prediction: &[f64]) -> Vec<f64> {
        prediction.to_vec()
    }
    /// The simulator's prediction with this hardware; None if the hardware does not change the prediction.
    fn with_hardware(&self, _sand: &SandParameters, _found: &HardwareDescription) -> Option<Vec<f64>> {
        None
    }
    /// The same model with these terms added to its sand; None if the model does not support terms.
    fn with_terms(&self, _terms: &[Term]) -> Option<Box<dyn ForwardModel + '_>> {
        None
    }
    /// Greatest normal speed [m/s], greatest depth [m] and least width [m] in the data, for the ranges of terms.
    fn reach(&self) -> [f64; 3] {
        [1.0; 3]
    }
    /// Adds to the sand of a simulation all settings other than the medium with which the model predicts this kind of data.
    fn finish(&self, _sand: &mut SandDescription) {}
    /// What the experiment file states.
    fn experiment(&self) -> &Experiment;
    /// The medium of the plain model.
    fn medium(&self) -> &Medium {
        &self.experiment().medium
    }
    /// The sand of the plain model.
    fn plain_sand(&self) -> SandParameters {
        (Mechanisms::default(), self.medium().coefficients)
    }
    /// The mechanisms that act on this kind of data.
    fn testable(&self) -> Testable;
    /// The features of the data.
    fn features(&self) -> Vec<Feature>;
    /// The size of the body of each unit, relative to those of its type; empty if it is not known.
    fn sizes(&self) -> Vec<f64> {
        Vec::new()
    }
    /// Divisions of the data in two by the motion, for each sample of each unit.
    fn divisions(&self) -> Vec<Division> {
        Vec::new()
    }
    /// Trials that the same apparatus could make next.
    fn menu(&self) -> Option<Menu<'_>> {
        None
    }
    /// A name in reports for the group of a unit (its shape).
    fn group(&self, unit: usize) -> &str;
}
