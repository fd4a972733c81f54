//! What a study is.

use super::inputs::Inputs;
use super::refusal;
use super::result::StudyResult;
use crate::error::Result;
use crate::progress::Progress;
use clap::{ArgMatches, Command};

/// A study: a struct whose fields are its arguments. The comment of a field is its help, with the unit in brackets.
pub trait Study: clap::Args + Send + 'static {
    /// Name of the command and of the function in Python.
    const NAME: &'static str;
    /// The Python class of its result, in `sandgait.results`; `Table` has columns and units, and nothing else.
    const PYTHON: &'static str = "Table";

    /// Reads the files that the arguments name, on the machine of the user.
    fn read(&self, _inputs: &mut Inputs) -> Result<()> {
        Ok(())
    }

    /// Checks arguments and files, and returns the work. It opens no file: a server has only what was sent.
    fn check(self, inputs: &Inputs) -> Result<StudyWork>;
}

/// Checked work.
pub struct StudyWork {
    /// Lines for people that are known before the work begins.
    pub warnings: Vec<String>,
    /// Memory that the work and its result take beside the request [bytes]. A server reserves it.
    pub bytes: usize,
    /// Does it take only some milliseconds? A server then does it at once.
    pub quick: bool,
    pub run: WorkFunction,
}

/// An error of the progress stops the work.
type WorkFunction = Box<dyn FnOnce(&dyn Progress) -> Result<StudyResult> + Send>;

impl StudyWork {
    /// Work without warnings whose memory is small.
    pub fn new(run: impl FnOnce(&dyn Progress) -> Result<StudyResult> + Send + 'static) -> Self {
        Self { warnings: Vec::new(), bytes: 0, quick: false, run: Box::new(run) }
    }

    pub fn warning(mut self, lines: impl IntoIterator<Item = String>) -> Self {
        self.warnings.extend(lines);
        self
    }

    /// Does the work; the result has all warnings.
    pub fn finish(self, progress: &dyn Progress) -> Result<StudyResult> {
        let mut result = (self.run)(progress)?;
        result.warnings.splice(0..0, self.warnings);
        Ok(result)
    }

    pub fn quick(mut self) -> Self {
        self.quick = true;
        self
    }

    pub fn taking(mut self, bytes: usize) -> Self {
        self.bytes = bytes;
        self
    }
}

/// A study with its arguments, whose type is hidden.
pub trait AnyStudy: Send {
    fn read(&self, inputs: &mut Inputs) -> Result<()>;
    fn check(self: Box<Self>, inputs: &Inputs) -> Result<StudyWork>;
}

impl<S: Study> AnyStudy for S {
    fn read(&self, inputs: &mut Inputs) -> Result<()> {
        Study::read(self, inputs)
    }

    fn check(self: Box<Self>, inputs: &Inputs) -> Result<StudyWork> {
        Study::check(*self, inputs)
    }
}

/// A row of the registry.
pub struct StudyEntry {
    pub name: &'static str,
    pub python: &'static str,
    augment: fn(Command) -> Command,
    from_matches: fn(&ArgMatches) -> clap::error::Result<Box<dyn AnyStudy>>,
}

impl StudyEntry {
    pub const fn of<S: Study>() -> Self {
        Self {
            name: S::NAME,
            python: S::PYTHON,
            augment: S::augment_args,
            from_matches: |matches| Ok(Box::new(S::from_arg_matches(matches)?)),
        }
    }

    /// The arguments as a command. `-1` is a value, so that a number below its range is refused with the range.
    pub fn command(&self) -> Command {
        (self.augment)(Command::new(self.name)).mut_args(|argument| {
            let takes_values = argument.get_action().takes_values() && !argument.is_allow_hyphen_values_set();
            argument.allow_negative_numbers(takes_values)
        })
    }

    /// The study with the arguments of a command line.
    pub fn of_matches(&self, matches: &ArgMatches) -> clap::error::Result<Box<dyn AnyStudy>> {
        (self.from_matches)(matches)
    }

    /// The study with arguments as words: `--name=value`, or `--name`, as the command has them.
    pub fn parse(&self, words: &[String]) -> Result<Box<dyn AnyStudy>> {
        let mut command = self.command().no_binary_name(true).disable_help_flag(true);
        let study = command.try_get_matches_from_mut(words).and_then(|matches| self.of_matches(&matches));
        study.map_err(|refused| refusal::of_request(&command, &refused))
    }
}
