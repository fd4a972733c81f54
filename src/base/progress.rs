//! Progress reports of long work. Their receiver may stop the work.

use crate::error::{Error, Result};
use parking_lot::Mutex;
use std::time::{Duration, Instant};

/// Receives progress reports, from any of the threads that work.
pub trait Progress: Sync {
    /// `done` is the finished share, 0 to 1; `stage` describes the next part of the work. If this returns an error,
    /// usually [`crate::Error::Cancelled`], the work stops and returns that error.
    fn report(&self, done: f64, stage: &str) -> Result<()>;

    /// A line that the user should be able to read at any later time. The default ignores it.
    fn note(&self, _line: &str) {}
}

/// Ignores all reports and never stops.
pub struct Silent;

impl Progress for Silent {
    fn report(&self, _done: f64, _stage: &str) -> Result<()> {
        Ok(())
    }
}

/// A part of longer work: its progress from 0 to 1 is reported as a share between `ends` of the whole.
pub struct PartialProgress<'a> {
    whole: &'a dyn Progress,
    ends: [f64; 2],
}

impl<'a> PartialProgress<'a> {
    pub fn new(whole: &'a dyn Progress, ends: [f64; 2]) -> Self {
        Self { whole, ends }
    }
}

impl Progress for PartialProgress<'_> {
    fn report(&self, done: f64, stage: &str) -> Result<()> {
        let [start, end] = self.ends;
        self.whole.report(start + (end - start) * done, stage)
    }

    fn note(&self, line: &str) {
        self.whole.note(line);
    }
}

/// Least time between two calls of [`Latch::stopped`] that ask the receiver: our choice, because work then stops within
/// a second, and asking takes hardly any time.
const ASKED: Duration = Duration::from_millis(200);

/// For work whose results cannot carry an error. The work asks [`Latch::stopped`] and, if stopped, ends early with
/// unfinished results. The next report returns the error, and so does every later one.
pub struct Latch<'a> {
    whole: &'a dyn Progress,
    told: Mutex<LatchState>,
}

struct LatchState {
    done: f64,
    stage: String,
    asked: Instant,
    error: Option<Error>,
}

impl<'a> Latch<'a> {
    pub fn new(whole: &'a dyn Progress) -> Self {
        Self {
            whole,
            told: Mutex::new(LatchState { done: 0.0, stage: String::new(), asked: Instant::now(), error: None }),
        }
    }

    /// Has the receiver stopped the work? Asks it by reporting the present stage again, but not at every call.
    pub fn stopped(&self) -> bool {
        let mut told = self.told.lock();
        if told.error.is_none() && told.asked.elapsed() >= ASKED {
            let (done, stage) = (told.done, told.stage.clone());
            // `ask` keeps the error.
            let _ = self.ask(&mut told, done, &stage);
        }
        told.error.is_some()
    }

    /// The error that stopped the work.
    pub fn error(&self) -> Option<Error> {
        self.told.lock().error.clone()
    }

    fn ask(&self, told: &mut LatchState, done: f64, stage: &str) -> Result<()> {
        if told.error.is_none() {
            told.error = self.whole.report(done, stage).err();
            (told.done, told.stage, told.asked) = (done, stage.to_owned(), Instant::now());
        }
        told.error.clone().map_or(Ok(()), Err)
    }
}

impl Progress for Latch<'_> {
    fn report(&self, done: f64, stage: &str) -> Result<()> {
        self.ask(&mut self.told.lock(), done, stage)
    }
}
