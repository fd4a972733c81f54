//! A file of options. Its options are inserted before the options of the command line, so that the command line takes
//! precedence.

use clap::Command;
use sandgait::error::unknown_name;
use sandgait::{Error, Result, files};
use std::ffi::OsString;
use std::path::Path;

/// Options that only the command line has.
const NOT_IN_FILES: [&str; 2] = ["config", "help"];

/// The options in the TOML file `path` as arguments of `command`.
///
/// # Errors
/// Names the file and the key that `command` does not know or whose value is no text, number or truth value.
pub fn arguments(command: &Command, path: &Path) -> Result<Vec<OsString>> {
    let text = files::read_text(path)?;
    let table: toml::Table = text.parse().map_err(|e: toml::de::Error| {
        let line = e.span().map_or(1, |s| 1 + text[..s.start].matches('\n').count());
        Error::file(path, format!("line {line}: {}", e.message()))
    })?;
    let known = command.get_arguments().filter_map(|a| a.get_long()).filter(|name| !NOT_IN_FILES.contains(name));
    let known: Vec<_> = known.collect();
    let mut arguments = Vec::new();
    for (key, value) in table {
        if !known.contains(&key.as_str()) {
            return Err(Error::file(path, unknown_name(&key, &known)));
        }
        let is_flag = command.get_arguments().any(|a| a.get_long() == Some(&key) && !a.get_action().takes_values());
        let value = match value {
            toml::Value::Boolean(set) if is_flag => {
                arguments.extend(set.then(|| format!("--{key}").into()));
                continue;
            }
            toml::Value::String(text) if !is_flag => text,
            toml::Value::Integer(number) if !is_flag => number.to_string(),
            other => {
                let expected = if is_flag { "true or false" } else { "text or a whole number" };
                return Err(Error::file(path, format!("{key}: {} where {expected} is expected", other.type_str())));
            }
        };
        arguments.push(format!("--{key}={value}").into());
    }
    Ok(arguments)
}
