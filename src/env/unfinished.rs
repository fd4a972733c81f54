//! A control step that is made in parts; [`super::stepping`] makes it.

use super::episode::Episode;

/// A control step that has begun.
pub(super) struct UnfinishedStep {
    /// Times at which delayed actions arrive [time steps], in ascending order, and how many of them are over.
    pub(super) arrivals: Vec<usize>,
    pub(super) arrived: usize,
    /// Time steps so far.
    pub(super) now: usize,
    /// Has the engine begun the part up to the next arrival?
    pub(super) begun: bool,
    /// Environments that keep their states.
    pub(super) held: Vec<(usize, Episode)>,
}
