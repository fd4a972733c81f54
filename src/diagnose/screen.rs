//! The linear effect of every candidate on the data. It gives the start values of fits, and the pairs that are worth a fit.

use super::fit::{Stack, slope};
use super::gram::{crosses, gram};
use super::study::FitInputs;
use super::whiten::Whitener;
use crate::number::dot;
use crate::sand::mechanism::CATALOG;
use nalgebra::{DMatrix, DVector};

/// A cause affects the data if its typical strength changes all data together by more than 0.01 σ: our choice, far
/// below the smallest effect that could be found. This is the square of 0.01.
pub const FELT: f64 = 1e-4;
/// Bound of a linear estimate in typical strengths: our choice; further from the plain model the linear estimate is
/// not reliable.
pub const USUAL: f64 = 4.0;

/// The effect of each candidate on the data: the change of the prediction per typical strength, at one value.
pub struct Screen {
    /// For each candidate its catalogue index, and the value at which its column was computed.
    pub candidates: Vec<(usize, f64)>,
    columns: Vec<Vec<f64>>,
    marginal_columns: Vec<Stack>,
    plain: Vec<f64>,
}

/// Products of the whitened columns with each other and with the residual, after the coefficients' effects were projected out.
pub struct Scores {
    pub gram: DMatrix<f64>,
    pub score: DVector<f64>,
}

/// The start values of each cause, and the predictions with them.
pub fn tried(study: &FitInputs, ids: &[usize]) -> (Vec<(usize, f64)>, Vec<Vec<f64>>) {
    let values = ids.iter().flat_map(|&id| starts(study, id).into_iter().map(move |value| (id, value)));
    let (values, (plain, coefficients)) = (values.collect::<Vec<_>>(), study.model.plain_sand());
    let states: Vec<_> = values.iter().map(|&(id, value)| (plain.with(id, value), coefficients)).collect();
    let moved = study.model.predict_many(&states);
    (values, moved)
}

impl Screen {
    /// Effects of the candidates on the prediction of the plain model.
    pub fn new(study: &FitInputs, candidates: &[usize]) -> Self {
        let plain = study.model.predict(&study.model.plain_sand());
        let (tried, moved) = tried(study, candidates);
        let column = |(&(id, value), moved): (&(usize, f64), Vec<f64>)| {
            slope(&moved, &plain, CATALOG[id].coordinate(value) / CATALOG[id].coordinate_typical())
        };
        let columns = tried.iter().zip(moved).map(column).collect();
        Self { candidates: tried, columns, marginal_columns: study.marginal_slopes[0].clone(), plain }
    }

    /// Scores of a stack of measured values.
    pub fn scores(&self, whitener: &Whitener, values: &[f64]) -> Scores {
        let residual: Vec<f64> = values.iter().zip(&self.plain).map(|(y, m)| y - m).collect();
        let white = whitener.apply(&residual);
        let (c, z) = (whitener.apply_all(&self.marginal_columns), whitener.apply_all(&self.columns));
        let count = c.len();
        let prior = gram(&c) + DMatrix::identity(count, count);
        let inverse = prior.try_inverse().unwrap_or_else(|| DMatrix::identity(count, count));
        let cz = crosses(&c, &z);
        let cr = DVector::from_fn(count, |i, _| dot(&c[i], &white));
        let gram = gram(&z) - cz.transpose() * &inverse * &cz;
        let score = DVector::from_fn(z.len(), |i, _| dot(&z[i], &white)) - cz.transpose() * &inverse * &cr;
        Scores { gram, score }
    }

    /// May this column's parameter have the sign of `value`?
    fn allowed(&self, column: usize, value: f64) -> bool {
        value >= 0.0 || CATALOG[self.candidates[column].0].coordinate_bounds()[0] < 0.0
    }

    /// All pairs of different causes, as Δχ² and two columns; the pair with the greatest gain comes first. A pair whose
    /// effects are equal within a part in a million is left out: our choice, because its values would be rounding.
    pub fn pairs(&self, gram: &DMatrix<f64>, score: &DVector<f64>) -> Vec<(f64, usize, usize)> {
        let mut all = Vec::new();
        for i in 0..score.len() {
            for j in 0..i {
                let (a, b, c) = (gram[(i, i)], gram[(i, j)], gram[(j, j)]);
                let determinant = a * c - b * b;
                if self.candidates[i].0 == self.candidates[j].0 || a.min(c) <= FELT || determinant <= 1e-6 * a * c {
                    continue;
                }
                let p = (c * score[i] - b * score[j]) / determinant;
                let q = (a * score[j] - b * score[i]) / determinant;
                if self.allowed(i, p) && self.allowed(j, q) {
                    all.push((p * score[i] + q * score[j], i, j));
                }
            }
        }
        all.sort_by(|a, b| b.0.total_cmp(&a.0));
        all
    }
}

/// Number of start values for an upper limit: from twice its typical value down to a quarter of it, in steps of √2. Our
/// choice, because the behaviour changes at the limit at which a motor begins to stall.
const CEILINGS: usize = 7;

/// Start values of a mechanism's fit; more than one value if the effect is far from proportional to the value. Those of
/// `friction_clip` are our choice, μ = 2, 0.5 and 0.2.
pub fn starts(study: &FitInputs, id: usize) -> Vec<f64> {
    let entry = &CATALOG[id];
    match entry.id {
        "friction_clip" => vec![0.5, 2.0, 5.0],
        _ if entry.ceiling => (0..CEILINGS).map(|k| 2.0 * entry.typical * 0.5f64.powf(0.5 * k as f64)).collect(),
        // A strength whose effect on the data is reliable: the typical strength, or a larger one for a rough model.
        _ => vec![(0.5 * entry.coordinate_typical()).max(study.steps[id])],
    }
}
