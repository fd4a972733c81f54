//! The form of a cause's law: does the effect depend on speed, depth and size as the law says? Each effect may have a free power of
//! each of these instead: its column times the logarithm of the quantity is the derivative by the power. If such a model predicts
//! left-out conditions better, the law's form is rejected.

use super::candidates::SECOND;
use super::evidence::EvidenceTable;
use super::fit::slope;
use super::left_out::{Contender, LawColumn};
use super::series::root_mean_square;
use super::study::FitInputs;
use crate::sand::mechanism::{CATALOG, Mechanisms, Side};
use crate::student;
use serde::Serialize;

/// A quantity counts if its logarithm varies by at least this standard deviation over the data: our choice, a factor of 1.2 in either
/// direction; a power of a quantity that hardly varies has no effect.
const VARIES: f64 = 0.2;
/// A form is rejected without left-out conditions, too, if 0 is farther from a power of the depth or size than this many halves of its 95 %
/// interval, 3 standard errors: our choice, as for a law beside a cause. They are those of the model's own errors where these are larger
/// than the noise. Few conditions hardly tell two models apart where their samples do. What grows otherwise with the depth is a layer, a
/// crust or a bottom, which no cause is, and these look different to intruders of other sizes. What grows with the speed may be a second
/// cause, and in grains all forces grow with it a little.
const CLEAR: f64 = 1.5;
/// Least depth [m] and share of the greatest speed whose logarithm is used: our choices; the effects are negligible there.
const SHALLOW: f64 = 2e-3;
const SLOW: f64 = 0.02;

/// The free power of one quantity in the law of one cause.
#[derive(Clone, Debug, Serialize, PartialEq)]
pub struct FreePower {
    pub id: String,
    /// `speed`, `depth` or `size`.
    pub by: String,
    /// Power that the data add to the law's own, and its 95 % interval.
    pub power: f64,
    pub ci95: [f64; 2],
    /// Does the interval exclude 0, and does a model with this power predict left-out conditions better beyond twice the standard error, or
    /// is 0, for a power of the depth or size, farther away than 1.5 halves of it, after the interval was widened to the model's errors?
    /// A power does not count if its square in standard errors is less than 1 % of the cause's: it may be a small error in the law of a very
    /// strong cause ([`SECOND`]).
    pub rejected: bool,
}

impl FreePower {
    /// A clause that says so, if the form is rejected.
    pub fn said(&self) -> Option<String> {
        let Self { id, by, power, .. } = self;
        let way = if *power > 0.0 { "faster" } else { "more slowly" };
        self.rejected.then(|| format!("the effect grows {way} with {by} than in {id} (power {power:+.2})"))
    }
}

/// The names of two quantities and of their features.
const SPEED: &str = "speed";
const DEPTH: &str = "depth";

/// The logarithm of each quantity at each sample of each unit, less its mean; only of those that vary.
fn quantities(study: &FitInputs) -> Vec<(&'static str, Vec<Vec<f64>>)> {
    let features = study.model.features();
    let feature = |name: &str| features.iter().find(|f| f.name == name).map(|f| f.values.clone());
    let floored = |mut values: Vec<Vec<f64>>, least: f64| {
        values.iter_mut().flatten().for_each(|v| *v = v.max(least).ln());
        values
    };
    let mut all = Vec::new();
    if let Some(speeds) = feature(SPEED) {
        let most = speeds.iter().flatten().copied().fold(0.0, f64::max);
        all.push((SPEED, floored(speeds, (SLOW * most).max(1e-9))));
    }
    all.extend(feature(DEPTH).map(|depths| (DEPTH, floored(depths, SHALLOW))));
    let sizes = study.model.sizes();
    if !sizes.is_empty() {
        let each = study.observations.units.iter().zip(sizes).map(|(u, size)| vec![size.ln(); u.samples]);
        all.push(("size", each.collect()));
    }
    all.retain_mut(|(_, values)| {
        let count = values.iter().map(Vec::len).sum::<usize>().max(1) as f64;
        let mean = values.iter().flatten().sum::<f64>() / count;
        values.iter_mut().flatten().for_each(|v| *v -= mean);
        (values.iter().flatten().map(|v| v * v).sum::<f64>() / count).sqrt() > VARIES
    });
    all
}

/// Do these sizes vary enough for a power of the size?
pub fn vary(sizes: &[f64]) -> bool {
    let logs = sizes.iter().map(|size| size.ln());
    let mean = logs.clone().sum::<f64>() / sizes.len().max(1) as f64;
    root_mean_square(logs.map(|v| v - mean)) > VARIES
}

/// Tests the form of each cause in the sand of a model.
pub fn free_powers(study: &FitInputs, model: &Contender, degrees: f64) -> Vec<FreePower> {
    let now = study.with_nuisances(model.nuisances.to_vec());
    let quantities = quantities(study);
    let mut columns: Vec<LawColumn> = Vec::new();
    let mut of: Vec<(usize, &'static str)> = Vec::new();
    for &id in model.fit.ids.iter().filter(|id| CATALOG[**id].side == Side::Sand) {
        let without = model.fit.mechanisms.with(id, Mechanisms::PLAIN.get(id));
        let without = now.model.predict(&(without, now.coefficients(&model.fit.deviations)));
        let effect = slope(&model.fit.prediction, &without, 1.0);
        for (by, logs) in &quantities {
            let units = &study.observations.units;
            let at = |u: usize, c: usize, i: usize| effect[units[u].block(c).start + i] * logs[u][i];
            columns.push(study.observations.stack(at).iter().map(|v| *v as f32).collect());
            of.push((id, by));
        }
    }
    let free = |k: usize| Contender { columns: std::slice::from_ref(&columns[k]), ..*model };
    let models: Vec<Contender> = [*model].into_iter().chain((0..columns.len()).map(free)).collect();
    let table = EvidenceTable::new(&now, now.whitener, &models);
    let normal = now.normal_equations(model.fit);
    let reach = student::two_sided_95(degrees.max(2.0));
    let clear = CLEAR * table.lack(0).max(1.0).sqrt();
    let covariance = now.covariance(model.fit);
    let strength = |id: usize| {
        let k = model.fit.ids.iter().position(|own| *own == id).unwrap_or(0);
        model.fit.coordinates()[k].powi(2) / covariance[(k, k)]
    };
    let tested = |(k, (id, by)): (usize, &(usize, &'static str))| {
        let column: Vec<f64> = columns[k].iter().copied().map(f64::from).collect();
        let [score, left] = normal.beside(&now.whitener.apply(&column), &model.fit.white)?;
        let (power, half) = (score / left.max(1e-300), reach * left.max(1e-300).sqrt().recip());
        let certain = power.abs() > half && table.beats(k + 1, 0) || *by != SPEED && power.abs() > clear * half;
        Some(FreePower {
            id: CATALOG[*id].id.into(),
            by: (*by).into(),
            power,
            ci95: [power - half, power + half],
            rejected: certain && power * power * left > SECOND * strength(*id),
        })
    };
    of.iter().enumerate().filter_map(tested).collect()
}
