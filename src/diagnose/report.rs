//! Contents of the report: `report.json`, as documented, and `sand.toml`.

use super::check::Check;
use super::form::FreePower;
use super::misfit::Misfit;
use super::nuisance::CauseKind;
use super::speed_exponent::SpeedExponent;
use super::split::Split;
use super::verdict::{Verdict, Written};
use crate::error::{Error, Result};
use crate::sand::SandDescription;
use crate::sim::hardware::HardwareDescription;
use serde::{Serialize, Serializer};
use std::collections::BTreeMap;

/// A cause with its strength.
#[derive(Clone, Debug, Serialize, PartialEq)]
pub struct Cause {
    pub id: String,
    /// The channel or the shape whose error this is, for an effect of measuring; null: of all.
    pub of: Option<String>,
    /// What is wrong: the sand, the measurement, or the robot.
    pub kind: CauseKind,
    pub value: f64,
    pub unit: String,
    pub ci95: [f64; 2],
    /// Is the value at a bound of its law?
    pub at_bound: bool,
}

/// A model that leads by its evidence, but that is not named.
#[derive(Clone, Debug, Serialize, PartialEq)]
pub struct Withheld {
    pub ids: Vec<String>,
    pub terms: Vec<String>,
    /// The tests that it failed.
    pub why: Vec<String>,
}

/// The stated coefficients against the fitted ones.
#[derive(Clone, Debug, Serialize, PartialEq)]
pub struct Recalibration {
    /// Measured over predicted stress of the sand, with effects of measuring marginalised ([`super::strength`]). If the data do not
    /// suffice for a verdict or for such a fit: measured over predicted force, geometric mean over conditions.
    pub factor: f64,
    pub ci95: [f64; 2],
    /// Coefficient → [stated, fitted, standard deviation of the fitted one] [N/m³].
    pub coefficients: BTreeMap<String, [f64; 3]>,
}

/// One model in the comparison by its predictions of left-out conditions.
#[derive(Clone, Debug, Serialize, PartialEq)]
pub struct EvidenceRow {
    /// `plain`, `recalibrated` (fitted coefficients), `established` (the plain sand with the effects of measuring that are
    /// named), `causes` or `law`.
    pub model: &'static str,
    /// Ids of its causes; empty for the plain model and for a law alone.
    pub ids: Vec<String>,
    /// Formulas of its laws found in the data.
    pub terms: Vec<String>,
    /// Log predictive density of left-out conditions, summed over the conditions.
    pub elpd: f64,
    /// `elpd` minus the elpd of the best model, 0 or negative.
    pub difference: f64,
    /// Standard error of `difference`, over conditions.
    pub standard_error: f64,
    /// Is it the model in `sand.toml`?
    pub written: bool,
}

/// One cause or pair that was tried.
#[derive(Clone, Debug, Serialize, PartialEq)]
pub struct Tried {
    pub ids: Vec<String>,
    pub values: Vec<f64>,
    pub delta_chi2: f64,
    /// Fraction by which the candidate reduces the held-out error of the plain model with fitted coefficients.
    pub cv_gain: Option<f64>,
    pub lack_of_fit: Option<f64>,
    /// Change of χ² + 2 × number of parameters (AIC); the next field has ln n in place of 2 (BIC).
    pub delta_aic: f64,
    pub delta_bic: f64,
    /// Whitened distance to the best explanation [σ].
    pub distance_to_best: Option<f64>,
}

/// Mean squares of the whitened errors on left-out conditions, after repetitions were averaged; noise alone gives 1.
#[derive(Clone, Debug, Default, Serialize, PartialEq)]
pub struct LackOfFit {
    pub plain: Option<f64>,
    pub extended: Option<f64>,
    pub limit: Option<f64>,
}

/// The gain of the extension on held-out conditions. Errors are root mean squares in units of the noise: after whitening and the mean
/// over repetitions, noise alone gives 1.
#[derive(Clone, Debug, Default, Serialize, PartialEq)]
pub struct Gain {
    /// Error of the simulation without changes [1].
    pub held_out_rmse_plain: Option<f64>,
    /// Error of the simulation with coefficients fitted within their prior, without a cause [1].
    pub held_out_rmse_recalibrated: Option<f64>,
    pub held_out_rmse_extended: Option<f64>,
    /// Error of a perfect model: 1.
    pub noise_floor: Option<f64>,
    /// Fraction by which the error of what is written is less than the plain model's, and its 95 % interval.
    pub reduction: Option<f64>,
    pub ci95: Option<[f64; 2]>,
    /// Reduction of the error as a share of the achievable reduction, which is the plain model's error minus that of a perfect
    /// model. None if the plain model's error is no larger than noise may cause. By chance the share may be slightly above 1.
    pub achievable_fraction: Option<f64>,
    /// Were cause, noise and whitening chosen without the held-out conditions in each fold?
    pub nested: bool,
    /// The same errors of the readings themselves.
    pub in_units: Option<RawErrors>,
}

/// Root mean square errors of readings on left-out conditions [unit].
#[derive(Clone, Debug, Default, Serialize, PartialEq)]
pub struct RawErrors {
    pub unit: String,
    pub plain: f64,
    pub recalibrated: f64,
    pub extended: f64,
    /// Standard deviation between repetitions, which no model can predict.
    pub noise_floor: f64,
}

/// Effects of measuring, marginalised and not named as causes.
#[derive(Clone, Debug, Serialize, PartialEq)]
pub struct NuisanceValue {
    pub id: String,
    /// The channel or the shape, if each has its own value.
    pub of: Option<String>,
    /// `log`: all data have one value. `trial`, `bed`: each trial or bed has its own value, with mean 0 and standard deviation `sd`.
    pub level: &'static str,
    pub value: f64,
    /// For a value of the whole log: the width of its 95 % interval divided by the width for a normal distribution with standard deviation 1.
    pub sd: f64,
    pub unit: &'static str,
}

/// The misfit that the final model leaves.
#[derive(Clone, Debug, Serialize, PartialEq)]
pub struct Remainder {
    /// Is the misfit larger than noise?
    pub significant: bool,
    /// Share of the plain model's misfit, the variance of its errors beyond noise, that remains.
    pub fraction: f64,
    #[serde(rename = "where")]
    pub place: String,
    pub lack_of_fit: f64,
    pub limit: f64,
}

/// A law found in the data.
#[derive(Clone, Debug, Serialize, PartialEq)]
pub struct TermFound {
    /// The formula as text, and in TeX.
    pub formula: String,
    pub tex: String,
    pub on: String,
    pub groups: BTreeMap<String, f64>,
    pub coefficient: f64,
    pub ci95: [f64; 2],
    pub range: BTreeMap<String, [f64; 2]>,
}

/// Upper limit of a cause that was not found.
#[derive(Clone, Debug, Serialize, PartialEq)]
pub struct UpperLimit {
    pub id: String,
    /// Upper limit of the size of the cause's value, for either sign.
    pub value: f64,
    pub unit: String,
    pub level: f64,
}

#[derive(Clone, Debug, Serialize, PartialEq)]
pub struct Untestable {
    pub id: String,
    pub why: String,
}

/// A proposed condition.
#[derive(Clone, Debug, Serialize, PartialEq)]
pub struct Proposal {
    pub condition: String,
    pub repetitions: usize,
    /// Whitened distance between the predictions of the two explanations for `REPETITIONS` repetitions of this condition [σ]; null if it
    /// is not known.
    pub expected_separation: Option<f64>,
}

#[derive(Clone, Debug, Serialize, PartialEq)]
pub struct NextExperiment {
    /// One sentence.
    pub why: String,
    /// The explanations that the experiment separates.
    pub decides: Vec<String>,
    /// New conditions: none is in the data.
    pub conditions: Vec<Proposal>,
    /// Greatest expected separation [σ]; null if it is not known.
    pub expected: Option<f64>,
}

/// All results of a diagnosis.
#[derive(Clone, Debug, Default, Serialize, PartialEq)]
pub struct Report {
    pub schema: &'static str,
    pub verdict: Verdict,
    /// What the checks of the data found before any fit.
    pub check: Check,
    /// What `sand.toml` contains.
    pub written: Written,
    /// The models that the verdict compares, the plain one first.
    pub evidence: Vec<EvidenceRow>,
    /// What is wrong, how much, and how sure: at most 160 characters.
    pub headline: String,
    /// What to do.
    pub action: String,
    /// The verdict in one sentence, with all that follows from the table.
    pub summary: String,
    /// The division of the data in which the plain model's error differs most.
    pub split: Option<Split>,
    /// How the measured forces differ from the plain model's.
    pub recalibration: Option<Recalibration>,
    pub withheld: Vec<Withheld>,
    pub causes: Vec<Cause>,
    /// Correlation of the causes' values, row by row; empty for fewer than two.
    pub correlations: Vec<Vec<f64>>,
    pub ambiguity_set: Vec<Vec<String>>,
    pub candidates: Vec<Tried>,
    pub lack_of_fit: LackOfFit,
    pub gain: Gain,
    pub nuisances: Vec<NuisanceValue>,
    /// None if the noise floor is not known.
    pub remainder: Option<Remainder>,
    pub terms: Vec<TermFound>,
    pub upper_limits: Vec<UpperLimit>,
    /// Degrees of freedom of the estimated noise along the causes' effects.
    pub degrees_of_freedom: Option<f64>,
    /// Does the law of the best cause have the right exponent of the speed? None if the law has no such exponent, or if
    /// the data cannot test it.
    pub form: Option<SpeedExponent>,
    /// Free powers in the laws of the causes.
    pub free_powers: Vec<FreePower>,
    pub misfit: Vec<Misfit>,
    /// The ranges with the largest errors of the plain model, in clauses; none without significant misfit.
    #[serde(rename = "where", serialize_with = "as_sentence")]
    pub whereabouts: Vec<String>,
    pub untestable: Vec<Untestable>,
    pub next_experiment: Option<NextExperiment>,
    /// Feature → least and greatest value in the data.
    pub valid_range: BTreeMap<String, [f64; 2]>,
    pub noise: Option<NoiseSummary>,
    pub warnings: Vec<String>,
    /// How the numbers were prepared.
    pub notes: Vec<String>,
    /// For walking data: means by condition and channel; empty for force logs.
    pub runs: Vec<RunMeans>,
    pub data_sha256: String,
}

/// Writes clauses as one sentence; null if there are none.
fn as_sentence<S: Serializer>(clauses: &[String], serializer: S) -> std::result::Result<S::Ok, S::Error> {
    (!clauses.is_empty()).then(|| clauses.join("; ")).serialize(serializer)
}

/// One channel of one condition, means over its repetitions.
#[derive(Clone, Debug, Serialize, PartialEq)]
pub struct RunMeans {
    pub condition: String,
    pub channel: String,
    pub unit: String,
    pub measured: f64,
    pub plain: f64,
    pub extended: Option<f64>,
}

/// Noise as learnt from the repetitions.
#[derive(Clone, Debug, Serialize, PartialEq)]
pub struct NoiseSummary {
    /// Standard deviations of the noise that all numbers of a repetition share: `bed_strength` (relative),
    /// `depth_zero`, offsets and drifts of force logs; `bed_strength` and `gait_scatter` of walking runs.
    pub shared: BTreeMap<String, f64>,
    /// Channel → [standard deviation of the proportional noise, standard deviation of the constant noise, correlation
    /// of the proportional noise from sample to sample].
    pub channels: BTreeMap<String, [f64; 3]>,
}

/// A finished diagnosis.
pub struct Diagnosis {
    pub report: Report,
    /// The extended model (the plain one if nothing helps), for the simulator.
    pub sand: SandDescription,
    /// Properties of the robot's motors, sensors and delays that were found, together with those that the experiment file states.
    pub hardware: HardwareDescription,
    /// Measured, plain and extended stacks, for plots.
    pub curves: Curves,
    /// Name of the data file.
    pub name: String,
}

/// Measured and predicted stacks in the order of `observations`.
pub struct Curves {
    pub observations: super::observations::Observations,
    /// The shape of each unit.
    pub groups: Vec<String>,
    /// Description of each condition in words.
    pub conditions: Vec<String>,
    /// Name of the sand.
    pub medium: String,
    pub plain: Vec<f64>,
    pub extended: Option<Vec<f64>>,
    /// Does the extended model consist of the plain sand and of hardware that was found?
    pub sand_is_plain: bool,
    /// Standard deviation of one repetition about the model.
    pub band: Vec<f64>,
}

impl Diagnosis {
    pub fn json(&self) -> Result<String> {
        serde_json::to_string_pretty(&self.report).map_err(|e| Error::invalid("report", e.to_string()))
    }
}
