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
impl OptionValue for [f64; 3] {}
impl OptionValue for Vec<Vec<f64>> {}
impl OptionValue for Vec<String> {}
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

/// serde's message without names of Rust's types.
fn in_words(message: &str) -> String {
    let Some((given, expected)) = message.rsplit_once("expected ") else { return message.to_owned() };
    let known = [
        ("a boolean", "true or false"),
        ("a string", "a text"),
        ("a map", "a dictionary"),
        ("a sequence", "a list"),
        ("f64", "a number"),
        ("u32", "a whole number from 0"),
        ("u64", "a whole number from 0"),
        ("usize", "a whole number from 0"),
    ];
    let expected = match known.iter().find(|(name, _)| *name == expected) {
        Some((_, words)) => *words,
        None if expected.starts_with("struct ") => "a dictionary",
        None => expected,
    };
    let given = [("string", "text"), ("floating point", "number"), ("integer", "number"), ("map", "dictionary")]
        .iter()
        .fold(given.to_owned(), |said, (name, word)| said.replacen(&format!(": {name}"), &format!(": {word}"), 1));
    let given = given.trim_start_matches("invalid type: ").trim_start_matches("invalid value: ");
    format!("{given}expected {expected}")
}

/// The value after `given` was set; in a dictionary, only the keys in `given` change.
pub fn changed<T: Serialize + DeserializeOwned>(name: &str, old: &T, given: &Value) -> Result<T> {
    let refused = |e: serde_json::Error| match given {
        Value::Null => Error::invalid(name, "null is not allowed"),
        _ => Error::invalid(name, in_words(&e.to_string())),
    };
    let mut whole = serde_json::to_value(old).map_err(refused)?;
    match (&mut whole, given) {
        (Value::Object(keys), Value::Object(given)) => keys.extend(given.clone()),
        (whole, given) => whole.clone_from(given),
    }
    serde_json::from_value(whole).map_err(refused)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn refusals_name_no_types_of_rust() {
        for (given, said) in [
            (json!("steep"), "x: text \"steep\", expected a number"),
            (json!([1]), "x: sequence, expected a number"),
            (json!({}), "x: dictionary, expected a number"),
            (json!(true), "x: boolean `true`, expected a number"),
            (Value::Null, "x: null is not allowed"),
        ] {
            assert_eq!(changed("x", &1.0, &given).unwrap_err().to_string(), said);
        }
        assert_eq!(
            changed("n", &1_u32, &json!(-3)).unwrap_err().to_string(),
            "n: number `-3`, expected a whole number from 0"
        );
        assert_eq!(changed("b", &true, &json!(3)).unwrap_err().to_string(), "b: number `3`, expected true or false");
    }
}
