//! The command line. Wrong use ends with exit code 2 and one line on stderr, and nothing has been written; what the
//! machine could not do ends with 1.

mod bench;
mod calibrate;
mod diagnose;
mod intrude;
mod media;
mod reproduce;
mod serve;
mod stress;
mod sweep;
mod tasks;
mod walk;

use clap::error::ErrorKind;
use clap::{Parser, Subcommand};
use sandgait::sand::Medium;
use sandgait::{Error, Result};
use std::io::Write as _;
use std::process::ExitCode;

/// Batched reinforcement-learning environments of legged robots on sand.
#[derive(Parser)]
#[command(version, max_term_width = 100, arg_required_else_help = true, after_help = EXAMPLES)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

const EXAMPLES: &str = "Examples:
  sandgait serve --listen unix:/tmp/sand.sock
  sandgait walk --leg L --frequency 2
  sandgait intrude --shape L --csv force.csv
  sandgait tasks --json

Each command has its own --help with more examples.";

#[derive(Subcommand)]
enum Command {
    Serve(serve::Serve),
    Walk(walk::Walk),
    Bench(bench::Bench),
    Diagnose(diagnose::Diagnose),
    Intrude(intrude::Intrude),
    Media(media::Media),
    Stress(stress::Stress),
    Reproduce(reproduce::Reproduce),
    Calibrate(calibrate::Calibrate),
    Sweep(sweep::Sweep),
    Tasks(tasks::Tasks),
}

pub fn main() -> ExitCode {
    let outcome = match Cli::try_parse() {
        Ok(cli) => run(cli.command),
        Err(e) if matches!(e.kind(), ErrorKind::DisplayHelp | ErrorKind::DisplayVersion) => Ok(e.to_string()),
        Err(e) if e.kind() == ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand => {
            Err(Error::invalid("command", "missing; see sandgait --help"))
        }
        Err(e) => {
            eprintln!("sandgait: {}", one_line(&e.to_string()));
            return ExitCode::from(2);
        }
    };
    match outcome {
        Ok(text) => print(&text),
        Err(error) => {
            eprintln!("sandgait: {}", error.to_string().replace('\n', " "));
            ExitCode::from(exit_code(&error))
        }
    }
}

/// Runs a command; its text goes to stdout.
fn run(command: Command) -> Result<String> {
    match command {
        Command::Serve(c) => c.run(),
        Command::Walk(c) => c.run(),
        Command::Bench(c) => c.run(),
        Command::Diagnose(c) => c.run(),
        Command::Intrude(c) => c.run(),
        Command::Media(c) => c.run(),
        Command::Stress(c) => c.run(),
        Command::Reproduce(c) => c.run(),
        Command::Calibrate(c) => c.run(),
        Command::Sweep(c) => c.run(),
        Command::Tasks(c) => c.run(),
    }
}

fn exit_code(error: &Error) -> u8 {
    match error {
        Error::Invalid { .. } | Error::Unknown { .. } | Error::File { .. } => 2,
        Error::OutOfOrder(_) | Error::Exhausted(_) | Error::Cancelled(_) => 1,
    }
}

/// Writes to stdout. A reader that has gone (as in `| head -1`) has what it wanted.
fn print(text: &str) -> ExitCode {
    let mut out = std::io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => {
            eprintln!("sandgait: stdout: {e}");
            ExitCode::FAILURE
        }
        _ => ExitCode::SUCCESS,
    }
}

/// clap's message without its usage block: `error: a … tip: b`.
fn one_line(message: &str) -> String {
    let said = message.split("\nUsage:").next().unwrap_or(message);
    let lines = said.lines().map(str::trim).filter(|l| !l.is_empty() && !l.starts_with("For more information"));
    lines.collect::<Vec<_>>().join(" ").trim_start_matches("error: ").replace(" tip:", "; tip:")
}

/// A medium by name; a warning on stderr if its numbers are extrapolated.
fn medium(name: &str) -> Result<Medium> {
    let medium = Medium::named(name)?;
    if let Some(caution) = Medium::caution(name) {
        eprintln!("sandgait: warning: {caution}");
    }
    Ok(medium)
}

/// Pretty JSON with a newline.
fn json(value: &serde_json::Value) -> String {
    format!("{value:#}\n")
}

/// Rows as left-aligned columns, two blanks apart.
fn table(rows: &[Vec<String>]) -> String {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let width = |k: usize| rows.iter().filter_map(|r| r.get(k)).map(|c| c.chars().count()).max().unwrap_or(0);
    let widths: Vec<_> = (0..columns).map(width).collect();
    let line = |row: &Vec<String>| {
        let cells = row.iter().zip(&widths).map(|(cell, w)| format!("{cell:w$}"));
        format!("{}\n", cells.collect::<Vec<_>>().join("  ").trim_end())
    };
    rows.iter().map(line).collect()
}
