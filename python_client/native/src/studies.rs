//! Studies: requests as dicts with the names of the messages' fields. They run the same code as a client's
//! messages.

use crate::errors::invalid;
use crate::remote::{self, Address};
use crate::tables::table;
use crate::values::keywords;
use crate::wait;
use pyo3::prelude::*;
use pyo3::types::PyMapping;
use sandgait::service::from_json;
use sandgait::service::proto::{self, diagnose_request, evaluate_request, trials_request};
use sandgait::service::studies::compute::{StudyRequest, StudyResult};

/// Name and content.
type File = (String, Vec<u8>);

/// A parameter and the values it takes: numbers, or names in place of numbers.
type Variation = (String, Vec<f64>, Vec<String>);

#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct Sand {
    medium: Option<String>,
    law: Option<String>,
    file: Option<File>,
}

#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct Robot {
    name: Option<String>,
    file: Option<File>,
}

#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct Intrude {
    shape: String,
    chord: f64,
    width: f64,
    hip_height: f64,
    omega: f64,
    sand: Sand,
}

/// Columns as bytes.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct Trials {
    shape: Option<String>,
    mesh: Option<File>,
    velocity: Vec<u8>,
    spin: Vec<u8>,
    depth: Vec<u8>,
    load: Vec<u8>,
    sand: Sand,
    friction: Option<f64>,
    plate_size: Option<f64>,
}

#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct Walk {
    leg: Option<String>,
    frequency: Vec<f64>,
    engine: String,
    sand: Sand,
    slope_deg: f64,
    dt: Option<f64>,
    robot: Robot,
}

#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct Sweep {
    vary: Vec<Variation>,
    set: Vec<Variation>,
    robot: Robot,
    frequency: f64,
    sand: Sand,
    optimize: Option<String>,
}

#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct Evaluate<'py> {
    onnx: Option<File>,
    gait: Option<String>,
    task_id: String,
    options: Bound<'py, PyMapping>,
    seeds: u32,
    media: Vec<String>,
    slopes: Vec<f64>,
}

#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct Diagnose<'py> {
    data: File,
    file: Option<File>,
    values: Option<Bound<'py, PyMapping>>,
}

fn file((name, content): File) -> proto::File {
    proto::File { name, content: content.into() }
}

fn variation((parameter, numbers, names): Variation) -> proto::Variation {
    proto::Variation { parameter, numbers, names }
}

impl Sand {
    fn message(self) -> Option<proto::Sand> {
        Some(proto::Sand { medium: self.medium, law: self.law, file: self.file.map(file) })
    }
}

impl Robot {
    fn message(self) -> Option<proto::Robot> {
        Some(proto::Robot { name: self.name, file: self.file.map(file) })
    }
}

fn structure(given: &Bound<'_, PyMapping>) -> PyResult<Option<prost_types::Struct>> {
    match from_json(&keywords(given)?).kind {
        Some(prost_types::value::Kind::StructValue(fields)) => Ok(Some(fields)),
        _ => Ok(None),
    }
}

fn requested(name: &str, given: &Bound<'_, PyAny>) -> PyResult<StudyRequest> {
    Ok(match name {
        "Intrude" => {
            let Intrude { shape, chord, width, hip_height, omega, sand } = given.extract()?;
            let [chord, width, hip_height, omega] = [chord, width, hip_height, omega].map(Some);
            StudyRequest::Intrude(proto::IntrudeRequest {
                shape,
                chord,
                width,
                hip_height,
                omega,
                sand: sand.message(),
            })
        }
        "Trials" => {
            let Trials { shape, mesh, velocity, spin, depth, load, sand, friction, plate_size } = given.extract()?;
            let mesh = mesh.map(|mesh| trials_request::Body::Mesh(file(mesh)));
            let body = mesh.or(shape.map(trials_request::Body::Shape));
            let [spin, depth, load] = [spin, depth, load].map(|column| Some(column.into()));
            let (velocity, sand) = (velocity.into(), sand.message());
            let request = proto::TrialsRequest { body, velocity, spin, depth, load, sand, friction, plate_size };
            StudyRequest::Trials(request)
        }
        "Walk" => {
            let Walk { leg, frequency, engine, sand, slope_deg, dt, robot } = given.extract()?;
            let (engine, sand, robot) = (Some(engine), sand.message(), robot.message());
            StudyRequest::Walk(proto::WalkRequest { leg, frequency, engine, sand, slope_deg, dt, robot })
        }
        "Sweep" => {
            let Sweep { vary, set, robot, frequency, sand, optimize } = given.extract()?;
            let [vary, set] = [vary, set].map(|all| all.into_iter().map(variation).collect());
            let (robot, frequency, sand) = (robot.message(), Some(frequency), sand.message());
            StudyRequest::Sweep(proto::SweepRequest { vary, set, robot, frequency, sand, optimize })
        }
        "Evaluate" => {
            let Evaluate { onnx, gait, task_id, options, seeds, media, slopes } = given.extract()?;
            let onnx = onnx.map(|network| evaluate_request::Policy::Onnx(file(network)));
            let policy = onnx.or(gait.map(evaluate_request::Policy::Gait));
            let (options, seeds) = (structure(&options)?, Some(seeds));
            StudyRequest::Evaluate(proto::EvaluateRequest { policy, task_id, options, seeds, media, slopes })
        }
        "Diagnose" => {
            let Diagnose { data, file: given, values } = given.extract()?;
            let tables = values.map(|values| structure(&values)).transpose()?.flatten();
            let experiment = given.map(|given| diagnose_request::Experiment::File(file(given)));
            let experiment = experiment.or(tables.map(diagnose_request::Experiment::Values));
            StudyRequest::Diagnose(proto::DiagnoseRequest { data: Some(file(data)), experiment })
        }
        other => return Err(invalid("study", format!("{other:?} is unknown"))),
    })
}

/// Study `name` at `place`, or in this process. Returns a table, or for a diagnosis its three files and the table
/// of curves. `told` is called with the finished share and the stage; its exception stops the study.
#[pyfunction]
#[pyo3(signature = (place, name, request, told))]
pub fn study<'py>(
    py: Python<'py>,
    place: Option<Address>,
    name: &str,
    request: &Bound<'py, PyAny>,
    told: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let study = requested(name, request)?;
    let outcome = match place {
        None => wait::study(py, told, move |progress| study.compute(progress))?,
        Some(place) => remote::study(py, place, study, told)?,
    };
    match outcome {
        StudyResult::Table(made) => table(py, &made),
        StudyResult::Diagnosis(diagnosis) => {
            let proto::Diagnosis { report_json, report_html, sand_toml, curves, hardware_toml } = diagnosis;
            let curves = table(py, &curves.unwrap_or_default())?;
            Ok((report_json, report_html, sand_toml, hardware_toml, curves).into_pyobject(py)?.into_any())
        }
    }
}
