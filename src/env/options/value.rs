//! The types that an option can have.

use super::OptionRow;
use crate::error::{Error, Result, check_range, unknown_name};
use crate::sand::Law;
use crate::sim::MemoryCount;
use crate::sim::engine::EngineKind;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use std::ops::RangeInclusive;

/// The value of an option; its type determines the checks.
pub trait OptionValue {
    /// Is it a range [low, high]?
    const IS_RANGE: bool = false;

    /// Adds the memory that the value has besides its own size: texts and lists.
    fn count_memory(&self, count: &mut MemoryCount);

    /// Refuses values that deserialisation accepts but the option does not.
    fn check(&self, _name: &str) -> Result<()> {
        Ok(())
    }

    /// For a dictionary: its keys.
    fn keys() -> Vec<OptionRow> {
        Vec::new()
    }

    /// The names among which users choose, if the type has others too.
    fn names() -> Vec<&'static str> {
        Vec::new()
    }
}

/// Options without texts and lists.
macro_rules! plain {
    ($($Type:ty),*) => {$(
        impl OptionValue for $Type {
            fn count_memory(&self, _count: &mut MemoryCount) {}
        }
    )*};
}

plain!(bool, u32, u64, usize, f64, [f64; 3], Law);

impl OptionValue for String {
    fn count_memory(&self, count: &mut MemoryCount) {
        count.add(self.len());
    }
}

impl OptionValue for Vec<Vec<f64>> {
    fn count_memory(&self, count: &mut MemoryCount) {
        count.add(size_of_val(&self[..]) + self.iter().map(|row| size_of_val(&row[..])).sum::<usize>());
    }
}

impl OptionValue for Vec<String> {
    fn count_memory(&self, count: &mut MemoryCount) {
        count.add(size_of_val(&self[..]) + self.iter().map(String::len).sum::<usize>());
    }
}

/// Memory of an entry of a map with its share of the map's nodes [bytes]: measured with maps of 1,000 texts, whose
/// nodes are half to fully used.
const ENTRY: usize = 64;

impl OptionValue for BTreeMap<String, f64> {
    fn count_memory(&self, count: &mut MemoryCount) {
        count.add(self.keys().map(|key| ENTRY + key.len()).sum());
    }
}

impl OptionValue for [f64; 2] {
    const IS_RANGE: bool = true;

    fn count_memory(&self, _count: &mut MemoryCount) {}
}

/// Two numbers that are no range.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct NumberPair(pub [f64; 2]);

impl OptionValue for NumberPair {
    fn count_memory(&self, _count: &mut MemoryCount) {}
}

impl OptionValue for EngineKind {
    fn count_memory(&self, _count: &mut MemoryCount) {}

    fn check(&self, _name: &str) -> Result<()> {
        match Self::ALL.contains(self) {
            true => Ok(()),
            false => Err(Error::unknown("engine", self.name(), &Self::ALL.map(Self::name))),
        }
    }

    fn names() -> Vec<&'static str> {
        Self::ALL.map(Self::name).to_vec()
    }
}

impl<T: OptionValue> OptionValue for Option<T> {
    const IS_RANGE: bool = T::IS_RANGE;

    fn count_memory(&self, count: &mut MemoryCount) {
        self.iter().for_each(|value| value.count_memory(count));
    }

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

/// Smallest number of an option besides 0: our choice, a picometre or picosecond. Equations divide by options and square
/// them; in single precision numbers below 1e-19 would give squares of 0, and quotients that are infinite or no numbers.
const SMALLEST: f64 = 1e-12;

impl Bounded for f64 {
    fn within(&self, name: &str, bounds: RangeInclusive<f64>) -> Result<()> {
        check_range(name, *self, bounds)?;
        match self.abs() {
            size if size > 0.0 && size < SMALLEST => {
                Err(Error::invalid(name, format!("{self:e} is neither 0 nor as large as {SMALLEST:e}")))
            }
            _ => Ok(()),
        }
    }
}

/// A vector, whose components have the same bounds.
impl Bounded for [f64; 3] {
    fn within(&self, name: &str, bounds: RangeInclusive<f64>) -> Result<()> {
        self.iter().try_for_each(|x| x.within(name, bounds.clone()))
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
        ("string or map", "a text"),
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
    let words = [
        ("string", "text"),
        ("floating point", "number"),
        ("integer", "number"),
        ("map", "dictionary"),
        ("sequence", "list"),
    ];
    let given = words
        .iter()
        .fold(given.to_owned(), |said, (name, word)| said.replacen(&format!(": {name}"), &format!(": {word}"), 1));
    let given = given.trim_start_matches("invalid type: ").trim_start_matches("invalid value: ");
    format!("{given}expected {expected}")
}

/// The error for an unknown name, from serde's message: "unknown variant `a`, expected one of `b`, `c`", or the same
/// with "field" for a key of a dictionary.
fn unknown(name: &'static str, message: &str, names: &[&str]) -> Option<Error> {
    let parts: Vec<&str> = message.split('`').collect();
    let given = parts.get(1)?;
    let known = match names {
        [] => parts[2..].iter().skip(1).step_by(2).copied().collect::<Vec<_>>(),
        names => names.to_vec(),
    };
    match *parts.first()? {
        "unknown variant " => Some(Error::unknown(name, given, &known)),
        "unknown field " => Some(Error::invalid(name, format!("key {}", unknown_name(given, &known)))),
        _ => None,
    }
}

/// Refuses a list in place of a dictionary. serde would take its values as those of the keys, by their order.
fn check_dictionaries(name: &str, keys: &[OptionRow], given: &Value) -> Result<()> {
    match given {
        Value::Array(_) if !keys.is_empty() => Err(Error::invalid(name, "list, expected a dictionary")),
        Value::Object(given) => keys.iter().try_for_each(|key| {
            let value = given.get(key.name).unwrap_or(&Value::Null);
            check_dictionaries(&format!("{name}.{}", key.name), &key.keys, value)
        }),
        _ => Ok(()),
    }
}

/// `given` with [x, x] in place of a number x where a range is expected.
fn with_ranges(given: &Value, is_range: bool, keys: &[OptionRow]) -> Value {
    match given {
        Value::Number(number) if is_range => Value::Array(vec![number.clone().into(); 2]),
        Value::Object(given) => {
            let of = |(name, value): (&String, &Value)| {
                let key = keys.iter().find(|key| key.name == name);
                (name.clone(), key.map_or_else(|| value.clone(), |key| with_ranges(value, key.is_range, &key.keys)))
            };
            Value::Object(given.iter().map(of).collect())
        }
        _ => given.clone(),
    }
}

/// The value after `given` was set; in a dictionary, only the keys in `given` change.
pub fn changed<T>(name: &'static str, old: &T, given: &Value) -> Result<T>
where
    T: OptionValue + Serialize + DeserializeOwned,
{
    let refused = |e: serde_json::Error| match given {
        Value::Null => {
            let said = in_words(&e.to_string());
            let expected = said.rsplit_once("expected ").map_or("a value", |(_, expected)| expected);
            Error::invalid(name, format!("null is not allowed, expected {expected}"))
        }
        _ => {
            let message = e.to_string();
            unknown(name, &message, &T::names()).unwrap_or_else(|| Error::invalid(name, in_words(&message)))
        }
    };
    let given = &with_ranges(given, T::IS_RANGE, &T::keys());
    let mut whole = serde_json::to_value(old).map_err(refused)?;
    // Weights of rewards name no keys.
    if whole.is_object() && given.is_array() {
        return Err(Error::invalid(name, "list, expected a dictionary"));
    }
    check_dictionaries(name, &T::keys(), given)?;
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

    /// A number stands for a range of that number, also in dictionaries; two other numbers need both.
    #[test]
    fn a_number_stands_for_a_range() {
        use crate::legged::draws::Commands;
        assert_eq!(changed("action_delay", &[0.0, 0.0], &json!(0.02)).unwrap(), [0.02, 0.02]);
        assert_eq!(changed("x", &None::<[f64; 2]>, &json!(1)).unwrap(), Some([1.0, 1.0]));
        let commands =
            changed("commands", &Commands::default(), &json!({"lin_vel_x": 0.4, "resampling_time": 5})).unwrap();
        assert_eq!((commands.lin_vel_x, commands.resampling_time), (Some([0.4, 0.4]), 5.0));
        let error = changed("start", &NumberPair([0.0; 2]), &json!(1)).unwrap_err().to_string();
        assert!(error.starts_with("start: "), "{error}");
    }

    #[test]
    fn refusals_name_no_types_of_rust() {
        for (given, said) in [
            (json!("steep"), "x: text \"steep\", expected a number"),
            (json!([1]), "x: list, expected a number"),
            (json!({}), "x: dictionary, expected a number"),
            (json!(true), "x: boolean `true`, expected a number"),
            (Value::Null, "x: null is not allowed, expected a number"),
        ] {
            assert_eq!(changed("x", &1.0, &given).unwrap_err().to_string(), said);
        }
        assert_eq!(
            changed("n", &1_u32, &json!(-3)).unwrap_err().to_string(),
            "n: number `-3`, expected a whole number from 0"
        );
        let null = changed("hardware", &String::new(), &Value::Null).unwrap_err().to_string();
        assert_eq!(null, "hardware: null is not allowed, expected a text");
        assert_eq!(changed("b", &true, &json!(3)).unwrap_err().to_string(), "b: number `3`, expected true or false");
    }

    /// serde takes a list as a dictionary's values in their order.
    #[test]
    fn a_list_is_no_dictionary() {
        let refused = |result: Result<()>| result.unwrap_err().to_string();
        let weights = |given| changed("weights", &crate::locomotion::Weights::default(), &given).map(drop);
        assert_eq!(refused(weights(json!([5]))), "weights: list, expected a dictionary");
        assert!(
            refused(weights(json!({"sped": 1}))).starts_with("weights: key \"sped\" is unknown; known: tracking, ")
        );
        let motors = |given| changed("actuator", &crate::sensors::Motors::default(), &given).map(drop);
        assert_eq!(refused(motors(json!([0.001]))), "actuator: list, expected a dictionary");
        let sensors = |given| changed("sensors", &crate::sensors::SensorOptions::default(), &given).map(drop);
        assert_eq!(refused(sensors(json!({"gyroscope": [1]}))), "sensors.gyroscope: list, expected a dictionary");
        sensors(json!({"gyroscope": null, "imu_position": [0, 0, 1]})).unwrap();
        assert_eq!(
            refused(changed("x", &Some(BTreeMap::<String, f64>::new()), &json!([1])).map(drop)),
            "x: list, expected a dictionary"
        );
    }

    /// Users choose between two of the engines.
    #[test]
    fn unknown_names_are_named_with_the_known_ones() {
        let engine = changed("engine", &EngineKind::Lanes, &json!("foo")).unwrap_err().to_string();
        assert_eq!(engine, "engine \"foo\" is unknown; known: lanes, rapier");
        let control = changed("control", &crate::control::Control::Torque, &json!("foo")).unwrap_err().to_string();
        assert_eq!(control, "control \"foo\" is unknown; known: hip_speed, hip_target, torque, clock");
    }
}
