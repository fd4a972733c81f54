//! Options of a task: one way for all commands and studies.

use super::arguments::{TaskOption, unfelt};
use super::inputs::OptionReader;
use crate::error::{Error, Result};
use crate::sand::SandDescription;
use crate::train::entry;
use serde_json::{Map, Value};

/// Options of the task.
#[derive(clap::Args, Clone, Default)]
pub struct OptionArgs {
    /// Option of the task, repeatable (`sandgait tasks NAME` lists them). VALUE is a number, a word, or JSON such as
    /// [0.1,0.6] or {"key": 1}; a number stands for a range of that number, and null for None. Of sand, hardware and
    /// robot VALUE can be a path
    #[arg(long = "option", value_name = "NAME=VALUE", allow_hyphen_values = true)]
    options: Vec<TaskOption>,
    /// The same as one JSON object
    #[arg(long = "options", value_name = "JSON", hide = true, allow_hyphen_values = true)]
    options_json: Option<String>,
}

impl OptionArgs {
    pub fn is_empty(&self) -> bool {
        self.options.is_empty() && self.options_json.is_none()
    }

    /// The options as the user wrote them.
    pub fn words(&self) -> Vec<String> {
        self.options.iter().map(|option| &option.0).chain(&self.options_json).cloned().collect()
    }

    /// The options, with the contents of the files that they name.
    pub fn read(&self, files: OptionReader) -> Result<Map<String, Value>> {
        let mut options = Value::Object(self.named()?);
        files(&mut options)?;
        Ok(options.as_object().cloned().unwrap_or_default())
    }

    /// `base` with these options in place of its own. In a dictionary only the given keys change.
    pub fn over(&self, mut base: Map<String, Value>, files: OptionReader) -> Result<Value> {
        for (name, value) in self.named()? {
            match (base.get_mut(&name), value) {
                (Some(Value::Object(old)), Value::Object(new)) => old.extend(new),
                (_, value) => drop(base.insert(name, value)),
            }
        }
        let mut options = Value::Object(base);
        files(&mut options)?;
        Ok(options)
    }

    fn named(&self) -> Result<Map<String, Value>> {
        let mut options = match self.options_json.as_deref().map(serde_json::from_str) {
            None => Map::new(),
            Some(Ok(Value::Object(options))) => options,
            Some(Ok(other)) => return Err(Error::invalid("--options", format!("{other} is no JSON object"))),
            Some(Err(e)) => return Err(Error::invalid("--options", format!("not JSON: {e}"))),
        };
        for TaskOption(word) in &self.options {
            let (name, value) = named(word)?;
            if options.insert(name.clone(), value).is_some() {
                return Err(Error::invalid(format!("--option {name}"), "is given twice"));
            }
        }
        Ok(options)
    }
}

/// Splits NAME=VALUE. JSON is read as such, and so are Python's words; anything else as in a file of settings.
fn named(word: &str) -> Result<(String, Value)> {
    let (name, text) = word.split_once('=').unwrap_or((word, ""));
    match (text.trim(), serde_json::from_str(text)) {
        ("None", _) => Ok((name.to_owned(), Value::Null)),
        (truth @ ("True" | "False"), _) => Ok((name.to_owned(), Value::Bool(truth == "True"))),
        (_, Ok(value)) => Ok((name.to_owned(), value)),
        _ => entry::pair("--option", word),
    }
}

/// A line that names the mechanisms without effect in the `sand` among a task's options.
pub fn unfelt_option(options: &Value) -> Option<String> {
    let text = options.get("sand").and_then(Value::as_str);
    // If the text is not a sand, the task refuses it with its own message.
    text.and_then(|text| SandDescription::from_toml(text).ok()).and_then(|sand| unfelt(&sand))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn args(words: &[&str], given: Option<&str>) -> OptionArgs {
        OptionArgs {
            options: words.iter().map(|w| TaskOption((*w).to_owned())).collect(),
            options_json: given.map(str::to_owned),
        }
    }

    #[test]
    fn values_are_json_or_words() {
        let words = [
            "leg=C",
            "slope_deg=-5",
            "command=[0.1, 0.6]",
            "weights={\"tracking\": 2}",
            "domain_rand={sand_range: [1, 2]}",
            "curriculum=None",
            "memory=True",
            "sand=",
            "medium=zeta=0.3",
        ];
        let read = Value::Object(args(&words, None).named().unwrap());
        let wanted = json!({
            "leg": "C", "slope_deg": -5, "command": [0.1, 0.6], "weights": {"tracking": 2},
            "domain_rand": {"sand_range": [1, 2]}, "curriculum": null, "memory": true, "sand": null,
            "medium": "zeta=0.3",
        });
        assert_eq!(read, wanted);
        assert_eq!(args(&[], Some("{\"leg\": \"C\"}")).named().unwrap()["leg"], "C");
    }

    #[test]
    fn wrong_options_are_refused_in_a_line() {
        for (words, given, said) in [
            (&["leg"][..], None, "--option: \"leg\" is not NAME=VALUE"),
            (&["leg=C", "leg=L"], None, "--option leg: is given twice"),
            (&["leg=C"], Some("{\"leg\": \"L\"}"), "--option leg: is given twice"),
            (&[], Some("{"), "--options: not JSON: "),
            (&[], Some("[1]"), "--options: [1] is no JSON object"),
        ] {
            let error = args(words, given).named().unwrap_err().to_string();
            assert!(error.starts_with(said) && !error.contains('\n'), "{error}");
        }
    }

    #[test]
    fn given_options_change_keys_of_dictionaries() {
        let base = json!({"leg": "C", "weights": {"tracking": 2.0, "action_rate": 1.0}});
        let args = args(&["weights={\"tracking\": 3}", "slope_deg=5"], None);
        let options = args.over(base.as_object().unwrap().clone(), |_| Ok(())).unwrap();
        let wanted = json!({"leg": "C", "slope_deg": 5, "weights": {"tracking": 3, "action_rate": 1.0}});
        assert_eq!(options, wanted);
    }
}
