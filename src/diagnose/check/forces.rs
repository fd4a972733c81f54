//! Compares measured forces with those that the stated medium predicts along the same motions: units and signs.
//!
//! A sand may be several times as strong as stated, but no sand pulls an intruder along, and none is a hundred times as strong.

use super::finding::{Finding, Severity::Refuse, Severity::Warn};
use super::logged::LoggedTrial;
use super::ratio::{nearest, products, proportion, proportion_of_changes};
use crate::observations::Observations;
use crate::series::{ends, root_mean_square};
use crate::table::Quantity;

/// No sand is this many times as strong, or as weak, as another: our choice. The stated media and those of Li, Zhang & Goldman
/// (2013) and Agarwal et al. (2021) differ by a factor of 20.
const NO_SAND: f64 = 50.0;
/// A force that differs by more than this factor from the prediction may be in another unit: our choice; batches of one sand differ
/// by a factor below two.
const DOUBTFUL: f64 = 4.0;
/// Least share of a channel in the predicted force for which its sign is compared: our choice.
const MAIN: f64 = 0.25;

/// Measured and predicted numbers of one channel.
struct ChannelPairs<'a> {
    name: &'a str,
    quantity: Quantity,
    /// (predicted, measured)
    pairs: Vec<(f64, f64)>,
}

impl ChannelPairs<'_> {
    fn predicted(&self) -> f64 {
        root_mean_square(self.pairs.iter().map(|p| p.0))
    }

    fn measured(&self) -> f64 {
        root_mean_square(self.pairs.iter().map(|p| p.1))
    }

    /// The ratio of measured to predicted, if values and changes agree on its sign: offsets do not change it.
    fn ratio(&self) -> Option<f64> {
        let (values, changes) = (proportion(self.pairs.iter().copied())?, proportion_of_changes(&self.pairs)?);
        (values * changes > 0.0).then_some(changes)
    }

    /// Ratio of the standard deviations: no offset and no wrong model changes its order of magnitude.
    fn swing(&self) -> f64 {
        let sd = |of: &dyn Fn(&(f64, f64)) -> f64| {
            let mean = self.pairs.iter().map(of).sum::<f64>() / self.pairs.len() as f64;
            root_mean_square(self.pairs.iter().map(|p| of(p) - mean))
        };
        sd(&|p| p.1) / sd(&|p| p.0).max(f64::MIN_POSITIVE)
    }

    /// Certainly another unit: the ratio of the sizes and of the changes is none that a sand has.
    fn other_unit(&self) -> Option<f64> {
        let size = self.measured() / self.predicted().max(f64::MIN_POSITIVE);
        let far = |ratio: f64| !(1.0 / NO_SAND..NO_SAND).contains(&ratio);
        let same_side = (size > 1.0) == (self.swing() > 1.0);
        (far(size) && far(self.swing()) && same_side && self.measured() > 0.0).then_some(size)
    }
}

pub fn check(trials: &[LoggedTrial], observations: &Observations, predicted: &[f64]) -> Vec<Finding> {
    let channels: Vec<ChannelPairs> =
        (0..observations.channels.len()).map(|c| pairs(observations, predicted, c)).collect();
    let force = channels[0].predicted().hypot(channels[1].predicted());
    let size = channels[0].measured().hypot(channels[1].measured());
    if size == 0.0 {
        return vec![Finding::new(Refuse, "Fx, Fz", "are 0 in all rows", "log the force on the intruder")];
    }
    if force == 0.0 {
        return vec![never_in_sand(trials)];
    }
    let mut found = units(&channels[..2]);
    if found.is_empty() {
        found.extend(signs(&channels[..2], force));
    }
    // A wrong force has a wrong torque, and both have one remedy.
    if found.is_empty() {
        found.extend(channels.get(2).and_then(|torque| torque_of(torque, size, trials)));
    }
    found.extend(without_contact(trials, observations, predicted, size));
    found
}

fn pairs<'a>(observations: &'a Observations, predicted: &[f64], channel: usize) -> ChannelPairs<'a> {
    let numbers = observations.units.iter().flat_map(|unit| unit.block(channel));
    ChannelPairs {
        name: &observations.channels[channel].name,
        quantity: if channel < 2 { Quantity::Force } else { Quantity::Torque },
        pairs: numbers.map(|k| (predicted[k], observations.values[k])).collect(),
    }
}

/// No pose of any trial is in the sand, though forces were measured.
fn never_in_sand(trials: &[LoggedTrial]) -> Finding {
    let (what, column) = ("no intruder of this file reaches the sand, which begins at z = 0", "hip_z, z");
    let heights = trials.iter().filter(|t| t.is_leg()).filter_map(|t| Some(t.hip_z? / t.size()));
    let [_, hip] = ends(heights);
    let remedy = match hip {
        hip if hip > 5.0 => "hip_z is many chords high: state its unit in [units], as in hip_z = \"mm\"",
        hip if hip > 1.0 => "hip_z is the height of the hip above the undisturbed surface, less than the chord",
        _ => "z points up from the undisturbed surface: z is negative in the sand",
    };
    Finding::new(Refuse, column, what, remedy)
}

/// What to state for a force that is `ratio` times the predicted one.
fn state(column: &str, quantity: Quantity, ratio: f64) -> String {
    match nearest(quantity, ratio) {
        Some((unit, _)) => format!("state the unit in [units], perhaps {column} = \"{unit}\""),
        None => "state the unit in [units]".into(),
    }
}

fn units(channels: &[ChannelPairs]) -> Vec<Finding> {
    let of = |c: &ChannelPairs| {
        let ratio = c.other_unit()?;
        let what = format!("is {ratio:.3e} times the force that the stated sand gives, which no sand has");
        Some(Finding::new(Refuse, c.name, what, state(c.name, c.quantity, ratio)))
    };
    let large = channels.iter().map(ChannelPairs::predicted).fold(0.0, f64::max);
    let main = |c: &&ChannelPairs| c.predicted() >= MAIN * large;
    let certain: Vec<Finding> = channels.iter().filter(main).filter_map(of).collect();
    if !certain.is_empty() {
        return certain;
    }
    let doubtful = |c: &ChannelPairs| {
        let ratio = c.ratio().filter(|r| *r > 0.0 && !(1.0 / DOUBTFUL..DOUBTFUL).contains(r))?;
        let what = format!("is {ratio:.3} times the force that the stated sand gives");
        let remedy = format!("see whether the sand is the stated one, or {}", state(c.name, c.quantity, ratio));
        Some(Finding::new(Warn, c.name, what, remedy))
    };
    channels.iter().filter(main).filter_map(doubtful).collect()
}

fn signs(channels: &[ChannelPairs], force: f64) -> Vec<Finding> {
    let against = |c: &&ChannelPairs| c.predicted() >= MAIN * force && c.ratio().is_some_and(|r| r < 0.0);
    let wrong: Vec<&str> = channels.iter().filter(against).map(|c| c.name).collect();
    let with = channels.iter().any(|c| c.ratio().is_some_and(|r| r > 0.0));
    match (&wrong[..], with) {
        ([], _) => Vec::new(),
        (names, false) => vec![Finding::new(
            Refuse,
            &names.join(", "),
            "pulls the intruder along, as no sand does: it is the force on the sand",
            "multiply Fx, Fz and Ty by -1: the forces on the intruder are needed",
        )],
        (names, true) => names
            .iter()
            .map(|name| {
                let what = "has the opposite sign of the sand's force, while the other component has the right one";
                Finding::new(Refuse, name, what, format!("multiply {name} by -1: x points forward, z up"))
            })
            .collect(),
    }
}

/// The lever of a torque is no longer than the intruder, and the torque on a leg resists its rotation.
fn torque_of(torque: &ChannelPairs, force: f64, trials: &[LoggedTrial]) -> Option<Finding> {
    let size = trials.iter().map(LoggedTrial::size).fold(0.0, f64::max);
    if torque.measured() == 0.0 {
        let what = "is 0 in all rows";
        return (torque.predicted() > 0.05 * size * force)
            .then(|| Finding::new(Warn, torque.name, what, "leave the column out if the torque was not measured"));
    }
    let lever = torque.measured() / force / size;
    let ratio = torque.measured() / torque.predicted().max(f64::MIN_POSITIVE);
    if lever > 10.0 && torque.swing() > 10.0 {
        let what = format!("is a force with a lever {lever:.0} times as long as the intruder");
        return Some(Finding::new(Refuse, torque.name, what, state(torque.name, torque.quantity, ratio)));
    }
    let legs = trials.iter().all(LoggedTrial::is_leg);
    torque.ratio().filter(|r| *r < 0.0 && legs).map(|_| {
        let what = "turns the leg on, as no sand does";
        Finding::new(Refuse, torque.name, what, "multiply Ty by -1: Ty = x·Fz − z·Fx about the hip")
    })
}

/// A trial whose force is large though its intruder never reaches the sand, as stated.
fn without_contact(
    trials: &[LoggedTrial],
    observations: &Observations,
    predicted: &[f64],
    force: f64,
) -> Option<Finding> {
    let rms = |unit: usize, of: &[f64]| {
        let own = &observations.units[unit];
        let [x, z] = [0, 1].map(|c| root_mean_square(own.block(c).map(|k| of[k])));
        x.hypot(z)
    };
    // Half of the usual force: our choice, far above offsets.
    let alone = |u: &usize| rms(*u, predicted) == 0.0 && rms(*u, &observations.values) > 0.5 * force;
    let unit = (0..observations.units.len()).find(alone)?;
    let trial = &trials[unit];
    let what = format!("trial {} never reaches the sand, but its forces are as large as usual", trial.id);
    Some(Finding::new(Warn, "hip_z, z", what, "see the height of this trial: its unit and its zero").at(trial.rows()))
}

/// Does a channel agree with its prediction well enough to compare times and single samples?
pub fn agrees(predicted: &[f64], measured: &[f64]) -> bool {
    let (aa, ab, bb) = products(predicted.iter().copied().zip(measured.iter().copied()));
    // 0.9: our choice; a delay, an outlier or an offset lowers a correlation near 1 by less.
    ab > 0.9 * (aa * bb).sqrt()
}
