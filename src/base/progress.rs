//! How far long work has come, told to whoever waits for it, who may stop it.

use crate::error::{Error, Result};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Hears how far work has come. Work of several threads reports from any of them.
pub trait Progress: Sync {
    /// `done` of the whole, 0 to 1, and what is done next. An error, [`crate::Error::Cancelled`] by custom, stops the work,
    /// which hands that error back.
    fn report(&self, done: f64, stage: &str) -> Result<()>;
}

/// Tells nobody and never stops.
pub struct Silent;

impl Progress for Silent {
    fn report(&self, _done: f64, _stage: &str) -> Result<()> {
        Ok(())
    }
}

/// A stretch of longer work: its 0 to 1 are `ends` of the whole.
pub struct Part<'a> {
    whole: &'a dyn Progress,
    ends: [f64; 2],
}

impl<'a> Part<'a> {
    pub fn new(whole: &'a dyn Progress, ends: [f64; 2]) -> Self {
        Self { whole, ends }
    }
}

impl Progress for Part<'_> {
    fn report(&self, done: f64, stage: &str) -> Result<()> {
        let [start, end] = self.ends;
        self.whole.report(start + (end - start) * done, stage)
    }
}

/// How often [`Latch::stopped`] asks: often against the second within which work is to stop, seldom enough to cost nothing.
const ASKED: Duration = Duration::from_millis(200);

/// For work whose results have no place for an error: deep inside it asks [`Latch::stopped`], and comes to a quick end with
/// whatever it has; the error is handed back by the next report, and by every later one.
pub struct Latch<'a> {
    whole: &'a dyn Progress,
    told: Mutex<Told>,
}

struct Told {
    done: f64,
    stage: String,
    asked: Instant,
    error: Option<Error>,
}

impl<'a> Latch<'a> {
    pub fn new(whole: &'a dyn Progress) -> Self {
        Self { whole, told: Mutex::new(Told { done: 0.0, stage: String::new(), asked: Instant::now(), error: None }) }
    }

    /// Has the work been stopped? Reports the present stage again to find out.
    pub fn stopped(&self) -> bool {
        let mut told = self.told();
        if told.error.is_none() && told.asked.elapsed() >= ASKED {
            let (done, stage) = (told.done, told.stage.clone());
            // What stopped it is kept.
            let _ = self.ask(&mut told, done, &stage);
        }
        told.error.is_some()
    }

    /// What stopped the work.
    pub fn error(&self) -> Option<Error> {
        self.told().error.clone()
    }

    fn told(&self) -> MutexGuard<'_, Told> {
        self.told.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn ask(&self, told: &mut Told, done: f64, stage: &str) -> Result<()> {
        if told.error.is_none() {
            told.error = self.whole.report(done, stage).err();
            (told.done, told.stage, told.asked) = (done, stage.to_owned(), Instant::now());
        }
        told.error.clone().map_or(Ok(()), Err)
    }
}

impl Progress for Latch<'_> {
    fn report(&self, done: f64, stage: &str) -> Result<()> {
        self.ask(&mut self.told(), done, stage)
    }
}
