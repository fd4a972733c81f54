//! The computations of all studies, for clients of the server and for this process. A request is checked before it
//! waits in the queue; only the rows of measured data are checked later. The returned function does the work.

use super::encode;
use crate::diagnose::experiment::Experiment;
use crate::error::{Error, Result, check_range};
use crate::evaluate::{Evaluation, EvaluationRequest, PolicySource};
use crate::fields::MOST_TRIALS;
use crate::parallel;
use crate::progress::Progress;
use crate::proto::diagnose_request::Experiment as Source;
use crate::proto::evaluate_request::Policy;
use crate::proto::trials_request::Body as Shaped;
use crate::proto::{
    self, DiagnoseRequest, Diagnosis, EvaluateRequest, File, IntrudeRequest, SweepRequest, Table, TrialsRequest,
    Variation, WalkRequest,
};
use crate::sand::intruder::{self, BodyShape, DepthOrLoad, PlatedBody, Trial as Motion, check_all, with_friction};
use crate::sand::intrusion::Rotation;
use crate::sand::{Law, LegShape, Medium, SandDescription};
use crate::sim::engine::EngineKind;
use crate::sim::model::Scene;
use crate::sim::walk::WalkTrial;
use crate::sim::{Model, Robot};
use crate::sweep::grid::{check_grid, grid};
use crate::sweep::{Design, SweepAxis, SweepMeasure, optimize, walk_all};
use crate::values;
use std::path::Path;
use std::time::{Duration, Instant};

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
    /// Runs the study on this thread and on threads that it starts.
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

/// A file's text. Errors use the client's name for it, because the client can correct the file.
fn text(file: &File) -> Result<&str> {
    std::str::from_utf8(&file.content).map_err(|_| Error::invalid(&file.name, "not UTF-8 text"))
}

/// Changes an error about the file at `path` into one about the client's `name`.
fn renamed(error: Error, path: &Path, name: &str) -> Error {
    match error {
        Error::File { path: at, reason } if Path::new(&at) == path => Error::invalid(name, reason),
        other => other,
    }
}

/// Sand, with warnings for its user.
fn sand(message: Option<proto::Sand>) -> Result<(SandDescription, Vec<String>)> {
    let proto::Sand { medium, law, file } = message.unwrap_or_default();
    if let Some(file) = file {
        if medium.is_some() || law.is_some() {
            return Err(Error::invalid("sand", "give either a sand file, or medium and law"));
        }
        let description = SandDescription::from_toml(text(&file)?);
        let description = description.map_err(|e| Error::invalid(&file.name, e.to_string()))?;
        return Ok((description, Vec::new()));
    }
    let (medium, law) = (medium.as_deref().unwrap_or(Medium::DEFAULT), law.as_deref().unwrap_or(Law::Li2013.name()));
    let description = SandDescription::named(medium, law)?;
    Ok((description, Medium::caution(medium).into_iter().collect()))
}

fn robot(message: Option<proto::Robot>) -> Result<Robot> {
    let proto::Robot { name, file } = message.unwrap_or_default();
    match (name, file) {
        (Some(_), Some(_)) => Err(Error::invalid("robot", "give either a file or a name, not both")),
        (None, Some(file)) => Robot::from_toml(text(&file)?),
        (name, None) => Robot::built_in(name.as_deref().unwrap_or(Robot::DEFAULT)),
    }
}

pub fn intrude(request: IntrudeRequest) -> Result<Table> {
    let mut rotation = Rotation::of(LegShape::named(&request.shape)?);
    rotation.chord = request.chord.unwrap_or(rotation.chord);
    rotation.width = request.width.unwrap_or(rotation.width);
    rotation.hip_height = request.hip_height.unwrap_or(rotation.hip_height);
    rotation.omega = request.omega.unwrap_or(rotation.omega);
    let (sand, warnings) = sand(request.sand)?;
    Ok(encode::table(encode::loads(&rotation.loads(&sand)?), warnings))
}

/// A part of the motions, after which the study reports and can be stopped, begins with so many for each processor, and
/// doubles while it takes less than this time: our choice.
const FIRST_TOGETHER: usize = 2;
const PART: Duration = Duration::from_millis(250);

/// Largest number of plates of a client's body. Our choice: they take 8 MB, and 300 MB in all positions of a period. A
/// default wheel has some 3,000 plates.
const MOST_PLATES: usize = 50_000;

pub fn trials(request: TrialsRequest) -> Result<StudyWork<Table>> {
    let TrialsRequest { body, velocity, spin, depth, load, sand: given, friction, plate_size } = request;
    let velocity = column("velocity", &velocity)?;
    let rows = velocity.len() / 3;
    check_range("number of rows", rows as f64, 1.0..=MOST_TRIALS as f64)?;
    let sized = |name: &str, bytes: Option<&[u8]>, wide: usize| -> Result<Option<Vec<f64>>> {
        let Some(values) = bytes.map(|b| column(name, b)).transpose()? else { return Ok(None) };
        if values.len() == wide * rows {
            return Ok(Some(values));
        }
        Err(Error::invalid(name, format!("{} numbers; {rows} rows have {}", values.len(), wide * rows)))
    };
    if velocity.len() != 3 * rows {
        return Err(Error::invalid("velocity", format!("{} numbers are not a multiple of three", velocity.len())));
    }
    let (spin, depth, load) =
        (sized("spin", spin.as_deref(), 3)?, sized("depth", depth.as_deref(), 1)?, sized("load", load.as_deref(), 1)?);
    let three = |all: &[f64], row: usize| [all[3 * row], all[3 * row + 1], all[3 * row + 2]];
    let motion = |row: usize| {
        let of = |all: &Option<Vec<f64>>| all.as_ref().map(|v| v[row]).filter(|v| !v.is_nan());
        let given = match (of(&depth), of(&load)) {
            (Some(depth), None) => DepthOrLoad::Depth(depth),
            (None, Some(load)) => DepthOrLoad::Load(load),
            (None, None) => return Err(wrong(row, "neither depth nor load is given")),
            (Some(_), Some(_)) => return Err(wrong(row, "both depth and load are given")),
        };
        Ok(Motion { velocity: three(&velocity, row), spin: spin.as_ref().map_or([0.0; 3], |s| three(s, row)), given })
    };
    let trials = (0..rows).map(motion).collect::<Result<Vec<_>>>()?;
    let (mut sand, warnings) = sand(given)?;
    if let Some(mu) = friction {
        sand = with_friction(&sand, mu)?;
    }
    check_all(&sand, &trials)?;
    let body = shaped(body, plate_size)?;
    Ok(Box::new(move |progress| {
        let mut outcomes = Vec::with_capacity(trials.len());
        let mut together = FIRST_TOGETHER * parallel::processors();
        while outcomes.len() < trials.len() {
            progress.report(outcomes.len() as f64 / trials.len() as f64, "trials")?;
            let (rest, start) = (&trials[outcomes.len()..], Instant::now());
            let part = &rest[..together.min(rest.len())];
            outcomes.extend(parallel::map(part, |trial| intruder::compute(&body, &sand, trial)));
            together *= if start.elapsed() < PART { 2 } else { 1 };
        }
        Ok(encode::table(encode::trials(&outcomes), warnings))
    }))
}

fn wrong(row: usize, reason: &str) -> Error {
    Error::invalid(format!("trial {}", row + 1), reason)
}

fn column(name: &str, bytes: &[u8]) -> Result<Vec<f64>> {
    let (numbers, rest) = bytes.as_chunks();
    if !rest.is_empty() {
        return Err(Error::invalid(name, format!("{} bytes are no whole numbers of 8", bytes.len())));
    }
    Ok(numbers.iter().map(|b| f64::from_le_bytes(*b)).collect())
}

fn shaped(body: Option<Shaped>, plate_size: Option<f64>) -> Result<PlatedBody> {
    match body {
        None => Err(Error::invalid("body", "none given")),
        Some(Shaped::Shape(text)) => match BodyShape::named(&text)? {
            // A server does not read files that a client names.
            BodyShape::Mesh(_) => {
                Err(Error::invalid("body", format!("{text}: a server reads no files; send the content of the mesh")))
            }
            shape => PlatedBody::cut_within(&shape, plate_size, MOST_PLATES),
        },
        Some(Shaped::Mesh(file)) => {
            let of_ours = |e: Error| match e {
                Error::File { reason, .. } => Error::invalid(&file.name, reason),
                other => other,
            };
            PlatedBody::of_mesh(Path::new(&file.name), &file.content, plate_size, MOST_PLATES).map_err(of_ours)
        }
    }
}

pub fn walk(request: WalkRequest) -> Result<StudyWork<Table>> {
    let mut robot = robot(request.robot)?;
    if let Some(leg) = &request.leg {
        robot = robot.with_leg_shape(leg)?;
    }
    let (sand, warnings) = sand(request.sand)?;
    let mut scene = Scene::on(&sand);
    scene.slope_deg = request.slope_deg;
    let engine = request.engine.as_deref().map_or(Ok(EngineKind::Lanes), EngineKind::named)?;
    scene.dt = request.dt.unwrap_or(engine.default_dt());
    check_range("number of frequencies", request.frequency.len() as f64, 1.0..=MOST_FREQUENCIES as f64)?;
    let model = Model::new(&robot, &scene)?;
    let trial = |frequency: &f64| {
        let trial = WalkTrial::new(model.clone(), *frequency);
        trial.validate().map(|()| trial)
    };
    let trials = request.frequency.iter().map(trial).collect::<Result<Vec<_>>>()?;
    Ok(Box::new(move |progress| {
        let results = walk_all(engine, &trials, progress)?;
        let columns = std::iter::once(encode::frequencies(&trials)).chain(encode::walks(&results));
        Ok(encode::table(columns.collect(), warnings))
    }))
}

/// Largest number of stride frequencies in one request: our choice, because each frequency has a model in memory.
const MOST_FREQUENCIES: usize = 4096;

pub fn sweep(request: SweepRequest) -> Result<StudyWork<Table>> {
    let goal = request.optimize.as_deref().map(SweepMeasure::named).transpose()?;
    check_range("number of parameters in vary", request.vary.len() as f64, 1.0..=MOST_VARIED as f64)?;
    if request.vary.len() > 2 && goal.is_none() {
        return Err(Error::invalid("vary", "a grid takes one or two parameters; optimize takes more"));
    }
    let axes = request.vary.into_iter().map(axis).collect::<Result<Vec<_>>>()?;
    let (sand, warnings) = sand(request.sand)?;
    let frequency = request.frequency.unwrap_or(Design::FREQUENCY);
    let mut base = Design { robot: robot(request.robot)?, scene: Scene::on(&sand), frequency, phase: 0.0 };
    for setting in request.set {
        let axis = axis(setting)?;
        let [value] = &axis.values[..] else {
            return Err(Error::invalid(axis.parameter.name, format!("{} values where one is set", axis.values.len())));
        };
        base.set([(axis.parameter.name, value.as_str())])?;
    }
    match goal {
        None => check_grid(&base, &axes).map(drop)?,
        Some(_) => optimize::bounds(&base, &axes).map(drop)?,
    }
    Ok(Box::new(move |progress| {
        let columns = match goal {
            None => encode::grid(&axes, &grid(&base, &axes, progress)?),
            Some(goal) => encode::optimum(&axes, &optimize::optimize(&base, &axes, goal, progress)?),
        };
        Ok(encode::table(columns, warnings))
    }))
}

/// Largest number of parameters that one request varies: all that exist.
const MOST_VARIED: usize = crate::sweep::Parameter::ALL.len();

fn axis(variation: Variation) -> Result<SweepAxis> {
    let Variation { parameter, numbers, names } = variation;
    if !numbers.is_empty() && !names.is_empty() {
        return Err(Error::invalid(parameter, "give either numbers or names, not both"));
    }
    SweepAxis::new(&parameter, numbers.iter().map(f64::to_string).chain(names).collect())
}

pub fn evaluate(request: EvaluateRequest) -> Result<StudyWork<Table>> {
    let EvaluateRequest { policy, task_id, options, seeds, media, slopes } = request;
    let policy = match policy {
        None => return Err(Error::invalid("policy", "none given")),
        Some(Policy::Onnx(file)) => PolicySource::Network { name: file.name, bytes: file.content.into() },
        // A server does not read files that a client names.
        Some(Policy::Gait(text)) => PolicySource::parse(&text, |file| {
            Err(Error::invalid(file, "a server reads no files; send the content of this one"))
        })?,
    };
    let seeds = seeds.map_or(EvaluationRequest::SEEDS, |n| n as usize);
    let options = values::to_json(options)?;
    let study = Evaluation::new(&EvaluationRequest { policy, task: task_id, options, seeds, media, slopes })?;
    Ok(Box::new(move |progress| Ok(encode::table(encode::evaluation(&study.run(progress)?), Vec::new()))))
}

pub fn diagnose(request: DiagnoseRequest) -> Result<StudyWork<Diagnosis>> {
    let data = request.data.ok_or_else(|| Error::invalid("data", "none given"))?;
    let experiment = match request.experiment {
        None => return Err(Error::invalid("experiment", "none given")),
        Some(Source::File(file)) => {
            Experiment::from_toml(text(&file)?).map_err(|e| Error::invalid(&file.name, e.to_string()))?
        }
        Some(Source::Values(tables)) => {
            let toml = toml::to_string(&values::to_json(Some(tables))?);
            Experiment::from_toml(&toml.map_err(|e| Error::invalid("experiment", e.to_string()))?)?
        }
    };
    // A server does not read files that a client names.
    if let Some(robot) = experiment.file.robot.as_deref().filter(|r| !Robot::names().contains(r)) {
        return Err(Error::unknown("robot", robot, &Robot::names()));
    }
    for (name, body) in &experiment.file.bodies {
        if let BodyShape::Mesh(_) = BodyShape::named(&body.body)? {
            return Err(Error::invalid(
                format!("body.{name}"),
                "a server reads no mesh files; use sandgait diagnose on the command line",
            ));
        }
    }
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
        let named = |e: Error| renamed(e, &path, &data.name);
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
