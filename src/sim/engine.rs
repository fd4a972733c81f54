//! The interface between a model and the engines that integrate it. No code above this file depends on which engine
//! runs.

use super::carriage::CarriageEngine;
use super::lanes::LanesEngine;
use super::model::Scene;
use super::rapier::RapierEngine;
use super::tree::TreeEngine;
use super::{Model, State};
use crate::error::{Error, Result};
use crate::number::flushed;
use crate::sand::memory::Moved;
use serde::{Deserialize, Serialize};

pub use super::command::Command;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum EngineKind {
    /// Our own articulated-body dynamics over SIMD lanes; see [`super::lanes`].
    Lanes,
    /// rapier3d multibodies, one world for each robot. The reference that `lanes` is tested against, and the engine for
    /// rigid obstacles; see [`super::rapier`].
    Rapier,
    /// Any tree of bodies from a file, over the same lanes; see [`super::tree`].
    Tree,
    /// Legs on driven carriages, for LegStroke; see [`super::carriage`].
    Carriage,
}

impl EngineKind {
    /// The engines for robots with identical legs; users choose between them.
    pub const ALL: [Self; 2] = [Self::Lanes, Self::Rapier];

    pub fn name(self) -> &'static str {
        match self {
            Self::Lanes => "lanes",
            Self::Rapier => "rapier",
            Self::Tree => "tree",
            Self::Carriage => "carriage",
        }
    }

    /// Default time step [s]: walks are within 1 to 2 % of the converged ones; see `docs/convergence.md`.
    pub fn default_dt(self) -> f64 {
        match self {
            Self::Lanes | Self::Tree | Self::Carriage => Scene::DEFAULT_DT,
            Self::Rapier => 5e-4,
        }
    }

    /// Number of environments in a shard, which a thread computes as a whole.
    pub fn shard_size(self) -> usize {
        match self {
            Self::Lanes | Self::Tree | Self::Carriage => 16,
            Self::Rapier => 1,
        }
    }

    pub fn named(name: &str) -> Result<Self> {
        let known = Self::ALL.map(Self::name);
        Self::ALL.into_iter().find(|e| e.name() == name).ok_or_else(|| Error::unknown("engine", name, &known))
    }
}

/// Robots that advance together, each on its own sand.
pub enum Engine {
    Lanes(LanesEngine),
    Rapier(RapierEngine),
    Tree(TreeEngine),
    Carriage(CarriageEngine),
}

impl Engine {
    /// `count` robots at rest, all with `model`.
    pub fn new(kind: EngineKind, model: &Model, count: usize) -> Result<Self> {
        if model.scene.memory.is_some() && !matches!(kind, EngineKind::Lanes | EngineKind::Tree) {
            let reason = format!("engine {} has none; lanes and tree have", kind.name());
            return Err(Error::invalid("memory", reason));
        }
        Ok(match kind {
            EngineKind::Lanes => Self::Lanes(LanesEngine::new(model, count)?),
            EngineKind::Rapier => Self::Rapier(RapierEngine::new(model, count)),
            EngineKind::Tree => Self::Tree(TreeEngine::new(model, count)?),
            EngineKind::Carriage => Self::Carriage(CarriageEngine::new(model, count)),
        })
    }

    /// Gives robot `index` another model with equally many joints and plates. Takes effect with the next
    /// `set_state`.
    pub fn set_model(&mut self, index: usize, model: &Model) {
        match self {
            Self::Lanes(e) => e.set_model(index, model),
            Self::Rapier(e) => e.set_model(index, model),
            Self::Tree(e) => e.set_model(index, model),
            Self::Carriage(e) => e.set_model(index, model),
        }
    }

    /// Scales the sand's stress on each leg of robot `index`, which has `model`, by `shares` [legs], until the
    /// model or the shares are set again. Takes effect at once.
    pub fn set_footing(&mut self, index: usize, model: &Model, shares: &[f64]) {
        match self {
            Self::Lanes(e) => e.set_footing(index, model, shares),
            Self::Rapier(e) => e.set_footing(index, model, shares),
            Self::Tree(_) => (), // no task of engine `tree` has footprints
            Self::Carriage(e) => e.set_footing(index, model, shares),
        }
    }

    pub fn set_state(&mut self, index: usize, state: &State) {
        match self {
            Self::Lanes(e) => e.set_state(index, state),
            Self::Rapier(e) => e.set_state(index, state),
            Self::Tree(e) => e.set_state(index, state),
            Self::Carriage(e) => e.set_state(index, state),
        }
    }

    /// Copies robot `index`'s state into `out` without allocating.
    pub fn state(&self, index: usize, out: &mut State) {
        match self {
            Self::Lanes(e) => e.state(index, out),
            Self::Rapier(e) => e.state(index, out),
            Self::Tree(e) => e.state(index, out),
            Self::Carriage(e) => e.state(index, out),
        }
    }

    /// The sand around robot `index`; None if it has no memory.
    pub fn sand(&self, index: usize) -> Option<&Moved> {
        match self {
            Self::Lanes(e) => e.sand(index),
            Self::Tree(e) => e.sand(index),
            Self::Rapier(_) | Self::Carriage(_) => None,
        }
    }

    pub fn command(&mut self, index: usize, command: &Command) {
        match self {
            Self::Lanes(e) => e.command(index, command),
            Self::Rapier(e) => e.command(index, command),
            Self::Tree(e) => e.command(index, command),
            Self::Carriage(e) => e.command(index, command),
        }
    }

    /// Advances every robot by `steps` time steps, with denormal numbers counted as zero: see [`flushed`].
    pub fn advance(&mut self, steps: usize) {
        self.advance_in_parts(steps, true);
    }

    /// The same in parts, of which the last one `ends` it: parts do not change bits, except in engine `rapier` with obstacles.
    pub fn advance_in_parts(&mut self, steps: usize, ends: bool) {
        flushed(|| match self {
            Self::Lanes(e) => e.advance_in_parts(steps, ends),
            Self::Rapier(e) => e.advance(steps),
            Self::Tree(e) => e.advance_in_parts(steps, ends),
            Self::Carriage(e) => e.advance_in_parts(steps, ends),
        });
    }

    /// Fills `out` with the sand's force on each leg of robot `index` along the surface's normal in the last time step [N]. Empty: the engine
    /// does not keep it, and [`super::pose::Pose`] computes it.
    pub fn supports(&self, index: usize, out: &mut Vec<f64>) {
        match self {
            Self::Lanes(e) => e.supports(index, out),
            Self::Rapier(_) | Self::Tree(_) | Self::Carriage(_) => out.clear(),
        }
    }
}
