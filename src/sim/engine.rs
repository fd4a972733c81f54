//! The interface between a model and the engines that integrate it. No code above this file depends on which engine
//! runs.
//!
//! `lanes` computes hexapods in SIMD lanes; it is our own code, because its speed is the purpose of the project. `rapier` builds
//! the same robot from rapier3d's multibodies: the reference for `lanes`, and the only engine with rigid obstacles. `carriage`
//! drives a leg through sand, for LegStroke alone. `tree` simulates any robot. It could simulate the hexapods, too; `lanes`
//! computes identical legs of flat strips in two coordinates, which is twice as fast.

use super::carriage::CarriageEngine;
use super::model::Scene;
use super::rapier::RapierEngine;
use super::{Model, lanes, tree};
use crate::error::{Error, Result};
use crate::number::{Isa, flushed};
use serde::{Deserialize, Serialize};
use std::ops::{Deref, DerefMut};

pub use super::command::Command;
pub use super::integrator::Integrator;

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

    /// Default time step [s], at which walks differ from the converged ones by at most 1 to 2 %; see `docs/convergence.md`.
    pub fn default_dt(self) -> f64 {
        match self {
            Self::Lanes | Self::Tree | Self::Carriage => Scene::DEFAULT_DT,
            Self::Rapier => 5e-4,
        }
    }

    /// Number of environments in a shard, which one thread computes: our choice, the most lanes that an instruction set
    /// has; `rapier` has no lanes.
    pub fn shard_size(self) -> usize {
        match self {
            Self::Lanes | Self::Tree | Self::Carriage => 16,
            Self::Rapier => 1,
        }
    }

    /// Number of robots that advance together in about the time of one.
    pub fn lanes(self) -> Result<usize> {
        Ok(match self {
            Self::Lanes | Self::Tree => Isa::choose()?.lanes(),
            Self::Rapier | Self::Carriage => 1,
        })
    }

    pub fn named(name: &str) -> Result<Self> {
        let known = Self::ALL.map(Self::name);
        Self::ALL.into_iter().find(|e| e.name() == name).ok_or_else(|| Error::unknown("engine", name, &known))
    }
}

/// Robots that advance together, each on its own sand. The processor treats denormal numbers as zero: see [`flushed`].
pub struct Engine(Box<dyn Integrator>);

impl Engine {
    /// `count` robots at rest, all with `model`.
    pub fn new(kind: EngineKind, model: &Model, count: usize) -> Result<Self> {
        if model.scene.memory.is_some() && !matches!(kind, EngineKind::Lanes | EngineKind::Tree) {
            let reason = format!("engine {} has none; lanes and tree have", kind.name());
            return Err(Error::invalid("memory", reason));
        }
        Ok(Self(match kind {
            EngineKind::Lanes => Box::new(lanes::engine(Isa::choose()?, model, count)?),
            EngineKind::Rapier => Box::new(RapierEngine::new(model, count)),
            EngineKind::Tree => Box::new(tree::engine(Isa::choose()?, model, count)?),
            EngineKind::Carriage => Box::new(CarriageEngine::new(model, count)),
        }))
    }

    /// See [`Integrator::advance`].
    pub fn advance(&mut self, steps: usize) {
        self.advance_in_parts(steps, true);
    }

    /// See [`Integrator::advance_in_parts`].
    pub fn advance_in_parts(&mut self, steps: usize, ends: bool) {
        flushed(|| self.0.advance_in_parts(steps, ends));
    }

    /// See [`Integrator::begin_part`].
    pub fn begin_part(&mut self, steps: usize) {
        flushed(|| self.0.begin_part(steps));
    }

    /// See [`Integrator::go_on`].
    pub fn go_on(&mut self, steps: usize, ends: bool) {
        flushed(|| self.0.go_on(steps, ends));
    }
}

impl Deref for Engine {
    type Target = dyn Integrator;

    fn deref(&self) -> &Self::Target {
        &*self.0
    }
}

impl DerefMut for Engine {
    fn deref_mut(&mut self) -> &mut Self::Target {
        &mut *self.0
    }
}
