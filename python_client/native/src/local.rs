//! The environments of one session in this process.

use crate::arrays;
use crate::errors::{invalid, of, raise};
use crate::process;
use crate::tables;
use crate::values::keywords;
use crate::wait::{self, PATIENCE};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyMapping, PyTuple};
use sandgait::Error;
use sandgait::env::ResetOptions;
use sandgait::env::registry::Blueprint;
use sandgait::pool::{Batch, Operation, Pool, Seal, Snapshot};
use sandgait::service;
use sandgait::session::{Answer, Environments, EnvironmentsGuard, view};
use std::sync::Arc;
use std::time::Duration;

/// `num_envs` environments of `task` with the keywords `options`; see `sandgait.door.Door`.
#[pyclass(frozen, module = "sandgait._native")]
pub struct Local {
    environments: Environments,
    pool: Arc<Pool>,
    process: u32,
    #[pyo3(get)]
    task: Py<PyAny>,
    /// Options without effect, and why.
    #[pyo3(get)]
    warnings: Vec<String>,
}

impl Local {
    /// The environments; waits while they are in use.
    fn lend(&self, py: Python<'_>) -> PyResult<EnvironmentsGuard> {
        if std::process::id() != self.process {
            let reason = "this environment belongs to the process that made it; make it anew after a fork";
            return Err(of("SandgaitError", reason.into()));
        }
        let mut lent = self.environments.take(Duration::ZERO);
        while lent.is_none() {
            lent = py.detach(|| {
                self.pool.assist(PATIENCE / 2);
                self.environments.take(PATIENCE / 2)
            });
            py.check_signals()?;
        }
        match lent {
            Some(Ok(guard)) => Ok(guard),
            Some(Err(Error::OutOfOrder(closed))) => Err(of("SandgaitError", closed)),
            Some(Err(error)) => Err(raise(&error)),
            None => Err(raise(&Error::Internal("the environments are away".into()))),
        }
    }

    /// Starts work that may take long; its answer is received later.
    fn start(&self, py: Python<'_>, work: impl FnOnce(EnvironmentsGuard, &Pool) + Send + 'static) -> PyResult<()> {
        let (guard, pool) = (self.lend(py)?, self.pool.clone());
        wait::spawn(move || work(guard, &pool))
    }

    /// The result of `work` on the environments, which it does not change.
    fn ask<T: Send + 'static>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&Batch) -> sandgait::Result<T> + Send + 'static,
    ) -> PyResult<T> {
        let mut guard = self.lend(py)?;
        wait::background(py, move |_| work(guard.batch()))
    }
}

/// Azimuth and elevation [°], distance [m], and whether the camera follows the robot.
pub type Camera = (Option<f64>, Option<f64>, Option<f64>, bool);

fn camera_options((azimuth_deg, elevation_deg, distance, follow): Camera) -> view::CameraOptions {
    view::CameraOptions { azimuth_deg, elevation_deg, distance, fixed: !follow }
}

/// Refuses a camera whose values are out of their ranges.
#[pyfunction]
pub fn check_camera(camera: Camera) -> PyResult<()> {
    camera_options(camera).check().map(drop).map_err(|error| raise(&error))
}

/// A step with `actions`, in which environments in `held` keep their state.
fn step(actions: Vec<f32>, held: Option<&[u8]>) -> impl FnOnce(&mut Batch) -> sandgait::Result<Operation> + use<> {
    let held = held.map(flags);
    move |batch| match held {
        None => batch.step(actions),
        Some(held) => batch.step_but(actions, held),
    }
}

fn flags(bytes: &[u8]) -> Vec<bool> {
    bytes.iter().map(|flag| *flag != 0).collect()
}

#[pymethods]
impl Local {
    #[new]
    fn new(
        py: Python<'_>,
        task: String,
        num_envs: usize,
        options: &Bound<'_, PyMapping>,
        threads: usize,
    ) -> PyResult<Self> {
        let options = keywords(options)?;
        let (blueprint, environments) = wait::background(py, move |stop| {
            let blueprint = Blueprint::new(&task, options)?;
            let environments = Environments::new(&blueprint, num_envs, || stop.is_set())?;
            Ok((blueprint, environments))
        })?;
        let task = tables::task(py, &service::task(&blueprint))?.unbind();
        let pool = process::pool(py, threads);
        Ok(Self { environments, pool, process: std::process::id(), task, warnings: blueprint.warnings() })
    }

    /// `seeds` and `mask` have one entry for each environment. Without seeds the random streams continue.
    #[pyo3(signature = (seeds, mask, options))]
    fn send_reset(
        &self,
        py: Python<'_>,
        seeds: Option<Vec<u64>>,
        mask: Option<&[u8]>,
        options: &Bound<'_, PyMapping>,
    ) -> PyResult<()> {
        let mask = mask.map(flags);
        if options.is_empty()? {
            let guard = self.lend(py)?;
            py.detach(|| guard.run(&self.pool, |b| b.reset(mask, seeds, ResetOptions::default())));
            return Ok(());
        }
        let changes = keywords(options)?;
        // Building models from options takes long.
        self.start(py, |guard, pool| guard.run(pool, |b| b.reset(mask, seeds, ResetOptions::new(changes)?)))
    }

    /// `actions` is float32 [num_envs, action]; environments in `held` keep their state.
    #[pyo3(signature = (actions, held))]
    fn send_step(&self, py: Python<'_>, actions: &Bound<'_, PyAny>, held: Option<&[u8]>) -> PyResult<()> {
        let check = step(arrays::floats(actions)?, held);
        let guard = self.lend(py)?;
        py.detach(|| guard.run(&self.pool, check));
        Ok(())
    }

    /// The same, and its answer. This thread helps, and the threads that make the step fill the answer's arrays.
    #[pyo3(signature = (actions, held))]
    fn step<'py>(
        &self,
        py: Python<'py>,
        actions: &Bound<'_, PyAny>,
        held: Option<&[u8]>,
    ) -> PyResult<Bound<'py, PyTuple>> {
        let check = step(arrays::floats(actions)?, held);
        let mut guard = self.lend(py)?;
        if !guard.is_soon() {
            py.detach(|| guard.run(&self.pool, check));
            return self.receive(py);
        }
        let rows = arrays::RowArrays::new(py, guard.batch());
        // SAFETY: `rows` lives until this function ends, and `run_here` returns only after the last thread has called it.
        let gather = unsafe { rows.gather() };
        py.detach(|| guard.run_here(&self.pool, |batch| Ok(check(batch)?.gathered(Some(gather)))));
        let mut guard = self.lend(py)?;
        match guard.answer() {
            Some(Answer::Rows) => {
                let answer = rows.answer(py, guard.batch());
                guard.end(Some(Answer::Rows));
                answer
            }
            other => Err(refused(guard, other)),
        }
    }

    /// `commands` is float32 [num_envs, 3].
    fn send_command(&self, py: Python<'_>, commands: &Bound<'_, PyAny>) -> PyResult<()> {
        let commands = arrays::floats(commands)?;
        let guard = self.lend(py)?;
        py.detach(|| guard.run(&self.pool, |b| b.set_command(&commands)));
        Ok(())
    }

    /// `sources`: u32, one for each environment.
    #[pyo3(signature = (snapshot, sources))]
    fn send_restore(&self, py: Python<'_>, snapshot: &[u8], sources: Option<&[u8]>) -> PyResult<()> {
        let snapshot = snapshot.to_vec();
        let sources: Option<Vec<u32>> =
            sources.map(|bytes| bytes.as_chunks().0.iter().map(|b| u32::from_ne_bytes(*b)).collect());
        let check = move |b: &mut Batch| -> sandgait::Result<Operation> {
            b.restore(Snapshot::from_bytes(&snapshot, &Seal::default())?, sources)
        };
        self.start(py, |guard, pool| guard.run(pool, check))
    }

    /// `actions`: float32 [steps, num_envs, action].
    fn send_rollout(&self, py: Python<'_>, actions: &Bound<'_, PyAny>, trajectories: bool) -> PyResult<()> {
        let actions = arrays::floats(actions)?;
        self.start(py, move |guard, pool| guard.roll(pool, trajectories, |b| b.roll(actions, trajectories)))
    }

    fn send_policy_rollout(&self, py: Python<'_>, onnx: &[u8], steps: u32, trajectories: bool) -> PyResult<()> {
        let onnx = onnx.to_vec();
        self.start(py, move |guard, pool| {
            guard.roll(pool, trajectories, |b| b.roll_network(&onnx, steps, trajectories));
        })
    }

    /// Answer to the last reset, step or restore. It can be received again until the next request.
    fn receive<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        let mut guard = self.lend(py)?;
        match guard.answer() {
            Some(Answer::Rows) => {
                let rows = arrays::batch(py, guard.batch());
                guard.end(Some(Answer::Rows));
                rows
            }
            other => Err(refused(guard, other)),
        }
    }

    /// Answer to the last rollout.
    fn receive_rollout<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        let mut guard = match self.lend(py) {
            Ok(guard) => guard,
            Err(error) => {
                self.environments.stop(); // no caller waits for it any more
                return Err(error);
            }
        };
        match guard.answer() {
            Some(Answer::Rolled(rolled)) => arrays::rolled(py, guard.batch(), &rolled),
            other => Err(refused(guard, other)),
        }
    }

    /// Is an answer pending, or still kept from the last request?
    #[getter]
    fn owes(&self) -> bool {
        // In a forked child another thread of the parent may hold the lock for ever.
        std::process::id() == self.process && self.environments.owes()
    }

    /// All environments as data.
    fn save<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let data = self.ask(py, |batch| batch.save()?.to_bytes(&Seal::default()))?;
        Ok(PyBytes::new(py, &data))
    }

    /// u8 [indices, height, width, 3]
    fn render<'py>(
        &self,
        py: Python<'py>,
        indices: Vec<u32>,
        size: [u32; 2],
        ended: bool,
        camera: Camera,
    ) -> PyResult<Bound<'py, PyBytes>> {
        let camera = camera_options(camera);
        let pixels = self.ask(py, move |batch| view::render(batch, &indices, size, ended, &camera))?;
        Ok(PyBytes::new(py, &pixels))
    }

    /// Header and row of environment `index`'s moment, as recordings hold them.
    fn observe<'py>(&self, py: Python<'py>, index: usize, ended: bool) -> PyResult<(String, Bound<'py, PyBytes>)> {
        let mut guard = self.lend(py)?;
        let (header, row) = view::observe(guard.batch(), index, ended).map_err(|e| raise(&e))?;
        Ok((header, PyBytes::new(py, &row)))
    }

    /// Frees the environments; calling it again does nothing.
    fn close(&self, py: Python<'_>) {
        if std::process::id() == self.process {
            py.detach(|| self.environments.close());
        }
    }
}

/// The error if there is no answer of the requested kind.
fn refused(guard: EnvironmentsGuard, answer: Option<Answer>) -> PyErr {
    match answer {
        Some(Answer::Refused(error)) => {
            let raised = raise(&error);
            guard.end(Some(Answer::Refused(error)));
            raised
        }
        other => {
            guard.end(other);
            invalid("receive", "no request of this kind was sent")
        }
    }
}
