//! The computations of all studies, for clients of the server and for this process. A request is checked first; the
//! returned function does the work.

use super::{decode, encode};
use crate::error::{Error, Result};
use crate::evaluate;
use crate::parallel;
use crate::progress::Progress;
use crate::proto::{self, DiagnoseRequest, DiagnoseResponse, IntrudeRequest, IntrudeResponse};
use crate::proto::{
    EvaluateRequest, EvaluateResponse, SweepRequest, SweepResponse, TrialsRequest, TrialsResponse, WalkRequest,
    WalkResponse,
};
use crate::sand::intruder;
use crate::sweep::{grid, optimize, walk_all};
use std::path::Path;

/// Work that reports its progress.
pub type Work<T> = Box<dyn FnOnce(&dyn Progress) -> Result<T> + Send>;

/// A requested study.
pub enum Study {
    Intrude(IntrudeRequest),
    Trials(TrialsRequest),
    Walk(WalkRequest),
    Sweep(SweepRequest),
    Evaluate(EvaluateRequest),
    Diagnose(DiagnoseRequest),
}

/// The results of a study.
pub enum Outcome {
    Table(proto::Table),
    Diagnosis(proto::Diagnosis),
}

impl Study {
    /// Runs the study on this thread and those that it starts.
    pub fn compute(self, progress: &dyn Progress) -> Result<Outcome> {
        use proto::{diagnose_response, evaluate_response, sweep_response, trials_response, walk_response};
        let outcome = match self {
            Self::Intrude(request) => intrude(request)?.table.map(Outcome::Table),
            Self::Trials(request) => match trials(request)?(progress)?.event {
                Some(trials_response::Event::Table(table)) => Some(Outcome::Table(table)),
                _ => None,
            },
            Self::Walk(request) => match walk(request)?(progress)?.event {
                Some(walk_response::Event::Table(table)) => Some(Outcome::Table(table)),
                _ => None,
            },
            Self::Sweep(request) => match sweep(request)?(progress)?.event {
                Some(sweep_response::Event::Table(table)) => Some(Outcome::Table(table)),
                _ => None,
            },
            Self::Evaluate(request) => match evaluate(request)?(progress)?.event {
                Some(evaluate_response::Event::Table(table)) => Some(Outcome::Table(table)),
                _ => None,
            },
            Self::Diagnose(request) => match diagnose(request)?(progress)?.event {
                Some(diagnose_response::Event::Diagnosis(diagnosis)) => Some(Outcome::Diagnosis(diagnosis)),
                _ => None,
            },
        };
        outcome.ok_or_else(|| Error::Internal("the study ended without a result".into()))
    }
}

pub fn intrude(request: IntrudeRequest) -> Result<IntrudeResponse> {
    let (rotation, sand) = decode::intrude(request)?;
    let table = encode::table(encode::loads(&rotation.loads(&sand.description)?), sand.warnings);
    Ok(IntrudeResponse { table: Some(table) })
}

/// Number of motions between two reports: our choice, about a second for a wheel.
const TOGETHER: usize = 2_000;

pub fn trials(request: TrialsRequest) -> Result<Work<TrialsResponse>> {
    let decode::Trials { body, sand, trials } = decode::trials(request)?;
    Ok(Box::new(move |progress| {
        let mut outcomes = Vec::with_capacity(trials.len());
        for part in trials.chunks(TOGETHER) {
            progress.report(outcomes.len() as f64 / trials.len() as f64, "trials")?;
            outcomes.extend(parallel::map(part, |trial| intruder::compute(&body, &sand.description, trial)));
        }
        let table = encode::table(encode::trials(&outcomes), sand.warnings);
        Ok(TrialsResponse { event: Some(proto::trials_response::Event::Table(table)) })
    }))
}

pub fn walk(request: WalkRequest) -> Result<Work<WalkResponse>> {
    let walks = decode::walk(request)?;
    Ok(Box::new(move |progress| {
        let results = walk_all(walks.engine, &walks.trials, progress)?;
        let columns = std::iter::once(encode::frequencies(&walks.trials)).chain(encode::walks(&results));
        let table = encode::table(columns.collect(), walks.warnings);
        Ok(WalkResponse { event: Some(proto::walk_response::Event::Table(table)) })
    }))
}

pub fn sweep(request: SweepRequest) -> Result<Work<SweepResponse>> {
    let sweep = decode::sweep(request)?;
    Ok(Box::new(move |progress| {
        let columns = match sweep.optimize {
            None => encode::grid(&sweep.axes, &grid(&sweep.base, &sweep.axes, progress)?),
            Some(goal) => encode::optimum(&sweep.axes, &optimize::optimize(&sweep.base, &sweep.axes, goal, progress)?),
        };
        let table = encode::table(columns, sweep.warnings);
        Ok(SweepResponse { event: Some(proto::sweep_response::Event::Table(table)) })
    }))
}

pub fn evaluate(request: EvaluateRequest) -> Result<Work<EvaluateResponse>> {
    let study = evaluate::Study::new(&decode::evaluate(request)?)?;
    Ok(Box::new(move |progress| {
        let table = encode::table(encode::evaluation(&study.run(progress)?), Vec::new());
        Ok(EvaluateResponse { event: Some(proto::evaluate_response::Event::Table(table)) })
    }))
}

pub fn diagnose(request: DiagnoseRequest) -> Result<Work<DiagnoseResponse>> {
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
        let diagnosis = proto::Diagnosis {
            report_json: read(&out.join("report.json"))?,
            report_html: read(&out.join("report.html"))?,
            sand_toml: read(&out.join("sand.toml"))?,
            curves: Some(encode::table(encode::curves(&diagnosis.curves), Vec::new())),
            hardware_toml: read(&out.join("hardware.toml"))?,
        };
        Ok(DiagnoseResponse { event: Some(proto::diagnose_response::Event::Diagnosis(diagnosis)) })
    }))
}

fn read(path: &Path) -> Result<String> {
    std::fs::read_to_string(path).map_err(|e| unusable(&e))
}

fn unusable(error: &std::io::Error) -> Error {
    Error::Exhausted(format!("the directory for temporary files cannot be used: {error}"))
}
