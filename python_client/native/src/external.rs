//! Trainings with environments of another program: `sandgait.external` steps them, in the thread that called `sandgait.train`.

use crate::arrays::{array, floats, numbers};
use parking_lot::Mutex;
use pyo3::prelude::*;
use sandgait::env::shard::Rows;
use sandgait::number::unflushed;
use sandgait::progress::Progress;
use sandgait::train::remote::{Pause, RemoteEnvironments};
use sandgait::{Error, Result};
use std::sync::Arc;

/// What a caller in Python has raised during a call from here, which ends the work.
#[derive(Clone, Default)]
pub struct Raised(Arc<Mutex<Option<PyErr>>>);

impl Raised {
    pub fn take(&self) -> Option<PyErr> {
        self.0.lock().take()
    }

    /// Calls Python, which has the usual denormal numbers.
    fn call<T>(&self, work: impl FnOnce(Python<'_>) -> PyResult<T>) -> Result<T> {
        unflushed(|| Python::attach(work)).map_err(|raised| {
            *self.0.lock() = Some(raised);
            Error::Cancelled("stopped".into())
        })
    }
}

/// Progress for Python, in its own thread. Ctrl-C ends the work.
pub struct DirectProgress {
    pub told: Option<Py<PyAny>>,
    pub raised: Raised,
    pub last: Mutex<(f64, String)>,
}

impl Progress for DirectProgress {
    fn report(&self, done: f64, stage: &str) -> Result<()> {
        let mut last = self.last.lock();
        let news = (last.0, last.1.as_str()) != (done, stage);
        if news {
            *last = (done, stage.to_owned());
        }
        self.raised.call(|py| {
            py.check_signals()?;
            match self.told.as_ref().filter(|_| news) {
                Some(told) => told.call1(py, (done, stage)).map(drop),
                None => Ok(()),
            }
        })
    }
}

/// A `sandgait.external.VectorEnvironments`.
pub struct ExternalEnvironments {
    pub vector: Py<PyAny>,
    pub raised: Raised,
    pub envs: usize,
    pub skipped: Vec<bool>,
}

impl RemoteEnvironments for ExternalEnvironments {
    fn reset(&mut self, seeds: &[u64], pause: Pause) -> Result<Rows> {
        pause()?;
        let observations = self.raised.call(|py| {
            let rows = self.vector.bind(py).call_method1("reset", (seeds.first(),))?;
            floats(&rows)
        })?;
        self.skipped.clear();
        let none = vec![0; self.envs];
        let rewards = vec![0.0; self.envs];
        Ok(Rows { observations, rewards, terminated: none.clone(), truncated: none, ..Rows::default() })
    }

    fn step(&mut self, actions: &[f32], _pause: Pause) -> Result<Rows> {
        let (rows, skipped) = self.raised.call(|py| {
            let actions = array(py, &[self.envs, actions.len() / self.envs], actions);
            let [observations, rewards, terminated, truncated, skipped, ended, last]: [Bound<'_, PyAny>; 7] =
                self.vector.bind(py).call_method1("step", (actions,))?.extract()?;
            let rows = Rows {
                observations: floats(&observations)?,
                rewards: floats(&rewards)?,
                terminated: numbers(&terminated)?,
                truncated: numbers(&truncated)?,
                infos: Vec::new(),
                ended: numbers(&ended)?,
                final_observations: floats(&last)?,
            };
            Ok((rows, numbers::<u8>(&skipped)?))
        })?;
        self.skipped = skipped.iter().map(|flag| *flag > 0).collect();
        Ok(rows)
    }

    fn save(&mut self, _pause: Pause) -> Result<Option<Vec<u8>>> {
        Ok(None)
    }

    fn restore(&mut self, _snapshot: &[u8], _pause: Pause) -> Result<Rows> {
        Err(Error::invalid("checkpoint", "environments of another program cannot be restored"))
    }

    fn skipped(&self) -> &[bool] {
        &self.skipped
    }

    fn terms(&mut self) -> Result<Option<Vec<(String, f64)>>> {
        self.raised.call(|py| self.vector.bind(py).call_method0("terms")?.extract()).map(Some)
    }
}
