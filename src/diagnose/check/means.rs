//! Compares the means of walking runs, and of bodies in steady motion, with those that the stated medium predicts.

use super::finding::{Finding, Severity::Refuse, Severity::Warn};
use super::ratio::{nearest, proportion};
use crate::observations::Observations;
use crate::series::root_mean_square;
use crate::table::Quantity;

/// No sand, robot or gait differs from the prediction by this factor: our choice, as for force logs.
const NEVER: f64 = 50.0;

/// Deviations from a mean. A steady gait may have almost none, and motors, not sand, then decide how large they are. So
/// no factor on them is certain to be a unit.
const DEVIATIONS: [&str; 2] = ["pitch_rms", "hip_speed_error_rms"];

/// Units and signs of all channels.
pub fn check(observations: &Observations, predicted: &[f64]) -> Vec<Finding> {
    (0..observations.channels.len()).filter_map(|c| channel(observations, predicted, c)).collect()
}

fn channel(observations: &Observations, predicted: &[f64], channel: usize) -> Option<Finding> {
    let all = observations.units.iter().flat_map(|unit| unit.block(channel));
    let pairs: Vec<(f64, f64)> = all.map(|k| (predicted[k], observations.values[k])).collect();
    let pairs: Vec<(f64, f64)> = pairs.into_iter().filter(|p| p.0.is_finite()).collect();
    let (name, unit): (&str, &str) = (&observations.channels[channel].name, observations.channels[channel].unit);
    let size = |c: usize| {
        let all = observations.units.iter().flat_map(|unit| unit.block(c)).map(|k| predicted[k]);
        root_mean_square(all.filter(|p| p.is_finite()))
    };
    let alike = (0..observations.channels.len()).filter(|c| observations.channels[*c].unit == unit);
    let most = alike.map(size).fold(0.0, f64::max);
    let [said, own] = [0, 1].map(|k| root_mean_square(pairs.iter().map(|p| [p.0, p.1][k])));
    if name == "depth" && own > 0.0 && pairs.iter().all(|p| p.1 <= 0.0) {
        return Some(Finding::new(Refuse, name, "is negative in all rows", "depth is positive below the surface"));
    }
    let ratio = own / said.max(f64::MIN_POSITIVE);
    // A force that is 0 by symmetry, such as that across the way of a ball, has no ratio and no sign.
    if DEVIATIONS.contains(&name) || NEVER * said < most {
        return None;
    }
    if own > 0.0 && said > 0.0 && !(1.0 / NEVER..NEVER).contains(&ratio) {
        let what = format!("is {ratio:.3e} times the value in a simulation, which no sand explains");
        let remedy =
            nearest(quantity(unit), ratio).map_or(String::new(), |(u, _)| format!(", perhaps {name} = \"{u}\""));
        return Some(Finding::new(Refuse, name, what, format!("state the unit in [units]{remedy}")));
    }
    proportion(pairs.into_iter()).filter(|r| *r < 0.0).map(|_| {
        let what = "has the opposite sign of the value in a simulation";
        Finding::new(Warn, name, what, "see the directions of the axes: x points forward")
    })
}

/// The quantity that has this SI unit.
fn quantity(unit: &str) -> Quantity {
    let known =
        [Quantity::Length, Quantity::Speed, Quantity::Angle, Quantity::AngularSpeed, Quantity::Force, Quantity::Torque];
    known.into_iter().find(|q| q.factor(unit) == Some(1.0)).unwrap_or(Quantity::Number)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observations::{Channel, Size};

    /// The force across a ball's way is 0 but for rounding, so a measured one says nothing about its unit; a force along it does.
    #[test]
    fn a_force_that_is_0_by_symmetry_has_no_ratio() {
        let channels = ["Fx", "Fy"].map(|name| Channel::new(name, "N", true)).to_vec();
        let rows = ["a", "b"].into_iter().map(|id| (id.to_owned(), 0));
        let log = |values: [f64; 4]| {
            let conditions = vec!["drag".into()];
            Observations::of_rows(Size::Channel, channels.clone(), &[0.0], rows.clone(), values.to_vec(), conditions)
        };
        let predicted = [-0.05, 1e-19, -0.06, -1e-19];
        assert_eq!(check(&log([-0.048, -2e-4, -0.062, 6e-4]), &predicted), vec![]);
        assert_eq!(check(&log([-48.0, -2e-4, -62.0, 6e-4]), &predicted)[0].what.split(' ').next(), Some("is"));
    }
}
