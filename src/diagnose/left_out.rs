//! Predicts every condition from the others, with a model that is linear near its fit.

use super::errors::SquaredErrors;
use super::fit::{Fit, Stack};
use super::gram::gram_of;
use super::nuisance::Nuisance;
use super::study::{FitInputs, reading};
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// Largest number of rounds to find the scale of a model's errors. The next constant is the relative change below which
/// the scale counts as found. Our choices; the scale affects the prediction only through the weight of the priors.
const ROUNDS: usize = 4;
const FOUND: f64 = 0.1;

/// A model to compare: a fit with its nuisances, and columns, of which at most one is added to the fit.
#[derive(Clone, Copy)]
pub struct Contender<'a> {
    pub fit: &'a Fit,
    pub nuisances: &'a [Nuisance],
    pub columns: &'a [LawColumn],
}

/// The change of a fit's prediction by a further effect of strength 1, such as a law. These columns take the most memory of a
/// diagnosis, and single precision is far more than a law needs.
pub type LawColumn = Vec<f32>;

impl Contender<'_> {
    /// The readings that the fit predicts.
    pub fn reading(&self) -> Vec<f64> {
        reading(self.fit, self.nuisances)
    }
}

/// How one model predicts each condition from the others.
pub struct LeftOutRow {
    /// Log predictive density of each condition that is used; the last entry is that of the stated priors of coefficients and nuisances.
    pub elpd: Vec<f64>,
    /// The predictions with the scale φ of the errors that all conditions give.
    pub predicted: Predicted,
    /// For each condition, φ as the other conditions give it.
    pub scales: Vec<f64>,
}

/// The linear approximation of a model near its fit, for the numbers of each condition. The last condition is the stated priors
/// of coefficients and nuisances, in which laws have no effect.
pub struct Linear {
    pub residual: Vec<DVector<f64>>,
    /// Derivatives of the numbers, one column for each parameter.
    pub slopes: Vec<DMatrix<f64>>,
    /// The effect of each law on the numbers of each measured condition.
    pub laws: Vec<Vec<DVector<f64>>>,
    /// Precision and score of each parameter's prior at the fit.
    pub prior: Vec<[f64; 2]>,
    /// Prior standard deviation of each law's coefficient.
    pub widths: Vec<f64>,
}

/// A condition, predicted from the others.
pub struct LeftOut {
    /// The law chosen without the condition.
    pub law: Option<usize>,
    /// Change of the parameters that the other conditions give.
    pub step: DVector<f64>,
    pub error: DVector<f64>,
    /// V⁻¹ e: the expected error of the condition itself, without the error of the parameters.
    pub solved: DVector<f64>,
    /// Q = eᵀ V⁻¹ e
    pub square: f64,
    /// ln |V|
    wider: f64,
}

/// The predictions of all conditions with one scale of the errors.
pub struct Predicted {
    /// The law chosen with no condition left out.
    pub law: Option<usize>,
    /// Change of the parameters with no condition left out; with a law, its coefficient is the last one.
    pub step: DVector<f64>,
    /// Each condition, predicted from the others.
    pub left: Vec<LeftOut>,
}

/// Products of a condition: information and score of the parameters; for each law its products with the parameters and with itself,
/// and its score.
#[derive(Clone)]
struct Products {
    information: DMatrix<f64>,
    score: DVector<f64>,
    laws: Vec<(DVector<f64>, [f64; 2])>,
}

/// The solution of normal equations.
struct Solution {
    factor: Option<Cholesky<f64, Dyn>>,
    step: DVector<f64>,
    /// ln |information|; infinite if the normal equations have no solution.
    ln_determinant: f64,
}

impl Solution {
    fn new(information: DMatrix<f64>, score: &DVector<f64>) -> Self {
        let factor = information.cholesky();
        let (step, ln_determinant) = match &factor {
            Some(factor) => (factor.solve(score), factor.ln_determinant()),
            None => (DVector::zeros(score.len()), f64::INFINITY),
        };
        Self { factor, step, ln_determinant }
    }

    fn inverse(&self) -> DMatrix<f64> {
        let n = self.step.len();
        self.factor.as_ref().map_or_else(|| DMatrix::zeros(n, n), Cholesky::inverse)
    }
}

impl Products {
    fn add(&mut self, other: &Products, weight: f64) {
        let information = self.information.iter_mut().zip(&other.information);
        information.for_each(|(sum, own)| *sum += own * weight);
        self.score.axpy(weight, &other.score, 1.0);
        for (sum, law) in self.laws.iter_mut().zip(&other.laws) {
            sum.0.axpy(weight, &law.0, 1.0);
            sum.1 = [sum.1[0] + weight * law.1[0], sum.1[1] + weight * law.1[1]];
        }
    }

    fn less(&self, other: &Products, weight: f64) -> Products {
        let mut rest = self.clone();
        rest.add(other, -weight);
        rest
    }

    /// The law that reduces the errors most beside the parameters, whose solution is `without`.
    fn best_law(&self, without: &Solution) -> Option<usize> {
        let factor = without.factor.as_ref()?;
        let gain = |(cross, own): &(DVector<f64>, [f64; 2])| {
            let left = own[0] - cross.dot(&factor.solve(cross));
            if left > 1e-9 * own[0] { (own[1] - cross.dot(&without.step)).powi(2) / left } else { 0.0 }
        };
        let gains: Vec<f64> = self.laws.iter().map(gain).collect();
        (0..gains.len()).max_by(|a, b| gains[*a].total_cmp(&gains[*b]))
    }

    /// The solution with a law as the last parameter, or without any.
    fn solution_with(&self, law: Option<usize>) -> Solution {
        let Some((cross, own)) = law.map(|law| &self.laws[law]) else {
            return Solution::new(self.information.clone(), &self.score);
        };
        let n = self.score.len();
        let (mut information, score) = (
            self.information.clone().resize(n + 1, n + 1, own[0]),
            self.score.clone().resize_vertically(n + 1, own[1]),
        );
        for k in 0..n {
            (information[(k, n)], information[(n, k)]) = (cross[k], cross[k]);
        }
        Solution::new(information, &score)
    }

    /// The solution with the best law, if there are laws.
    fn solution(&self) -> (Option<usize>, Solution) {
        let without = self.solution_with(None);
        match self.best_law(&without) {
            None => (None, without),
            law => (law, self.solution_with(law)),
        }
    }
}

/// A model in some of its conditions, and the products of each.
struct InConditions<'a> {
    model: &'a Linear,
    /// The conditions; the last one is the stated priors.
    used: Vec<usize>,
    each: Vec<Products>,
}

impl Linear {
    fn products(&self, c: usize) -> Products {
        let (slopes, residual, n) = (&self.slopes[c], &self.residual[c], self.prior.len());
        let column = |k: usize| &slopes.as_slice()[k * residual.len()..(k + 1) * residual.len()];
        let columns: Vec<&[f64]> = (0..n).map(column).collect();
        let law = |l: &Vec<DVector<f64>>| match l.get(c) {
            Some(own) => (slopes.tr_mul(own), [own.norm_squared(), own.dot(residual)]),
            None => (DVector::zeros(n), [0.0; 2]),
        };
        let laws = self.laws.iter().map(law).collect();
        Products { information: gram_of(&columns), score: slopes.tr_mul(residual), laws }
    }

    /// The row of the table in the conditions `used` alone; `degrees` are the degrees of freedom of the noise.
    pub fn row(&self, used: &[usize], degrees: f64) -> LeftOutRow {
        let used: Vec<usize> = used.iter().copied().chain([self.residual.len() - 1]).collect();
        let each = used.iter().map(|&c| self.products(c)).collect();
        InConditions { model: self, used, each }.row(degrees)
    }
}

impl InConditions<'_> {
    /// Number of measured conditions.
    fn measured(&self) -> usize {
        self.used.len() - 1
    }

    /// Weight of a condition if the variance of errors is `scale` times that of the noise. The weight of the last condition, the stated
    /// priors, does not depend on `scale`.
    fn weight(&self, c: usize, scale: f64) -> f64 {
        if c < self.measured() { scale.recip() } else { 1.0 }
    }

    /// Sum of the products of all conditions, together with the prior.
    fn total(&self, scale: f64) -> Products {
        let Linear { prior, widths, .. } = self.model;
        let n = prior.len();
        let mut all = Products {
            information: DMatrix::from_diagonal(&DVector::from_fn(n, |k, _| prior[k][0].max(1e-12))),
            score: DVector::from_fn(n, |k, _| prior[k][1]),
            laws: widths.iter().map(|w| (DVector::zeros(n), [w.powi(-2), 0.0])).collect(),
        };
        self.each.iter().enumerate().for_each(|(c, own)| all.add(own, self.weight(c, scale)));
        all
    }

    /// Scale of the errors, estimated from all conditions except `without`: their mean square, where one more condition
    /// is counted that scatters as the repetitions do. The scale is at least 1, because no model scatters less than the
    /// repetitions.
    fn scale(&self, left: &[LeftOut], without: Option<usize>) -> f64 {
        let own = |c: usize| left[c].square / left[c].error.len().max(1) as f64;
        let (mut sum, mut count) = (1.0, 1.0);
        for c in (0..self.measured()).filter(|c| Some(*c) != without) {
            sum += own(c);
            count += 1.0;
        }
        f64::max(sum / count, 1.0)
    }

    /// The effect of a change of the parameters on the numbers of a condition.
    fn effect(&self, c: usize, law: Option<usize>, step: &DVector<f64>) -> DVector<f64> {
        let (c, n) = (self.used[c], self.model.prior.len());
        let mut effect = &self.model.slopes[c] * step.rows(0, n);
        if let Some(own) = law.and_then(|law| self.model.laws[law].get(c)) {
            effect.axpy(step[n], own, 1.0);
        }
        effect
    }

    /// The products of each parameter with the numbers of a condition.
    fn along(&self, c: usize, law: Option<usize>, numbers: &DVector<f64>) -> DVector<f64> {
        let c = self.used[c];
        let products = self.model.slopes[c].tr_mul(numbers);
        let Some(law) = law else { return products };
        let own = self.model.laws[law].get(c).map_or(0.0, |own| own.dot(numbers));
        products.push(own)
    }

    fn predicted(&self, scale: f64) -> Predicted {
        let all = self.total(scale);
        let (law, whole) = all.solution();
        let inverse = whole.inverse();
        let of = |c: usize| {
            let weight = self.weight(c, scale);
            let (own, without) = all.less(&self.each[c], weight).solution();
            let error = &self.model.residual[self.used[c]] - self.effect(c, own, &without.step);
            let back = self.along(c, own, &error);
            // Usually the same law is chosen without the condition.
            let (along, ln_determinant) = if own == law {
                (&inverse * back, whole.ln_determinant)
            } else {
                let with = all.solution_with(own);
                (with.inverse() * back, with.ln_determinant)
            };
            let solved = &error - self.effect(c, own, &along) * weight;
            let square = error.dot(&solved).max(0.0);
            let wider = (ln_determinant - without.ln_determinant).max(0.0);
            LeftOut { law: own, step: without.step, error, solved, square, wider }
        };
        let left = (0..self.each.len()).map(of).collect();
        Predicted { law, step: whole.step, left }
    }

    fn row(&self, degrees: f64) -> LeftOutRow {
        let mut scale = 1.0;
        let mut now = self.predicted(scale);
        for _ in 0..ROUNDS {
            let next = self.scale(&now.left, None);
            if (next / scale - 1.0).abs() < FOUND {
                break;
            }
            scale = next;
            now = self.predicted(scale);
        }
        let scales: Vec<f64> = (0..self.each.len())
            .map(|c| if c < self.measured() { self.scale(&now.left, Some(c)) } else { 1.0 })
            .collect();
        let density = |(c, (own, scale)): (usize, (&LeftOut, &f64))| {
            let n = own.error.len() as f64;
            let square = own.square / scale;
            // The stated priors count by how far the model is from them, and not by whether the data could predict them:
            // a model without these parameters predicts them exactly.
            let wider = if c < self.measured() { own.wider } else { 0.0 };
            // A simulation that diverges predicts nothing.
            let density = -0.5 * (wider + n * scale.ln() + (degrees + n) * (square / degrees).ln_1p());
            density.max(-1e12)
        };
        let elpd = now.left.iter().zip(&scales).enumerate().map(density).collect();
        LeftOutRow { elpd, predicted: now, scales }
    }
}

/// Errors of the predicted readings on the conditions `held`, with the parameters of the model changed by `step`, of which the last
/// belongs to the `law`. `reading` is that of the model's fit.
pub fn held_out(
    study: &FitInputs,
    model: &Contender,
    reading: &[f64],
    (law, step): (Option<usize>, &[f64]),
    held: &[usize],
) -> SquaredErrors {
    let parts: Vec<(f64, &Stack)> = step.iter().copied().zip(&model.fit.slopes).collect();
    let law = law.and_then(|l| Some((step[step.len() - 1], model.columns.get(l)?)));
    let described = |k: usize| law.map_or(0.0, |(coefficient, column)| coefficient * f64::from(column[k]));
    SquaredErrors::of(
        study.observations,
        |k| reading[k] + parts.iter().map(|(d, s)| d * s[k]).sum::<f64>() + described(k),
        held,
    )
}
