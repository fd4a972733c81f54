//! The grammar of the command line.

use super::Cli;
use clap::{CommandFactory as _, FromArgMatches as _};
use sandgait::study::layout;
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

#[cfg(test)]
mod tests {
    use super::*;
    use sandgait::study::refusal::one_line;

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
            ("sandgait evaluate tripod --seeds 3 --seeds 4", "--seeds: is given twice"),
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
