//! Measured numbers in one stack, independent of how they were measured: the input of the statistics; and what the readers of logs
//! share.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::ops::Range;

/// A measured quantity.
#[derive(Clone, Debug, PartialEq)]
pub struct Channel {
    pub name: Cow<'static, str>,
    pub unit: &'static str,
    /// Does the channel count in the held-out error? All channels that count have the same unit, so for example the torque of a
    /// force log does not.
    pub in_rmse: bool,
}

impl Channel {
    pub const fn new(name: &'static str, unit: &'static str, in_rmse: bool) -> Self {
        Self { name: Cow::Borrowed(name), unit, in_rmse }
    }
}

/// One trial or run: the unit of cross-validation and of repetition.
#[derive(Clone, Debug, PartialEq)]
pub struct Unit {
    pub id: String,
    pub condition: usize,
    /// Start of its block of `samples × channels` numbers in the stack; channel by channel.
    pub start: usize,
    pub samples: usize,
    /// Coordinate that increases along the trial and has the same meaning in all repetitions (angle travelled [rad],
    /// path [m]).
    pub progress: Vec<f64>,
}

impl Unit {
    /// This unit's numbers of channel `channel` in the stack.
    pub fn block(&self, channel: usize) -> Range<usize> {
        let from = self.start + channel * self.samples;
        from..from + self.samples
    }
}

/// The size S to which the noise of grains is proportional.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Size {
    /// The magnitude of the force whose components are the first two channels.
    Force,
    /// The value of each channel itself.
    Channel,
}

/// All measured data.
#[derive(Clone, Debug)]
pub struct Observations {
    pub size: Size,
    pub values: Vec<f64>,
    pub channels: Vec<Channel>,
    pub units: Vec<Unit>,
    /// Names of the conditions. Repetitions of a condition differ only by chance.
    pub conditions: Vec<String>,
}

impl Observations {
    /// Observations of units that all have the same `progress`; each row has a unit's id and condition.
    pub fn of_rows(
        size: Size,
        channels: Vec<Channel>,
        progress: &[f64],
        rows: impl Iterator<Item = (String, usize)>,
        values: Vec<f64>,
        conditions: Vec<String>,
    ) -> Self {
        let unit = |(row, (id, condition)): (usize, (String, usize))| Unit {
            id,
            condition,
            start: row * channels.len() * progress.len(),
            samples: progress.len(),
            progress: progress.to_vec(),
        };
        Self { size, values, units: rows.enumerate().map(unit).collect(), channels, conditions }
    }

    /// All numbers of a unit in a stack.
    pub fn span(&self, unit: &Unit) -> Range<usize> {
        unit.start..unit.start + unit.samples * self.channels.len()
    }

    /// A stack of f(unit, channel, sample).
    pub fn stack(&self, f: impl Fn(usize, usize, usize) -> f64) -> Vec<f64> {
        let channels = self.channels.len();
        let of = |u: usize| (0..channels).flat_map(move |c| (0..self.units[u].samples).map(move |i| (u, c, i)));
        (0..self.units.len()).flat_map(of).map(|(u, c, i)| f(u, c, i)).collect()
    }

    /// Units of each condition, in order.
    pub fn repetitions(&self) -> Vec<Vec<usize>> {
        let mut groups = vec![Vec::new(); self.conditions.len()];
        for (index, unit) in self.units.iter().enumerate() {
            groups[unit.condition].push(index);
        }
        groups
    }

    /// Is the channel 0 in all samples? Then it was not measured.
    pub fn is_empty(&self, channel: usize) -> bool {
        self.units.iter().flat_map(|u| u.block(channel)).all(|k| self.values[k] == 0.0)
    }

    /// Places in a stack of the numbers of some units that count in the error.
    pub fn counted<'a>(&'a self, units: impl Iterator<Item = &'a Unit>) -> impl Iterator<Item = usize> {
        let channels = self.channels.iter().enumerate().filter(|c| c.1.in_rmse).map(|c| c.0);
        units.flat_map(move |unit| channels.clone().flat_map(|c| unit.block(c)))
    }

    /// Unit of the channels that count in the error.
    pub fn error_unit(&self) -> &'static str {
        self.channels.iter().find(|c| c.in_rmse).map_or("", |c| c.unit)
    }
}

/// A log, read and checked: what was measured, and in which setting.
pub struct MeasuredLog<S> {
    pub observations: Observations,
    /// Motions or setups. Trials with the same motion share a setting, as do runs with the same setup.
    pub settings: Vec<S>,
    /// Index in `settings` for each unit.
    pub setting_of: Vec<usize>,
    /// Optional columns that are absent or blank throughout.
    pub missing: Vec<&'static str>,
    /// Notes for the report on how the numbers were prepared.
    pub notes: Vec<String>,
    /// Checksum of the data file.
    pub sha256: String,
}

/// Assigns numbers to names in order of appearance.
#[derive(Default)]
pub struct Names {
    places: BTreeMap<String, usize>,
    pub list: Vec<String>,
}

impl Names {
    pub fn place(&mut self, name: &str) -> usize {
        let next = self.list.len();
        *self.places.entry(name.into()).or_insert_with(|| {
            self.list.push(name.into());
            next
        })
    }
}

/// Defines `COLUMNS`, and a constant with the index of each column. The calling file must have `HeaderColumn` and
/// `Quantity` in scope.
macro_rules! columns {
    ($($place:ident = $name:literal $quantity:ident $required:literal;)*) => {
        #[allow(non_camel_case_types, clippy::upper_case_acronyms)]
        enum Index { $($place),* }
        const COLUMNS: &[HeaderColumn] =
            &[$(HeaderColumn { name: $name, quantity: Quantity::$quantity, required: $required }),*];
        $(const $place: usize = Index::$place as usize;)*
    };
}
pub(crate) use columns;
