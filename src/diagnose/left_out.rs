//! Predicts every condition from the others, with a model that is linear near its fit.

use super::errors::SquaredErrors;
use super::fit::{COEFFICIENTS, Fit, Stack};
use super::nuisance::Nuisance;
use super::study::FitInputs;
use nalgebra::{DMatrix, DVector};

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

/// The readings that `fit` predicts: the sand and the nuisances.
pub fn reading(fit: &Fit, nuisances: &[Nuisance]) -> Vec<f64> {
    let mut reading = fit.prediction.clone();
    for (nuisance, d) in nuisances.iter().zip(&fit.deviations[COEFFICIENTS..]) {
        reading.iter_mut().zip(nuisance.column.iter()).for_each(|(r, c)| *r += d * c);
        if let Some(bend) = &nuisance.bend {
            reading.iter_mut().zip(bend.iter()).for_each(|(r, b)| *r += b);
        }
    }
    reading
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
/// of coefficients and nuisances.
pub struct Linear {
    pub residual: Vec<DVector<f64>>,
    pub slopes: Vec<Vec<DVector<f64>>>,
    pub laws: Vec<Vec<DVector<f64>>>,
    /// Precision and score of each parameter's prior at the fit.
    pub prior: Vec<[f64; 2]>,
    /// Prior standard deviation of each law's coefficient.
    pub widths: Vec<f64>,
}

/// Products of a condition: information and score of the parameters; for each law its products with the parameters and with itself,
/// and its score.
#[derive(Clone)]
struct Products {
    information: DMatrix<f64>,
    score: DVector<f64>,
    laws: Vec<(DVector<f64>, [f64; 2])>,
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

impl Products {
    fn add(&mut self, other: &Products, weight: f64) {
        self.information += &other.information * weight;
        self.score += &other.score * weight;
        for (sum, law) in self.laws.iter_mut().zip(&other.laws) {
            sum.0 += &law.0 * weight;
            sum.1 = [sum.1[0] + weight * law.1[0], sum.1[1] + weight * law.1[1]];
        }
    }

    fn less(&self, other: &Products, weight: f64) -> Products {
        let mut rest = self.clone();
        rest.add(other, -weight);
        rest
    }

    /// The law that reduces the errors most.
    fn best_law(&self) -> Option<usize> {
        if self.laws.is_empty() {
            return None;
        }
        let factor = self.information.clone().cholesky()?;
        let adjusted = factor.solve(&self.score);
        let gain = |(cross, own): &(DVector<f64>, [f64; 2])| {
            let left = own[0] - cross.dot(&factor.solve(cross));
            if left > 1e-9 * own[0] { (own[1] - cross.dot(&adjusted)).powi(2) / left } else { 0.0 }
        };
        let gains: Vec<f64> = self.laws.iter().map(gain).collect();
        (0..gains.len()).max_by(|a, b| gains[*a].total_cmp(&gains[*b]))
    }

    /// Information and score with a law as the last parameter.
    fn with(&self, law: Option<usize>) -> (DMatrix<f64>, DVector<f64>) {
        let Some((cross, own)) = law.map(|l| &self.laws[l]) else {
            return (self.information.clone(), self.score.clone());
        };
        let n = self.score.len();
        let (mut information, mut score) = (
            self.information.clone().resize(n + 1, n + 1, own[0]),
            self.score.clone().resize_vertically(n + 1, own[1]),
        );
        for k in 0..n {
            (information[(k, n)], information[(n, k)]) = (cross[k], cross[k]);
        }
        (information[(n, n)], score[n]) = (own[0], own[1]);
        (information, score)
    }
}

impl Linear {
    fn products(&self, c: usize) -> Products {
        let n = self.slopes.len();
        let mut information = DMatrix::zeros(n, n);
        for i in 0..n {
            for j in 0..=i {
                let product = self.slopes[i][c].dot(&self.slopes[j][c]);
                (information[(i, j)], information[(j, i)]) = (product, product);
            }
        }
        let law = |l: &Vec<DVector<f64>>| {
            let cross = DVector::from_fn(n, |i, _| self.slopes[i][c].dot(&l[c]));
            (cross, [l[c].norm_squared(), l[c].dot(&self.residual[c])])
        };
        let score = DVector::from_fn(n, |i, _| self.slopes[i][c].dot(&self.residual[c]));
        Products { information, score, laws: self.laws.iter().map(law).collect() }
    }

    /// Number of measured conditions.
    fn measured(&self) -> usize {
        self.residual.len() - 1
    }

    /// Weight of a condition if the variance of errors is `scale` times that of the noise. The weight of the last condition, the stated
    /// priors, does not depend on `scale`.
    fn weight(&self, c: usize, scale: f64) -> f64 {
        if c < self.measured() { scale.recip() } else { 1.0 }
    }

    /// Sum of the products of all conditions, together with the prior.
    fn total(&self, each: &[Products], scale: f64) -> Products {
        let n = self.slopes.len();
        let mut all = Products {
            information: DMatrix::from_diagonal(&DVector::from_fn(n, |k, _| self.prior[k][0].max(1e-12))),
            score: DVector::from_fn(n, |k, _| self.prior[k][1]),
            laws: self.widths.iter().map(|w| (DVector::zeros(n), [w.powi(-2), 0.0])).collect(),
        };
        each.iter().enumerate().for_each(|(c, own)| all.add(own, self.weight(c, scale)));
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

    fn predicted(&self, each: &[Products], scale: f64) -> Predicted {
        let all = self.total(each, scale);
        let law = all.best_law();
        let (information, score) = all.with(law);
        let step = solved(&information, &score).0;
        let inverse = inverted(information);
        let of = |c: usize| {
            let weight = self.weight(c, scale);
            let rest = all.less(&each[c], weight);
            let own = rest.best_law();
            let (without, score) = rest.with(own);
            let (with, total) = all.with(own);
            let (step, determinant) = solved(&without, &score);
            let jacobian = self.jacobian(c, own);
            let error = &self.residual[c] - &jacobian * &step;
            let back = jacobian.transpose() * &error;
            let along = if own == law { &inverse * back } else { inverted(with.clone()) * back };
            let solved_error = &error - (&jacobian * along) * weight;
            let square = error.dot(&solved_error).max(0.0);
            let wider = (solved(&with, &total).1 - determinant).max(0.0);
            LeftOut { law: own, step, error, solved: solved_error, square, wider }
        };
        let left = (0..each.len()).map(of).collect();
        Predicted { law, step, left }
    }

    /// The same model in the conditions `used` alone.
    pub fn of(&self, used: &[usize]) -> Self {
        let kept = |all: &Vec<DVector<f64>>| {
            used.iter().map(|&c| all[c].clone()).chain(all.last().cloned()).collect::<Vec<_>>()
        };
        Self {
            residual: kept(&self.residual),
            slopes: self.slopes.iter().map(kept).collect(),
            laws: self.laws.iter().map(kept).collect(),
            prior: self.prior.clone(),
            widths: self.widths.clone(),
        }
    }

    /// The row of the table; `degrees` are the degrees of freedom of the noise.
    pub fn row(&self, degrees: f64) -> LeftOutRow {
        let each: Vec<Products> = (0..self.residual.len()).map(|c| self.products(c)).collect();
        let mut scale = 1.0;
        let mut now = self.predicted(&each, scale);
        for _ in 0..ROUNDS {
            let next = self.scale(&now.left, None);
            if (next / scale - 1.0).abs() < FOUND {
                break;
            }
            scale = next;
            now = self.predicted(&each, scale);
        }
        let scales: Vec<f64> =
            (0..each.len()).map(|c| if c < self.measured() { self.scale(&now.left, Some(c)) } else { 1.0 }).collect();
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

    fn jacobian(&self, c: usize, law: Option<usize>) -> DMatrix<f64> {
        let columns: Vec<_> =
            self.slopes.iter().map(|s| s[c].clone()).chain(law.map(|l| self.laws[l][c].clone())).collect();
        DMatrix::from_columns(&columns)
    }
}

/// Solution of a b = x, and ln |a|.
fn solved(a: &DMatrix<f64>, b: &DVector<f64>) -> (DVector<f64>, f64) {
    let factor = a.clone().cholesky();
    factor.map_or_else(|| (DVector::zeros(b.len()), f64::INFINITY), |f| (f.solve(b), f.ln_determinant()))
}

fn inverted(a: DMatrix<f64>) -> DMatrix<f64> {
    let n = a.nrows();
    a.cholesky().map_or_else(|| DMatrix::zeros(n, n), |f| f.inverse())
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
