//! Work that Python waits for. Python's lock is free meanwhile, and Ctrl-C works.

use crate::errors::raise;
use parking_lot::Mutex;
use pyo3::prelude::*;
use sandgait::progress::Progress;
use sandgait::{Error, Result};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::Duration;

/// Interval of checks whether Python was interrupted: our choice, well below the 100 ms that a person notices.
pub const PATIENCE: Duration = Duration::from_millis(20);

/// Messages from a working thread to Python.
enum Event<T> {
    Progress(f64, String),
    Note(String),
    Done(Result<T>),
}

/// Tells the work whether a caller still waits for it.
#[derive(Clone, Default)]
pub struct Stop(Arc<AtomicBool>);

impl Stop {
    pub fn is_set(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

/// Progress of a study, for Python.
struct ProgressSender<T> {
    events: Sender<Event<T>>,
    stop: Stop,
}

impl<T: Send> Progress for ProgressSender<T> {
    fn report(&self, done: f64, stage: &str) -> Result<()> {
        if self.stop.is_set() {
            return Err(Error::Cancelled("stopped".into()));
        }
        // A caller that has left has set `stop`.
        let _ = self.events.send(Event::Progress(done, stage.to_owned()));
        Ok(())
    }

    fn note(&self, line: &str) {
        let _ = self.events.send(Event::Note(line.to_owned()));
    }
}

/// Result of `work` on a thread of its own. Ctrl-C is raised at once; the work is told to stop and ends by itself.
pub fn background<T: Send + 'static>(
    py: Python<'_>,
    work: impl FnOnce(&Stop) -> Result<T> + Send + 'static,
) -> PyResult<T> {
    let (stop, (sender, events)) = (Stop::default(), channel());
    let own = stop.clone();
    spawn(move || {
        let _ = sender.send(Event::Done(work(&own)));
    })?;
    wait(py, &Mutex::new(events), &stop, None)
}

/// The same for work with progress reports, which go to `told` with the finished share and the stage.
pub fn study<T: Send + 'static>(
    py: Python<'_>,
    told: Option<&Bound<'_, PyAny>>,
    work: impl FnOnce(&dyn Progress) -> Result<T> + Send + 'static,
) -> PyResult<T> {
    let (stop, events) = begun(work)?;
    wait(py, &events, &stop, told)
}

/// The same for work that must finish by itself because it leaves files: an interrupt is raised after that, with
/// the work's own report as a note. A second Ctrl-C does not wait.
pub fn to_the_end<T: Send + 'static>(
    py: Python<'_>,
    told: Option<&Bound<'_, PyAny>>,
    work: impl FnOnce(&dyn Progress) -> Result<T> + Send + 'static,
) -> PyResult<T> {
    let (stop, events) = begun(work)?;
    let outcome = wait(py, &events, &stop, told);
    let Err(raised) = &outcome else { return outcome };
    if stop.is_set()
        && let Err(ended) = wait(py, &events, &stop, None)
    {
        raised.value(py).call_method1("add_note", (ended.value(py).str()?,))?;
    }
    outcome
}

/// Starts work with progress reports.
fn begun<T: Send + 'static>(
    work: impl FnOnce(&dyn Progress) -> Result<T> + Send + 'static,
) -> PyResult<(Stop, Events<T>)> {
    let (stop, (sender, events)) = (Stop::default(), channel());
    let progress = ProgressSender { events: sender.clone(), stop: stop.clone() };
    spawn(move || {
        let _ = sender.send(Event::Done(work(&progress)));
    })?;
    Ok((stop, Mutex::new(events)))
}

/// Messages from the work; the waiting thread holds the lock.
type Events<T> = Mutex<Receiver<Event<T>>>;

/// Starts a thread without waiting for it.
pub fn spawn(work: impl FnOnce() + Send + 'static) -> PyResult<()> {
    let started = std::thread::Builder::new().name("sandgait".into()).spawn(work);
    started.map(drop).map_err(|e| raise(&Error::Exhausted(format!("no thread can be started: {e}"))))
}

/// Prints a line on Python's stderr, as progress is shown there.
fn print(py: Python<'_>, line: &str) -> PyResult<()> {
    py.import("sys")?.getattr("stderr")?.call_method1("write", (format!("{line}\n"),)).map(drop)
}

fn wait<T: Send>(py: Python<'_>, events: &Events<T>, stop: &Stop, told: Option<&Bound<'_, PyAny>>) -> PyResult<T> {
    let mut last = (0.0, String::new());
    loop {
        let next = || events.lock().recv_timeout(PATIENCE);
        let interrupted = match py.detach(next) {
            Ok(Event::Done(done)) => return done.map_err(|e| raise(&e)),
            Ok(Event::Progress(done, stage)) => {
                // Several threads report, so the order varies; only larger values are passed on.
                let now = (f64::clamp(done, last.0, 1.0), stage);
                let news = now != last;
                last = now;
                match told.filter(|_| news) {
                    Some(told) => told.call1((last.0, &last.1)).map(drop),
                    None => Ok(()),
                }
            }
            Ok(Event::Note(line)) => match told {
                Some(_) => print(py, &line),
                None => Ok(()),
            },
            Err(RecvTimeoutError::Timeout) => Ok(()),
            // A panic; the thread has printed the reason on stderr.
            Err(RecvTimeoutError::Disconnected) => {
                return Err(raise(&Error::Internal("the work failed".into())));
            }
        };
        if let Err(raised) = interrupted.and_then(|()| py.check_signals()) {
            stop.0.store(true, Ordering::Relaxed);
            return Err(raised);
        }
    }
}
