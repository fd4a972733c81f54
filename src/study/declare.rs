//! What a study is.

use super::inputs::Inputs;
use super::refusal;
use super::result::StudyResult;
use crate::error::{Error, Result, check_range};
use crate::progress::Progress;
use clap::{Arg, ArgMatches, Command};
use std::cmp::Reverse;

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

    /// What a user may do next, as a command to copy.
    fn next(&self) -> Option<String> {
        None
    }

    /// Memory that [`Self::check`] and the work take in proportion to the files, besides the files [bytes]. A server reserves it
    /// before it checks, until the result has been sent.
    fn cost(&self, _inputs: &Inputs) -> usize {
        0
    }

    /// Checks arguments and files, and returns the work. It opens no file: a server has only what was sent.
    fn check(self, inputs: &Inputs) -> Result<StudyWork>;
}

/// Checked work.
pub struct StudyWork {
    /// Lines for people that are known before the work begins.
    pub warnings: Vec<String>,
    /// Memory that the work and its result take beside the request and [`Study::cost`] [bytes]. A server reserves it, or a part of
    /// it, when the turn of the study comes.
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
    fn next(&self) -> Option<String>;
    fn cost(&self, inputs: &Inputs) -> usize;
    fn check(self: Box<Self>, inputs: &Inputs) -> Result<StudyWork>;
}

impl<S: Study> AnyStudy for S {
    fn read(&self, inputs: &mut Inputs) -> Result<()> {
        Study::read(self, inputs)
    }

    fn next(&self) -> Option<String> {
        Study::next(self)
    }

    fn cost(&self, inputs: &Inputs) -> usize {
        Study::cost(self, inputs)
    }

    fn check(self: Box<Self>, inputs: &Inputs) -> Result<StudyWork> {
        Study::check(*self, inputs)
    }
}

/// Largest number of words of a request: our choice, because all options of a task together are some 60.
const MOST_WORDS: usize = 1024;

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

    /// The study with arguments as words: `--name=value`, or `--name`, as the command has them. Its errors name arguments by
    /// keywords.
    pub fn parse(&'static self, words: &[String]) -> Result<Box<dyn AnyStudy>> {
        let study = self.parse_words(words)?;
        Ok(Box::new(StudyByKeywords { entry: self, study }))
    }

    pub(super) fn parse_words(&self, words: &[String]) -> Result<Box<dyn AnyStudy>> {
        check_range("number of arguments", words.len() as f64, 0.0..=MOST_WORDS as f64)?;
        let mut command = self.command().no_binary_name(true).disable_help_flag(true);
        let study = command.try_get_matches_from_mut(words).and_then(|matches| self.of_matches(&matches));
        study.map_err(|refused| refusal::of_request(&command, &refused))
    }

    /// `text` with keywords in place of the options of the command line: plate_size for --plate-size.
    fn in_keywords(&self, text: &str) -> String {
        let command = self.command();
        let names = |argument: &Arg| Some((format!("--{}", argument.get_long()?), argument.get_id().to_string()));
        let mut all: Vec<(String, String)> = command.get_arguments().filter_map(names).collect();
        // The longer name first, because the other may begin it.
        all.sort_by_key(|(long, _)| Reverse(long.len()));
        all.iter().fold(text.to_owned(), |text, (long, keyword)| text.replace(long, keyword))
    }

    /// The error of a study for callers that have keywords.
    fn by_keywords(&self, error: Error) -> Error {
        match error {
            Error::Invalid { field, reason } => Error::invalid(self.in_keywords(&field), self.in_keywords(&reason)),
            other => other,
        }
    }
}

/// A study of which the errors name arguments by keywords.
struct StudyByKeywords {
    entry: &'static StudyEntry,
    study: Box<dyn AnyStudy>,
}

impl AnyStudy for StudyByKeywords {
    fn read(&self, inputs: &mut Inputs) -> Result<()> {
        self.study.read(inputs).map_err(|e| self.entry.by_keywords(e))
    }

    fn next(&self) -> Option<String> {
        self.study.next()
    }

    fn cost(&self, inputs: &Inputs) -> usize {
        self.study.cost(inputs)
    }

    fn check(self: Box<Self>, inputs: &Inputs) -> Result<StudyWork> {
        let Self { entry, study } = *self;
        let mut work = study.check(inputs).map_err(|e| entry.by_keywords(e))?;
        let run = work.run;
        work.run = Box::new(move |progress| run(progress).map_err(|e| entry.by_keywords(e)));
        Ok(work)
    }
}
