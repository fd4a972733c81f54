//! What one repetition has in common over all its numbers: noise of low rank.
//!
//! A trial's bed is a little stronger or weaker as a whole; a robot's hips start a little earlier or later, and every
//! measurement of that run moves with them. With the directions as columns of U and their standard deviations in it, the
//! covariance of a unit is D + U Uᵀ, D the noise of its channels.

use nalgebra::{DMatrix, DVector};
use std::ops::Range;

/// Directions that share one standard deviation, which the repetitions tell.
#[derive(Clone, Debug)]
pub struct Shared {
    pub name: &'static str,
    pub unit: &'static str,
    /// Standard deviation from which the search starts.
    pub guess: f64,
    /// Is it left out where the repetitions do not ask for it?
    pub optional: bool,
    /// In the order of the observations, each a direction within every unit.
    pub stacks: Vec<Vec<f64>>,
}

impl Shared {
    /// The directions in one unit, whose numbers stand at `span` of a stack.
    pub fn vectors(&self, span: Range<usize>) -> impl Iterator<Item = &[f64]> {
        self.stacks.iter().map(move |s| &s[span.clone()])
    }
}

/// The symmetric root of (1 + W Wᵀ)⁻¹ for a few columns W.
#[derive(Clone)]
pub struct LowRank {
    /// Unit vectors, and what is left of the part along each.
    axes: Vec<(Vec<f64>, f64)>,
}

impl LowRank {
    pub fn new(columns: &[Vec<f64>]) -> Self {
        if columns.is_empty() {
            return Self { axes: Vec::new() };
        }
        let eigen = gram(columns).symmetric_eigen();
        let axis = |k: usize| {
            let square = eigen.eigenvalues[k];
            // A direction that the others already span brings nothing of its own.
            (square > 1e-9 * eigen.eigenvalues.max().max(1e-3)).then(|| {
                let mut unit = vec![0.0; columns[0].len()];
                for (column, share) in columns.iter().zip(eigen.eigenvectors.column(k).iter()) {
                    unit.iter_mut().zip(column).for_each(|(u, c)| *u += share / square.sqrt() * c);
                }
                (unit, 1.0 / (1.0 + square).sqrt())
            })
        };
        Self { axes: (0..columns.len()).filter_map(axis).collect() }
    }

    /// Whitens `own` in place.
    pub fn apply(&self, own: &mut [f64]) {
        for (unit, keep) in &self.axes {
            let part = own.iter().zip(unit).map(|(v, u)| v * u).sum::<f64>();
            own.iter_mut().zip(unit).for_each(|(v, u)| *v -= (1.0 - keep) * part * u);
        }
    }
}

fn gram(columns: &[Vec<f64>]) -> DMatrix<f64> {
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    DMatrix::from_fn(columns.len(), columns.len(), |i, j| product(&columns[i], &columns[j]))
}

/// ln |1 + W Wᵀ| and the quadratic form wᵀ (1 + W Wᵀ)⁻¹ w by the matrix inversion lemma.
pub struct Likelihood {
    columns: Vec<Vec<f64>>,
    inverse: DMatrix<f64>,
    pub log_determinant: f64,
}

impl Likelihood {
    pub fn new(columns: Vec<Vec<f64>>) -> Self {
        let size = columns.len();
        let factor = (gram(&columns) + DMatrix::identity(size, size)).cholesky();
        let log_determinant = factor.as_ref().map_or(f64::INFINITY, |f| f.ln_determinant());
        let inverse = factor.map_or_else(|| DMatrix::zeros(size, size), |f| f.inverse());
        Self { columns, inverse, log_determinant }
    }

    /// Of a vector given channel by channel.
    pub fn square(&self, white: &[f64]) -> f64 {
        let along = |c: &Vec<f64>| c.iter().zip(white).map(|(c, w)| c * w).sum::<f64>();
        let b = DVector::from_iterator(self.columns.len(), self.columns.iter().map(along));
        white.iter().map(|w| w * w).sum::<f64>() - (b.transpose() * &self.inverse * &b)[0]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Both forms against the dense covariance.
    #[test]
    fn low_rank_algebra_is_that_of_the_dense_matrix() {
        let columns = vec![vec![1.0, -2.0, 0.5, 0.0], vec![0.3, 0.4, -1.0, 2.0], vec![1.3, -1.6, -0.5, 2.0]];
        let w = DMatrix::from_fn(4, 3, |i, j| columns[j][i]);
        let dense = DMatrix::identity(4, 4) + &w * w.transpose();
        let v = [0.7, -0.1, 1.1, 0.4];
        let vector = DVector::from_row_slice(&v);
        let square = (vector.transpose() * dense.clone().try_inverse().unwrap() * &vector)[0];
        let mut white = v;
        LowRank::new(&columns).apply(&mut white);
        assert!((white.iter().map(|w| w * w).sum::<f64>() - square).abs() < 1e-12);
        let likelihood = Likelihood::new(columns);
        assert!((likelihood.square(&v) - square).abs() < 1e-12);
        assert!((likelihood.log_determinant - dense.determinant().ln()).abs() < 1e-12);
    }
}
