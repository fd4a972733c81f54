//! `hardware.toml`: what is known of a robot's motors, sensors and delays, as a file. The diagnosis writes it, and all tasks read it.
//!
//! Each entry is a quantity with its value and its 95 % interval. The file's tables have the names of the tasks'
//! options: `actuator`, `sensors.gyroscope` and so on; `action_delay` is an entry without a table.

use crate::error::{Error, Result, check_toml};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

/// A value and its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HardwareQuantity {
    pub value: f64,
    pub interval: [f64; 2],
}

/// The description of a robot's hardware.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct HardwareDescription {
    pub source: String,
    /// By the path of the option, such as `sensors.gyroscope.delay`.
    pub quantities: BTreeMap<String, HardwareQuantity>,
}

/// Number of names in the longest path: `sensors.imu_rotation.x`.
const DEEPEST: usize = 3;

impl HardwareDescription {
    /// Reads the file's text. The names of quantities are not checked here.
    ///
    /// # Errors
    /// It is no TOML, an entry is no quantity, or a value is not within its interval.
    pub fn from_toml(text: &str) -> Result<Self> {
        check_toml("hardware", text)?;
        let table: toml::Table =
            toml::from_str(text).map_err(|e| Error::invalid("hardware", e.message().to_string()))?;
        let mut all = Self::default();
        for (key, value) in table {
            match value {
                toml::Value::String(text) if key == "source" => all.source = text,
                value => all.read(key, value, 1)?,
            }
        }
        Ok(all)
    }

    fn read(&mut self, path: String, value: toml::Value, depth: usize) -> Result<()> {
        let toml::Value::Table(table) = value else {
            let reason = format!("{path}: expected a table with value and interval");
            return Err(Error::invalid("hardware", reason));
        };
        if !table.contains_key("value") {
            if depth == DEEPEST {
                return Err(Error::invalid("hardware", format!("{path}: value is missing")));
            }
            return table.into_iter().try_for_each(|(key, value)| self.read(format!("{path}.{key}"), value, depth + 1));
        }
        let refused = |e: toml::de::Error| Error::invalid("hardware", format!("{path}: {}", e.message()));
        let quantity: HardwareQuantity = table.try_into().map_err(refused)?;
        let HardwareQuantity { value, interval: [low, high] } = quantity;
        if !(low <= value && value <= high && low.is_finite() && high.is_finite()) {
            let reason = format!("{path}: the value {value} is not within its interval [{low}, {high}]");
            return Err(Error::invalid("hardware", reason));
        }
        self.quantities.insert(path, quantity);
        Ok(())
    }

    pub fn load(path: &Path) -> Result<Self> {
        let text = sandgait_base::files::read_text(path)?;
        Self::from_toml(&text).map_err(|e| Error::file(path, e))
    }

    /// The file's text.
    pub fn to_toml(&self) -> String {
        let mut text = format!("source = {}\n", toml::Value::from(self.source.clone()));
        let split = |path: &str| path.rsplit_once('.').map(|(table, key)| (table.to_owned(), key.to_owned()));
        let mut present = None;
        // Quantities without a table come first.
        let without = self.quantities.iter().filter(|(path, _)| split(path).is_none());
        let within = self.quantities.iter().filter(|(path, _)| split(path).is_some());
        for (path, HardwareQuantity { value, interval: [low, high] }) in without.chain(within) {
            let key = match split(path) {
                Some((table, key)) => {
                    if present.as_ref() != Some(&table) {
                        let _ = write!(text, "\n[{table}]\n");
                        present = Some(table);
                    }
                    key
                }
                None => path.clone(),
            };
            let _ = writeln!(text, "{key} = {{ value = {value:?}, interval = [{low:?}, {high:?}] }}");
        }
        text
    }

    pub fn value(&self, path: &str) -> Option<f64> {
        self.quantities.get(path).map(|quantity| quantity.value)
    }

    /// These quantities, together with those of `other` that are missing here.
    pub fn or(&self, other: &Self) -> Self {
        let mut quantities = other.quantities.clone();
        quantities.extend(self.quantities.clone());
        Self { source: self.source.clone(), quantities }
    }

    /// Values drawn uniformly from the intervals, in the order of the paths: `uniform` draws from [0, 1).
    pub fn drawn(&self, mut uniform: impl FnMut() -> f64) -> Self {
        let mut drawn = self.clone();
        for HardwareQuantity { value, interval: [low, high] } in drawn.quantities.values_mut() {
            *value = *low + (*high - *low) * uniform();
        }
        drawn
    }
}
