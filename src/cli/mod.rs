//! The command line. Wrong usage ends with exit code 2 and one line on stderr, and no file is written. Failures of the
//! machine end with exit code 1.

mod bench;
mod calibrate;
mod config;
mod diagnose;
mod evaluate;
mod grammar;
mod heights;
mod intrude;
mod layout;
mod media;
mod options;
mod play;
mod progress;
mod python;
mod replay;
mod reproduce;
mod robot;
mod robot_check;
mod robot_json;
mod robots;
mod serve;
mod stress;
mod sweep;
mod task_page;
mod tasks;
mod train;
mod trained;
mod trials;
mod validate;
mod walk;

use layout::table;

pub use heights::pack as pack_heights;
pub use robot::{check as check_robot, is_description, pack as pack_robot};
pub use train::{TrainingArgs, learn};

use self::grammar::{one_line, parse};
use self::progress::Bar;
use clap::error::ErrorKind;
use clap::{CommandFactory as _, Parser, Subcommand};
use sandgait::sand::{Law, Medium, SandDescription};
use sandgait::{Error, Result, error::bounded};
use std::ffi::OsString;
use std::io::Write as _;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

/// Batched reinforcement-learning environments of legged robots on sand.
#[derive(Parser)]
#[command(version, max_term_width = 100, arg_required_else_help = true, after_help = EXAMPLES)]
struct Cli {
    #[command(subcommand)]
    command: CliCommand,
}

const EXAMPLES: &str = "Examples:
  sandgait serve --listen unix:/tmp/sand.sock
  sandgait walk --leg L --frequency 2
  sandgait intrude --shape L --csv force.csv
  sandgait tasks --json

Each command has its own --help with more examples.";

/// Replaces paths in a task's options by the files' texts: a robot, sand, hardware, and heights of the ground.
fn read_files(options: &mut serde_json::Value) -> Result<()> {
    robot::read_option(options)?;
    read_text(options.get_mut("sand"))?;
    read_text(options.get_mut("hardware"))?;
    read_text(options.get_mut("domain_rand").and_then(|draws| draws.get_mut("hardware")))?;
    heights::read_option(options)
}

/// Replaces the path of a sand.toml or hardware.toml by its text.
fn read_text(option: Option<&mut serde_json::Value>) -> Result<()> {
    let Some(option) = option else { return Ok(()) };
    // The text of a file has several lines, and a path has one.
    if let Some(path) = option.as_str().filter(|text| !text.is_empty() && !text.contains('\n')) {
        *option = std::fs::read_to_string(path).map_err(|e| Error::file(path.as_ref(), e))?.into();
    }
    Ok(())
}

/// The commands, each with the file and the type of its arguments.
macro_rules! commands {
    ($($name:ident: $file:ident::$arguments:ident),* $(,)?) => {
        #[derive(Subcommand)]
        enum CliCommand {
            $($name($file::$arguments)),*
        }

        /// Runs a command; its text goes to stdout.
        fn run(command: CliCommand) -> Result<String> {
            match command {
                $(CliCommand::$name(arguments) => arguments.run()),*
            }
        }
    };
}

commands! {
    Serve: serve::ServeArgs,
    Walk: walk::WalkArgs,
    Bench: bench::BenchArgs,
    Diagnose: diagnose::DiagnoseArgs,
    Evaluate: evaluate::EvaluateArgs,
    Intrude: intrude::IntrudeArgs,
    Media: media::MediaArgs,
    Stress: stress::StressArgs,
    Play: play::PlayArgs,
    Replay: replay::ReplayArgs,
    Reproduce: reproduce::ReproduceArgs,
    Robot: robot::RobotArgs,
    Robots: robots::RobotsArgs,
    Calibrate: calibrate::CalibrateArgs,
    Certify: python::CertifyArgs,
    Adapt: python::AdaptArgs,
    Sweep: sweep::SweepArgs,
    Tasks: tasks::TasksArgs,
    Train: train::TrainArgs,
    Validate: validate::ValidateArgs,
}

/// Runs the command line `arguments`, the program's name first, and returns the exit code.
pub fn main(arguments: impl IntoIterator<Item = OsString>) -> u8 {
    let mut arguments: Vec<OsString> = arguments.into_iter().collect();
    // `help` is a command that clap adds, without a help of its own.
    if arguments.get(1).is_some_and(|command| command == "help") {
        arguments.retain(|argument| argument != "--help" && argument != "-h");
    }
    let outcome = match parse(&arguments) {
        Ok(Cli { command: CliCommand::Serve(serve::ServeArgs { config: Some(file), .. }) }) => {
            with_file(&file, arguments).and_then(|cli| run(cli.command))
        }
        Ok(Cli { command: CliCommand::Robot(robot) }) if robot.check => match robot.run_check() {
            Ok((text, stands)) => return print(&text).max(u8::from(!stands)),
            Err(error) => Err(error),
        },
        Ok(cli) => run(cli.command),
        Err(e) if matches!(e.kind(), ErrorKind::DisplayHelp | ErrorKind::DisplayVersion) => Ok(e.to_string()),
        Err(e) if e.kind() == ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand => {
            Err(Error::invalid("command", "missing; see sandgait --help"))
        }
        Err(e) => {
            eprintln!("sandgait: {}", bounded(one_line(&e)));
            return 2;
        }
    };
    match outcome {
        Ok(text) => print(&text),
        Err(error) => {
            eprintln!("sandgait: {}", bounded(error.to_string().replace('\n', " ")));
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
    parse(&all.into_iter().chain(given).collect::<Vec<_>>()).map_err(|e| Error::file(file, one_line(&e)))
}

/// A parser of whole numbers in `range`. Its refusals name the range.
fn whole<T: TryFrom<u64>>(
    range: RangeInclusive<u64>,
) -> impl Fn(&str) -> std::result::Result<T, String> + Clone + Send + Sync {
    move |text| {
        let number: i128 = text.parse().map_err(|_| "no whole number".to_owned())?;
        let within = u64::try_from(number).ok().filter(|n| range.contains(n)).and_then(|n| T::try_from(n).ok());
        within.ok_or_else(|| format!("{number} is outside [{}, {}]", range.start(), range.end()))
    }
}

fn exit_code(error: &Error) -> u8 {
    match error {
        Error::Invalid { .. } | Error::Unknown { .. } | Error::Replaced { .. } | Error::File { .. } => 2,
        Error::Unwritten { .. } | Error::Lost { .. } | Error::Internal(_) => 1,
        // As a shell says of a program that Ctrl-C has ended.
        Error::Cancelled(_) => 130,
        Error::OutOfOrder(_) | Error::Exhausted(_) => 1,
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

/// Largest number of threads: our choice, because usual machines have fewer cores.
const MOST_THREADS: u64 = 1024;

/// The sand of a command.
#[derive(clap::Args)]
struct SandArgs {
    /// Sand: a name from `sandgait media`, zeta=VALUE or mu=VALUE,rho=VALUE
    #[arg(long, default_value = Medium::DEFAULT)]
    medium: String,
    /// Resistive force law: li2013, penetration-drag-1d or agarwal2023
    #[arg(long, default_value = Law::Li2013.name())]
    law: String,
    /// A sand.toml, for example from a diagnosis, instead of --medium and --law
    #[arg(long, value_name = "FILE", conflicts_with_all = ["medium", "law"])]
    sand: Option<PathBuf>,
}

impl SandArgs {
    /// The sand of the file, or of medium and law by their names. Warns on stderr if its numbers are extrapolated.
    fn sand(&self) -> Result<SandDescription> {
        match &self.sand {
            Some(file) => SandDescription::load(file),
            None => named_sand(&self.medium, &self.law),
        }
    }

    /// Like [`Self::sand`], for walking robots. Also warns on stderr of each mechanism that has no effect on them.
    fn sand_to_walk_on(&self) -> Result<SandDescription> {
        let sand = self.sand()?;
        warn_of_unfelt(&sand);
        Ok(sand)
    }
}

fn named_sand(medium: &str, law: &str) -> Result<SandDescription> {
    if let Some(caution) = Medium::caution(medium) {
        eprintln!("sandgait: warning: {caution}");
    }
    SandDescription::named(medium, law)
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
    let lines = sand.mechanisms.unfelt_by_walkers();
    warn(&lines.iter().map(|line| format!("sand {}: {line}", sand.name)).collect::<Vec<_>>(), "");
}

/// Number of notes of one kind that a warning shows: our choice, so that it can be read at a glance.
const SHOWN: usize = 3;

/// Writes one warning on stderr with `notes`, which are of one kind. `whole`: where to find the notes that are left
/// out.
fn warn(notes: &[String], whole: &str) {
    if notes.is_empty() {
        return;
    }
    let more = match notes.len().saturating_sub(SHOWN) {
        0 => String::new(),
        n if whole.is_empty() => format!("; and {n} more"),
        n => format!("; and {n} more: {whole}"),
    };
    eprintln!("sandgait: warning: {}{more}", notes[..notes.len().min(SHOWN)].join("; "));
}

/// Pretty JSON with a newline.
fn json(value: &serde_json::Value) -> String {
    format!("{value:#}\n")
}
