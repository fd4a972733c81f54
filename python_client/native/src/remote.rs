//! Servers: the requests and answers of a session's stream, calls, and studies.

use crate::arrays;
use crate::errors::StatusError;
use crate::local::Camera;
use crate::tables;
use crate::values::keywords;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyMapping, PyTuple};
use sandgait::client::{self, PATIENCE, ServerAddress, StudyCall, StudyEvent, call};
use sandgait::service::from_json;
use sandgait::service::proto::run_session_request::Request as SessionRequest;
use sandgait::service::proto::run_session_response::Response as SessionResponse;
use sandgait::service::proto::{self, RunSessionRequest, RunSessionResponse};
use sandgait::study::StudyResult;
use std::future::Future;
use std::mem::ManuallyDrop;
use std::pin::pin;
use std::time::Duration;
use tonic::Status;

/// Address, token, TLS, authority, certificate and key, as `sandgait.Remote` has them.
pub type Address = (String, Option<String>, bool, Option<Vec<u8>>, Option<Vec<u8>>, Option<Vec<u8>>);

pub fn place((address, token, tls, ca, certificate, key): Address) -> ServerAddress {
    ServerAddress { address, token, tls, ca, identity: certificate.zip(key) }
}

fn raise(status: &Status) -> PyErr {
    StatusError::new_err((i32::from(status.code()), status.message().to_owned()))
}

/// Waits for a call; Ctrl-C interrupts it.
fn drive<T: Send>(py: Python<'_>, work: impl Future<Output = Result<T, Status>> + Send) -> PyResult<T> {
    let runtime = client::runtime().map_err(|e| raise(&e))?;
    let mut work = pin!(work);
    loop {
        let (runtime, work) = (&runtime, work.as_mut());
        match py.detach(move || client::wait(runtime, work, PATIENCE)) {
            Some(done) => return done.map_err(|e| raise(&e)),
            None => py.check_signals()?,
        }
    }
}

/// Version, protocol and tasks of the server at `address`.
#[pyfunction]
pub fn describe_server(py: Python<'_>, address: Address) -> PyResult<(String, u32, Vec<Bound<'_, PyAny>>)> {
    let place = place(address);
    let reply = drive(py, call::describe(&place))?;
    let tasks = reply.tasks.iter().map(|task| tables::task(py, task)).collect::<PyResult<_>>()?;
    Ok((reply.version, reply.protocol, tasks))
}

/// Id, task and warnings of a session that the server at `address` has made.
#[pyfunction]
pub fn create_session<'py>(
    py: Python<'py>,
    address: Address,
    task: String,
    num_envs: u32,
    options: &Bound<'py, PyMapping>,
) -> PyResult<(String, Bound<'py, PyAny>, Vec<String>)> {
    let (place, options) = (place(address), keywords(options)?);
    let reply = drive(py, call::create_session(&place, task, num_envs, &options))?;
    Ok((reply.session_id, tables::task(py, &reply.task.unwrap_or_default())?, reply.warnings))
}

/// Frees a session, if its server answers within `timeout` [s].
#[pyfunction]
pub fn close_session(py: Python<'_>, address: Address, session_id: String, timeout: f64) -> PyResult<()> {
    let place = place(address);
    drive(py, call::close_session(&place, session_id, Duration::from_secs_f64(timeout)))
}

/// A study on a server: its result, and its `about` as text. An exception during the wait stops it there.
pub fn study(
    py: Python<'_>,
    address: Address,
    call: StudyCall,
    told: Option<&Bound<'_, PyAny>>,
) -> PyResult<(StudyResult, String)> {
    let runtime = client::runtime().map_err(|e| raise(&e))?;
    let place = place(address);
    let mut opening = Box::pin(client::study(&place, call));
    let mut events = loop {
        let (runtime, opening) = (&runtime, opening.as_mut());
        match py.detach(move || client::wait(runtime, opening, PATIENCE)) {
            Some(opened) => break opened.map_err(|e| raise(&e))?,
            None => py.check_signals()?,
        }
    };
    loop {
        let (runtime, events) = (&runtime, &mut events);
        match py.detach(move || client::wait(runtime, pin!(client::next(events)), PATIENCE)) {
            Some(Some(Ok(StudyEvent::Done(outcome, about)))) => return Ok((outcome, about)),
            Some(Some(Ok(StudyEvent::Progress(done, stage)))) => {
                if let Some(told) = told {
                    told.call1((done, stage))?;
                }
            }
            Some(Some(Err(status))) => return Err(raise(&status)),
            Some(None) => return Err(raise(&Status::unavailable("the study ended without a result"))),
            None => (),
        }
        py.check_signals()?;
    }
}

/// A request of a session's stream.
#[pyclass(module = "sandgait._native")]
pub struct Request {
    #[pyo3(get, set)]
    sequence: u64,
    asked: SessionRequest,
}

impl Request {
    fn of(asked: SessionRequest) -> Self {
        Self { sequence: 0, asked }
    }
}

/// float32 in the form of messages.
fn packed(array: &Bound<'_, PyAny>) -> PyResult<Vec<u8>> {
    Ok(arrays::floats(array)?.iter().flat_map(|x| x.to_le_bytes()).collect())
}

#[pymethods]
impl Request {
    #[staticmethod]
    #[pyo3(signature = (seeds, mask, options))]
    fn reset(seeds: Option<Vec<u64>>, mask: Option<Vec<u8>>, options: &Bound<'_, PyMapping>) -> PyResult<Self> {
        let options = match from_json(&keywords(options)?).kind {
            Some(prost_types::value::Kind::StructValue(fields)) if !fields.fields.is_empty() => Some(fields),
            _ => None,
        };
        let (seeds, mask) = (seeds.unwrap_or_default(), mask.unwrap_or_default().into());
        Ok(Self::of(SessionRequest::Reset(proto::Reset { seeds, mask, options })))
    }

    #[staticmethod]
    #[pyo3(signature = (actions, held))]
    fn step(actions: &Bound<'_, PyAny>, held: Option<Vec<u8>>) -> PyResult<Self> {
        let (actions, held) = (packed(actions)?.into(), held.unwrap_or_default().into());
        Ok(Self::of(SessionRequest::Step(proto::Step { actions, held })))
    }

    #[staticmethod]
    fn set_command(commands: &Bound<'_, PyAny>) -> PyResult<Self> {
        Ok(Self::of(SessionRequest::SetCommand(proto::SetCommand { commands: packed(commands)?.into() })))
    }

    #[staticmethod]
    fn save() -> Self {
        Self::of(SessionRequest::Save(proto::Save {}))
    }

    #[staticmethod]
    #[pyo3(signature = (snapshot, sources))]
    fn restore(snapshot: Vec<u8>, sources: Option<Vec<u8>>) -> Self {
        let (snapshot, sources) = (snapshot.into(), sources.unwrap_or_default().into());
        Self::of(SessionRequest::Restore(proto::Restore { snapshot, sources }))
    }

    #[staticmethod]
    fn rollout(actions: &Bound<'_, PyAny>, trajectories: bool) -> PyResult<Self> {
        Ok(Self::of(SessionRequest::Rollout(proto::Rollout { actions: packed(actions)?.into(), trajectories })))
    }

    #[staticmethod]
    fn policy_rollout(onnx: Vec<u8>, steps: u32, trajectories: bool) -> Self {
        Self::of(SessionRequest::PolicyRollout(proto::PolicyRollout { onnx: onnx.into(), steps, trajectories }))
    }

    #[staticmethod]
    fn render(indices: Vec<u32>, size: [u32; 2], ended: bool, camera: Camera) -> Self {
        let [width, height] = size;
        let (azimuth_deg, elevation_deg, distance, follow) = camera;
        let camera = Some(proto::Camera { azimuth_deg, elevation_deg, distance, fixed: !follow });
        Self::of(SessionRequest::Render(proto::Render { indices, width, height, ended, camera }))
    }

    #[staticmethod]
    fn observe(index: u32, ended: bool) -> Self {
        Self::of(SessionRequest::Observe(proto::Observe { index, ended }))
    }

    /// Does it change the environments?
    #[getter]
    fn changes(&self) -> bool {
        use SessionRequest::{Reset, Restore, SetCommand, Step};
        matches!(self.asked, Reset(_) | Step(_) | Restore(_) | SetCommand(_))
    }
}

/// An answer of a session's stream.
#[pyclass(frozen, module = "sandgait._native")]
pub struct Response(RunSessionResponse);

impl Response {
    fn wrong(&self) -> PyErr {
        raise(&Status::internal("the server's answer does not match the request"))
    }

    fn part(&self) -> Option<&proto::RolloutPart> {
        match &self.0.response {
            Some(SessionResponse::Rollout(part)) => Some(part),
            _ => None,
        }
    }
}

#[pymethods]
impl Response {
    #[getter]
    fn sequence(&self) -> u64 {
        self.0.sequence
    }

    /// Code and message, if the request was refused.
    #[getter]
    fn failure(&self) -> Option<(i32, &str)> {
        match &self.0.response {
            Some(SessionResponse::Failure(failure)) => Some((failure.code, &failure.message)),
            _ => None,
        }
    }

    /// Is it a part of a rollout, and not the last one?
    #[getter]
    fn is_part(&self) -> bool {
        self.part().is_some_and(|part| part.returns.is_empty())
    }

    /// Number of the first step of a rollout's part.
    #[getter]
    fn first_step(&self) -> Option<u32> {
        self.part().map(|part| part.first_step)
    }

    /// See `Local.receive`.
    fn batch<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        match &self.0.response {
            Some(SessionResponse::Batch(batch)) => arrays::message(py, batch),
            _ => Err(self.wrong()),
        }
    }

    #[getter]
    fn snapshot<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        match &self.0.response {
            Some(SessionResponse::Snapshot(snapshot)) => Ok(PyBytes::new(py, &snapshot.data)),
            _ => Err(self.wrong()),
        }
    }

    #[getter]
    fn pixels<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        match &self.0.response {
            Some(SessionResponse::Pictures(pictures)) => Ok(PyBytes::new(py, &pictures.pixels)),
            _ => Err(self.wrong()),
        }
    }

    #[getter]
    fn observation<'py>(&self, py: Python<'py>) -> PyResult<(String, Bound<'py, PyBytes>)> {
        match &self.0.response {
            Some(SessionResponse::Observation(moment)) => Ok((moment.header.clone(), PyBytes::new(py, &moment.row))),
            _ => Err(self.wrong()),
        }
    }
}

/// The arrays of a rollout from all its parts; see `Local.receive_rollout`. `row`: observations, actions.
#[pyfunction]
pub fn rollout<'py>(
    py: Python<'py>,
    parts: Vec<PyRef<'py, Response>>,
    envs: usize,
    row: [usize; 2],
) -> PyResult<Bound<'py, PyTuple>> {
    let parts: Vec<_> = parts.iter().filter_map(|response| response.part()).collect();
    arrays::parts(py, &parts, envs, row)
}

/// A stream to one session. In a forked child it is not used, because its connection is the parent's.
#[pyclass(frozen, module = "sandgait._native")]
pub struct Stream {
    stream: ManuallyDrop<client::Stream>,
    process: u32,
}

impl Drop for Stream {
    fn drop(&mut self) {
        if self.process == std::process::id() {
            // SAFETY: nothing uses it after this.
            unsafe { ManuallyDrop::drop(&mut self.stream) };
        }
    }
}

#[pymethods]
impl Stream {
    #[new]
    fn new(py: Python<'_>, address: Address, session_id: String) -> PyResult<Self> {
        let place = place(address);
        let opened =
            py.detach(|| client::Stream::open(place, session_id, || Python::attach(|py| py.check_signals())))?;
        let stream = ManuallyDrop::new(opened.map_err(|e| raise(&e))?);
        Ok(Self { stream, process: std::process::id() })
    }

    /// Number of the last request that the session has answered.
    #[getter]
    fn last_sequence(&self) -> u64 {
        self.stream.last_sequence
    }

    /// Sends a request and does not wait for its answer. `here`: the caller waits for the answer next, so its thread sends.
    #[pyo3(signature = (request, here = false))]
    fn send(&self, request: &Request, here: bool) {
        let (session_id, sequence) = (String::new(), request.sequence);
        let request = Some(request.asked.clone());
        self.stream.send(RunSessionRequest { session_id, sequence, request }, here);
    }

    /// The next answer. After an interrupt the next call returns it.
    fn receive(&self, py: Python<'_>) -> PyResult<Response> {
        loop {
            match py.detach(|| self.stream.receive(PATIENCE)) {
                Some(answer) => return answer.map(Response).map_err(|e| raise(&e)),
                None => py.check_signals()?,
            }
        }
    }

    /// Ends the stream; the session stays for the time of its lease.
    fn close(&self) {
        self.stream.close();
    }
}
