//! Gates of the diagnosis, calibrated for each data set on data simulated without any hidden cause.
//!
//! A simulated null has the data's own design, the plain model with coefficients drawn from their prior, and the noise
//! learnt from the repetitions; its noise is then estimated anew, so the gates know that the noise is not known.

use super::fit::slope;
use super::fit::{COEFFICIENTS, Column, Study, dot};
use super::lack_of_fit;
use super::noise::{Noise, Source, sizes};
use super::observations::Observations;
use super::whiten::Whitener;
use crate::parallel;
use crate::sand::mechanism::{CATALOG, Mechanisms};
use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;

/// Chance of each gate to open on data with nothing hidden. Two gates make 0.6 %, below the target of 1 %.
const FALSE_ALARM: f64 = 0.003;
/// Simulated nulls: their mean and spread are then known to some 10 %. Our choice, for the time it takes.
const NULLS: usize = 80;

/// Numbers that nulls on different cores hold together: 256 MB, our choice, so that many cores do not fill the memory.
const NUMBERS_AT_ONCE: usize = 32 << 20;

/// A cause is felt by the data if its typical strength moves them by more than 0.01 σ altogether: our choice, far below
/// anything that could be found.
pub const FELT: f64 = 1e-4;

/// What a candidate does to the data: the change of the prediction per typical strength, taken at one value.
pub struct Screen {
    /// Catalogue index and the value at which the column was taken.
    pub candidates: Vec<(usize, f64)>,
    columns: Vec<Vec<f64>>,
    pub coefficient_columns: Vec<Column>,
    plain: Vec<f64>,
}

/// Products of the whitened columns with the coefficients projected out, and with the residual.
pub struct Scores {
    pub gram: DMatrix<f64>,
    pub score: DVector<f64>,
    /// Whitened residual with the coefficients adjusted.
    white: Vec<f64>,
}

pub struct Gates {
    /// Δχ² that the best single cause must exceed.
    pub single: f64,
    /// Mean square of the smooth whitened residual above which the fit is lacking.
    pub lack_of_fit: f64,
    /// How much larger χ² differences are than for known noise.
    pub inflation: f64,
}

impl Screen {
    /// Columns about the state of `fit`, for the candidates not in it.
    pub fn new(study: &Study, candidates: &[usize]) -> Self {
        let plain = study.model.predict(&Mechanisms::default(), &study.model.medium().coefficients);
        let tried = candidates.iter().flat_map(|&id| starts(study, id).into_iter().map(move |value| (id, value)));
        let tried: Vec<_> = tried.collect();
        let coefficients = study.model.medium().coefficients;
        let states: Vec<_> = tried.iter().map(|&(id, v)| (Mechanisms::default().with(id, v), coefficients)).collect();
        let moved = study.model.predict_many(&states);
        let column = |(&(id, value), moved): (&(usize, f64), Vec<f64>)| {
            slope(&moved, &plain, CATALOG[id].coordinate(value) / CATALOG[id].coordinate_typical())
        };
        let columns = tried.iter().zip(moved).map(column).collect();
        Self { candidates: tried, columns, coefficient_columns: study.coefficient_slopes(), plain }
    }

    /// Scores of a stack of measured values.
    pub fn scores(&self, whitener: &Whitener, values: &[f64]) -> Scores {
        let residual: Vec<f64> = values.iter().zip(&self.plain).map(|(y, m)| y - m).collect();
        let white = whitener.apply(&residual);
        let c: Vec<_> = self.coefficient_columns.iter().map(|c| whitener.apply(c)).collect();
        let z: Vec<_> = self.columns.iter().map(|c| whitener.apply(c)).collect();
        let prior = products(&c) + DMatrix::identity(COEFFICIENTS, COEFFICIENTS);
        let inverse = prior.try_inverse().unwrap_or_else(|| DMatrix::identity(COEFFICIENTS, COEFFICIENTS));
        let cz = DMatrix::from_fn(COEFFICIENTS, z.len(), |i, j| dot(&c[i], &z[j]));
        let cr = DVector::from_fn(COEFFICIENTS, |i, _| dot(&c[i], &white));
        let gram = products(&z) - cz.transpose() * &inverse * &cz;
        let score = DVector::from_fn(z.len(), |i, _| dot(&z[i], &white)) - cz.transpose() * &inverse * &cr;
        let adjusted = inverse * cr;
        let mut left = white;
        for (column, share) in c.iter().zip(&adjusted) {
            left.iter_mut().zip(column).for_each(|(r, c)| *r -= share * c);
        }
        Scores { gram, score, white: left }
    }

    /// May the parameter of this column take the sign of `value`?
    fn allowed(&self, column: usize, value: f64) -> bool {
        value >= 0.0 || CATALOG[self.candidates[column].0].coordinate_bounds()[0] < 0.0
    }

    /// Largest Δχ² of any single cause.
    fn best_single(&self, gram: &DMatrix<f64>, score: &DVector<f64>) -> f64 {
        let felt = (0..score.len()).filter(|&k| gram[(k, k)] > FELT && self.allowed(k, score[k]));
        felt.map(|k| score[k] * score[k] / gram[(k, k)]).fold(0.0, f64::max)
    }

    /// Every pair of different causes with its Δχ², best first, as pairs of columns.
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

    /// What a second term gains by chance when the cause is column `truth` alone with strength `value`.
    pub fn second_gate(&self, gram: &DMatrix<f64>, truth: usize, value: f64, inflation: f64) -> f64 {
        let Some(root) = square_root(gram) else {
            return f64::INFINITY;
        };
        let entry = &CATALOG[self.candidates[truth].0];
        let mean = gram.column(truth) * (entry.coordinate(value) / entry.coordinate_typical());
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(2);
        let draws: Vec<f64> = (0..1500)
            .map(|_| {
                let score = &mean + &root * DVector::from_fn(mean.len(), |_, _| StandardNormal.sample(&mut rng));
                let pair = self.pairs(gram, &score).first().map_or(0.0, |p| p.0);
                (pair - self.best_single(gram, &score)).max(0.0)
            })
            .collect();
        inflation * quantile(draws, 1.0 - FALSE_ALARM)
    }
}

/// Products of every column with every other.
fn products(columns: &[Vec<f64>]) -> DMatrix<f64> {
    let mut gram = DMatrix::zeros(columns.len(), columns.len());
    for i in 0..columns.len() {
        for j in 0..=i {
            let product = dot(&columns[i], &columns[j]);
            (gram[(i, j)], gram[(j, i)]) = (product, product);
        }
    }
    gram
}

/// Starts of a ceiling: from twice its typical value down to a quarter, each √2 lower; what a motor does changes altogether
/// where it begins to stall. Our choice.
const CEILINGS: usize = 7;

/// Values from which a mechanism's fit starts; more than one where its effect is far from proportional.
pub fn starts(study: &Study, id: usize) -> Vec<f64> {
    let entry = &CATALOG[id];
    match entry.id {
        "friction_clip" => vec![0.5, 2.0, 5.0],
        _ if entry.ceiling => (0..CEILINGS).map(|k| 2.0 * entry.typical * 0.5f64.powf(0.5 * k as f64)).collect(),
        _ => vec![study.felt_strength(id)],
    }
}

/// L with L Lᵀ = `gram`, which may be singular; rows and columns that the data do not feel are left at 0.
fn square_root(gram: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let n = gram.nrows();
    let scale: Vec<f64> = (0..n).map(|k| if gram[(k, k)] > FELT { gram[(k, k)].sqrt() } else { 0.0 }).collect();
    let inverse = |k: usize| if scale[k] > 0.0 { 1.0 / scale[k] } else { 0.0 };
    let correlation = DMatrix::from_fn(n, n, |i, j| gram[(i, j)] * inverse(i) * inverse(j));
    let eigen = correlation.try_symmetric_eigen(1e-12, 1000)?;
    let root = DMatrix::from_diagonal(&eigen.eigenvalues.map(|v| v.max(0.0).sqrt()));
    Some(DMatrix::from_diagonal(&DVector::from_vec(scale)) * eigen.eigenvectors * root)
}

fn quantile(mut values: Vec<f64>, share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values[((values.len() as f64 * share) as usize).min(values.len() - 1)]
}

/// Gates for this data set.
pub fn gates(study: &Study, source: &Source, screen: &Screen, noise: &Noise, scores: &Scores) -> Gates {
    let seeds: Vec<u64> = (0..NULLS as u64).collect();
    let stopped = || study.model.stopped();
    let of = |&seed: &u64| if stopped() { (0.0, 0.0) } else { null(source, screen, noise, seed, &stopped) };
    let columns = 2 * (screen.candidates.len() + COEFFICIENTS);
    let together = (NUMBERS_AT_ONCE / (columns * source.observations.values.len()).max(1)).max(1);
    let nulls: Vec<_> = seeds.chunks(together).flat_map(|part| parallel::map(part, of)).collect();
    let ideal = ideal(screen, &scores.gram);
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len().max(1) as f64;
    let best: Vec<f64> = nulls.iter().map(|n| n.0).collect();
    // The nulls may only widen the gate: they are few, and by chance their mean can fall below the known one.
    let inflation = (mean(&best) / mean(&ideal).max(1e-9)).max(1.0);
    let lacks: Vec<f64> = nulls.iter().map(|n| n.1).collect();
    let center = mean(&lacks);
    let spread = (mean(&lacks.iter().map(|l| (l - center).powi(2)).collect::<Vec<_>>()) * 1.0125).sqrt();
    Gates {
        single: inflation * quantile(ideal, 1.0 - FALSE_ALARM),
        // 2.75 is the normal quantile of FALSE_ALARM; a tenth more for the skewness of a sum of squares.
        lack_of_fit: center + 1.1 * 2.75 * spread,
        inflation,
    }
}

/// Largest single Δχ² under known noise: Gaussian scores with the Gram matrix as covariance.
fn ideal(screen: &Screen, gram: &DMatrix<f64>) -> Vec<f64> {
    let Some(root) = square_root(gram) else {
        return vec![f64::INFINITY];
    };
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(1);
    let mut draw =
        || screen.best_single(gram, &(&root * DVector::from_fn(gram.nrows(), |_, _| StandardNormal.sample(&mut rng))));
    (0..20_000).map(|_| draw()).collect()
}

/// One simulated null: (largest single Δχ², lack of fit).
fn null(source: &Source, screen: &Screen, noise: &Noise, seed: u64, stopped: &dyn Fn() -> bool) -> (f64, f64) {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(0x5eed ^ seed);
    let mut values = screen.plain.clone();
    for column in &screen.coefficient_columns {
        let share: f64 = StandardNormal.sample(&mut rng);
        values.iter_mut().zip(column.iter()).for_each(|(v, c)| *v += share * c);
    }
    noise.add(source, &mut values, &mut rng);
    let simulated = Observations { values, ..source.observations.clone() };
    let source = Source { observations: &simulated, sizes: &sizes(&simulated), ..*source };
    let whitener = Whitener::new(&source, &source.noise(Some(noise), stopped));
    let scores = screen.scores(&whitener, &simulated.values);
    (screen.best_single(&scores.gram, &scores.score), lack_of_fit::statistic(&simulated, &scores.white))
}
