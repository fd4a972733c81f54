//! How the resistance to penetration grows with depth and with size, from several pushes of discs or plates.
//!
//! The pressure p = F/A of each push is averaged over stretches of depth, so that all pushes have about equal weight.
//! Five laws are fitted to ln p by least squares. Each law is then tested on pushes, and on sizes, that were left out
//! of its fit. The rig bends by its compliance times the force, and the log contains this deflection as depth; the
//! compliance is fitted, too.

pub use super::pressure_law::PressureLaw;
use super::{TRANSIENT, jackknife, refused};
use crate::error::{Result, check_range};
use crate::student;
use nalgebra::{DMatrix, DVector};
use serde::Serialize;

/// Number of stretches of depth over each of which a push is averaged: our choice, because a line needs several points.
const STRETCHES: usize = 12;
/// Least number of stretches with samples: our choice, because a power of depth needs several.
const LEAST_STRETCHES: usize = 4;
/// Number of compliances that are tried, evenly spaced from 0 to 0.8 times the compliance that would explain the whole
/// depth of a stretch. Our choice: the steps are then below 2 % of the largest one, and no depth becomes 0 or less.
const COMPLIANCES: usize = 60;
/// A law with more parameters is preferred only if its prediction error is smaller by this share: our choice, so that
/// chance does not decide.
const WORTH: f64 = 0.05;
/// Largest number of pushes: our choice, far more than an experiment has.
pub const MOST_PUSHES: usize = 1000;
/// Largest number of samples of all pushes together: our choice, a thousand for each of [`MOST_PUSHES`].
pub const MOST_SAMPLES: usize = 1_000_000;

/// One penetration.
#[derive(Clone, Debug)]
pub struct Penetration {
    pub name: String,
    /// Diameter of the disc [m]; for a rectangle, the diameter of the disc with the same area.
    pub diameter: f64,
    /// Depth [m] and force [N].
    pub points: Vec<[f64; 2]>,
    /// Least and greatest speed [m/s], if the log has them.
    pub speeds: Option<[f64; 2]>,
}

impl Penetration {
    /// [m²]
    pub fn area(&self) -> f64 {
        std::f64::consts::FRAC_PI_4 * self.diameter * self.diameter
    }
}

/// A number with its 95 % interval, from leaving out one push at a time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Value {
    pub value: f64,
    pub interval: [f64; 2],
}

/// Errors of a law: root mean squares of ln(predicted/measured), in %.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LawScore {
    pub law: PressureLaw,
    pub formula: &'static str,
    /// Error on the pushes of the fit.
    pub fitted_percent: f64,
    /// Error on pushes that were left out of the fit.
    pub other_push_percent: f64,
    /// Error on sizes that were left out of the fit; None if too few sizes remain for a fit.
    pub other_size_percent: Option<f64>,
}

/// ζ of one size, as `sandgait calibrate` gives it for one push.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct OfSize {
    /// [m]
    pub diameter: f64,
    pub pushes: usize,
    /// ζ of a line through the origin, F = ζ z A, mean over the pushes [N/cm³].
    pub zeta: f64,
    /// 95 % confidence interval of the mean, from the scatter between pushes; none for one push.
    pub zeta_interval: Option<[f64; 2]>,
    /// Standard deviation between pushes, in % of the mean; none for one push.
    pub repeatability_percent: Option<f64>,
}

/// Results of several pushes.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Pushes {
    pub sizes: Vec<OfSize>,
    pub laws: Vec<LawScore>,
    /// The recommended law.
    pub law: PressureLaw,
    /// n in |z|^n, fitted together with the exponent of size if there are several sizes.
    pub depth_exponent: Value,
    /// q in D^q; None if there is only one size.
    pub size_exponent: Option<Value>,
    /// Compliance of the rig [m/N].
    pub compliance: Value,
    /// Greatest depth [m] and force [N].
    pub greatest: [f64; 2],
    /// The recommended law's parameters, see [`fit`].
    #[serde(skip)]
    pub(super) fitted: [f64; 3],
    pub cautions: Vec<String>,
}

/// One stretch of a push: the logarithms of depth, size and pressure; the rig's deflection is subtracted from the depth.
type Point = [f64; 3];

/// Compares the laws. `compliance` [m/N] of the rig is fitted if it is not given.
pub fn compare(pushes: &[Penetration], compliance: Option<f64>) -> Result<Pushes> {
    if pushes.len() < 2 {
        return Err(refused("one push only: several are needed to compare laws; leave out the column trial"));
    }
    if pushes.len() > MOST_PUSHES {
        return Err(refused(format!("{} pushes are more than {MOST_PUSHES}", pushes.len())));
    }
    if let Some(c) = compliance {
        check_range("compliance", c, 0.0..=1.0)?;
    }
    let stretches = pushes.iter().map(stretches).collect::<Result<Vec<_>>>()?;
    let all: Vec<usize> = (0..pushes.len()).collect();
    let sized = diameters(pushes).len() > 1;
    let given = |chosen: &[usize]| compliance.map_or_else(|| soft(pushes, &stretches, chosen, sized), Ok);
    let here = given(&all)?;
    let points = |compliance: f64| logs(pushes, &stretches, compliance);
    let laws = PressureLaw::ALL.into_iter().filter(|law| sized || !law.knows_size());
    let scores = laws.map(|law| score(law, pushes, &points(here)?)).collect::<Result<Vec<_>>>()?;
    let widest = if sized { PressureLaw::PowerAndSize } else { PressureLaw::Power };
    let parameters = |chosen: &[usize], c: f64| fit(widest, &gathered(&points(c)?, chosen));
    let mut without = Vec::new();
    for left in &all {
        let others: Vec<usize> = all.iter().copied().filter(|k| k != left).collect();
        let c = given(&others)?;
        without.push((c, parameters(&others, c)?));
    }
    let whole = parameters(&all, here)?;
    let of = |k: usize| with_interval(whole[k], without.iter().map(|w| w.1[k]));
    let greatest = |k: usize| pushes.iter().flat_map(|p| p.points.iter().map(move |q| q[k])).fold(0.0, f64::max);
    let law = chosen(&scores);
    let not_negative = |v: Value| Value { interval: positive(v.interval), ..v };
    let mut study = Pushes {
        sizes: by_size(pushes)?,
        law,
        fitted: fit(law, &gathered(&points(here)?, &all))?,
        laws: scores,
        depth_exponent: not_negative(of(1)),
        size_exponent: sized.then(|| of(2)),
        compliance: not_negative(with_interval(here, without.iter().map(|w| w.0))),
        greatest: [greatest(0), greatest(1)],
        cautions: Vec::new(),
    };
    study.cautions = cautions(&study, pushes);
    Ok(study)
}

/// The simplest law whose error no other law reduces by more than the share [`WORTH`]. If each law has an error on
/// left-out sizes, these errors are compared. If one lacks it, the errors on left-out pushes are, because the two kinds
/// cannot be compared: a left-out size is harder to predict.
fn chosen(scores: &[LawScore]) -> PressureLaw {
    let sizes = scores.iter().all(|s| s.other_size_percent.is_some());
    let error = |s: &LawScore| s.other_size_percent.filter(|_| sizes).unwrap_or(s.other_push_percent);
    let least = scores.iter().map(error).fold(f64::INFINITY, f64::min);
    let near = scores.iter().filter(|s| error(s) <= least * (1.0 + WORTH));
    near.min_by_key(|s| s.law.parameters()).map_or(PressureLaw::Proportional, |s| s.law)
}

/// The sizes; diameters that differ by less than 1 µm are one size: our choice, far below any tolerance of a disc.
fn diameters(pushes: &[Penetration]) -> Vec<f64> {
    let mut all: Vec<f64> = pushes.iter().map(|p| p.diameter).collect();
    all.sort_by(f64::total_cmp);
    all.dedup_by(|a, b| (*a - *b).abs() < 1e-6);
    all
}

/// Mean depth and force of each stretch of depth, without the uppermost tenth of the depth.
fn stretches(push: &Penetration) -> Result<Vec<[f64; 2]>> {
    let deepest = push.points.iter().map(|p| p[0]).fold(0.0, f64::max);
    let from = TRANSIENT * deepest;
    let mut sums = [[0.0; 3]; STRETCHES];
    for [depth, force] in push.points.iter().filter(|p| p[0] >= from && p[1] > 0.0) {
        let k = (((depth - from) / (deepest - from) * STRETCHES as f64) as usize).min(STRETCHES - 1);
        sums[k] = [sums[k][0] + depth, sums[k][1] + force, sums[k][2] + 1.0];
    }
    let means: Vec<_> = sums.iter().filter(|s| s[2] > 0.0).map(|s| [s[0] / s[2], s[1] / s[2]]).collect();
    if deepest <= 0.0 || means.len() < LEAST_STRETCHES {
        let reason = format!(
            "push {}: fewer than {LEAST_STRETCHES} of {STRETCHES} stretches of depth have a force above 0",
            push.name
        );
        return Err(refused(reason));
    }
    Ok(means)
}

fn logs(pushes: &[Penetration], stretches: &[Vec<[f64; 2]>], compliance: f64) -> Result<Vec<Vec<Point>>> {
    let of = |(push, means): (&Penetration, &Vec<[f64; 2]>)| {
        let point = |&[depth, force]: &[f64; 2]| {
            let left = depth - compliance * force;
            if left <= 0.0 {
                return Err(refused(format!(
                    "push {}: a compliance of {compliance:e} m/N is more than all of its depth",
                    push.name
                )));
            }
            Ok([left.ln(), push.diameter.ln(), (force / push.area()).ln()])
        };
        means.iter().map(point).collect()
    };
    pushes.iter().zip(stretches).map(of).collect()
}

fn gathered(points: &[Vec<Point>], chosen: &[usize]) -> Vec<Point> {
    chosen.iter().flat_map(|k| points[*k].iter().copied()).collect()
}

/// Parameters: ln of the scale (for `Footing`: a, b), exponent of depth, exponent of size. Singular values below 1e-9
/// count as 0: our choice, above rounding.
fn fit(law: PressureLaw, points: &[Point]) -> Result<[f64; 3]> {
    let column = |p: &Point| match law {
        PressureLaw::Proportional => vec![1.0],
        PressureLaw::Power => vec![1.0, p[0]],
        PressureLaw::Size => vec![1.0, p[1]],
        PressureLaw::PowerAndSize => vec![1.0, p[0], p[1]],
        // Each equation is divided by its pressure, so that least squares minimises relative errors.
        PressureLaw::Footing => vec![(p[1] - p[2]).exp(), (p[0] - p[2]).exp()],
    };
    let target = |p: &Point| match law {
        PressureLaw::Proportional | PressureLaw::Size => p[2] - p[0],
        PressureLaw::Power | PressureLaw::PowerAndSize => p[2],
        PressureLaw::Footing => 1.0,
    };
    let rows: Vec<f64> = points.iter().flat_map(column).collect();
    let matrix = DMatrix::from_row_slice(points.len(), law.parameters(), &rows);
    let target = DVector::from_iterator(points.len(), points.iter().map(target));
    let svd = matrix.svd(true, true);
    let x = svd.solve(&target, 1e-9).map_err(refused)?;
    Ok(match law {
        PressureLaw::Proportional => [x[0], 1.0, 0.0],
        PressureLaw::Power => [x[0], x[1], 0.0],
        PressureLaw::Size => [x[0], 1.0, x[1]],
        PressureLaw::PowerAndSize => [x[0], x[1], x[2]],
        PressureLaw::Footing => [x[0], x[1], 0.0],
    })
}

/// ln(predicted/measured).
fn off(law: PressureLaw, x: &[f64; 3], p: &Point) -> f64 {
    let predicted = match law {
        // The bound makes the error very large if a footing predicts a pressure of 0 or less.
        PressureLaw::Footing => (x[0] * p[1].exp() + x[1] * p[0].exp()).max(1e-9).ln(),
        _ => x[0] + x[1] * p[0] + x[2] * p[1],
    };
    predicted - p[2]
}

fn squares(law: PressureLaw, x: &[f64; 3], points: &[Point]) -> f64 {
    points.iter().map(|p| off(law, x, p).powi(2)).sum()
}

fn percent(sum: f64, count: usize) -> f64 {
    100.0 * (sum / count as f64).sqrt()
}

fn score(law: PressureLaw, pushes: &[Penetration], points: &[Vec<Point>]) -> Result<LawScore> {
    let all: Vec<usize> = (0..pushes.len()).collect();
    let count = points.iter().map(Vec::len).sum();
    // Leaves out each group in turn: a law that is fitted to all other groups predicts it.
    let left_out = |groups: &[Vec<usize>]| -> Result<f64> {
        let mut sum = 0.0;
        for group in groups {
            let others: Vec<usize> = all.iter().copied().filter(|k| !group.contains(k)).collect();
            sum += squares(law, &fit(law, &gathered(points, &others))?, &gathered(points, group));
        }
        Ok(percent(sum, count))
    };
    let sizes = diameters(pushes);
    let of_size = |d: &f64| all.iter().copied().filter(|k| (pushes[*k].diameter - d).abs() < 1e-6).collect();
    let groups: Vec<Vec<usize>> = sizes.iter().map(of_size).collect();
    // A law with an exponent of size needs at least two sizes in its fit.
    let enough = sizes.len() > 1 + usize::from(law.knows_size());
    let gathered = gathered(points, &all);
    Ok(LawScore {
        law,
        formula: law.formula(),
        fitted_percent: percent(squares(law, &fit(law, &gathered)?, &gathered), count),
        other_push_percent: left_out(&all.iter().map(|k| vec![*k]).collect::<Vec<_>>())?,
        other_size_percent: if enough { Some(left_out(&groups)?) } else { None },
    })
}

/// The compliance [m/N] with which the law that has the most exponents fits best.
fn soft(pushes: &[Penetration], stretches: &[Vec<[f64; 2]>], chosen: &[usize], sized: bool) -> Result<f64> {
    let law = if sized { PressureLaw::PowerAndSize } else { PressureLaw::Power };
    let all = stretches.iter().flatten();
    let most = 0.8 * all.map(|[depth, force]| depth / force).fold(f64::INFINITY, f64::min);
    let mut best = (f64::INFINITY, 0.0);
    for k in 0..COMPLIANCES {
        let c = most * k as f64 / COMPLIANCES as f64;
        let points = gathered(&logs(pushes, stretches, c)?, chosen);
        let left = squares(law, &fit(law, &points)?, &points);
        if left < best.0 {
            best = (left, c);
        }
    }
    Ok(best.1)
}

/// The interval of a quantity that is never negative: a wide one, of few pushes, ends at 0.
fn positive([low, high]: [f64; 2]) -> [f64; 2] {
    [low.max(0.0), high]
}

/// A 95 % interval by the jackknife: `without` are the values with one push left out.
fn with_interval(value: f64, without: impl Iterator<Item = f64>) -> Value {
    let without: Vec<f64> = without.collect();
    let half = student::two_sided_95(without.len() as f64 - 1.0) * jackknife(&without);
    Value { value, interval: [value - half, value + half] }
}

fn by_size(pushes: &[Penetration]) -> Result<Vec<OfSize>> {
    let of = |diameter: f64| {
        let own = pushes.iter().filter(|p| (p.diameter - diameter).abs() < 1e-6);
        let zetas = own.map(|push| {
            let deepest = push.points.iter().map(|p| p[0]).fold(0.0, f64::max);
            let kept = push.points.iter().filter(|p| p[0] >= TRANSIENT * deepest);
            super::through_origin(kept) / push.area() * 1e-6
        });
        let zetas: Vec<f64> = zetas.collect();
        let n = zetas.len() as f64;
        let mean = zetas.iter().sum::<f64>() / n;
        if !(mean > 0.0 && mean.is_finite()) {
            return Err(refused(format!("discs of {:.1} mm: force does not grow with depth", 1e3 * diameter)));
        }
        let scatter = (zetas.iter().map(|z| (z - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
        let repeatability_percent = (zetas.len() > 1).then(|| 100.0 * scatter / mean);
        let half = student::two_sided_95(n - 1.0) * scatter / n.sqrt();
        let zeta_interval = (zetas.len() > 1).then_some(positive([mean - half, mean + half]));
        Ok(OfSize { diameter, pushes: zetas.len(), zeta: mean, zeta_interval, repeatability_percent })
    };
    diameters(pushes).into_iter().map(of).collect()
}

/// If pushes of one size scatter by more than this [%], a warning asks if the beds were prepared alike: our choice,
/// twice the scatter of beds that the diagnosis assumes for a robot's log (`bed_strength` in `diagnose/nuisance.rs`).
const MOST_SCATTER: f64 = 10.0;

/// Exponents of depth this close to 1 are not worth a warning: our choice; twice the depth then changes ζ by 3 %.
const STRAIGHT: f64 = 0.05;

fn cautions(study: &Pushes, pushes: &[Penetration]) -> Vec<String> {
    let mut cautions = Vec::new();
    let [low, high] = study.depth_exponent.interval;
    if (low > 1.0 || high < 1.0) && (study.depth_exponent.value - 1.0).abs() > STRAIGHT {
        let [depth, _] = study.greatest;
        cautions.push(format!(
            "force grows as depth to the power {:.2} [{low:.2}, {high:.2}], not in proportion: ζ holds near {:.0} mm only",
            study.depth_exponent.value,
            1e3 * depth / 2.0
        ));
    }
    match (&study.size_exponent, &study.sizes[..]) {
        (Some(Value { value, interval: [low, high] }), [first, .., last]) if *low > 0.0 || *high < 0.0 => {
            cautions.push(format!(
                "pressure grows as size to the power {value:.2} [{low:.2}, {high:.2}]: ζ of {:.0} mm is {:.2} times that of {:.0} mm, \
                 so it does not apply to feet of another size",
                1e3 * last.diameter,
                last.zeta / first.zeta,
                1e3 * first.diameter
            ));
        }
        (None, [only]) => cautions.push(format!(
            "one size only ({:.0} mm): whether ζ applies to other sizes is not known",
            1e3 * only.diameter
        )),
        _ => (),
    }
    for size in &study.sizes {
        if let Some(scatter) = size.repeatability_percent.filter(|s| *s > MOST_SCATTER) {
            cautions.push(format!(
                "pushes of {:.0} mm scatter by {scatter:.0} %: was the bed prepared alike?",
                1e3 * size.diameter
            ));
        }
    }
    // Below 0.5 m/s inertia adds less than a tenth to the force (docs/physics.md, limits of the law).
    let speeds = pushes.iter().filter_map(|p| p.speeds);
    let range = speeds.fold([f64::INFINITY, 0.0_f64], |[low, high], s| [low.min(s[0]), high.max(s[1])]);
    if range[1] > 0.5 {
        cautions.push(format!("pushed at up to {:.2} m/s: above 0.5 m/s inertia adds to ζ", range[1]));
    }
    cautions.push(format!(
        "nothing is known below {:.0} mm and above {:.0} N",
        1e3 * study.greatest[0],
        study.greatest[1]
    ));
    cautions
}

#[cfg(test)]
mod tests;
