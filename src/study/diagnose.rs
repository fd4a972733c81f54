//! `diagnose`: where a simulation disagrees with measured data, and why.

use super::arguments::{DataPath, TomlPath};
use super::declare::{Study, StudyWork};
use super::inputs::Inputs;
use super::result::{StudyColumn, StudyFile, StudyResult, StudyTable};
use crate::error::{Error, Result};
use crate::progress::Progress;
use crate::sand::intruder::BodyShape;
use crate::sim::Robot;
use bytes::Bytes;
use sandgait_diagnose::check::finding::Severity;
use sandgait_diagnose::experiment::Experiment;
use sandgait_diagnose::report::{Curves, Diagnosis};
use serde_json::{Map, json};
use std::path::Path;

/// Memory of a diagnosis for each row of its data [bytes]: 929 MiB were measured for 40,000 rows of a force log, when
/// all models ran at the same time (2026-11-23).
const ROW: usize = 24 << 10;

/// Largest data that were sent [bytes]: our choice. 40,000 rows of a force log, the most that a diagnosis takes, have about 8 MB;
/// logs of robots may have more rows.
const SENT_DATA: usize = 64 << 20;

/// Files of a report.
const FILES: [&str; 4] = ["report.json", "report.html", "sand.toml", "hardware.toml"];

/// Find where the simulation disagrees with measured data, name the cause, extend the model and measure the gain.
///
/// The files are report.json, report.html, sand.toml and hardware.toml. The table "curves" has a row for each sample: trial,
/// condition, shape and progress (angle [rad] or position along the path [m]). Each measured channel C has four columns: C,
/// the predictions C_plain and C_extended of the two models, and C_sd, the standard deviation of one repetition.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  sandgait diagnose forces.csv --experiment experiment.toml --out report")]
pub struct Diagnose {
    /// Measured data as CSV; `python -m sandgait.logs` converts Parquet, LeRobot data sets, MCAP and ROS bags
    data: DataPath,
    /// Facts that the data file does not contain: medium, shapes, units (TOML)
    #[arg(long, value_name = "FILE")]
    experiment: TomlPath,
}

impl Study for Diagnose {
    const NAME: &'static str = "diagnose";
    const PYTHON: &'static str = "Diagnosis";

    fn read(&self, inputs: &mut Inputs) -> Result<()> {
        inputs.read(&self.experiment.0)?;
        inputs.read(&self.data.0)?;
        // Results of earlier diagnoses. A text of several lines is the content of a file already.
        let tables: toml::Table = toml(inputs.text(&self.experiment.0)?)?.parse().unwrap_or_default();
        let named = ["medium", "hardware"].iter().filter_map(|key| tables.get(*key)?.as_str());
        let named = named.filter(|name| name.ends_with(".toml") && !name.contains('\n'));
        named.map(str::to_owned).collect::<Vec<_>>().iter().try_for_each(|name| inputs.read(name))
    }

    fn next(&self) -> Option<String> {
        Some(
            "with --out FOLDER, to learn on the sand that was found: sandgait train --option sand=FOLDER/sand.toml"
                .into(),
        )
    }

    fn check(self, inputs: &Inputs) -> Result<StudyWork> {
        let read = |name: &str| inputs.text(name).map(str::to_owned);
        let data = inputs.bytes(&self.data.0, SENT_DATA)?.clone();
        let experiment = Experiment::with_files(&toml(inputs.text(&self.experiment.0)?)?, &read);
        let experiment = experiment.map_err(|e| Error::file(Path::new(&self.experiment.0), e))?;
        if !inputs.local {
            check_sent(&experiment)?;
        }
        let (name, bytes) = (self.data.0, ROW * rows(&data));
        let run = move |progress: &dyn Progress| diagnosed(&name, &data, &experiment, progress);
        Ok(StudyWork::new(run).taking(bytes))
    }
}

/// The text of an experiment file; tables may also be JSON.
fn toml(text: &str) -> Result<String> {
    if !text.trim_start().starts_with('{') {
        return Ok(text.to_owned());
    }
    let wrong = |e: String| Error::invalid("experiment", e);
    let tables: serde_json::Value = serde_json::from_str(text).map_err(|e| wrong(e.to_string()))?;
    toml::to_string(&tables).map_err(|e| wrong(e.to_string()))
}

/// Refuses an experiment whose robot or bodies are in files: a server reads no file that a client names.
fn check_sent(experiment: &Experiment) -> Result<()> {
    if let Some(robot) = experiment.file.robot.as_deref().filter(|robot| !Robot::names().contains(robot)) {
        return Err(Error::unknown("robot", robot, &Robot::names()));
    }
    for (name, body) in &experiment.file.bodies {
        if let BodyShape::Mesh(_) = BodyShape::named(&body.body)? {
            let reason = "a server reads no mesh files; diagnose on your own machine";
            return Err(Error::invalid(format!("body.{name}"), reason));
        }
    }
    Ok(())
}

/// Number of rows. The reader ends a row at a line feed, at a carriage return, and at both together.
fn rows(data: &[u8]) -> usize {
    let alone = data.windows(2).filter(|pair| pair[0] == b'\r' && pair[1] != b'\n').count();
    alone + data.iter().filter(|byte| **byte == b'\n').count()
}

fn diagnosed(name: &str, data: &Bytes, experiment: &Experiment, progress: &dyn Progress) -> Result<StudyResult> {
    // The diagnosis reads and writes files, so it gets a directory that only this user can enter.
    let directory = tempfile::tempdir().map_err(|e| unusable(&e))?;
    let (own, out) = (directory.path().join("in"), directory.path().join("out"));
    std::fs::create_dir(&own).map_err(|e| unusable(&e))?;
    let last = Path::new(name).file_name().map_or_else(Default::default, |last| last.to_string_lossy());
    // Messages repeat the name, so the file has it too unless the file system would refuse it.
    let usable = last.len() < 200 && !last.is_empty() && !last.chars().any(char::is_control);
    let path = own.join(if usable { &*last } else { "data" });
    std::fs::write(&path, data).map_err(|e| unusable(&e))?;
    let mut diagnosis =
        sandgait_diagnose::diagnose(&path, experiment, progress).map_err(|e| renamed(e, &path, name))?;
    diagnosis.name = last.to_string();
    diagnosis.write(&out)?;
    let file = |file: &str| match std::fs::read(out.join(file)) {
        Ok(content) => Ok(StudyFile::new(file, content)),
        Err(e) => Err(unusable(&e)),
    };
    Ok(StudyResult { files: FILES.iter().map(|name| file(name)).collect::<Result<_>>()?, ..result(name, &diagnosis) })
}

fn result(name: &str, diagnosis: &Diagnosis) -> StudyResult {
    let report = &diagnosis.report;
    let warned = report.check.findings.iter().filter(|f| f.severity == Severity::Warn);
    let about = [("verdict", json!(report.verdict)), ("summary", json!(report.summary))];
    let split = report.split.as_ref().map(|split| format!("Measured against predicted forces: {}\n", split.said()));
    StudyResult {
        summary: format!("{}\n{}\n{}", report.headline, report.action, split.unwrap_or_default()),
        warnings: warned.map(|finding| format!("{name}: {}", finding.line())).collect(),
        about: about.into_iter().map(|(key, value)| (key.to_owned(), value)).collect::<Map<_, _>>(),
        ..StudyResult::table(StudyTable::new("curves", curves(&diagnosis.curves)))
    }
}

/// Changes an error about the file at `path` into one about the user's `name`.
fn renamed(error: Error, path: &Path, name: &str) -> Error {
    match error {
        Error::File { path: at, reason } if Path::new(&at) == path => Error::file(Path::new(name), reason),
        other => other,
    }
}

fn unusable(error: &std::io::Error) -> Error {
    Error::Exhausted(format!("the directory for temporary files cannot be used: {error}"))
}

/// One row for each sample, in the order of the observations.
fn curves(c: &Curves) -> Vec<StudyColumn> {
    let o = &c.observations;
    let each = |of: &dyn Fn(usize) -> String| -> Vec<String> {
        o.units.iter().enumerate().flat_map(|(u, unit)| std::iter::repeat_n(of(u), unit.samples)).collect()
    };
    let mut columns = vec![
        StudyColumn::names("trial", each(&|u| o.units[u].id.clone())),
        StudyColumn::names("condition", each(&|u| o.conditions[o.units[u].condition].clone())),
        StudyColumn::names("shape", each(&|u| c.groups[u].clone())),
        StudyColumn::numbers("progress", "rad or m", o.units.iter().flat_map(|u| u.progress.iter().copied())),
    ];
    for (k, channel) in o.channels.iter().enumerate() {
        let stack = |name: String, values: &[f64]| {
            let places = o.units.iter().flat_map(|u| u.block(k));
            StudyColumn::numbers(&name, channel.unit, places.map(|i| values[i]))
        };
        columns.push(stack(channel.name.to_string(), &o.values));
        columns.push(stack(format!("{}_plain", channel.name), &c.plain));
        columns.push(stack(format!("{}_extended", channel.name), c.extended.as_ref().unwrap_or(&c.plain)));
        columns.push(stack(format!("{}_sd", channel.name), &c.band));
    }
    columns
}

#[cfg(test)]
mod tests {
    use super::rows;

    #[test]
    fn rows_end_as_the_reader_ends_them() {
        for end in ["\n", "\r", "\r\n"] {
            let count = rows(format!("1{end}").repeat(9).as_bytes());
            assert!([8, 9].contains(&count), "{end:?}: {count}");
        }
    }
}
