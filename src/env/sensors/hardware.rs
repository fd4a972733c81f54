//! What `hardware.toml` says of a task's motors, sensors and delays. Its values hold for all options that the user leaves at their defaults.

use super::options::{Imperfections, LONGEST_DELAY, Motors};
use super::random::stream;
use super::{Hardware, Sensor, Sensors};
use crate::error::{Error, Result, check_range};
use crate::options::Options;
use crate::sim::hardware::{HardwareDescription, HardwareQuantity};
use rand::Rng as _;
use std::f64::consts::PI;

/// In place of a step's number, this selects the random numbers for hardware. It differs from the steps' numbers, which
/// the sensors' draws use, and from the number for the actions' delay.
const DRAW: u64 = u64::MAX - 1;
/// Path of the delay of actions.
const ACTION_DELAY: &str = "action_delay";
/// Paths of the rotation of the inertial measurement unit.
const ROTATION: [&str; 3] = ["sensors.imu_rotation.x", "sensors.imu_rotation.y", "sensors.imu_rotation.z"];

/// The hardware of a session: values, and intervals that each episode draws from.
#[derive(Clone, Debug, Default)]
pub struct HardwareFiles {
    values: HardwareDescription,
    random: Option<HardwareDescription>,
}

impl HardwareFiles {
    /// Reads the files of options `hardware` and `domain_rand`.
    pub fn new(options: &Hardware) -> Result<Self> {
        let read = |name: &str, text: &str| {
            let renamed = |e: Error| match e {
                Error::Invalid { field, reason } if field == "hardware" => Error::invalid(name, reason),
                Error::Invalid { field, reason } => Error::invalid(name, format!("{field}: {reason}")),
                other => Error::invalid(name, other.to_string()),
            };
            let file = HardwareDescription::from_toml(text).and_then(|file| check(&file).map(|()| file));
            file.map_err(renamed)
        };
        let drawn = &options.domain_rand.hardware;
        Ok(Self {
            values: if options.hardware.is_empty() {
                HardwareDescription::default()
            } else {
                read("hardware", &options.hardware)?
            },
            random: if drawn.is_empty() { None } else { Some(read("domain_rand.hardware", drawn)?) },
        })
    }

    /// Memory of what was read from the files [bytes].
    pub fn memory_bytes(&self) -> usize {
        let entry = |path: &String| 2 * size_of::<HardwareQuantity>() + 2 * size_of::<String>() + path.len();
        let file = |file: &HardwareDescription| file.source.len() + file.quantities.keys().map(entry).sum::<usize>();
        file(&self.values) + self.random.as_ref().map_or(0, file)
    }

    pub fn is_random(&self) -> bool {
        self.random.is_some()
    }

    /// The values that all episodes share. For a drawn quantity, this is the value in the file from whose interval
    /// episodes draw.
    pub fn values(&self) -> HardwareDescription {
        self.random.as_ref().map_or_else(|| self.values.clone(), |random| random.or(&self.values))
    }

    /// The values of an episode.
    pub fn of_episode(&self, seed: u64, number: u64) -> HardwareDescription {
        let Some(random) = &self.random else { return self.values.clone() };
        let mut stream = stream(seed, number, DRAW);
        random.drawn(|| stream.random::<f64>()).or(&self.values)
    }

    /// Range of the delay of actions [s]; `own`: the range in the options.
    pub fn action_delay(&self, own: [f64; 2]) -> [f64; 2] {
        let of = |file: &HardwareDescription| file.quantities.get(ACTION_DELAY).copied();
        match (own, self.random.as_ref().and_then(of), of(&self.values)) {
            ([0.0, 0.0], Some(HardwareQuantity { interval, .. }), _) => interval,
            ([0.0, 0.0], None, Some(HardwareQuantity { value, .. })) => [value; 2],
            _ => own,
        }
    }

    /// Longest delay that `sensor` can have in an episode [s].
    pub fn longest(&self, sensor: Sensor, own: Imperfections) -> f64 {
        let path = format!("sensors.{}.delay", sensor.name());
        let drawn = self.random.as_ref().and_then(|file| file.quantities.get(&path)).map(|q| q.interval[1]);
        drawn.filter(|_| own.delay == 0.0).unwrap_or(imperfections(own, sensor, &self.values).delay)
    }
}

/// Refuses unknown quantities, and values that the options would not take.
fn check(file: &HardwareDescription) -> Result<()> {
    for (path, HardwareQuantity { value, interval }) in &file.quantities {
        for number in [*value, interval[0], interval[1]] {
            let alone = HardwareDescription {
                quantities: [(path.clone(), HardwareQuantity { value: number, interval: [number; 2] })].into(),
                ..HardwareDescription::default()
            };
            if path == ACTION_DELAY {
                check_range(path, number, 0.0..=LONGEST_DELAY)?;
            } else if ROTATION.contains(&path.as_str()) {
                check_range(path, number, -PI..=PI)?;
            } else if path.strip_prefix("actuator.").is_some_and(|key| Motors::default().get(key).is_some()) {
                motors(Motors::default(), &alone).check_all("actuator.")?;
            } else {
                let rest = path.strip_prefix("sensors.").and_then(|rest| rest.split_once('.'));
                let known = |(name, key): (&str, &str)| {
                    let sensor = Sensor::ALL.into_iter().find(|s| s.name() == name)?;
                    Imperfections::default().get(key).map(|_| sensor)
                };
                let Some(sensor) = rest.and_then(known) else {
                    let all = ["actuator.…", "sensors.<sensor>.…", "sensors.imu_rotation.x", ACTION_DELAY];
                    return Err(Error::unknown("quantity", path, &all));
                };
                imperfections(Imperfections::default(), sensor, &alone)
                    .check_all(&format!("sensors.{}.", sensor.name()))?;
            }
        }
    }
    Ok(())
}

/// `own`, in which the file's values replace all options that have their default.
fn filled<O: Options>(own: &O, table: &str, file: &HardwareDescription) -> O {
    let (mut all, default) = (own.clone(), O::default());
    for row in O::rows() {
        if let Some(value) = file.value(&format!("{table}.{}", row.name))
            && own.get(row.name) == default.get(row.name)
        {
            // The value was checked when the file was read.
            let _ = all.set(row.name, &value.into());
        }
    }
    all
}

pub fn motors(own: Motors, file: &HardwareDescription) -> Motors {
    filled(&own, "actuator", file)
}

pub fn imperfections(own: Imperfections, sensor: Sensor, file: &HardwareDescription) -> Imperfections {
    filled(&own, &format!("sensors.{}", sensor.name()), file)
}

/// Does the file have any quantity of this sensor?
pub fn names(file: &HardwareDescription, sensor: Sensor) -> bool {
    let table = format!("sensors.{}.", sensor.name());
    file.quantities.keys().any(|path| path.starts_with(&table))
}

/// Rotation vector of the inertial measurement unit [rad].
pub fn imu_rotation(own: &Sensors, file: &HardwareDescription) -> [f64; 3] {
    if own.imu_rotation != [0.0; 3] {
        return own.imu_rotation;
    }
    ROTATION.map(|path| file.value(path).unwrap_or(0.0))
}
