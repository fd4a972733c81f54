//! Compares the positions x and z of a leg with its hip and its angle: each point of the leg moves on a circle.

use super::finding::{Finding, Severity::Refuse, Severity::Warn, joined};
use super::logged::LoggedTrial;
use crate::experiment::Intruder;
use crate::series::ends;
use crate::table::Quantity;
use nalgebra::{Matrix3, Vector3};
use std::f64::consts::PI;

/// Fewest samples, and least range of the angle [rad], of a trial that is compared: our choices; a circle is not determined by less.
const FEWEST: usize = 6;
const RANGE: f64 = 1.0;
/// Largest misfit of a circle, as a share of its radius: our choice, above the noise of positions.
const ROUND: f64 = 0.05;

/// A circle that a coordinate follows: place = along · s + across · c + center, with s and c of the angle.
struct Circle {
    along: f64,
    across: f64,
    center: f64,
    /// Root mean square of the misfit.
    off: f64,
}

impl Circle {
    fn radius(&self) -> f64 {
        self.along.hypot(self.across)
    }

    fn is_round(&self) -> bool {
        self.off < ROUND * self.radius()
    }
}

/// Fits `place` by `basis` and a constant.
fn circle(basis: impl Fn(usize) -> [f64; 2], place: &[f64]) -> Option<Circle> {
    let row = |i: usize| Vector3::new(basis(i)[0], basis(i)[1], 1.0);
    let (mut square, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for (i, p) in place.iter().enumerate() {
        square += row(i) * row(i).transpose();
        right += row(i) * *p;
    }
    let fit = square.cholesky()?.solve(&right);
    let misfit = place.iter().enumerate().map(|(i, p)| (p - row(i).dot(&fit)).powi(2)).sum::<f64>();
    let off = (misfit / place.len() as f64).sqrt();
    off.is_finite().then_some(Circle { along: fit[0], across: fit[1], center: fit[2], off })
}

/// The circles of x = x₀ + a sin θ + b cos θ and z = z₀ − a cos θ + b sin θ, with angles multiplied by `unit`.
fn circles(trial: &LoggedTrial, unit: f64) -> Option<[Circle; 2]> {
    let turn = |i: usize| (unit * trial.theta[i]).sin_cos();
    let x = circle(|i| [turn(i).0, turn(i).1], &trial.place[0])?;
    let z = circle(|i| [-turn(i).1, turn(i).0], &trial.place[1])?;
    Some([x, z])
}

pub fn check(trials: &[LoggedTrial]) -> Vec<Finding> {
    joined(trials.iter().map(|trial| contradiction(trial).map(|f| f.at(trial.rows()))).collect())
}

fn contradiction(trial: &LoggedTrial) -> Option<Finding> {
    let Some(Intruder::Leg { chord, .. }) = trial.intruder else { return None };
    let [low, high] = ends(trial.theta.iter().copied());
    if trial.t.len() < FEWEST || high - low < RANGE {
        return None;
    }
    let [x, z] = circles(trial, 1.0)?;
    if !(x.is_round() && z.is_round()) {
        let degrees = circles(trial, PI / 180.0).filter(|c| c.iter().all(Circle::is_round));
        let what = format!("{low:.1} to {high:.1}, but x and z turn by {:.1} rad", (high - low).to_radians());
        return degrees.map(|_| Finding::new(Refuse, "theta", what, "state [units] theta = \"deg\""));
    }
    let sizes = [too_large("x", &x, chord), too_large("z", &z, chord)];
    let size = match sizes {
        [Some(mut x), Some(z)] if x.severity == z.severity => {
            x.place.column = Some("x, z".into());
            x.remedy = format!("{}; {}", x.remedy, z.remedy);
            Some(x)
        }
        [x, z] => x.or(z),
    };
    size.or_else(|| inverted(trial, &x, &z)).or_else(|| hip(trial, &z, chord))
}

/// Looks for a unit in which the radius is that of a point of the leg. Its centroid is at half the chord or more, its tip at the
/// whole; 0.3 and 1.3 leave room for other points, our choice.
fn too_large(column: &str, circle: &Circle, chord: f64) -> Option<Finding> {
    let radius = circle.radius();
    if radius < 3.0 * chord {
        return None;
    }
    let fits = |u: &&(&'static str, f64)| (0.3..1.3).contains(&(radius * u.1 / chord));
    let what = format!("moves on a circle of radius {radius:.3} m about the hip, but the leg's chord is {chord} m");
    Some(match Quantity::Length.units().iter().find(fits) {
        Some((unit, _)) => Finding::new(Refuse, column, what, format!("state [units] {column} = \"{unit}\"")),
        None => Finding::new(Warn, column, what, format!("see whether {column} and the chord have the same unit")),
    })
}

/// Looks for an axis that counts the other way.
fn inverted(trial: &LoggedTrial, x: &Circle, z: &Circle) -> Option<Finding> {
    let alike = (x.along * z.along + x.across * z.across) / (x.radius() * z.radius());
    if alike > 0.7 {
        let zero = z.across.atan2(z.along);
        // 0.7 rad: our choice; the centroid of a bent leg is some 0.4 rad from its chord.
        return (zero.abs() > 0.7).then(|| {
            let what = format!("x and z are {:.0}° from straight down where theta is 0", zero.to_degrees());
            Finding::new(Warn, "theta", what, "at theta = 0 the tip must point straight down")
        });
    }
    if alike > -0.7 {
        let what = format!("x and z do not turn with theta about the hip in trial {}", trial.id);
        return Some(Finding::new(
            Warn,
            "theta",
            what,
            "at theta = 0 the tip must point straight down, theta > 0 toward +x",
        ));
    }
    Some(match z.along < 0.0 {
        true => Finding::new(
            Refuse,
            "z",
            "z falls where theta says that the tip rises: it counts down",
            "multiply z, vz and Fz by -1: z points up",
        ),
        false => Finding::new(
            Refuse,
            "x",
            "x falls where theta says that the tip moves to +x",
            "multiply x, vx and Fx, or theta and omega, by -1",
        ),
    })
}

/// Compares the height of the hip with the centre of the circle.
fn hip(trial: &LoggedTrial, z: &Circle, chord: f64) -> Option<Finding> {
    let stated = trial.hip_z?;
    let off = |height: f64| (height - z.center).abs();
    if off(stated) < 0.1 * chord {
        return None;
    }
    let what = format!("{stated} m, but z turns about a height of {:.4} m", z.center);
    let unit = Quantity::Length.units().iter().find(|u| u.1 != 1.0 && off(stated * u.1) < 0.1 * chord);
    // Without a known factor either number may be right, and only hip_z counts.
    Some(match unit.filter(|_| stated.abs() > 2.0 * chord) {
        Some((unit, _)) => Finding::new(Refuse, "hip_z", what, format!("state [units] hip_z = \"{unit}\"")),
        None => Finding::new(Warn, "hip_z", what, "hip_z counts; see which of the two is right"),
    })
}
