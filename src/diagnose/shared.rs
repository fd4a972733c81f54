//! Noise that all numbers of one repetition share: noise of low rank.
//!
//! For example, the whole bed of a trial is a little stronger or weaker, or a robot's hips start a little earlier or
//! later, and all measurements of this trial change accordingly. Let the columns of U be the directions, each
//! multiplied by its standard deviation. Then the covariance of a unit is D + U Uᵀ, where D is the covariance of the
//! noise of its channels.

use super::gram::gram;
use crate::number::{add_scaled, dot};
use nalgebra::{DMatrix, DVector};
use std::ops::Range;

/// Directions with a common standard deviation, which is learnt from the repetitions.
#[derive(Clone, Debug)]
pub struct SharedNoise {
    pub name: &'static str,
    pub unit: &'static str,
    /// Standard deviation from which the search starts.
    pub guess: f64,
    /// Is this part of the noise left out if the repetitions do not show it?
    pub optional: bool,
    /// Stacks in the order of the observations; each contains a direction for every unit.
    pub stacks: Vec<Vec<f64>>,
}

/// Causes of differences between repetitions, and errors of the model, at one prediction.
#[derive(Clone, Debug, Default)]
pub struct Uncertainty {
    /// Noise that all numbers of a repetition share.
    pub shared: Vec<SharedNoise>,
    /// Errors of the model that are the same for all repetitions of a condition; each vector has the size of one
    /// standard deviation.
    pub common: Vec<Vec<f64>>,
    /// Standard deviation of the model's error at each number, independent between numbers and equal in all repetitions;
    /// empty if it is not known.
    pub own: Vec<f64>,
}

impl SharedNoise {
    /// One direction.
    pub fn one(name: &'static str, unit: &'static str, guess: f64, optional: bool, stack: Vec<f64>) -> Self {
        Self { name, unit, guess, optional, stacks: vec![stack] }
    }

    /// The directions in one unit, whose numbers are at `span` of a stack.
    pub fn vectors(&self, span: Range<usize>) -> impl Iterator<Item = &[f64]> {
        self.stacks.iter().map(move |s| &s[span.clone()])
    }
}

/// The symmetric root of (1 + W Wᵀ)⁻¹ for a few columns W: 1 − W B Wᵀ.
#[derive(Clone)]
pub struct LowRank {
    columns: Vec<Vec<f64>>,
    /// B, row by row.
    middle: Vec<Vec<f64>>,
}

impl LowRank {
    pub fn new(columns: Vec<Vec<f64>>) -> Self {
        if columns.is_empty() {
            return Self { columns, middle: Vec::new() };
        }
        let eigen = gram(&columns).symmetric_eigen();
        // (1 − 1/√(1 + λ))/λ, without cancellation
        let share = |square: f64| {
            let root = (1.0 + square.max(0.0)).sqrt();
            1.0 / (root * (root + 1.0))
        };
        let vectors = &eigen.eigenvectors;
        let middle = vectors * DMatrix::from_diagonal(&eigen.eigenvalues.map(share)) * vectors.transpose();
        let middle = middle.row_iter().map(|row| row.iter().copied().collect()).collect();
        Self { columns, middle }
    }

    /// Whitens `own` in place.
    pub fn apply(&self, own: &mut [f64]) {
        let along: Vec<f64> = self.columns.iter().map(|column| dot(column, own)).collect();
        for (column, row) in self.columns.iter().zip(&self.middle) {
            add_scaled(own, -dot(row, &along), column);
        }
    }
}

/// Computes ln |M| and quadratic forms of M⁻¹ for M = 1 + S G S. S is diagonal with standard deviations; G has the
/// products of the directions.
pub struct Likelihood {
    inverse: DMatrix<f64>,
    pub log_determinant: f64,
}

impl Likelihood {
    /// `products` has G in its first rows and columns.
    pub fn new(products: &DMatrix<f64>, sd: &[f64]) -> Self {
        let size = sd.len();
        let one = DMatrix::identity(size, size);
        let factor = (DMatrix::from_fn(size, size, |i, j| sd[i] * sd[j] * products[(i, j)]) + one).cholesky();
        let log_determinant = factor.as_ref().map_or(f64::INFINITY, |f| f.ln_determinant());
        let inverse = factor.map_or_else(|| DMatrix::zeros(size, size), |f| f.inverse());
        Self { inverse, log_determinant }
    }

    /// wᵀ (1 + W Wᵀ)⁻¹ w by the matrix inversion lemma, from wᵀ w and W's products with w.
    pub fn square(&self, own: f64, along: &DVector<f64>) -> f64 {
        own - along.dot(&(&self.inverse * along))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Compares both forms with the dense covariance.
    #[test]
    fn low_rank_algebra_is_that_of_the_dense_matrix() {
        let columns = vec![vec![1.0, -2.0, 0.5, 0.0], vec![0.3, 0.4, -1.0, 2.0], vec![1.3, -1.6, -0.5, 2.0]];
        let w = DMatrix::from_fn(4, 3, |i, j| columns[j][i]);
        let dense = DMatrix::identity(4, 4) + &w * w.transpose();
        let v = [0.7, -0.1, 1.1, 0.4];
        let vector = DVector::from_row_slice(&v);
        let square = (vector.transpose() * dense.clone().try_inverse().unwrap() * &vector)[0];
        let mut white = v;
        LowRank::new(columns.clone()).apply(&mut white);
        assert!((white.iter().map(|w| w * w).sum::<f64>() - square).abs() < 1e-12);
        let likelihood = Likelihood::new(&gram(&columns), &[1.0; 3]);
        let along = DVector::from_iterator(3, columns.iter().map(|c| dot(c, &v)));
        assert!((likelihood.square(dot(&v, &v), &along) - square).abs() < 1e-12);
        assert!((likelihood.log_determinant - dense.determinant().ln()).abs() < 1e-12);
    }
}
