//! Work that Python waits for. Its lock is free meanwhile, and Ctrl-C is heard.

use crate::errors::raise;
use pyo3::prelude::*;
use sandgait::progress::Progress;
use sandgait::{Error, Result};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::Duration;

/// Between two looks at whether Python was interrupted: our choice, well below the 100 ms that a person notices.
pub const PATIENCE: Duration = Duration::from_millis(20);

/// What a thread tells Python while it works.
enum Event<T> {
    Progress(f64, String),
    Done(Result<T>),
}

/// Says whether anybody waits for the work any more.
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
            return Err(Error::Cancelled("the study was stopped".into()));
        }
        // Whoever has gone has set `stop`.
        let _ = self.events.send(Event::Progress(done, stage.to_owned()));
        Ok(())
    }
}

/// Result of `work` on a thread of its own. Ctrl-C is raised at once; the work is told to stop and comes to its end alone.
pub fn background<T: Send + 'static>(
    py: Python<'_>,
    work: impl FnOnce(&Stop) -> Result<T> + Send + 'static,
) -> PyResult<T> {
    let (stop, (sender, events)) = (Stop::default(), channel());
    let own = stop.clone();
    spawn(move || {
        let _ = sender.send(Event::Done(work(&own)));
    })?;
    wait(py, events, &stop, None)
}

/// The same for work that tells its progress: to `told`, with the share done and what is done now.
pub fn study<T: Send + 'static>(
    py: Python<'_>,
    told: Option<&Bound<'_, PyAny>>,
    work: impl FnOnce(&dyn Progress) -> Result<T> + Send + 'static,
) -> PyResult<T> {
    let (stop, (sender, events)) = (Stop::default(), channel());
    let progress = ProgressSender { events: sender.clone(), stop: stop.clone() };
    spawn(move || {
        let _ = sender.send(Event::Done(work(&progress)));
    })?;
    wait(py, events, &stop, told)
}

/// Starts a thread that nobody waits for.
pub fn spawn(work: impl FnOnce() + Send + 'static) -> PyResult<()> {
    let started = std::thread::Builder::new().name("sandgait".into()).spawn(work);
    started.map(drop).map_err(|e| raise(&Error::Exhausted(format!("no thread can be started: {e}"))))
}

fn wait<T: Send>(
    py: Python<'_>,
    mut events: Receiver<Event<T>>,
    stop: &Stop,
    told: Option<&Bound<'_, PyAny>>,
) -> PyResult<T> {
    let mut last = (0.0, String::new());
    loop {
        let interrupted = match py.detach({
            let events = &mut events;
            move || events.recv_timeout(PATIENCE)
        }) {
            Ok(Event::Done(done)) => return done.map_err(|e| raise(&e)),
            Ok(Event::Progress(done, stage)) => {
                // Reports of several threads come out of order; what is told only grows.
                let now = (f64::clamp(done, last.0, 1.0), stage);
                let news = now != last;
                last = now;
                match told.filter(|_| news) {
                    Some(told) => told.call1((last.0, &last.1)).map(drop),
                    None => Ok(()),
                }
            }
            Err(RecvTimeoutError::Timeout) => Ok(()),
            // A panic; the thread has said why on stderr.
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
