//! The command line. Wrong usage ends with exit code 2 and one line on stderr, and no file is written. Failures of the
//! machine end with exit code 1.

mod bench;
mod calibrate;
mod config;
mod design;
mod diagnose;
mod evaluate;
mod heights;
mod intrude;
mod media;
mod replay;
mod reproduce;
mod robot;
mod robot_check;
mod robots;
mod serve;
mod stress;
mod sweep;
mod task_page;
mod tasks;
mod train;
mod trials;
mod validate;
mod walk;

pub use heights::pack as pack_heights;
pub use robot::{check as check_robot, is_description, pack as pack_robot};
pub use train::{Training, learn};

use clap::error::ErrorKind;
use clap::{CommandFactory as _, Parser, Subcommand};
use indicatif::{ProgressBar, ProgressStyle};
use sandgait::progress::Progress;
use sandgait::sand::{Medium, SandDescription};
use sandgait::{Error, Result};
use std::ffi::OsString;
use std::io::Write as _;
use std::path::Path;

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

/// Replaces paths in a task's options by the files' packed texts: a robot, and heights of the ground.
fn read_files(options: &mut serde_json::Value) -> Result<()> {
    robot::read_option(options)?;
    heights::read_option(options)
}

#[derive(Subcommand)]
enum Command {
    Serve(serve::Serve),
    Walk(walk::Walk),
    Bench(bench::Bench),
    Diagnose(diagnose::Diagnose),
    Evaluate(evaluate::Evaluate),
    Intrude(intrude::Intrude),
    Media(media::Media),
    Stress(stress::Stress),
    Replay(replay::Replay),
    Reproduce(reproduce::Reproduce),
    Robot(robot::Robot),
    Robots(robots::Robots),
    Calibrate(calibrate::Calibrate),
    Sweep(sweep::Sweep),
    Tasks(tasks::Tasks),
    Train(train::Train),
    Validate(validate::Validate),
}

/// Runs the command line `arguments`, the program's name first, and returns the exit code.
pub fn main(arguments: impl IntoIterator<Item = OsString>) -> u8 {
    let arguments: Vec<OsString> = arguments.into_iter().collect();
    let outcome = match Cli::try_parse_from(&arguments) {
        Ok(Cli { command: Command::Serve(serve::Serve { config: Some(file), .. }) }) => {
            with_file(&file, arguments).and_then(|cli| run(cli.command))
        }
        Ok(Cli { command: Command::Robot(robot) }) if robot.check => match robot.run_check() {
            Ok((text, stands)) => return print(&text).max(u8::from(!stands)),
            Err(error) => Err(error),
        },
        Ok(cli) => run(cli.command),
        Err(e) if matches!(e.kind(), ErrorKind::DisplayHelp | ErrorKind::DisplayVersion) => Ok(e.to_string()),
        Err(e) if e.kind() == ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand => {
            Err(Error::invalid("command", "missing; see sandgait --help"))
        }
        Err(e) => {
            eprintln!("sandgait: {}", one_line(&e.to_string()));
            return 2;
        }
    };
    match outcome {
        Ok(text) => print(&text),
        Err(error) => {
            eprintln!("sandgait: {}", error.to_string().replace('\n', " "));
            exit_code(&error)
        }
    }
}

/// The same command line, with the options of a file inserted.
fn with_file(file: &Path, given: Vec<OsString>) -> Result<Cli> {
    let mut given = given.into_iter();
    let mut all: Vec<_> = given.by_ref().take(2).collect();
    let cli = Cli::command();
    let command = all.get(1).and_then(|name| cli.find_subcommand(name));
    all.extend(config::arguments(command.unwrap_or(&cli), file)?);
    // The command line alone was valid, so the error is in the file.
    Cli::try_parse_from(all.into_iter().chain(given)).map_err(|e| Error::file(file, one_line(&e.to_string())))
}

/// Runs a command; its text goes to stdout.
fn run(command: Command) -> Result<String> {
    match command {
        Command::Serve(c) => c.run(),
        Command::Walk(c) => c.run(),
        Command::Bench(c) => c.run(),
        Command::Diagnose(c) => c.run(),
        Command::Evaluate(c) => c.run(),
        Command::Intrude(c) => c.run(),
        Command::Media(c) => c.run(),
        Command::Stress(c) => c.run(),
        Command::Replay(c) => c.run(),
        Command::Reproduce(c) => c.run(),
        Command::Robot(c) => c.run(),
        Command::Robots(c) => c.run(),
        Command::Calibrate(c) => c.run(),
        Command::Sweep(c) => c.run(),
        Command::Tasks(c) => c.run(),
        Command::Train(c) => c.run(),
        Command::Validate(c) => c.run(),
    }
}

fn exit_code(error: &Error) -> u8 {
    match error {
        Error::Invalid { .. } | Error::Unknown { .. } | Error::Replaced { .. } | Error::File { .. } => 2,
        Error::OutOfOrder(_) | Error::Exhausted(_) | Error::Cancelled(_) | Error::Internal(_) => 1,
    }
}

/// Writes to stdout. If the reader has closed it (as in `| head -1`), that is no error.
fn print(text: &str) -> u8 {
    let mut out = std::io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => {
            eprintln!("sandgait: stdout: {e}");
            1
        }
        _ => 0,
    }
}

/// clap's message without its usage block: `error: a … tip: b`.
fn one_line(message: &str) -> String {
    let said = message.split("\nUsage:").next().unwrap_or(message);
    let lines = said.lines().map(str::trim).filter(|l| !l.is_empty() && !l.starts_with("For more information"));
    lines.collect::<Vec<_>>().join(" ").trim_start_matches("error: ").replace(" tip:", "; tip:")
}

/// The sand of a file, or of a medium and a law by their names. Warns on stderr if its numbers are extrapolated.
fn sand(medium: &str, law: &str, file: Option<&Path>) -> Result<SandDescription> {
    if let Some(file) = file {
        return SandDescription::load(file);
    }
    if let Some(caution) = Medium::caution(medium) {
        eprintln!("sandgait: warning: {caution}");
    }
    SandDescription::named(medium, law)
}

/// The same as [`sand`], for walking robots. Warns on stderr of each mechanism that has no effect on them.
fn sand_to_walk_on(medium: &str, law: &str, file: Option<&Path>) -> Result<SandDescription> {
    let sand = sand(medium, law, file)?;
    warn_of_unfelt(&sand);
    Ok(sand)
}

/// Warns of mechanisms without effect in the `sand` among a task's options.
fn warn_of_unfelt_option(options: &serde_json::Value) {
    let text = options.get("sand").and_then(serde_json::Value::as_str);
    // If the text is not a sand, the task refuses it with its own message.
    if let Some(sand) = text.and_then(|text| SandDescription::from_toml(text).ok()) {
        warn_of_unfelt(&sand);
    }
}

fn warn_of_unfelt(sand: &SandDescription) {
    for line in sand.mechanisms.unfelt_by_walkers() {
        eprintln!("sandgait: warning: sand {}: {line}", sand.name);
    }
}

/// A progress bar. If the output is not a terminal, indicatif prints nothing.
struct Bar(ProgressBar);

impl Bar {
    const STEPS: u64 = 1000;

    fn new() -> Self {
        let style = ProgressStyle::with_template("{bar:40} {percent} % of {msg}, {eta} left");
        Self(ProgressBar::new(Self::STEPS).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar())))
    }
}

impl Progress for Bar {
    fn report(&self, done: f64, stage: &str) -> Result<()> {
        self.0.set_message(stage.to_owned());
        self.0.set_position((done * Self::STEPS as f64) as u64);
        Ok(())
    }
}

impl Drop for Bar {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
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
