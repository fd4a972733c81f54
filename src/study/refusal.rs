//! Wrong arguments in one line, in the words of this program's other messages.

use crate::error::{Error, unknown_name};
use clap::Command;
use clap::error::{ContextKind, ContextValue, ErrorKind};
use std::error::Error as _;

/// clap's refusal as a line for the command line, where arguments begin with `--`.
pub fn one_line(error: &clap::Error) -> String {
    let context = |kind| match error.get(kind) {
        Some(ContextValue::String(text)) => Some(text.clone()),
        Some(ContextValue::Strings(all)) if !all.is_empty() => Some(all.join(", ")),
        _ => None,
    };
    // `--repeats <N>` without its placeholder
    let name = |argument: String| argument.split(" <").next().unwrap_or_default().to_owned();
    let argument = context(ContextKind::InvalidArg);
    match (error.kind(), argument, context(ContextKind::InvalidValue)) {
        (ErrorKind::MissingRequiredArgument, Some(missing), _) => format!("missing: {missing}"),
        (ErrorKind::ArgumentConflict, Some(argument), _) => {
            let [name, other] = [argument, context(ContextKind::PriorArg).unwrap_or_default()].map(name);
            match name == other {
                true => format!("{name}: is given twice"),
                false => format!("{name}: cannot be given with {other}"),
            }
        }
        (ErrorKind::InvalidValue, Some(argument), Some(value)) if !value.is_empty() => {
            let known = context(ContextKind::ValidValue).unwrap_or_default();
            let known: Vec<&str> = known.split(", ").collect();
            format!("{}: {}", name(argument), unknown_name(&value, &known))
        }
        (ErrorKind::ValueValidation, Some(argument), Some(value)) => {
            let reason = error.source().map_or_else(String::new, |e| match e.downcast_ref::<Error>() {
                Some(Error::Invalid { reason, .. }) => reason.clone(),
                _ => range(&e.to_string()),
            });
            let repeats = reason.starts_with(&value) || reason.starts_with(&format!("{value:?}"));
            let said = if repeats { reason } else { format!("{value:?}: {reason}") };
            format!("{}: {said}", name(argument))
        }
        _ => without_usage(&error.to_string()),
    }
}

/// The same for a request, whose arguments have the names of Python's keywords: `plate_size` for `--plate-size`.
pub fn of_request(command: &Command, error: &clap::Error) -> Error {
    let keyword = |name: &str| {
        let name = name.split(" <").next().unwrap_or_default();
        let plain = name.trim_start_matches("--").trim_matches(['<', '>', '.', '[', ']']);
        let is_meant = |argument: &&clap::Arg| match argument.get_long() {
            Some(long) => long == plain,
            None => argument.get_value_names().is_some_and(|names| names[0].as_str() == plain),
        };
        command
            .get_arguments()
            .find(is_meant)
            .map_or_else(|| plain.to_owned(), |argument| argument.get_id().to_string())
    };
    let line = one_line(error);
    match line.split_once(": ") {
        Some(("missing", names)) => Error::invalid(keyword(names.split(", ").next().unwrap_or_default()), "missing"),
        Some((name, reason)) if name.starts_with("--") || name.starts_with('<') => {
            let reason = match reason.strip_prefix("cannot be given with ") {
                Some(other) => format!("cannot be given with {}", keyword(other)),
                None => reason.to_owned(),
            };
            Error::invalid(keyword(name), reason)
        }
        _ => Error::invalid("arguments", line),
    }
}

/// Changes Rust's words for a number outside its range, such as `3 is not in 5..=65535`, into mathematical notation.
fn range(reason: &str) -> String {
    let Some((value, range)) = reason.split_once(" is not in ") else { return reason.to_owned() };
    let (low, high) = range.split_once("..").unwrap_or((range, ""));
    match high.strip_prefix('=') {
        Some(high) => format!("{value} is outside [{low}, {high}]"),
        None => format!("{value} is outside [{low}, {high})"),
    }
}

/// clap's message without its usage block: `error: a … tip: b`.
fn without_usage(message: &str) -> String {
    let said = message.split("\nUsage:").next().unwrap_or(message);
    let lines = said.lines().map(str::trim).filter(|l| !l.is_empty() && !l.starts_with("For more information"));
    lines.collect::<Vec<_>>().join(" ").trim_start_matches("error: ").replace(" tip:", "; tip:")
}
