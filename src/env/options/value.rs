//! The types that an option can have.

use super::OptionRow;
use super::robot::RobotName;
use crate::error::{Error, Result, check_range};
use crate::sand::Law;
use crate::sim::engine::EngineKind;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;
use std::collections::BTreeMap;
use std::ops::RangeInclusive;

/// The value of an option; its type determines the checks.
pub trait OptionValue {
    /// Refuses values that deserialisation accepts but the option does not.
    fn check(&self, _name: &str) -> Result<()> {
        Ok(())
    }

    /// For a dictionary: its keys.
    fn keys() -> Vec<OptionRow> {
        Vec::new()
    }
}

impl OptionValue for bool {}
impl OptionValue for u64 {}
impl OptionValue for f64 {}
impl OptionValue for [f64; 2] {}
impl OptionValue for String {}
impl OptionValue for Vec<Vec<f64>> {}
impl OptionValue for Law {}
impl OptionValue for RobotName {}
impl OptionValue for BTreeMap<String, f64> {}
impl OptionValue for u32 {}
impl OptionValue for usize {}

impl OptionValue for EngineKind {
    fn check(&self, _name: &str) -> Result<()> {
        match Self::ALL.contains(self) {
            true => Ok(()),
            false => Err(Error::unknown("engine", self.name(), &Self::ALL.map(Self::name))),
        }
    }
}

impl<T: OptionValue> OptionValue for Option<T> {
    fn check(&self, name: &str) -> Result<()> {
        self.as_ref().map_or(Ok(()), |value| value.check(name))
    }

    fn keys() -> Vec<OptionRow> {
        T::keys()
    }
}

/// A value that can have bounds.
pub trait Bounded {
    fn within(&self, name: &str, bounds: RangeInclusive<f64>) -> Result<()>;
}

impl Bounded for f64 {
    fn within(&self, name: &str, bounds: RangeInclusive<f64>) -> Result<()> {
        check_range(name, *self, bounds).map(drop)
    }
}

impl Bounded for u32 {
    fn within(&self, name: &str, bounds: RangeInclusive<f64>) -> Result<()> {
        f64::from(*self).within(name, bounds)
    }
}

impl Bounded for usize {
    fn within(&self, name: &str, bounds: RangeInclusive<f64>) -> Result<()> {
        (*self as f64).within(name, bounds)
    }
}

impl<T: Bounded> Bounded for Option<T> {
    fn within(&self, name: &str, bounds: RangeInclusive<f64>) -> Result<()> {
        self.as_ref().map_or(Ok(()), |value| value.within(name, bounds))
    }
}

/// A range [low, high] of a random draw.
impl Bounded for [f64; 2] {
    fn within(&self, name: &str, bounds: RangeInclusive<f64>) -> Result<()> {
        let [low, high] = *self;
        low.within(&format!("{name}[0]"), bounds.clone())?;
        high.within(&format!("{name}[1]"), low..=*bounds.end())
    }
}

/// Values by name, each within the bounds.
impl Bounded for BTreeMap<String, f64> {
    fn within(&self, name: &str, bounds: RangeInclusive<f64>) -> Result<()> {
        self.iter().try_for_each(|(key, value)| value.within(&format!("{name}[{key:?}]"), bounds.clone()))
    }
}

/// The value after `given` was set; in a dictionary, only the keys in `given` change.
pub fn changed<T: Serialize + DeserializeOwned>(name: &str, old: &T, given: &Value) -> Result<T> {
    let refused = |e: serde_json::Error| match given {
        Value::Null => Error::invalid(name, "null is not allowed"),
        _ => Error::invalid(name, e.to_string()),
    };
    let mut whole = serde_json::to_value(old).map_err(refused)?;
    match (&mut whole, given) {
        (Value::Object(keys), Value::Object(given)) => keys.extend(given.clone()),
        (whole, given) => whole.clone_from(given),
    }
    serde_json::from_value(whole).map_err(refused)
}
