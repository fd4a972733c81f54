//! Products of long columns with each other.

use crate::number::{Doubles, Kernel, Real};
use nalgebra::DMatrix;
use std::array::from_fn;
use std::borrow::Borrow;

/// Rows of columns that are multiplied together: our choice. So many rows of some 50 columns (200 kB) stay in a processor's cache until
/// every pair of columns is multiplied; whole columns of a long log would be read from memory for every pair.
const ROWS: usize = 512;
/// Numbers that are multiplied together, as in [`crate::number::dot`]: two registers of AVX2.
const LANES: usize = 8;
/// Columns that are multiplied with one other together: our choice, as many sums as registers hold.
const TOGETHER: usize = 4;

/// Products of every column with every other.
pub fn gram(columns: &[impl Borrow<Vec<f64>>]) -> DMatrix<f64> {
    gram_of(&columns.iter().map(|column| column.borrow().as_slice()).collect::<Vec<_>>())
}

/// The same for columns in one matrix.
pub fn gram_of(columns: &[&[f64]]) -> DMatrix<f64> {
    let mut gram = DMatrix::zeros(columns.len(), columns.len());
    each_part(columns, |part| {
        for i in 0..part.len() {
            multiply(part[i], &part[..=i], |j, product| gram[(i, j)] += product);
        }
    });
    gram.fill_upper_triangle_with_lower_triangle();
    gram
}

/// Products of each of `rows` with each of `columns`.
pub fn crosses(rows: &[impl Borrow<Vec<f64>>], columns: &[impl Borrow<Vec<f64>>]) -> DMatrix<f64> {
    let mut products = DMatrix::zeros(rows.len(), columns.len());
    let all = rows.iter().map(|row| row.borrow().as_slice());
    let all: Vec<&[f64]> = all.chain(columns.iter().map(|column| column.borrow().as_slice())).collect();
    each_part(&all, |part| {
        let (rows, columns) = part.split_at(rows.len());
        for (i, row) in rows.iter().enumerate() {
            multiply(row, columns, |j, product| products[(i, j)] += product);
        }
    });
    products
}

/// Calls `f` with the same rows of all columns, part by part.
fn each_part(columns: &[&[f64]], mut f: impl FnMut(&[&[f64]])) {
    let length = columns.first().map_or(0, |column| column.len());
    let mut part = columns.to_vec();
    for from in (0..length).step_by(ROWS) {
        let rows = from..(from + ROWS).min(length);
        part.iter_mut().zip(columns).for_each(|(part, column)| *part = &column[rows.clone()]);
        f(&part);
    }
}

/// Calls `take` with the place of each column and its product with `own`.
fn multiply(own: &[f64], columns: &[&[f64]], mut take: impl FnMut(usize, f64)) {
    let (four, rest) = columns.as_chunks::<TOGETHER>();
    for (k, columns) in four.iter().enumerate() {
        let products = products(own, columns);
        (0..TOGETHER).for_each(|n| take(k * TOGETHER + n, products[n]));
    }
    for (k, column) in rest.iter().enumerate() {
        take(four.len() * TOGETHER + k, products(own, &[column])[0]);
    }
}

/// Products of a column with N others; each is bit-identical to [`crate::number::dot`].
fn products<const N: usize>(own: &[f64], columns: &[&[f64]; N]) -> [f64; N] {
    let mut out = [0.0; N];
    Doubles::dispatch(ColumnProducts { own, columns, out: &mut out });
    out
}

struct ColumnProducts<'a, const N: usize> {
    own: &'a [f64],
    columns: &'a [&'a [f64]; N],
    out: &'a mut [f64; N],
}

impl<const N: usize> Kernel for ColumnProducts<'_, N> {
    #[inline(always)]
    fn run(self) {
        let (own, last) = self.own.as_chunks::<LANES>();
        let columns = self.columns.map(|column| column[..self.own.len()].as_chunks::<LANES>());
        let mut sums = [[0.0; LANES]; N];
        for (i, a) in own.iter().enumerate() {
            for (sums, (column, _)) in sums.iter_mut().zip(&columns) {
                let b = &column[i];
                *sums = from_fn(|l| sums[l] + a[l] * b[l]);
            }
        }
        *self.out =
            from_fn(|n| sums[n].iter().sum::<f64>() + last.iter().zip(columns[n].1).map(|(a, b)| a * b).sum::<f64>());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::number::dot;

    /// Products of long columns are sums over parts of them.
    #[test]
    fn products_of_long_columns_are_those_of_whole_ones() {
        let column = |k: usize| -> Vec<f64> { (0..2 * ROWS + 7).map(|i| ((i * (k + 3)) as f64).sin()).collect() };
        let columns: Vec<Vec<f64>> = (0..7).map(column).collect();
        let (all, some) = (gram(&columns), crosses(&columns[2..4], &columns));
        for i in 0..7 {
            for j in 0..7 {
                let whole: f64 = columns[i].iter().zip(&columns[j]).map(|(a, b)| a * b).sum();
                assert!((all[(i, j)] - whole).abs() < 1e-9 && all[(i, j)] == all[(j, i)], "{i} {j}: {}", all[(i, j)]);
                assert!(!(2..4).contains(&i) || (some[(i - 2, j)] - whole).abs() < 1e-9, "{i} {j}");
            }
        }
    }

    #[test]
    fn products_of_several_columns_are_those_of_single_ones() {
        let [a, b, c] = [0.3, 0.7, 1.1].map(|k: f64| (0..43).map(|i| (k * f64::from(i)).sin()).collect::<Vec<f64>>());
        let together = products(&a, &[&b[..], &c[..], &a[..], &b[..]]);
        assert_eq!(together, [dot(&a, &b), dot(&a, &c), dot(&a, &a), dot(&a, &b)]);
    }
}
