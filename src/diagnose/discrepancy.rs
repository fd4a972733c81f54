//! The part of the data that no model explains: a smooth, small error of the model, as a Gaussian process over the
//! features of the data.
//!
//! In each channel of each shape the model's relative error may be a smooth function of the features (speed, depth,
//! angle, pass, place). Each feature is replaced by its rank, so that each decade of speed has equal weight. The
//! function is a sum of random cosines (Rahimi & Recht 2007, a Gaussian kernel's features) with weights N(0, τ²).
//! τ, the size of the relative error, maximises the evidence of the residual. The weights are marginalised like the
//! coefficients. (The idea: Kennedy & O'Hagan 2001.)

use super::fit::Fit;
use super::forward::Feature;
use super::observations::{Observations, Size};
use super::study::Study;
use crate::number::dot;
use crate::parallel;
use nalgebra::{DMatrix, DVector};
use rand::{Rng, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use std::f64::consts::PI;

/// Number of random cosines for each channel of each shape: our choice, enough for several periods along each feature,
/// and far fewer than samples.
const WAVES: usize = 6;
/// Relative sizes that are tried: a thousandth to three tenths, eight a decade. Our choice: a model with a larger
/// relative error everywhere is wrong and not merely inaccurate.
const SIZES: usize = 21;
/// Twice the logarithm of the evidence above which there is a discrepancy; chance exceeds it once in a thousand.
const SEEN: f64 = super::chi_squared::AT_999_PER_MILLE;

/// The `k`th relative size that is tried.
fn size(k: usize) -> f64 {
    1e-3 * 10f64.powf(k as f64 / 8.0)
}

/// Directions of the model's error, whitened.
pub struct Directions {
    /// The same directions before the whitening.
    pub raw: Vec<Vec<f64>>,
    white: Vec<Vec<f64>>,
    products: DMatrix<f64>,
}

/// The size of the discrepancy about one fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Discrepancy {
    /// τ; 0 if the data need none.
    pub size: f64,
    /// −2 ln of the evidence of the data, without constants that all models have in common.
    pub surprise: f64,
}

impl Discrepancy {
    /// Is it as large as a discrepancy may be? Then the error is not small, and a discrepancy of this size
    /// would also explain what a cause explains.
    pub fn too_large(&self) -> bool {
        self.size >= size(SIZES - 1)
    }
}

impl Directions {
    /// Directions about the prediction of `fit`.
    pub fn new(study: &Study, fit: &Fit) -> Self {
        let raw = columns(study.observations, &study.model.features(), &groups(study), &fit.prediction);
        let white = parallel::map(&raw, |c| study.whitener.apply(c));
        let count = white.len();
        let places: Vec<usize> = (0..count).collect();
        let rows =
            parallel::map(&places, |&i| white[..=i].iter().map(|other| dot(&white[i], other)).collect::<Vec<_>>());
        let products = DMatrix::from_fn(count, count, |i, j| rows[i.max(j)][i.min(j)]);
        Self { raw, white, products }
    }

    /// Products with a whitened vector.
    fn along(&self, white: &[f64]) -> DVector<f64> {
        DVector::from_iterator(self.white.len(), self.white.iter().map(|w| dot(w, white)))
    }

    /// The size of the discrepancy about a fit, with the fit's parameters adjusted.
    pub fn about(&self, fit: &Fit) -> Discrepancy {
        let joint = self.joint(fit);
        // The size with the greatest evidence. A size other than 0 must also exceed the threshold.
        let none = Discrepancy { size: 0.0, surprise: joint.surprise(0.0) };
        let tried = (0..SIZES).map(|k| Discrepancy { size: size(k), surprise: joint.surprise(size(k)) });
        let best = tried.min_by(|a, b| a.surprise.total_cmp(&b.surprise)).unwrap_or(none);
        if best.surprise < none.surprise - SEEN { best } else { none }
    }

    fn joint(&self, fit: &Fit) -> Joint {
        let (information, _) = fit.normal_equations();
        let count = information.nrows();
        let cross = DMatrix::from_fn(count, self.white.len(), |i, j| dot(&fit.white_slopes[i], &self.white[j]));
        let score = self.along(&fit.white);
        let solved = information.clone().cholesky().map(|c| c.solve(&cross));
        let left = solved.map_or_else(|| self.products.clone(), |s| &self.products - cross.transpose() * s);
        // At the end of a fit its scores are zero.
        let eigen = left.symmetric_eigen();
        let along = eigen.eigenvectors.transpose() * score;
        Joint { values: eigen.eigenvalues.iter().copied().collect(), along, objective: fit.objective }
    }
}

/// The residual in the eigenvectors of the directions, with the fit's parameters projected out.
struct Joint {
    values: Vec<f64>,
    along: DVector<f64>,
    objective: f64,
}

impl Joint {
    fn surprise(&self, size: f64) -> f64 {
        let square = size * size;
        let term = |(value, along): (&f64, &f64)| {
            let grown = 1.0 + square * value.max(0.0);
            grown.ln() - square * along * along / grown
        };
        self.objective + self.values.iter().zip(self.along.iter()).map(term).sum::<f64>()
    }
}

/// For each unit (a trial or run) the index of its shape, and the number of shapes.
fn groups(study: &Study) -> (Vec<usize>, usize) {
    let mut names: Vec<&str> = Vec::new();
    let of = |u: usize| {
        let name = study.model.group(u);
        names.iter().position(|n| *n == name).unwrap_or_else(|| {
            names.push(name);
            names.len() - 1
        })
    };
    let places = (0..study.observations.units.len()).map(of).collect();
    (places, names.len())
}

/// Ranks of a feature's values, −1…1; None for a feature that does not vary.
fn ranks(feature: &Feature) -> Option<Vec<Vec<f64>>> {
    let mut all: Vec<f64> = feature.values.iter().flatten().copied().collect();
    all.sort_by(f64::total_cmp);
    let (first, last) = (all.first()?, all.last()?);
    if last - first <= 1e-9 * last.abs().max(first.abs()) {
        return None;
    }
    let n = all.len() as f64;
    let rank = |v: &f64| {
        let (low, high) = (all.partition_point(|a| a < v), all.partition_point(|a| a <= v));
        (low + high) as f64 / n - 1.0
    };
    Some(feature.values.iter().map(|unit| unit.iter().map(rank).collect()).collect())
}

/// The directions, not whitened.
fn columns(o: &Observations, features: &[Feature], groups: &(Vec<usize>, usize), prediction: &[f64]) -> Vec<Vec<f64>> {
    let features: Vec<_> = features.iter().filter_map(ranks).collect();
    let sizes = sizes(o, prediction);
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(4);
    let mut columns = Vec::new();
    for group in 0..groups.1 {
        for channel in 0..o.channels.len() {
            for wave in 0..=WAVES {
                let turns: Vec<f64> = features.iter().map(|_| StandardNormal.sample(&mut rng)).collect();
                let phase = rng.random_range(0.0..2.0 * PI);
                let mut column = vec![0.0; prediction.len()];
                for (u, unit) in o.units.iter().enumerate().filter(|(u, _)| groups.0[*u] == group) {
                    for (i, k) in unit.block(channel).enumerate() {
                        let turned: f64 = features.iter().zip(&turns).map(|(f, w): (_, &f64)| w * f[u][i]).sum();
                        // The first wave is constant in all features.
                        let at = if wave == 0 { 1.0 } else { (2.0 / WAVES as f64).sqrt() * (turned + phase).cos() };
                        column[k] = sizes[k] * at;
                    }
                }
                columns.push(column);
            }
        }
    }
    columns
}

/// The size to which an error is relative, for each number. With `Size::Force` this is the size of the force in the
/// first two channels; in other channels it is multiplied by the ratio of the root mean squares. With `Size::Channel`
/// it is each channel's own size.
fn sizes(o: &Observations, prediction: &[f64]) -> Vec<f64> {
    let mut sizes: Vec<f64> = prediction.iter().map(|p| p.abs()).collect();
    if o.size == Size::Channel || o.channels.len() < 2 {
        return sizes;
    }
    let square = |channel: usize| {
        o.units.iter().flat_map(|u| u.block(channel)).map(|k| prediction[k] * prediction[k]).sum::<f64>()
    };
    let force = square(0) + square(1);
    for channel in 0..o.channels.len() {
        let share = if channel < 2 { 1.0 } else { (square(channel) / force.max(1e-300)).sqrt() };
        for unit in &o.units {
            for (i, k) in unit.block(channel).enumerate() {
                let [x, z] = [0, 1].map(|c| prediction[unit.block(c).start + i]);
                sizes[k] = share * x.hypot(z);
            }
        }
    }
    sizes
}
