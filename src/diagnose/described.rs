//! A law found in the data, if no mechanism explains them: a coefficient times a product of powers of dimensionless
//! groups.
//!
//! Every law of the dictionary is a column in addition to coefficients and nuisances, because stresses add up and a
//! sensor's reading is linear in them. The best law must gain more than the best of so many laws gains by chance.
//! In each fold of the conditions, noise, whitening and law are chosen anew: the held-out error must fall, and the
//! folds must choose nearly the same powers.

use super::calibrate::{Gates, chi_squared_over, quantile, square_root};
use super::cross_validation::HeldOut;
use super::errors::Errors;
use super::fit::{Column, Fit, slope};
use super::fitted::candidate;
use super::nested::{self, Known};
use super::study::Study;
use crate::number::dot;
use crate::parallel;
use crate::sand::GRAVITY;
use crate::sand::term::{On, Term};
use crate::student;
use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Powers of v_n²/(g|z|) and of |z|/w in the dictionary: our choice, up to the cube of the speed, in steps that
/// logs can resolve.
const FROUDE: [f64; 6] = [0.25, 0.5, 0.75, 1.0, 1.25, 1.5];
const DEPTH: [f64; 7] = [-0.75, -0.5, -0.25, 0.0, 0.25, 0.5, 0.75];
/// Powers of |z|/w in laws that do not depend on speed; the power 0 would be the medium itself.
const STILL: [f64; 7] = [-1.0, -0.75, -0.5, -0.25, 0.5, 1.0, 1.5];
/// Least depth [m] in the range of a law: segments nearer to the surface carry almost no force. Our choice.
const SHALLOW: f64 = 1e-3;
/// Probability of naming a law if there is none.
const FALSE_ALARM: f64 = 0.002;
/// Share of the folds that must choose nearly the same powers.
const STABLE: f64 = 0.75;
/// Tolerance of "nearly the same": one step of the dictionary in the speed's power, two in the depth's, because the
/// two are correlated. Our choice.
const NEARLY: [f64; 2] = [0.25, 0.5];
/// Number of random draws from which the gain of the best law by chance is computed.
const NULLS: usize = 1500;

/// A law with its coefficient.
pub struct Described {
    pub term: Term,
    /// 95 % interval of the coefficient.
    pub ci95: [f64; 2],
    pub delta_chi2: f64,
    /// Held-out errors of the plain model and of the law, chosen anew in each fold.
    pub nested: [HeldOut; 2],
    /// The model with the law; coefficients and nuisances are fitted with it.
    pub fit: Fit,
}

/// The dictionary, over the range of the data.
pub(super) fn dictionary([speed, depth, width]: [f64; 3]) -> Vec<Term> {
    let shallow = SHALLOW / width;
    let term = |(froude, over): (f64, f64)| {
        let (mut groups, mut range) = (BTreeMap::new(), BTreeMap::new());
        if froude != 0.0 {
            groups.insert("froude".to_string(), froude);
            range.insert("froude".to_string(), [0.0, speed * speed / (GRAVITY * SHALLOW)]);
        }
        if over != 0.0 {
            groups.insert("depth_over_width".to_string(), over);
            range.insert("depth_over_width".to_string(), [shallow, (depth / width).max(2.0 * shallow)]);
        }
        Term { on: On::Normal, coefficient: 1.0, groups, range }
    };
    let moving = FROUDE.iter().flat_map(|f| DEPTH.iter().map(move |d| (*f, *d)));
    moving.chain(STILL.iter().map(|d| (0.0, *d))).map(term).collect()
}

fn powers(term: &Term) -> [f64; 2] {
    ["froude", "depth_over_width"].map(|g| term.groups.get(g).copied().unwrap_or(0.0))
}

/// The gain of each law if coefficients and nuisances are fitted together with it.
pub(super) struct Scores {
    gram: DMatrix<f64>,
    score: DVector<f64>,
}

/// Scores of whitened columns about a whitened fit.
pub(super) fn scores(fit_slopes: &[Column], white: &[f64], deviations: &[f64], columns: &[Column]) -> Option<Scores> {
    let n = fit_slopes.len();
    let mut information = DMatrix::from_fn(n, n, |i, j| if j <= i { dot(&fit_slopes[i], &fit_slopes[j]) } else { 0.0 });
    information.fill_upper_triangle_with_lower_triangle();
    let own = n - deviations.len();
    let mut score = DVector::from_fn(n, |i, _| dot(&fit_slopes[i], white));
    for (k, d) in deviations.iter().enumerate() {
        information[(own + k, own + k)] += 1.0;
        score[own + k] -= d;
    }
    let inverse = information.try_inverse()?;
    let places: Vec<usize> = (0..columns.len()).collect();
    let rows = parallel::map(&places, |&k| {
        let cross: Vec<f64> = fit_slopes.iter().map(|s| dot(s, &columns[k])).collect();
        (cross, (0..=k).map(|j| dot(&columns[k], &columns[j])).collect::<Vec<_>>())
    });
    let cross = DMatrix::from_fn(n, columns.len(), |i, k| rows[k].0[i]);
    let products = DMatrix::from_fn(columns.len(), columns.len(), |i, j| rows[i.max(j)].1[i.min(j)]);
    let gram = products - cross.transpose() * &inverse * &cross;
    let score = DVector::from_fn(columns.len(), |k, _| dot(&columns[k], white)) - cross.transpose() * inverse * score;
    Some(Scores { gram, score })
}

/// The law with the greatest gain, with its coefficient and gain, among those that are physically possible.
pub(super) fn best(study: &Study, fit: &Fit, laws: &[Term], scores: &Scores) -> Option<(usize, f64, f64)> {
    let medium = study.model.medium();
    let coefficients = study.coefficients(&fit.deviations);
    let of = |k: usize| {
        let (felt, along) = (scores.gram[(k, k)], scores.score[k]);
        (felt > 1e-9).then(|| (k, along / felt, along * along / felt))
    };
    let mut all: Vec<_> = (0..laws.len()).filter_map(of).collect();
    all.sort_by(|a, b| b.2.total_cmp(&a.2));
    let can_be = |&(k, coefficient, _): &(usize, f64, f64)| {
        Term { coefficient, ..laws[k].clone() }.check(&coefficients, medium.bulk_density).is_ok()
    };
    all.into_iter().find(can_be)
}

/// Gain of the best law of the dictionary by chance, if the noise's variance is known with these degrees of freedom.
pub(super) fn gate(scores: &Scores, degrees: f64) -> f64 {
    let Some(root) = square_root(&scores.gram) else { return f64::INFINITY };
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(6);
    let mut draw = || {
        let score = &root * DVector::from_fn(scores.gram.nrows(), |_, _| StandardNormal.sample(&mut rng));
        let gain = |k: usize| if scores.gram[(k, k)] > 1e-9 { score[k] * score[k] / scores.gram[(k, k)] } else { 0.0 };
        let z: f64 = StandardNormal.sample(&mut rng);
        (0..score.len()).map(gain).fold(0.0, f64::max) / chi_squared_over(degrees, z)
    };
    quantile((0..NULLS).map(|_| draw()).collect(), 1.0 - FALSE_ALARM)
}

/// The law that the data support in addition to the plain model `base`; None if no law passes all tests.
pub fn described(study: &Study, known: &Known, base: &Fit, gates: &Gates) -> Option<Described> {
    let laws = dictionary(study.model.reach());
    let columns = columns(study, base, &laws)?;
    let white = parallel::map(&columns, |c| Arc::new(study.whitener.apply(c)));
    let all = scores(&base.white_slopes, &base.white, &base.deviations, &white)?;
    let (chosen, coefficient, gain) = best(study, base, &laws, &all)?;
    if gain <= gates.inflation * gate(&all, gates.degrees_of(&[])) {
        return None;
    }
    let (nested, folds) = held_out(study, known, base, &laws, &columns);
    if !holds(&laws, chosen, &folds, &nested) {
        return None;
    }
    let reach = student::two_sided_95(gates.degrees_of(&[])) * gates.inflation.sqrt();
    fitted(study, base, Term { coefficient, ..laws[chosen].clone() }, reach, nested)
}

/// Change of the prediction of `base` by each law with the coefficient 1; None if the model supports no laws.
pub(super) fn columns(study: &Study, base: &Fit, laws: &[Term]) -> Option<Vec<Vec<f64>>> {
    let coefficients = study.coefficients(&base.deviations);
    let column = |law: &Term| {
        let model = study.model.with_terms(std::slice::from_ref(law))?;
        Some(slope(&model.predict(&base.mechanisms, &coefficients), &base.prediction, 1.0))
    };
    parallel::map(laws, column).into_iter().collect()
}

/// Does the law `chosen` hold without the conditions of each fold: do the folds choose nearly the same powers, and is
/// the second error on held-out conditions smaller than the first?
pub(super) fn holds(laws: &[Term], chosen: usize, folds: &[Option<usize>], nested: &[HeldOut; 2]) -> bool {
    let near = |k: &&usize| {
        let (a, b) = (powers(&laws[chosen]), powers(&laws[**k]));
        (0..2).all(|i| (a[i] - b[i]).abs() <= NEARLY[i] + 1e-9)
    };
    let alike = folds.iter().flatten().filter(near).count();
    let helps = nested[0].errors.reduction_interval(&nested[1].errors)[0] > 0.0;
    helps && alike as f64 >= STABLE * folds.len() as f64
}

/// Law, causes, coefficients and nuisances fitted together, in rounds, because the columns depend slightly on them.
/// The coefficient's interval is `reach` standard deviations to both sides.
pub(super) fn fitted(study: &Study, base: &Fit, term: Term, reach: f64, nested: [HeldOut; 2]) -> Option<Described> {
    let mut term = term;
    let mut fit = base.clone();
    let mut sd = 0.0;
    for _ in 0..3 {
        let model = study.model.with_terms(std::slice::from_ref(&term))?;
        let own = study.with_model(&*model);
        fit = own.fit_near(&fit);
        let step = 0.02 * term.coefficient;
        let more = Term { coefficient: term.coefficient + step, ..term.clone() };
        let model = study.model.with_terms(std::slice::from_ref(&more))?;
        let moved = model.predict(&fit.mechanisms, &study.coefficients(&fit.deviations));
        let column = Arc::new(study.whitener.apply(&slope(&moved, &fit.prediction, step)));
        let own = scores(&fit.white_slopes, &fit.white, &fit.deviations, &[column])?;
        term.coefficient += own.score[0] / own.gram[(0, 0)];
        sd = own.gram[(0, 0)].recip().sqrt();
    }
    let model = study.model.with_terms(std::slice::from_ref(&term))?;
    let fit = study.with_model(&*model).fit_near(&fit);
    let delta_chi2 = base.objective - fit.objective;
    let ci95 = [term.coefficient - reach * sd, term.coefficient + reach * sd];
    term.check(&study.coefficients(&fit.deviations), study.model.medium().bulk_density).ok()?;
    Some(Described { term, ci95, delta_chi2, nested, fit })
}

/// Held-out errors with noise, whitening and law learnt anew in each fold, and the law of each fold.
fn held_out(
    study: &Study,
    known: &Known,
    base: &Fit,
    laws: &[Term],
    columns: &[Vec<f64>],
) -> ([HeldOut; 2], Vec<Option<usize>>) {
    let o = study.observations;
    let folds = nested::folds(o.conditions.len());
    let made = parallel::map(&folds, |held| {
        let whitener = known.without(study, held);
        let slopes: Vec<Column> = base.slopes.iter().map(|s| Arc::new(whitener.apply(s))).collect();
        let white = whitener.apply(&slope(&o.values, &study.reading(base), 1.0));
        let laws_white: Vec<Column> = columns.iter().map(|c| Arc::new(whitener.apply(c))).collect();
        let found = scores(&slopes, &white, &base.deviations, &laws_white);
        let chosen = found.and_then(|s| best(study, base, laws, &s)).map(|b| b.0);
        let without = nested::least_squares(&slopes, &white, &base.deviations).0;
        let with = chosen.map(|k| {
            let all: Vec<Column> = [laws_white[k].clone()].into_iter().chain(slopes.iter().cloned()).collect();
            nested::least_squares(&all, &white, &base.deviations).0
        });
        let moved = |steps: &[f64], law: Option<(f64, usize)>| {
            let sand = super::fit::COEFFICIENTS;
            let at = |k: usize| {
                let own = base.slopes.iter().zip(&steps[..sand]).map(|(s, d)| s[k] * d).sum::<f64>();
                base.prediction[k] + own + law.map_or(0.0, |(c, l)| c * columns[l][k])
            };
            nested::errors_of(study, at, held)
        };
        let extended = match (&with, chosen) {
            (Some(step), Some(k)) => moved(&step[1..], Some((step[0], k))),
            _ => moved(&without, None),
        };
        ([moved(&without, None), extended], chosen)
    });
    let (parts, chosen): (Vec<[HeldOut; 2]>, Vec<Option<usize>>) = made.into_iter().unzip();
    (nested::together(&folds, parts, o.conditions.len()), chosen)
}

/// Share of the misfit beyond noise that the law explains. There are two such shares: of the error on held-out
/// conditions, compared with the plain model with or without fitted coefficients, whichever is better; and of the
/// whitened error. The smaller one is returned.
pub fn explained(study: &Study, base: &Fit, law: &Described, [plain, floor]: [&Errors; 2]) -> f64 {
    let [before, after, least] = [&law.nested[0].errors, &law.nested[1].errors, floor].map(|e| e.rmse().powi(2));
    let before = before.min(plain.rmse().powi(2));
    let lack = |fit: &Fit| candidate(study, base, fit.clone()).lack.excess.max(0.0);
    let by_noise = 1.0 - lack(&law.fit) / lack(base).max(1e-9);
    // If the plain model's error is hardly larger than the scatter, a share of their difference has no meaning.
    if before > 1.2 * least { by_noise.min(1.0 - (after - least).max(0.0) / (before - least)) } else { by_noise }
}
