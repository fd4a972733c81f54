//! Compares the logged motion with itself: speeds with the change of positions, angles with the ranges that angles have.

use super::finding::{Finding, Severity::Refuse, Severity::Warn, joined};
use super::logged::LoggedTrial;
use super::ratio::{NEAR, nearest, proportion};
use crate::series::{central_difference, ends};
use crate::table::Quantity;
use std::f64::consts::{PI, TAU};

/// Fewest samples of a trial from which a ratio is taken: our choice.
const FEWEST: usize = 5;
/// A ratio within this factor of 1 is no contradiction: our choice, because differences of few samples err by some ten percent.
const SAME: f64 = 1.5;

pub fn check(trials: &[LoggedTrial]) -> Vec<Finding> {
    let each = |f: &dyn Fn(&LoggedTrial) -> Option<Finding>| joined(trials.iter().map(f).collect());
    let mut found = each(&turning);
    found.extend((0..2).flat_map(|k| each(&|trial| moving(trial, k))));
    found.extend(each(&|trial| angle_of_plate("plate_beta", trial, trial.beta)));
    found.extend(each(&|trial| angle_of_plate("plate_gamma", trial, largest(&trial.gamma))));
    found.extend(each(&direction));
    found.extend(each(&interval));
    found
}

/// Ratio of the logged speeds to the change of the logged places.
fn speed_ratio(t: &[f64], place: &[f64], speed: &[f64]) -> Option<f64> {
    if t.len() < FEWEST {
        return None;
    }
    let [low, high] = ends(place.iter().copied());
    // A sample at which an angle is wrapped is left out.
    let steady = |i: &usize| (place[i + 1] - place[i - 1]).abs() <= 0.5 * (high - low).max(f64::MIN_POSITIVE);
    let inner = (1..t.len() - 1).filter(|i| t.len() < 2 * FEWEST || steady(i));
    proportion(inner.map(|i| (central_difference(t, place, i, 1), speed[i])))
}

/// What explains that the speed is `ratio` times the change of the place: a unit of one of the three columns.
fn explained(ratio: f64, speed: (&str, Quantity), place: (&str, Quantity)) -> Option<String> {
    let state = |column: &str, unit: &str| format!("[units] {column} = \"{unit}\"");
    let size = ratio.abs();
    let of_speed = nearest(speed.1, size).map(|(u, off)| (state(speed.0, u), off));
    let of_place = nearest(place.1, 1.0 / size).map(|(u, off)| (state(place.0, u), off));
    let of_time = nearest(Quantity::Time, size).map(|(u, off)| (state("t", u), off));
    let best = [of_speed, of_place, of_time].into_iter().flatten().filter(|(_, off)| *off < f64::ln(1.0 + NEAR));
    let mut best: Vec<_> = best.collect();
    best.sort_by(|a, b| a.1.total_cmp(&b.1));
    let least = best.first()?.1;
    // Units that explain the ratio equally well are all named.
    let said: Vec<_> = best.into_iter().filter(|b| b.1 < least + 0.01).map(|b| b.0).collect();
    Some(format!("state {}", said.join(" or ")))
}

fn contradiction(ratio: f64, speed: (&str, Quantity), place: (&str, Quantity), trial: &LoggedTrial) -> Option<Finding> {
    let (speed_name, place_name) = (speed.0, place.0);
    let of = format!("the change of {place_name} over t in trial {}", trial.id);
    let wrong = format!("one of {speed_name}, {place_name} and t has the wrong sign or order");
    if (1.0 / SAME..SAME).contains(&-ratio) {
        return Some(
            Finding::new(Refuse, speed_name, format!("has the opposite sign of {of}"), wrong).at(trial.rows()),
        );
    }
    if (1.0 / SAME..SAME).contains(&ratio) {
        return None;
    }
    let what = format!("is {ratio:.3} times {of}");
    Some(
        match explained(ratio, speed, place) {
            Some(remedy) if ratio > 0.0 => Finding::new(Refuse, speed_name, what, remedy),
            Some(remedy) => Finding::new(Refuse, speed_name, what, format!("{remedy}; and {wrong}")),
            None => {
                Finding::new(Warn, speed_name, what, format!("see which of {speed_name}, {place_name} and t is right"))
            }
        }
        .at(trial.rows()),
    )
}

/// Compares a leg's angular speed with the change of its angle.
fn turning(trial: &LoggedTrial) -> Option<Finding> {
    let ratio = speed_ratio(&trial.t, &trial.theta, &trial.omega).filter(|_| trial.is_leg())?;
    let (speed, place) = (("omega", Quantity::AngularSpeed), ("theta", Quantity::Angle));
    contradiction(ratio, speed, place, trial)
}

/// Compares a component of the velocity with the change of the position.
fn moving(trial: &LoggedTrial, k: usize) -> Option<Finding> {
    // The smaller component of a straight motion may be noise only.
    let way = |k: usize| ends(trial.place[k].iter().copied());
    let [own, other] = [way(k), way(1 - k)].map(|[low, high]| high - low);
    let ratio = speed_ratio(&trial.t, &trial.place[k], &trial.velocity[k])?;
    let (speed, place) = ((["vx", "vz"][k], Quantity::Speed), (["x", "z"][k], Quantity::Length));
    contradiction(ratio, speed, place, trial).filter(|_| own >= 0.1 * other || other.is_nan())
}

/// Angles of a plate are between −π and π, so larger ones are in degrees.
fn angle_of_plate(column: &str, trial: &LoggedTrial, angle: Option<f64>) -> Option<Finding> {
    let angle = angle.filter(|a| a.abs() > TAU && !trial.is_leg())?;
    let what = format!("{angle} is more than a turn, as an angle in radians");
    Some(Finding::new(Refuse, column, what, format!("state [units] {column} = \"deg\"")).at(trial.rows()))
}

/// The largest of all numbers, whatever their signs; None if there is none.
fn largest(values: &[f64]) -> Option<f64> {
    values.iter().copied().filter(|v| !v.is_nan()).max_by(|a, b| a.abs().total_cmp(&b.abs()))
}

/// Compares the stated intrusion angles with the directions of the velocity, (cos γ, −sin γ) or its mirror image. Rows count by their
/// speed, because slow ones have no sure direction.
fn direction(trial: &LoggedTrial) -> Option<Finding> {
    if trial.is_leg() {
        return None;
    }
    let rows = trial.gamma.iter().zip(trial.velocity[0].iter().zip(&trial.velocity[1]));
    let rows = rows.filter(|(gamma, (vx, vz))| gamma.abs() <= TAU && vx.is_finite() && vz.is_finite());
    // Angles of the same slope, whatever the quadrant.
    let [own, stated] = rows.fold([[0.0; 2]; 2], |[own, stated], (gamma, (vx, vz))| {
        let speed = vx.hypot(*vz);
        let of = |sum: [f64; 2], x: f64, z: f64| [sum[0] + x.abs(), sum[1] + z.abs()];
        [of(own, *vx, *vz), of(stated, speed * gamma.cos(), speed * gamma.sin())]
    });
    let [own, stated] = [own, stated].map(|[x, z]| z.atan2(x));
    // 0.3 rad: our choice, far above the errors of a drive.
    let off = (own - stated).abs();
    (off > 0.3 && off <= PI).then(|| {
        let what = format!(
            "{:.0}°, but trial {} moves at {:.0}° to the surface",
            stated.to_degrees(),
            trial.id,
            own.to_degrees()
        );
        Finding::new(Warn, "plate_gamma", what, "the velocity counts, and not plate_gamma").at(trial.rows())
    })
}

/// Longest time between two samples as a multiple of the usual one: our choice, as for robots' logs.
const LONGEST_GAP: f64 = 10.0;

/// Looks for gaps in the clock.
fn interval(trial: &LoggedTrial) -> Option<Finding> {
    let mut steps: Vec<f64> = trial.t.windows(2).map(|w| w[1] - w[0]).collect();
    let gap = steps.iter().position(|s| *s == steps.iter().copied().fold(0.0, f64::max))?;
    let longest = steps[gap];
    steps.sort_by(f64::total_cmp);
    let usual = steps[steps.len() / 2];
    (steps.len() >= FEWEST && longest > LONGEST_GAP * usual).then(|| {
        let what = format!("{longest:.3} s without a sample, {:.0} times as long as usual", longest / usual);
        let remedy = "see whether the logger lost samples, or whether t changes its unit";
        Finding::new(Warn, "t", what, remedy).at([trial.lines[gap], trial.lines[gap + 1]])
    })
}
