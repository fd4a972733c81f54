//! Thresholds ("gates") of the diagnosis, calibrated for each data set on simulated data without a hidden cause
//! ("nulls").
//!
//! A null has the data's own design, the plain model with coefficients drawn from their prior, and the noise learnt
//! from the repetitions. It is analysed with another noise that the repetitions make equally likely, because the
//! true noise is not known. The effect on χ² is expressed as degrees of freedom, one number for each cause, so the
//! gates have the tails of F and not of χ².

use super::fit::slope;
use super::fit::{COEFFICIENTS, Column};
use super::lack_of_fit::{self, Lack};
use super::noise::{Noise, Source, sizes};
use super::observations::Observations;
use super::shared::gram;
use super::study::Study;
use super::whiten::Whitener;
use crate::number::{add_scaled, dot};
use crate::parallel;
use crate::sand::mechanism::{CATALOG, Mechanisms};
use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;

/// Probability that a gate opens on data without a hidden cause. For three gates this is 0.6 %, below the target of 1
/// %.
const FALSE_ALARM: f64 = 0.002;
/// Quantile of the normal distribution for [`FALSE_ALARM`].
const NORMAL: f64 = 2.88;
/// Quantile of the maximum of many numbers (Gumbel's distribution) for a quarter of [`FALSE_ALARM`], in standard
/// deviations above the mean. A misfit of a single condition needs the strongest evidence.
const GREATEST: f64 = 5.48;
/// Number of simulated nulls: their mean and spread are then known to some 10 %. Our choice, a compromise with
/// time.
const NULLS: usize = 80;

/// Largest number of values that the nulls on all cores hold together: our choice, 256 MB, so that many cores do not
/// fill the memory.
const NUMBERS_AT_ONCE: usize = 32 << 20;

/// A cause affects the data if its typical strength changes them by more than 0.01 σ in all: our choice, far below the
/// smallest effect that could be found.
pub const FELT: f64 = 1e-4;

/// The effect of each candidate on the data: the change of the prediction per typical strength, at one value.
pub struct Screen {
    /// For each candidate its catalogue index, and the value at which its column was computed.
    pub candidates: Vec<(usize, f64)>,
    columns: Vec<Vec<f64>>,
    pub marginal_columns: Vec<Column>,
    plain: Vec<f64>,
}

/// Products of the whitened columns with the coefficients projected out, and with the residual.
pub struct Scores {
    pub gram: DMatrix<f64>,
    pub score: DVector<f64>,
    /// Whitened residual with the coefficients adjusted.
    white: Vec<f64>,
}

#[derive(Clone, Debug)]
pub struct Gates {
    /// Δχ² that the best single cause must exceed.
    pub single: f64,
    /// [`Lack::mean`] and [`Lack::worst`] above which the fit is lacking.
    pub lack_of_fit: f64,
    pub worst: f64,
    /// Thresholds of χ² differences are multiplied by this number. It is 1 if simulated logs without a cause give the
    /// differences that the F distribution predicts, and larger if they give larger ones.
    pub inflation: f64,
    /// Catalogue index, and the degrees of freedom of the estimated noise along the cause's effect.
    pub degrees: Vec<(usize, f64)>,
}

impl Gates {
    pub fn lacking(&self, lack: &Lack) -> bool {
        lack.mean > self.lack_of_fit || lack.worst > self.worst
    }

    /// Is a lack of fit only slightly above its limit? The limit comes from few nulls and from estimated noise.
    pub fn slight(&self, lack: &Lack) -> bool {
        lack.mean <= SLIGHT * self.lack_of_fit && lack.worst <= SLIGHT * self.worst
    }

    /// Degrees of freedom of a set of causes: the least among its members, or among all causes if the set is empty. At
    /// least 2, our choice, because below that intervals would be useless.
    pub fn degrees_of(&self, ids: &[usize]) -> f64 {
        let own = self.degrees.iter().filter(|d| ids.is_empty() || ids.contains(&d.0));
        own.map(|d| d.1).fold(MOST_DEGREES, f64::min)
    }
}

/// A lack of fit up to this factor above its limit does not prevent naming a cause: our choice; the limit itself is
/// known to a tenth or so.
const SLIGHT: f64 = 1.2;
/// From this many degrees of freedom on the tails are those of χ²: our choice, the difference is below 1 %.
const MOST_DEGREES: f64 = 10_000.0;

impl Screen {
    /// Columns at the state of `fit`, for the candidates that it does not contain.
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
        Self { candidates: tried, columns, marginal_columns: study.marginal_slopes(), plain }
    }

    /// Scores of a stack of measured values.
    pub fn scores(&self, whitener: &Whitener, values: &[f64]) -> Scores {
        let residual: Vec<f64> = values.iter().zip(&self.plain).map(|(y, m)| y - m).collect();
        let white = whitener.apply(&residual);
        let c: Vec<_> = self.marginal_columns.iter().map(|c| whitener.apply(c)).collect();
        let z: Vec<_> = self.columns.iter().map(|c| whitener.apply(c)).collect();
        let count = c.len();
        let prior = gram(&c) + DMatrix::identity(count, count);
        let inverse = prior.try_inverse().unwrap_or_else(|| DMatrix::identity(count, count));
        let cz = DMatrix::from_fn(count, z.len(), |i, j| dot(&c[i], &z[j]));
        let cr = DVector::from_fn(count, |i, _| dot(&c[i], &white));
        let gram = gram(&z) - cz.transpose() * &inverse * &cz;
        let score = DVector::from_fn(z.len(), |i, _| dot(&z[i], &white)) - cz.transpose() * &inverse * &cr;
        let adjusted = inverse * cr;
        let mut left = white;
        for (column, share) in c.iter().zip(&adjusted) {
            add_scaled(&mut left, -share, column);
        }
        Scores { gram, score, white: left }
    }

    /// May this column's parameter have the sign of `value`?
    fn allowed(&self, column: usize, value: f64) -> bool {
        value >= 0.0 || CATALOG[self.candidates[column].0].coordinate_bounds()[0] < 0.0
    }

    /// Largest Δχ² of any single cause.
    fn best_single(&self, gram: &DMatrix<f64>, score: &DVector<f64>) -> f64 {
        self.best_of(gram, score, |_| 1.0)
    }

    /// The same as [`Self::best_single`], with each cause's Δχ² times a factor.
    fn best_of(&self, gram: &DMatrix<f64>, score: &DVector<f64>, factor: impl Fn(usize) -> f64) -> f64 {
        let felt = (0..score.len()).filter(|&k| gram[(k, k)] > FELT && self.allowed(k, score[k]));
        felt.map(|k| factor(k) * score[k] * score[k] / gram[(k, k)]).fold(0.0, f64::max)
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

    /// Δχ² of a second term by chance, if the cause is column `truth` alone with strength `value`.
    pub fn second_gate(&self, gram: &DMatrix<f64>, truth: usize, value: f64, gates: &Gates) -> f64 {
        let Some(root) = square_root(gram) else {
            return f64::INFINITY;
        };
        let entry = &CATALOG[self.candidates[truth].0];
        let mean = gram.column(truth) * (entry.coordinate(value) / entry.coordinate_typical());
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(2);
        let degrees = gates.degrees_of(&[]);
        let draws: Vec<f64> = (0..1500)
            .map(|_| {
                let score = &mean + &root * DVector::from_fn(mean.len(), |_, _| StandardNormal.sample(&mut rng));
                let pair = self.pairs(gram, &score).first().map_or(0.0, |p| p.0);
                let z: f64 = StandardNormal.sample(&mut rng);
                (pair - self.best_single(gram, &score)).max(0.0) / chi_squared_over(degrees, z)
            })
            .collect();
        gates.inflation * quantile(draws, 1.0 - FALSE_ALARM)
    }
}

/// Number of start values for an upper limit: from twice its typical value down to a quarter of it, in steps of √2. Our
/// choice, because the behaviour changes at the limit at which a motor begins to stall.
const CEILINGS: usize = 7;

/// Start values of a mechanism's fit; more than one if its effect is far from proportional.
pub fn starts(study: &Study, id: usize) -> Vec<f64> {
    let entry = &CATALOG[id];
    match entry.id {
        "friction_clip" => vec![0.5, 2.0, 5.0],
        _ if entry.ceiling => (0..CEILINGS).map(|k| 2.0 * entry.typical * 0.5f64.powf(0.5 * k as f64)).collect(),
        _ => vec![study.felt_strength(id)],
    }
}

/// L with L Lᵀ = `gram`, which may be singular; rows and columns without effect on the data stay 0.
pub fn square_root(gram: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let n = gram.nrows();
    let scale: Vec<f64> = (0..n).map(|k| if gram[(k, k)] > FELT { gram[(k, k)].sqrt() } else { 0.0 }).collect();
    let inverse = |k: usize| if scale[k] > 0.0 { 1.0 / scale[k] } else { 0.0 };
    let correlation = DMatrix::from_fn(n, n, |i, j| gram[(i, j)] * inverse(i) * inverse(j));
    let eigen = correlation.try_symmetric_eigen(1e-12, 1000)?;
    let root = DMatrix::from_diagonal(&eigen.eigenvalues.map(|v| v.max(0.0).sqrt()));
    Some(DMatrix::from_diagonal(&DVector::from_vec(scale)) * eigen.eigenvectors * root)
}

pub fn quantile(mut values: Vec<f64>, share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values[((values.len() as f64 * share) as usize).min(values.len() - 1)]
}

/// One simulated null.
struct Null {
    /// Largest single Δχ².
    best: f64,
    lack: Lack,
    /// Information of each column under the drawn noise over that under the known noise.
    information: Vec<f64>,
}

/// Gates for this data set.
pub fn gates(study: &Study, source: &Source, screen: &Screen, noise: &Noise, scores: &Scores) -> Gates {
    let stopped = || study.model.stopped();
    let draws = source.draws(noise, NULLS, &stopped);
    let seeds: Vec<usize> = (0..NULLS).collect();
    let of = |&seed: &usize| null(source, screen, [noise, &draws[seed]], &scores.gram, seed, &stopped);
    let columns = 2 * (screen.candidates.len() + screen.marginal_columns.len());
    let together = (NUMBERS_AT_ONCE / (columns * source.observations.values.len()).max(1)).max(1);
    let nulls: Vec<Null> = seeds.chunks(together).flat_map(|part| parallel::map(part, of)).collect();
    let degrees: Vec<f64> = (0..screen.candidates.len()).map(|k| degrees(&nulls, k)).collect();
    let ideal = ideal(screen, &scores.gram, &degrees);
    let of = |f: fn(&Null) -> f64| spread(&nulls.iter().map(f).collect::<Vec<_>>());
    let (mean, worst, count) = (of(|n| n.lack.mean), of(|n| n.lack.worst), of(|n| n.lack.count).0);
    Gates {
        // The nulls can only raise the gate: they are few, and by chance their mean can be below the theoretical
        // one.
        inflation: (of(|n| n.best).0 / spread(&ideal).0.max(1e-9)).max(1.0),
        single: (of(|n| n.best).0 / spread(&ideal).0.max(1e-9)).max(1.0) * quantile(ideal, 1.0 - FALSE_ALARM),
        // The factor 1.1 allows for the skewness of a sum of squares. The limit is at least the mean square that noise
        // alone can cause, even if all nulls, whose noise is known, stay below it.
        lack_of_fit: (mean.0 + 1.1 * NORMAL * mean.1).max(1.0 + 1.1 * NORMAL * (2.0 / count.max(1.0)).sqrt()),
        worst: worst.0 + GREATEST * worst.1,
        degrees: screen.candidates.iter().map(|c| c.0).zip(degrees).collect(),
    }
}

/// Mean and standard deviation.
fn spread(values: &[f64]) -> (f64, f64) {
    let count = values.len().max(1) as f64;
    let mean = values.iter().sum::<f64>() / count;
    let square = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (count - 1.0).max(1.0);
    (mean, square.sqrt())
}

/// ν of column `k`, from the variance of the logarithm of an estimated variance, 2/ν.
fn degrees(nulls: &[Null], k: usize) -> f64 {
    let logs: Vec<f64> = nulls.iter().map(|n| n.information[k]).filter(|i| *i > 0.0).map(f64::ln).collect();
    let sd = spread(&logs).1;
    if logs.len() < 2 { MOST_DEGREES } else { (2.0 / (sd * sd).max(1e-12)).clamp(2.0, MOST_DEGREES) }
}

/// Quantile of χ² over its `degrees` of freedom, at the normal deviate `z` (Wilson & Hilferty 1931).
pub fn chi_squared_over(degrees: f64, z: f64) -> f64 {
    let share = 2.0 / (9.0 * degrees);
    (1.0 - share + z * share.sqrt()).max(0.05).powi(3)
}

/// Largest single Δχ² by chance: Gaussian scores with the Gram matrix as covariance, over an estimated variance
/// with these degrees of freedom.
fn ideal(screen: &Screen, gram: &DMatrix<f64>, degrees: &[f64]) -> Vec<f64> {
    let Some(root) = square_root(gram) else {
        return vec![f64::INFINITY];
    };
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(1);
    let mut draw = || {
        let score = &root * DVector::from_fn(gram.nrows(), |_, _| StandardNormal.sample(&mut rng));
        let z: f64 = StandardNormal.sample(&mut rng);
        screen.best_of(gram, &score, |k| 1.0 / chi_squared_over(degrees[k], z))
    };
    (0..20_000).map(|_| draw()).collect()
}

/// One simulated null, made with the noise `known` and analysed with the noise `drawn`.
fn null(
    source: &Source,
    screen: &Screen,
    [known, drawn]: [&Noise; 2],
    gram: &DMatrix<f64>,
    seed: usize,
    stopped: &(dyn Fn() -> bool + Sync),
) -> Null {
    let lack = Lack { mean: 1.0, worst: 0.0, excess: 0.0, count: 0.0 };
    if stopped() {
        return Null { best: 0.0, lack, information: vec![0.0; screen.candidates.len()] };
    }
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(0x5eed ^ seed as u64);
    let mut values = screen.plain.clone();
    // Nuisances are projected out, whatever their values. Draws from their wide priors would only distort the
    // sizes.
    for column in &screen.marginal_columns[..COEFFICIENTS] {
        let share: f64 = StandardNormal.sample(&mut rng);
        values.iter_mut().zip(column.iter()).for_each(|(v, c)| *v += share * c);
    }
    known.add(source, &mut values, &mut rng);
    let simulated = Observations { values, ..source.observations.clone() };
    let source = Source { observations: &simulated, sizes: &sizes(&simulated), ..*source };
    let scores = screen.scores(&Whitener::new(&source, drawn), &simulated.values);
    let information =
        (0..gram.nrows()).map(|k| if gram[(k, k)] > FELT { scores.gram[(k, k)] / gram[(k, k)] } else { 0.0 });
    Null {
        best: screen.best_single(&scores.gram, &scores.score),
        lack: lack_of_fit::statistic(&simulated, &scores.white),
        information: information.collect(),
    }
}
