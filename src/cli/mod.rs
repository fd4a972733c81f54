//! The command line. Wrong usage ends with exit code 2 and one line on stderr, and no file is written. Failures of the
//! machine end with exit code 1.

mod bench;
mod completions;
mod config;
mod grammar;
mod heights;
mod media;
mod play;
mod progress;
mod python;
mod replay;
mod robot;
mod robot_check;
mod robot_json;
mod robots;
mod say;
mod serve;
mod signals;
mod stress;
mod studies;
mod study;
mod task_page;
mod tasks;
mod train;

pub use heights::pack as pack_heights;
pub use robot::{check as check_robot, is_description, pack as pack_robot};
pub use train::{TrainingArgs, learn};

use self::grammar::parse;
use self::progress::Bar;
use clap::error::ErrorKind;
use clap::{CommandFactory as _, Parser, Subcommand};
use sandgait::sand::{Medium, SandDescription};
use sandgait::study::arguments::whole;
use sandgait::study::layout::table;
use sandgait::study::options::{OptionArgs, unfelt_option};
use sandgait::study::refusal::one_line;
use sandgait::{Error, Result, error::bounded, files};
use std::ffi::OsString;
use std::io::Write as _;
use std::path::Path;

/// Batched reinforcement-learning environments of legged robots on sand.
#[derive(Parser)]
#[command(version, styles = say::HELP, max_term_width = 100, arg_required_else_help = true, after_help = EXAMPLES)]
struct Cli {
    /// Write no progress, notes and next steps to stderr; warnings and errors stay
    #[arg(long, short, global = true)]
    quiet: bool,
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
        *option = files::read_text(path.as_ref())?.into();
    }
    Ok(())
}

/// The commands beside the studies, each with the file and the type of its arguments.
macro_rules! commands {
    ($($name:ident: $file:ident::$arguments:ident),* $(,)?) => {
        #[derive(Subcommand)]
        enum CliCommand {
            #[command(flatten)]
            Study(study::StudyCommand),
            $($name($file::$arguments)),*
        }

        /// Runs a command; its text goes to stdout.
        fn run(command: CliCommand) -> Result<String> {
            match command {
                CliCommand::Study(study) => study.run(),
                $(CliCommand::$name(arguments) => arguments.run()),*
            }
        }
    };
}

commands! {
    Serve: serve::ServeArgs,
    Bench: bench::BenchArgs,
    Media: media::MediaArgs,
    Stress: stress::StressArgs,
    Play: play::PlayArgs,
    Replay: replay::ReplayArgs,
    Robot: robot::RobotArgs,
    Robots: robots::RobotsArgs,
    Studies: studies::StudiesArgs,
    Certify: python::CertifyArgs,
    Adapt: python::AdaptArgs,
    Tasks: tasks::TasksArgs,
    Train: train::TrainArgs,
    Completions: completions::CompletionsArgs,
}

/// Runs the command line `arguments`, the program's name first, and returns the exit code.
pub fn main(arguments: impl IntoIterator<Item = OsString>) -> u8 {
    let mut arguments: Vec<OsString> = arguments.into_iter().collect();
    // `help` is a command that clap adds, without a help of its own.
    if arguments.get(1).is_some_and(|command| command == "help") {
        arguments.retain(|argument| argument != "--help" && argument != "-h");
    }
    let parsed = parse(&arguments);
    if parsed.as_ref().is_ok_and(|cli| cli.quiet) {
        progress::silence();
    }
    let outcome = match parsed {
        Ok(Cli { command: CliCommand::Serve(serve::ServeArgs { config: Some(file), .. }), .. }) => {
            with_file(&file, arguments).and_then(|cli| run(cli.command))
        }
        Ok(Cli { command: CliCommand::Robot(robot), .. }) if robot.check => match robot.run_check() {
            Ok((text, stands)) => return print(&text).max(u8::from(!stands)),
            Err(error) => Err(error),
        },
        Ok(cli) => run(cli.command),
        // Without a command clap's error is the help.
        Err(e)
            if matches!(
                e.kind(),
                ErrorKind::DisplayHelp
                    | ErrorKind::DisplayVersion
                    | ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand
            ) =>
        {
            return print(&say::styled(&e.render()));
        }
        Err(e) => {
            say::error(bounded(one_line(&e)));
            return 2;
        }
    };
    match outcome {
        Ok(text) => {
            let code = print(&text);
            progress::say_next();
            code
        }
        Err(error) => {
            say::error(bounded(error.to_string().replace('\n', " ")));
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
            say::error(format_args!("stdout: {e}"));
            1
        }
        _ => 0,
    }
}

/// Largest number of threads: our choice, because usual machines have fewer cores.
const MOST_THREADS: u64 = 1024;

/// Sand by names. Warns on stderr if its numbers are extrapolated.
fn named_sand(medium: &str, law: &str) -> Result<SandDescription> {
    warn_each(Medium::caution(medium).as_slice());
    SandDescription::named(medium, law)
}

/// Warns of mechanisms without effect in the `sand` among a task's options.
fn warn_of_unfelt_option(options: &serde_json::Value) {
    warn_each(unfelt_option(options).as_slice());
}

/// Writes each line as a warning of its own.
fn warn_each(lines: &[String]) {
    lines.iter().for_each(say::warning);
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
    say::warning(format_args!("{}{more}", notes[..notes.len().min(SHOWN)].join("; ")));
}

/// Pretty JSON with a newline.
fn json(value: &serde_json::Value) -> String {
    format!("{value:#}\n")
}
