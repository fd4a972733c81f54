//! Reads the part of YAML that files of hyperparameters use: tables, lists, texts, anchors and merge keys (`<<`),
//! as JSON values.

use crate::error::{Error, Result};
use saphyr_parser::{Event, Parser, ScalarStyle};
use serde_json::{Map, Value};
use std::collections::HashMap;

/// Largest text [bytes]: our choice, as for the two limits below, far more than a file of hyperparameters needs.
const MOST_BYTES: usize = 1 << 20;
/// Deepest nesting.
const MOST_DEPTH: usize = 32;
/// Largest memory of all values [bytes]. A value with an anchor counts twice, and once more at every use.
const MOST_MEMORY: usize = 8 << 20;
/// Memory that is counted for a value besides its text [bytes]: our choice, twice the size of [`Value`], because lists
/// have spare room. Tables of few entries take more.
const VALUE: usize = 64;

/// An incomplete value.
enum OpenYaml {
    List(Vec<Value>),
    /// A table, with the key whose value comes next.
    Table(Map<String, Value>, Option<String>),
}

struct YamlReader {
    /// Values that are not complete, with their anchors; the innermost value is last.
    open: Vec<(OpenYaml, usize)>,
    anchors: HashMap<usize, (Value, usize)>,
    /// Memory of the values so far [bytes].
    memory: usize,
    whole: Option<Value>,
}

/// The value of `text`; null if it is empty.
pub fn read(text: &str) -> Result<Value> {
    if text.len() > MOST_BYTES {
        return Err(Error::invalid("YAML", format!("{} bytes are more than {MOST_BYTES}", text.len())));
    }
    let mut reader = YamlReader { open: Vec::new(), anchors: HashMap::new(), memory: 0, whole: None };
    for event in Parser::new_from_str(text) {
        let (event, span) = event.map_err(|e| Error::invalid("YAML", e.to_string()))?;
        let wrong = |why: String| Error::invalid("YAML", format!("line {}: {why}", span.start.line()));
        reader.take(event).map_err(wrong)?;
    }
    Ok(reader.whole.unwrap_or_default())
}

type YamlResult = std::result::Result<(), String>;

impl YamlReader {
    fn take(&mut self, event: Event) -> YamlResult {
        match event {
            Event::Scalar(text, style, anchor, _) => {
                let value = scalar(&text, style);
                let own = memory(&value);
                self.place(value, anchor, own)
            }
            Event::SequenceStart(anchor, _) => self.begin(OpenYaml::List(Vec::new()), anchor),
            Event::MappingStart(anchor, _) => self.begin(OpenYaml::Table(Map::new(), None), anchor),
            Event::SequenceEnd | Event::MappingEnd => {
                let Some((open, anchor)) = self.open.pop() else { return Ok(()) };
                let value = match open {
                    OpenYaml::List(list) => Value::Array(list),
                    OpenYaml::Table(table, _) => Value::Object(table),
                };
                // The parts of the value are counted already.
                self.place(value, anchor, VALUE)
            }
            Event::Alias(anchor) => {
                let known = self.anchors.get(&anchor).cloned();
                let (value, memory) = known.ok_or("an anchor is used inside itself")?;
                self.place(value, 0, memory)
            }
            Event::DocumentStart(_) if self.whole.is_some() => Err("a second document begins".into()),
            _ => Ok(()),
        }
    }

    fn begin(&mut self, open: OpenYaml, anchor: usize) -> YamlResult {
        if self.open.len() >= MOST_DEPTH {
            return Err(format!("nested more than {MOST_DEPTH} deep"));
        }
        self.open.push((open, anchor));
        Ok(())
    }

    fn count(&mut self, memory: usize) -> YamlResult {
        self.memory += memory;
        if self.memory > MOST_MEMORY {
            return Err(format!("its values need more than {} MiB", MOST_MEMORY >> 20));
        }
        Ok(())
    }

    /// Adds a complete value to its parent. `own`: its memory that is not counted yet.
    fn place(&mut self, value: Value, anchor: usize, own: usize) -> YamlResult {
        self.count(own)?;
        if anchor > 0 {
            let copy = memory(&value);
            self.count(copy)?;
            self.anchors.insert(anchor, (value.clone(), copy));
        }
        match self.open.last_mut().map(|(open, _)| open) {
            None => self.whole = Some(value),
            Some(OpenYaml::List(list)) => list.push(value),
            Some(OpenYaml::Table(table, key)) => match key.take() {
                None => *key = Some(name(&value).ok_or("a name is no text")?),
                Some(name) if name == "<<" => merge(table, value)?,
                // The table's own entries take precedence over merged ones, in any order.
                Some(name) => drop(table.insert(name, value)),
            },
        }
        Ok(())
    }
}

/// Adds the entries of a table, or of a list of tables, except entries whose names exist already.
fn merge(table: &mut Map<String, Value>, value: Value) -> YamlResult {
    match value {
        Value::Object(other) => other.into_iter().for_each(|(name, value)| {
            table.entry(name).or_insert(value);
        }),
        Value::Array(others) => others.into_iter().try_for_each(|other| merge(table, other))?,
        _ => return Err("<<: needs a table".into()),
    }
    Ok(())
}

fn name(value: &Value) -> Option<String> {
    match value {
        Value::String(text) => Some(text.clone()),
        Value::Number(number) => Some(number.to_string()),
        _ => None,
    }
}

/// Memory of a value [bytes].
fn memory(value: &Value) -> usize {
    VALUE
        + match value {
            Value::String(text) => text.len(),
            Value::Array(list) => list.iter().map(memory).sum(),
            Value::Object(table) => table.iter().map(|(name, value)| VALUE + name.len() + memory(value)).sum(),
            _ => 0,
        }
}

/// The value of a word without quotes; numbers may have `_` between digits, as in YAML 1.1.
fn scalar(text: &str, style: ScalarStyle) -> Value {
    if style != ScalarStyle::Plain {
        return text.into();
    }
    match text {
        "" | "~" | "null" | "Null" | "NULL" => return Value::Null,
        "true" | "True" | "TRUE" => return true.into(),
        "false" | "False" | "FALSE" => return false.into(),
        _ => (),
    }
    let digits = text.replace('_', "");
    // Words such as "inf" and "nan" are not numbers here.
    if !text.starts_with(|c: char| c.is_ascii_digit() || "+-.".contains(c)) {
        return text.into();
    }
    match (digits.parse::<i64>(), digits.parse::<f64>()) {
        (Ok(whole), _) => whole.into(),
        (_, Ok(number)) if number.is_finite() => number.into(),
        _ => text.into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn the_file_of_examples_is_read_as_python_reads_it() {
        let all = read(include_str!("../../examples/hyperparameters/ppo.yml")).unwrap();
        let gait = &all["sandgait/HexapodGait-v1"];
        assert_eq!(gait["n_timesteps"], 10_000_000);
        assert_eq!(gait["learning_rate"], "lin_1e-3");
        assert_eq!(gait["policy_kwargs"], json!({"log_std_init": 0.0, "net_arch": [64, 64]}));
        let legs = &all["sandgait/HexapodLegs-v1"];
        assert_eq!((&legs["n_envs"], &legs["seconds"], &legs["gamma"]), (&json!(128), &json!(600), &json!(0.95)));
    }

    #[test]
    fn what_is_no_such_file_is_refused_in_a_line() {
        let long = format!("a: &a {}\nb: [{}]", "x".repeat(60_000), "*a, ".repeat(20_000));
        let names: String = (0..30).map(|k| format!("b{}: &b{} {{<<: *b{k}, k{k}: 1}}\n", k + 1, k + 1)).collect();
        let names = format!("b0: &b0 {{{}: 1}}\n{names}", "x".repeat(300_000));
        let bomb: String = (0..30).map(|k| format!("a{}: &a{} [*a{k}, *a{k}, *a{k}]\n", k + 1, k + 1)).collect();
        for (text, says) in [
            ("a: [1, 2", "YAML: "),
            (&format!("a0: &a0 1\n{bomb}") as &str, "its values need more than 8 MiB"),
            (&long, "its values need more than 8 MiB"),
            (&names, "its values need more than 8 MiB"),
            (&("[".repeat(40) + &"]".repeat(40)), "nested more than 32 deep"),
            (&"[".repeat(10_000), "YAML: "),
            ("a: &a [*a]", "YAML: "),
            ("<<: 3", "<<: needs a table"),
            ("---\na: 1\n---\nb: 2", "a second document begins"),
        ] {
            let error = read(text).unwrap_err().to_string();
            assert!(error.contains(says) && !error.contains('\n'), "{error}");
        }
        assert_eq!(read("").unwrap(), Value::Null);
        assert_eq!(
            read("[1e-3, .5, inf, -3, '7', 1_000, yes]").unwrap(),
            json!([1e-3, 0.5, "inf", -3, "7", 1000, "yes"])
        );
    }
}
