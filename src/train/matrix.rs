//! The arithmetic of networks: products of matrices, and element-wise functions.
//!
//! Numbers are added in an order that depends on sizes alone, so results are bit-identical on every thread. Crate
//! `matrixmultiply`, which nalgebra needs anyway, computes the products. Measured 2026-11-22 on an AMD EPYC (Zen 5)
//! with one thread and 128 to 256 rows by 64 × 64, it reached 70 to 130 GFLOP/s, and crate `gemm` 48 to 71.

use crate::number::Kernel;

/// A matrix of numbers in a slice, row by row, or its transpose.
#[derive(Clone, Copy)]
pub struct Matrix<'a> {
    data: &'a [f32],
    rows: usize,
    columns: usize,
    transposed: bool,
}

impl<'a> Matrix<'a> {
    pub fn new(data: &'a [f32], columns: usize) -> Self {
        Self { data, rows: data.len() / columns, columns, transposed: false }
    }

    pub fn transposed(self) -> Self {
        Self { rows: self.columns, columns: self.rows, transposed: !self.transposed, ..self }
    }

    /// Distance between rows, and between columns.
    fn strides(&self) -> [isize; 2] {
        if self.transposed { [1, self.rows as isize] } else { [self.columns as isize, 1] }
    }
}

/// Sets `out` to a·b, or to out + a·b if `add` is true.
pub fn multiply(a: Matrix, b: Matrix, add: bool, out: &mut [f32]) {
    assert!(a.columns == b.rows && out.len() == a.rows * b.columns, "sizes of a product");
    assert!(a.data.len() == a.rows * a.columns && b.data.len() == b.rows * b.columns, "sizes of its factors");
    let ([a_row, a_column], [b_row, b_column]) = (a.strides(), b.strides());
    let keep = if add { 1.0 } else { 0.0 };
    // SAFETY: the assertions above; every index of each matrix lies in its slice, and `out` is borrowed by nobody else.
    unsafe {
        matrixmultiply::sgemm(
            a.rows,
            a.columns,
            b.columns,
            1.0,
            a.data.as_ptr(),
            a_row,
            a_column,
            b.data.as_ptr(),
            b_row,
            b_column,
            keep,
            out.as_mut_ptr(),
            b.columns as isize,
            1,
        );
    }
}

/// Hyperbolic tangent with an absolute error below 4e-7, by the rational function of Eigen 3.4
/// (`generic_fast_tanh_float`, Benoit Steiner).
#[inline(always)]
pub fn tanh(x: f32) -> f32 {
    let x = x.clamp(-7.905_311, 7.905_311);
    let s = x * x;
    let p = s * -2.760_768_5e-16 + 2.000_188e-13;
    let p = s * p + -8.604_672e-11;
    let p = s * p + 5.122_297_2e-8;
    let p = s * p + 1.485_722_4e-5;
    let p = s * p + 6.372_619_4e-4;
    let p = s * p + 4.893_524_6e-3;
    let q = s * 1.198_258_4e-6 + 1.185_347_1e-4;
    let q = s * q + 2.268_434_7e-3;
    let q = s * q + 4.893_525e-3;
    x * p / q
}

/// Adds `bias` to every row, and applies the hyperbolic tangent if `curved`.
pub struct AddBias<'a> {
    pub rows: &'a mut [f32],
    pub bias: &'a [f32],
    pub curved: bool,
}

impl Kernel for AddBias<'_> {
    #[inline(always)]
    fn run(self) {
        for row in self.rows.chunks_exact_mut(self.bias.len()) {
            if self.curved {
                row.iter_mut().zip(self.bias).for_each(|(x, b)| *x = tanh(*x + b));
            } else {
                row.iter_mut().zip(self.bias).for_each(|(x, b)| *x += b);
            }
        }
    }
}

/// Turns the derivatives by the outputs y of hyperbolic tangents into those by their inputs: `slopes` · (1 − y²).
pub struct TanhGradient<'a> {
    pub slopes: &'a mut [f32],
    pub outputs: &'a [f32],
}

impl Kernel for TanhGradient<'_> {
    #[inline(always)]
    fn run(self) {
        self.slopes.iter_mut().zip(self.outputs).for_each(|(slope, y)| *slope *= 1.0 - y * y);
    }
}

/// Adds every row of `rows` to `sum`.
pub struct SumRows<'a> {
    pub rows: &'a [f32],
    pub sum: &'a mut [f32],
}

impl Kernel for SumRows<'_> {
    #[inline(always)]
    fn run(self) {
        for row in self.rows.chunks_exact(self.sum.len()) {
            self.sum.iter_mut().zip(row).for_each(|(sum, x)| *sum += x);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tangent_is_near_the_true_one() {
        for k in -120_000..=120_000 {
            let x = k as f32 * 1e-4;
            let error = f64::from(tanh(x)) - f64::from(x).tanh();
            assert!(error.abs() < 4e-7, "tanh({x}) is off by {error}");
        }
        assert!(tanh(f32::NAN).is_nan());
    }

    /// All four combinations of transposed factors, compared with sums in `f64`.
    #[test]
    fn products_are_products() {
        let (m, k, n) = (7, 33, 5);
        let a: Vec<f32> = (0..m * k).map(|i| (i as f32 * 0.7).sin()).collect();
        let b: Vec<f32> = (0..k * n).map(|i| (i as f32 * 1.3).cos()).collect();
        let turn = |x: &[f32], columns: usize| -> Vec<f32> {
            (0..columns).flat_map(|j| x.iter().skip(j).step_by(columns).copied()).collect()
        };
        let (at, bt) = (turn(&a, k), turn(&b, n));
        for (left, right) in [
            (Matrix::new(&a, k), Matrix::new(&b, n)),
            (Matrix::new(&at, m).transposed(), Matrix::new(&b, n)),
            (Matrix::new(&a, k), Matrix::new(&bt, k).transposed()),
            (Matrix::new(&at, m).transposed(), Matrix::new(&bt, k).transposed()),
        ] {
            let mut out = vec![1.0; m * n];
            multiply(left, right, true, &mut out);
            for (i, got) in out.iter().enumerate() {
                let (row, column) = (i / n, i % n);
                let sum: f64 = (0..k).map(|j| f64::from(a[row * k + j]) * f64::from(b[j * n + column])).sum();
                assert!((f64::from(*got) - 1.0 - sum).abs() < 1e-5);
            }
        }
    }
}
