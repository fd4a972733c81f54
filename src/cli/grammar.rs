//! The grammar of the command line, and refusals in one line.

use super::{Cli, layout};
use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{CommandFactory as _, FromArgMatches as _};
use sandgait::Error;
use sandgait::error::unknown_name;
use std::error::Error as _;
use std::ffi::OsString;

/// The command line's grammar. `-1` is a value, so that a number below its range is refused with the range. Examples are
/// broken so that each can be copied.
pub(super) fn grammar() -> clap::Command {
    let numeric = |argument: clap::Arg| {
        let takes_values = argument.get_action().takes_values() && !argument.is_allow_hyphen_values_set();
        argument.allow_negative_numbers(takes_values)
    };
    Cli::command().mut_subcommands(|command| {
        let examples = command.get_after_help().map(|text| layout::examples(&text.to_string()));
        let command = command.mut_args(numeric);
        examples.into_iter().fold(command, clap::Command::after_help)
    })
}

/// Parses a command line.
pub(super) fn parse(arguments: &[OsString]) -> std::result::Result<Cli, clap::Error> {
    Cli::from_arg_matches(&grammar().try_get_matches_from(arguments)?)
}

/// clap's refusal in one line, in the words of this program's other messages.
pub(super) fn one_line(error: &clap::Error) -> String {
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

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(line: &str) -> String {
        let words: Vec<_> = line.split(' ').map(OsString::from).collect();
        let Err(error) = parse(&words) else { panic!("{line} is accepted") };
        one_line(&error)
    }

    #[test]
    fn refusals_name_argument_value_and_range() {
        for (line, said) in [
            ("sandgait bench --repeats 3", "--repeats: 3 is outside [5, 1000]"),
            ("sandgait bench --repeats x", "--repeats: \"x\": no whole number"),
            ("sandgait bench --envs 0", "--envs: 0 is outside [1, 65536]"),
            ("sandgait bench --envs 10000000000", "--envs: 10000000000 is outside [1, 65536]"),
            ("sandgait bench --threads -1", "--threads: -1 is outside [0, 1024]"),
            ("sandgait train --timesteps -5", "--timesteps: -5 is outside [1, 1000000000000]"),
            ("sandgait train --threads -1", "--threads: -1 is outside [0, 1024]"),
            ("sandgait train --checkpoint-every 0", "--checkpoint-every: 0 is outside [1, 1000000000000]"),
            ("sandgait serve --max-sessions -1", "--max-sessions: -1 is outside [1, 4294967295]"),
            ("sandgait serve --threads -1", "--threads: -1 is outside [0, 1024]"),
            ("sandgait play x.onnx --port -1", "--port: -1 is outside [0, 65535]"),
            ("sandgait evaluate tripod --seeds -3", "--seeds: -3 is outside [2, 100000]"),
            ("sandgait serve --listen foo", "--listen: \"foo\" is not HOST:PORT or unix:PATH (invalid socket address)"),
            ("sandgait walk", "missing: --frequency <HZ>"),
            ("sandgait serve --max-message-mib 4096", "--max-message-mib: 4096 is outside [1, 4095]"),
            (
                "sandgait walk --frequncy 2",
                "unexpected argument '--frequncy' found; tip: a similar argument exists: '--frequency'",
            ),
        ] {
            assert_eq!(refused(line), said);
        }
        let unknown = refused("sandgait bench --through grpc");
        let said = "--through: \"grpc\" is unknown; did you mean \"grpc-uds\"? known: process, grpc-uds";
        assert!(unknown.starts_with(said), "{unknown}");
    }

    /// At 80 and at 120 columns no line of any help is wider, and each word of the wide help is in the narrow one.
    #[test]
    fn help_is_wrapped_at_words() {
        for command in grammar().get_subcommands() {
            let help = |width| command.clone().term_width(width).render_long_help().to_string();
            let words = |text: &str| text.split_whitespace().map(str::to_owned).collect::<Vec<_>>();
            let [narrow, wide] = [80, 120].map(|width| {
                let text = help(width);
                // A line of examples without a blank to break at, such as a long option, may be wider.
                let broad = text.lines().find(|l| l.chars().count() > width && l.trim().contains(' '));
                assert_eq!(broad, None, "{} at {width}", command.get_name());
                words(&text)
            });
            assert_eq!(narrow, wide, "{}", command.get_name());
        }
    }

    /// Each example of a help at 80 columns is a command that a shell takes as it stands, and this program parses it.
    #[test]
    fn examples_can_be_copied() {
        for command in grammar().get_subcommands() {
            let help = command.clone().term_width(80).render_long_help().to_string();
            let examples = help.rsplit_once("Examples:\n").map_or("", |(_, examples)| examples);
            assert!(examples.contains("sandgait "), "{}", command.get_name());
            for line in examples.replace("\\\n", " ").lines().filter(|l| !l.is_empty() && !l.trim().starts_with('#')) {
                let line = line.split(" && ").next().unwrap().split(" > ").next().unwrap().trim();
                let words = line.split_whitespace().skip_while(|word| word.contains("SANDGAIT_")).map(OsString::from);
                // An option of a JSON object would need a shell here.
                if line.contains('\'') {
                    continue;
                }
                if let Err(error) = parse(&words.collect::<Vec<_>>()) {
                    panic!("{line}: {error}");
                }
            }
        }
    }
}
