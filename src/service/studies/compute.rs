//! The computations of all studies, for clients of the server and for this process. A request is checked first; the
//! returned function does the work.

use super::{decode, encode};
use crate::error::{Error, Result};
use crate::evaluate;
use crate::parallel;
use crate::progress::Progress;
use crate::proto::WalkRequest;
use crate::proto::{DiagnoseRequest, Diagnosis, EvaluateRequest, IntrudeRequest, SweepRequest, Table, TrialsRequest};
use crate::sand::intruder;
use crate::sweep::{grid, optimize, walk_all};
use std::path::Path;

/// Work that reports its progress.
pub type StudyWork<T> = Box<dyn FnOnce(&dyn Progress) -> Result<T> + Send>;

/// A requested study.
pub enum StudyRequest {
    Intrude(IntrudeRequest),
    Trials(TrialsRequest),
    Walk(WalkRequest),
    Sweep(SweepRequest),
    Evaluate(EvaluateRequest),
    Diagnose(DiagnoseRequest),
}

/// The results of a study.
pub enum StudyResult {
    Table(Table),
    Diagnosis(Diagnosis),
}

impl StudyRequest {
    /// Runs the study on this thread and those that it starts.
    pub fn compute(self, progress: &dyn Progress) -> Result<StudyResult> {
        match self {
            Self::Intrude(request) => intrude(request).map(StudyResult::Table),
            Self::Trials(request) => trials(request)?(progress).map(StudyResult::Table),
            Self::Walk(request) => walk(request)?(progress).map(StudyResult::Table),
            Self::Sweep(request) => sweep(request)?(progress).map(StudyResult::Table),
            Self::Evaluate(request) => evaluate(request)?(progress).map(StudyResult::Table),
            Self::Diagnose(request) => diagnose(request)?(progress).map(StudyResult::Diagnosis),
        }
    }
}

pub fn intrude(request: IntrudeRequest) -> Result<Table> {
    let (rotation, sand) = decode::intrude(request)?;
    Ok(encode::table(encode::loads(&rotation.loads(&sand.description)?), sand.warnings))
}

/// Number of motions between two reports: our choice, about a second for a wheel.
const TOGETHER: usize = 2_000;

pub fn trials(request: TrialsRequest) -> Result<StudyWork<Table>> {
    let decode::TrialInputs { body, sand, trials } = decode::trials(request)?;
    Ok(Box::new(move |progress| {
        let mut outcomes = Vec::with_capacity(trials.len());
        for part in trials.chunks(TOGETHER) {
            progress.report(outcomes.len() as f64 / trials.len() as f64, "trials")?;
            outcomes.extend(parallel::map(part, |trial| intruder::compute(&body, &sand.description, trial)));
        }
        Ok(encode::table(encode::trials(&outcomes), sand.warnings))
    }))
}

pub fn walk(request: WalkRequest) -> Result<StudyWork<Table>> {
    let walks = decode::walk(request)?;
    Ok(Box::new(move |progress| {
        let results = walk_all(walks.engine, &walks.trials, progress)?;
        let columns = std::iter::once(encode::frequencies(&walks.trials)).chain(encode::walks(&results));
        Ok(encode::table(columns.collect(), walks.warnings))
    }))
}

pub fn sweep(request: SweepRequest) -> Result<StudyWork<Table>> {
    let sweep = decode::sweep(request)?;
    Ok(Box::new(move |progress| {
        let columns = match sweep.optimize {
            None => encode::grid(&sweep.axes, &grid(&sweep.base, &sweep.axes, progress)?),
            Some(goal) => encode::optimum(&sweep.axes, &optimize::optimize(&sweep.base, &sweep.axes, goal, progress)?),
        };
        Ok(encode::table(columns, sweep.warnings))
    }))
}

pub fn evaluate(request: EvaluateRequest) -> Result<StudyWork<Table>> {
    let study = evaluate::Evaluation::new(&decode::evaluate(request)?)?;
    Ok(Box::new(move |progress| Ok(encode::table(encode::evaluation(&study.run(progress)?), Vec::new()))))
}

pub fn diagnose(request: DiagnoseRequest) -> Result<StudyWork<Diagnosis>> {
    let (data, experiment) = decode::diagnose(request)?;
    Ok(Box::new(move |progress| {
        // The diagnosis reads and writes files, so it gets a directory that only this user can enter.
        let directory = tempfile::tempdir().map_err(|e| unusable(&e))?;
        let (own, out) = (directory.path().join("in"), directory.path().join("out"));
        std::fs::create_dir(&own).map_err(|e| unusable(&e))?;
        let name = Path::new(&data.name).file_name().map_or_else(Default::default, |n| n.to_string_lossy());
        // Messages repeat the name, so the file has it too unless the file system would refuse it.
        let usable = name.len() < 200 && !name.is_empty() && !name.chars().any(char::is_control);
        let path = own.join(if usable { &*name } else { "data" });
        std::fs::write(&path, &data.content).map_err(|e| unusable(&e))?;
        let named = |e: Error| decode::renamed(e, &path, &data.name);
        let mut diagnosis = crate::diagnose::diagnose(&path, &experiment, progress).map_err(named)?;
        diagnosis.name = name.to_string();
        diagnosis.write(&out)?;
        Ok(Diagnosis {
            report_json: read(&out.join("report.json"))?,
            report_html: read(&out.join("report.html"))?,
            sand_toml: read(&out.join("sand.toml"))?,
            curves: Some(encode::table(encode::curves(&diagnosis.curves), Vec::new())),
            hardware_toml: read(&out.join("hardware.toml"))?,
        })
    }))
}

fn read(path: &Path) -> Result<String> {
    std::fs::read_to_string(path).map_err(|e| unusable(&e))
}

fn unusable(error: &std::io::Error) -> Error {
    Error::Exhausted(format!("the directory for temporary files cannot be used: {error}"))
}
