//! How far long work has come, told to whoever waits for it, who may stop it.

use crate::error::Result;

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
