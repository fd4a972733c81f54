//! What the extension is worth on conditions that nothing has seen: in each fold the noise is learnt, the data are whitened and
//! the causes are chosen anew, without the conditions held out.
//!
//! Values are fitted by one Gauss-Newton step from where the full fits stand, which is exact for a linear model. A cause that the
//! rest of the data does not show is not chosen in that fold.

use super::calibrate::Gates;
use super::cross_validation::HeldOut;
use super::errors::Errors;
use super::fit::{COEFFICIENTS, Column, Fit, Study, dot};
use super::fitted::Fitted;
use super::noise::{Noise, Source};
use super::whiten::Whitener;
use crate::parallel;
use nalgebra::{DMatrix, DVector};
use std::sync::Arc;

/// Folds: our choice, as many noises have to be learnt.
const FOLDS: usize = 6;
/// Candidates that each fold chooses from: the best of the full fit's size, and of single causes.
const CHOSEN_FROM: [usize; 2] = [4, 2];
/// A cause whose information falls below this share of that of all data is not shown by the rest: our choice.
const SHOWN: f64 = 0.02;

/// Held-out errors of base and of the extension chosen in each fold.
pub fn nested(study: &Study, source: &Source, noise: &Noise, fitted: &Fitted, gates: &Gates) -> [HeldOut; 2] {
    let places = folds(study.observations.conditions.len());
    let made = parallel::map(&places, |held| fold(study, source, noise, fitted, gates, held));
    together(&places, made, study.observations.conditions.len())
}

/// Conditions held out in each fold.
pub fn folds(conditions: usize) -> Vec<Vec<usize>> {
    let folds = FOLDS.min(conditions);
    // Designs are in order; a step that has no divisor in common with their number scatters them.
    let stride = (conditions / 2 + 1..conditions + 2).find(|s| gcd(*s, conditions) == 1).unwrap_or(1);
    (0..folds).map(|f| (f..conditions).step_by(folds).map(|k| k * stride % conditions).collect()).collect()
}

/// Errors of all folds, condition by condition.
pub fn together(folds: &[Vec<usize>], parts: Vec<[HeldOut; 2]>, conditions: usize) -> [HeldOut; 2] {
    let empty =
        || HeldOut { errors: Errors { square: vec![0.0; conditions], count: vec![0.0; conditions] }, deviance: 0.0 };
    let mut total = [empty(), empty()];
    for (held, parts) in folds.iter().zip(parts) {
        for (total, part) in total.iter_mut().zip(parts) {
            for (&condition, (square, count)) in held.iter().zip(part.errors.square.iter().zip(&part.errors.count)) {
                (total.errors.square[condition], total.errors.count[condition]) = (*square, *count);
            }
        }
    }
    total
}

fn gcd(a: usize, b: usize) -> usize {
    if b == 0 { a } else { gcd(b, a % b) }
}

/// Whitened columns of one fold; fits share many.
struct Whitened<'a> {
    whitener: &'a Whitener,
    known: Vec<(Column, Column)>,
}

impl Whitened<'_> {
    fn of(&mut self, column: &Column) -> Column {
        if let Some((_, white)) = self.known.iter().find(|(own, _)| Arc::ptr_eq(own, column)) {
            return white.clone();
        }
        let white = Arc::new(self.whitener.apply(column));
        self.known.push((column.clone(), white.clone()));
        white
    }
}

/// A candidate adjusted on a fold's rest.
struct Adjusted {
    step: Vec<f64>,
    /// Least objective on the rest.
    objective: f64,
    shown: bool,
}

/// Held-out errors of base and choice on the conditions `held`, in their order.
fn fold(study: &Study, source: &Source, noise: &Noise, fitted: &Fitted, gates: &Gates, held: &[usize]) -> [HeldOut; 2] {
    let source = Source { left_out: held, ..*source };
    let own = source.noise(Some(noise), &|| study.model.stopped());
    let whitener = Whitener::new(&source, &own);
    let mut whitened = Whitened { whitener: &whitener, known: Vec::new() };
    let base = &fitted.base.fit;
    let size = fitted.best().map_or(1, |c| c.fit.ids.len());
    let mut choices: Vec<&Fit> = Vec::new();
    for (count, size) in CHOSEN_FROM.into_iter().zip([size, 1]) {
        let own = fitted.candidates.iter().map(|c| &c.fit).filter(|f| f.ids.len() == size && !f.slopes.is_empty());
        own.take(count).for_each(|fit| {
            if !choices.iter().any(|c| c.ids == fit.ids) {
                choices.push(fit);
            }
        });
    }
    let mut adjust = |fit: &Fit| adjusted(study, &mut whitened, fit, held);
    let of_base = adjust(base);
    let tried: Vec<(&Fit, Adjusted)> = choices.into_iter().map(|fit| (fit, adjust(fit))).collect();
    let least = |size: usize| {
        let of = tried.iter().filter(|t| t.0.ids.len() == size && t.1.shown);
        of.min_by(|a, b| a.1.objective.total_cmp(&b.1.objective))
    };
    let (single, pair) = (least(1), least(2));
    let gained = |t: &(&Fit, Adjusted)| of_base.objective - t.1.objective;
    let single = single.filter(|t| gained(t) > gates.single);
    let beside = single.map_or(gates.single, &gained) + fitted.second_gate.unwrap_or(f64::INFINITY);
    let chosen = pair.filter(|t| size > 1 && gained(t) > beside).or(single);
    let (fit, adjusted) = chosen.map_or((base, &of_base), |t| (t.0, &t.1));
    [errors(study, base, &of_base.step, held), errors(study, fit, &adjusted.step, held)]
}

/// One Gauss-Newton step on all conditions but those `held`.
fn adjusted(study: &Study, whitened: &mut Whitened, fit: &Fit, held: &[usize]) -> Adjusted {
    let o = study.observations;
    let slopes: Vec<Column> = fit.slopes.iter().map(|s| whitened.of(s)).collect();
    let reading = study.reading(fit);
    let white: Vec<f64> =
        whitened.whitener.apply(&o.values.iter().zip(&reading).map(|(y, m)| y - m).collect::<Vec<_>>());
    let n = slopes.len();
    let (mut whole, mut left): (DMatrix<f64>, DMatrix<f64>) = (DMatrix::zeros(n, n), DMatrix::zeros(n, n));
    let mut score: DVector<f64> = DVector::zeros(n);
    let mut objective = dot(&fit.deviations, &fit.deviations);
    for unit in &o.units {
        let span = o.span(unit);
        let rest = !held.contains(&unit.condition);
        for i in 0..n {
            for j in 0..=i {
                let product = dot(&slopes[i][span.clone()], &slopes[j][span.clone()]);
                whole[(i, j)] += product;
                left[(i, j)] += if rest { product } else { 0.0 };
            }
            score[i] += if rest { dot(&slopes[i][span.clone()], &white[span.clone()]) } else { 0.0 };
        }
        objective += if rest { dot(&white[span.clone()], &white[span]) } else { 0.0 };
    }
    let count = fit.ids.len();
    let shown = (0..count).all(|k| left[(k, k)] > SHOWN * whole[(k, k)]);
    left.fill_upper_triangle_with_lower_triangle();
    for (k, deviation) in fit.deviations.iter().enumerate() {
        left[(count + k, count + k)] += 1.0;
        score[count + k] -= deviation;
    }
    (0..n).for_each(|k| left[(k, k)] = left[(k, k)].max(1e-300) * (1.0 + 1e-9));
    let step = left.cholesky().map_or_else(|| DVector::zeros(n), |c| c.solve(&score));
    Adjusted { objective: objective - score.dot(&step), step: step.iter().copied().collect(), shown }
}

/// Least squares step along whitened slopes, the last of which are those by `deviations` with their prior.
pub fn step(slopes: &[Vec<f64>], white: &[f64], deviations: &[f64]) -> Vec<f64> {
    let n = slopes.len();
    let mut information = DMatrix::from_fn(n, n, |i, j| if j <= i { dot(&slopes[i], &slopes[j]) } else { 0.0 });
    information.fill_upper_triangle_with_lower_triangle();
    let mut score = DVector::from_fn(n, |i, _| dot(&slopes[i], white));
    let own = n - deviations.len();
    for (k, d) in deviations.iter().enumerate() {
        information[(own + k, own + k)] += 1.0;
        score[own + k] -= d;
    }
    information.cholesky().map_or_else(|| vec![0.0; n], |c| c.solve(&score).iter().copied().collect())
}

/// Errors on the conditions `held` of a fit moved by a step.
fn errors(study: &Study, fit: &Fit, step: &[f64], held: &[usize]) -> HeldOut {
    let sand = fit.ids.len() + COEFFICIENTS;
    let moved = |k: usize| fit.slopes.iter().zip(&step[..sand]).map(|(s, d)| s[k] * d).sum::<f64>();
    errors_of(study, |k| fit.prediction[k] + moved(k), held)
}

/// Errors of a prediction, number by number, on the conditions `held`.
pub fn errors_of(study: &Study, prediction: impl Fn(usize) -> f64, held: &[usize]) -> HeldOut {
    let o = study.observations;
    let of = |&condition: &usize| {
        let units = o.units.iter().filter(|u| u.condition == condition);
        let counted = o.channels.iter().enumerate().filter(|c| c.1.in_rmse).map(|c| c.0);
        let blocks = units.flat_map(|u| counted.clone().map(|c| u.block(c)));
        let add = |(square, count): (f64, f64), k: usize| (square + (o.values[k] - prediction(k)).powi(2), count + 1.0);
        blocks.flatten().fold((0.0, 0.0), add)
    };
    let (square, count): (Vec<f64>, Vec<f64>) = held.iter().map(of).unzip();
    HeldOut { errors: Errors { square, count }, deviance: 0.0 }
}
