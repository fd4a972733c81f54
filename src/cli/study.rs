//! The commands of studies, made from their declarations.

use super::Bar;
use clap::{Arg, ArgMatches, Command, FromArgMatches, Subcommand, value_parser};
use sandgait::files::{self, Lock};
use sandgait::study::{AnyStudy, Inputs, STUDIES, StudyEntry, StudyFile, StudyResult};
use sandgait::{Error, Result};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// A study with its arguments, and where its result goes.
pub struct StudyCommand {
    study: Box<dyn AnyStudy>,
    outputs: StudyOutputs,
}

/// The folder of a result, for this process alone.
struct LockedFolder {
    _lock: Lock,
    /// The folder, if it was not there before.
    new: Option<PathBuf>,
}

impl LockedFolder {
    /// Removes the folder again, because nothing was written into it.
    fn leave(&self) {
        if let Some(folder) = &self.new {
            // A folder that another process has filled meanwhile stays.
            let _ = std::fs::remove_dir(folder);
        }
    }
}

/// Where a result goes.
struct StudyOutputs {
    csv: Option<PathBuf>,
    json: Option<PathBuf>,
    out: Option<PathBuf>,
}

/// `--json` without a file.
const STDOUT: &str = "-";

/// The options of [`StudyOutputs`]: id, name, value and help. A study may have an option of the same name, which then replaces
/// ours.
const OUTPUTS: [(&str, &str, &str, &str); 3] = [
    ("table as csv", "csv", "FILE", "Write the table to this CSV file"),
    ("result as json", "json", "FILE", "Print JSON, or write it to FILE"),
    ("folder of all", "out", "DIR", "Write all tables and files of the result into this folder"),
];

impl Subcommand for StudyCommand {
    fn augment_subcommands(all: Command) -> Command {
        STUDIES.iter().fold(all, |all, entry| all.subcommand(command(entry)))
    }

    fn augment_subcommands_for_update(all: Command) -> Command {
        Self::augment_subcommands(all)
    }

    fn has_subcommand(name: &str) -> bool {
        STUDIES.iter().any(|entry| entry.name == name)
    }
}

/// The command of a study.
fn command(entry: &StudyEntry) -> Command {
    OUTPUTS.iter().fold(entry.command(), |study, (id, long, value, help)| {
        if study.get_arguments().any(|argument| argument.get_long() == Some(*long)) {
            return study;
        }
        let option = Arg::new(*id).long(*long).value_name(*value).help(*help).value_parser(value_parser!(PathBuf));
        let alone = *long == "json";
        study.arg(if alone { option.num_args(0..=1).default_missing_value(STDOUT) } else { option })
    })
}

impl FromArgMatches for StudyCommand {
    fn from_arg_matches(matches: &ArgMatches) -> clap::error::Result<Self> {
        let missing = || clap::Error::new(clap::error::ErrorKind::MissingSubcommand);
        let (name, matches) = matches.subcommand().ok_or_else(missing)?;
        let entry = STUDIES.iter().find(|entry| entry.name == name).ok_or_else(missing)?;
        Ok(Self { study: entry.of_matches(matches)?, outputs: StudyOutputs::of(matches) })
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> clap::error::Result<()> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

impl StudyCommand {
    pub fn run(self) -> Result<String> {
        let Self { study, outputs } = self;
        let mut inputs = Inputs::local(super::read_files);
        study.read(&mut inputs)?;
        let next = study.next();
        let work = study.check(&inputs)?;
        drop(inputs);
        let folder = outputs.prepare()?;
        super::warn_each(&work.warnings);
        let clock = Instant::now();
        let result = (work.run)(&Bar::new()).inspect_err(|_| folder.iter().for_each(LockedFolder::leave))?;
        super::warn_each(&result.warnings);
        super::progress::next_step(next);
        outputs.write(&result, clock.elapsed().as_secs_f64())
    }
}

impl StudyOutputs {
    fn of(matches: &ArgMatches) -> Self {
        // An option that the study has replaced is not there.
        let [csv, json, out] = OUTPUTS.map(|(id, ..)| matches.try_get_one::<PathBuf>(id).ok().flatten().cloned());
        Self { csv, json, out }
    }

    /// Refuses paths at which nothing can be written, before the work begins. Creates the folder, and locks it for this process.
    fn prepare(&self) -> Result<Option<LockedFolder>> {
        let json = self.json.as_ref().filter(|path| path.as_os_str() != STDOUT);
        self.csv.iter().chain(json).try_for_each(|path| writable(path))?;
        let Some(folder) = &self.out else { return Ok(None) };
        let new = (!folder.exists()).then(|| folder.clone());
        std::fs::create_dir_all(folder).map_err(|e| Error::unwritten(folder, &e))?;
        let lock = Lock::new(folder, "choose another one with --out, or wait until it has ended")?;
        Ok(Some(LockedFolder { _lock: lock, new }))
    }

    /// Writes the result of `seconds` of work; returns what goes to stdout.
    fn write(&self, result: &StudyResult, seconds: f64) -> Result<String> {
        // A path may be a device, such as /dev/stdout.
        let put = |path: &Path, content: &[u8]| std::fs::write(path, content).map_err(|e| Error::unwritten(path, &e));
        for StudyFile { name, content } in &result.named_files {
            put(Path::new(name), content)?;
        }
        if let Some(reason) = &result.failure {
            return Err(Error::Exhausted(reason.clone()));
        }
        if let (Some(path), Some(table)) = (&self.csv, result.tables.first()) {
            put(path, table.csv().as_bytes())?;
        }
        if let Some(folder) = &self.out {
            for table in &result.tables {
                files::write(&folder.join(format!("{}.csv", table.name)), table.csv().as_bytes())?;
            }
            for StudyFile { name, content } in &result.files {
                let path = folder.join(name);
                let inside = path.parent().unwrap_or(folder);
                std::fs::create_dir_all(inside).map_err(|e| Error::unwritten(inside, &e))?;
                files::write(&path, content)?;
            }
        }
        let pace = (result.simulated > 0.0).then(|| result.simulated / seconds);
        if let Some(path) = &self.json {
            let mut all = result.json();
            all.extend(pace.map(|pace| ("real_time_factor".to_owned(), pace.into())));
            let text = super::json(&all.into());
            if path.as_os_str() == STDOUT {
                return Ok(text);
            }
            put(path, text.as_bytes())?;
        }
        let text = match pace {
            Some(pace) => format!("{} ({pace:.0} times real time)\n", result.summary.trim_end()),
            None => result.summary.clone(),
        };
        // People look at the page first.
        let page = result.files.iter().find(|file| file.name.ends_with(".html"));
        let page = self.out.as_ref().zip(page).map(|(folder, page)| format!("{}\n", folder.join(&page.name).display()));
        Ok(text + &page.unwrap_or_default())
    }
}

/// Refuses a path that is a folder or in a missing folder. Creates nothing.
fn writable(path: &Path) -> Result<()> {
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    std::fs::metadata(folder).map_err(|e| Error::unwritten(path, &e))?;
    match path.is_dir() {
        true => Err(Error::unwritten(path, &ErrorKind::IsADirectory.into())),
        false => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sandgait::study::StudyTable;

    #[test]
    fn a_result_of_no_use_is_a_failure_and_only_its_recording_is_written() {
        let folder = tempfile::tempdir().unwrap();
        let [csv, recording] = ["walks.csv", "walk.rec"].map(|name| folder.path().join(name));
        let result = StudyResult {
            failure: Some("the simulation diverged".into()),
            named_files: vec![StudyFile::new(recording.to_str().unwrap(), "states")],
            ..StudyResult::table(StudyTable::default())
        };
        let outputs = StudyOutputs { csv: Some(csv.clone()), json: None, out: None };
        let error = outputs.write(&result, 1.0).unwrap_err();
        assert_eq!((crate::cli::exit_code(&error), error.to_string().as_str()), (1, "the simulation diverged"));
        assert!(recording.exists() && !csv.exists());
    }
}
