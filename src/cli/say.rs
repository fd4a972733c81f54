//! Lines on stderr. The beginning of a line says what it is, in colour where a terminal has it; anstream asks the terminal, `NO_COLOR` and
//! `CLICOLOR`.

use clap::builder::styling::{AnsiColor, Style};
use clap::builder::{StyledStr, Styles};
use std::fmt::Display;

/// Colours of help texts: those of cargo.
pub const HELP: Styles = Styles::styled()
    .header(AnsiColor::Green.on_default().bold())
    .usage(AnsiColor::Green.on_default().bold())
    .literal(AnsiColor::Cyan.on_default().bold())
    .placeholder(AnsiColor::Cyan.on_default());

const ERROR: Style = AnsiColor::Red.on_default().bold();
const WARNING: Style = AnsiColor::Yellow.on_default().bold();
const NEXT: Style = AnsiColor::Green.on_default().bold();

/// An error, the last line of a command.
pub fn error(line: impl Display) {
    anstream::eprintln!("{ERROR}sandgait:{ERROR:#} {line}");
}

pub fn warning(line: impl Display) {
    anstream::eprintln!("sandgait: {WARNING}warning:{WARNING:#} {line}");
}

pub fn note(line: impl Display) {
    anstream::eprintln!("sandgait: {line}");
}

/// What a user may do next.
pub fn next(line: impl Display) {
    anstream::eprintln!("{NEXT}next:{NEXT:#} {line}");
}

/// A text of clap for stdout, in colour where stdout has it.
pub fn styled(text: &StyledStr) -> String {
    match anstream::AutoStream::choice(&std::io::stdout()) {
        anstream::ColorChoice::Never => text.to_string(),
        _ => text.ansi().to_string(),
    }
}
