//! The gain of the extension on held-out conditions. In each fold the noise is learnt, the data are whitened and the
//! causes are chosen without the held-out conditions.
//!
//! Values are fitted by one Gauss-Newton step from the full fits, which is exact for a linear model. A cause that
//! the rest of the data does not show is not chosen in that fold.

use super::calibrate::Gates;
use super::cross_validation::HeldOut;
use super::errors::Errors;
use super::fit::{COEFFICIENTS, Column, Fit};
use super::fitted::{Beside, Fitted};
use super::noise::{Noise, Source};
use super::study::Study;
use super::whiten::Whitener;
use crate::number::dot;
use crate::parallel;
use nalgebra::{DMatrix, DVector};
use std::sync::Arc;

/// Number of folds: our choice; each needs its own noise.
const FOLDS: usize = 6;
/// Numbers of candidates in each fold: the best with as many causes as the full fit, and the best single causes.
const CHOSEN_FROM: [usize; 2] = [4, 2];
/// If the information on a cause falls below this share of that in all data, the fold's data do not show it: our
/// choice.
const SHOWN: f64 = 0.02;

/// Held-out errors of the plain model and of the extension chosen in each fold.
#[derive(Clone)]
pub struct Nested {
    /// Errors of the sand's prediction.
    pub sand: [HeldOut; 2],
    /// Errors of the sensor's predicted readings, with nuisances fitted to the rest of the data.
    pub reading: [HeldOut; 2],
}

/// The choice of one fold.
pub struct Choice {
    /// Conditions that were not used.
    pub held: Vec<usize>,
    /// The chosen explanation, as fitted to all data; [`Known::without`] gave the whitening.
    pub fit: Fit,
    pub whitener: Whitener,
}

/// The errors on held-out conditions, and the choice of each fold.
pub fn nested(study: &Study, fitted: &Fitted, gates: &Gates, known: &Known) -> (Nested, Vec<Choice>) {
    let conditions = study.observations.conditions.len();
    let places = folds(conditions);
    let made = parallel::map(&places, |held| fold(study, fitted, gates, known, held));
    let (errors, choices): (Vec<_>, Vec<Choice>) = made.into_iter().unzip();
    let (sand, reading) = errors.into_iter().unzip();
    (Nested { sand: together(&places, sand, conditions), reading: together(&places, reading, conditions) }, choices)
}

/// Conditions held out in each fold.
pub fn folds(conditions: usize) -> Vec<Vec<usize>> {
    let folds = FOLDS.min(conditions);
    // Neighbouring conditions of a design are similar. A stride without a common divisor with their number distributes
    // them over the folds.
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

/// Inputs that are known before conditions are held out.
pub struct Known<'a> {
    pub source: &'a Source<'a>,
    /// Start of the search for each fold's noise.
    pub noise: &'a Noise,
    pub beside: Option<&'a Beside>,
}

impl Known<'_> {
    /// The whitening learnt from the other conditions; held-out numbers are 0 after it.
    pub fn without(&self, study: &Study, held: &[usize]) -> Whitener {
        let source = Source { left_out: held, ..*self.source };
        let noise = source.noise(Some(self.noise), &|| study.model.stopped());
        let own = Whitener::new(&source, &noise).without(study.observations, held);
        match self.beside {
            Some(beside) => beside.on(own),
            None => own,
        }
    }
}

/// Whitened columns of one fold; fits share many of them.
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

/// Errors of the sand's predictions and of readings, of the plain model and of the choice each.
type BothErrors = ([HeldOut; 2], [HeldOut; 2]);

/// A candidate fitted to the rest of the data in a fold.
struct Adjusted {
    step: Vec<f64>,
    /// Least objective on the rest.
    objective: f64,
    shown: bool,
}

/// Held-out errors of the plain model and of the choice on the conditions `held`, in their order: of the sand, and
/// of readings; and the choice.
fn fold(study: &Study, fitted: &Fitted, gates: &Gates, known: &Known, held: &[usize]) -> (BothErrors, Choice) {
    let whitener = known.without(study, held);
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
    let mut adjust = |fit: &Fit| adjusted(study, &mut whitened, fit);
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
    let both = [(base, &of_base.step), (fit, &adjusted.step)];
    let sand = both.map(|(fit, step)| errors(study, &fit.prediction, fit, &step[..fit.ids.len() + COEFFICIENTS], held));
    let reading = both.map(|(fit, step)| errors(study, &study.reading(fit), fit, step, held));
    let fit = fit.clone();
    ((sand, reading), Choice { held: held.to_vec(), fit, whitener })
}

/// One Gauss-Newton step on the data that are not held out.
fn adjusted(study: &Study, whitened: &mut Whitened, fit: &Fit) -> Adjusted {
    let slopes: Vec<Column> = fit.slopes.iter().map(|s| whitened.of(s)).collect();
    let left: Vec<f64> = study.observations.values.iter().zip(study.reading(fit)).map(|(y, m)| y - m).collect();
    let white = whitened.whitener.apply(&left);
    let square = |column: &Column| dot(column, column);
    let shown = (0..fit.ids.len()).all(|k| square(&slopes[k]) > SHOWN * square(&fit.white_slopes[k]));
    let (step, gained) = least_squares(&slopes, &white, &fit.deviations);
    let objective = dot(&white, &white) + dot(&fit.deviations, &fit.deviations) - gained;
    Adjusted { objective, step, shown }
}

/// Returns the least squares step along whitened slopes, and its gain. The last slopes are those by `deviations`, which
/// have a prior.
pub fn least_squares(slopes: &[Column], white: &[f64], deviations: &[f64]) -> (Vec<f64>, f64) {
    let n = slopes.len();
    let mut information = DMatrix::from_fn(n, n, |i, j| if j <= i { dot(&slopes[i], &slopes[j]) } else { 0.0 });
    information.fill_upper_triangle_with_lower_triangle();
    let mut score = DVector::from_fn(n, |i, _| dot(&slopes[i], white));
    let own = n - deviations.len();
    for (k, d) in deviations.iter().enumerate() {
        information[(own + k, own + k)] += 1.0;
        score[own + k] -= d;
    }
    (0..n).for_each(|k| information[(k, k)] = information[(k, k)].max(1e-300) * (1.0 + 1e-9));
    let step = information.cholesky().map_or_else(|| DVector::zeros(n), |c| c.solve(&score));
    let gained = score.dot(&step);
    (step.iter().copied().collect(), gained)
}

/// Errors on the conditions `held` of a fit that predicts `from`, moved by a step along its first slopes.
fn errors(study: &Study, from: &[f64], fit: &Fit, step: &[f64], held: &[usize]) -> HeldOut {
    let moved = |k: usize| fit.slopes.iter().zip(step).map(|(s, d)| s[k] * d).sum::<f64>();
    errors_of(study, |k| from[k] + moved(k), held)
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
