//! The ground that a robot walks on.

use super::obstacle::Obstacle;
use super::robot::Robot;
use super::tree::relief::Relief;
use super::tree::{HardGround, TreeModel};
use crate::error::{Error, Result, check_range};
use crate::number::Real;
use crate::sand::memory::MemorySettings;
use crate::sand::{Law, Mechanisms, Medium, Regularization, SandBed, SandDescription};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// The ground that the robot walks on, and the time step.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scene {
    pub medium: Medium,
    pub law: Law,
    #[serde(default)]
    pub surface: Regularization,
    /// Mechanisms of the sand. Mechanisms that concern sensors and logs have no effect here.
    #[serde(default)]
    pub mechanisms: Mechanisms,
    /// The surface rises toward +x [°]; gravity tilts in the surface's frame.
    pub slope_deg: f64,
    /// Time step [s].
    pub dt: f64,
    /// Extra mass at the base's centre [kg].
    pub payload: f64,
    /// Rigid obstacles in the sand; only engine `rapier` supports them.
    #[serde(default)]
    pub obstacles: Vec<Obstacle>,
    /// Hard ground in the sand or in place of it; only engine `tree` supports it.
    #[serde(default)]
    pub hard: Vec<HardGround>,
    /// Heights of the surface; None: flat. Only engine `tree` supports it. It is not part of a stored scene; the code
    /// that reads a scene adds it.
    #[serde(skip)]
    pub relief: Option<Arc<Relief>>,
    /// Settings of sand that stays where the robot has moved it; None: the surface never changes. Engines `lanes` and
    /// `tree` support it, on flat sand.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub memory: Option<MemorySettings>,
}

/// Cells along a side of the square of heights that moves with a robot, as a power of two: 64. Our choice, because they
/// take 12 KiB.
const BITS: u32 = 6;

/// Largest distance from the robot's middle to its farthest point [cells]: our choice, so that some cells remain around
/// the robot, although the square follows it in steps of eight cells.
const WITHIN: f64 = 22.0;

impl Scene {
    /// Time step of engine `lanes`, 1 ms: the largest at which the reference walks differ from the converged ones by at
    /// most 1 % (`docs/convergence.md`). Other engines have their own: [`super::engine::EngineKind::default_dt`].
    pub const DEFAULT_DT: f64 = 1e-3;

    /// Steepest slope, uphill or downhill [°]: natural slopes of dry sand end near 35°, its angle of repose.
    pub const MAX_SLOPE_DEG: f64 = 35.0;

    /// Largest payload [kg]: our choice, the mass of the heaviest base that [`Robot::validate`] accepts.
    pub const MAX_PAYLOAD: f64 = 1e3;

    pub fn flat(medium: Medium) -> Self {
        Self {
            medium,
            law: Law::Li2013,
            surface: Regularization::default(),
            mechanisms: Mechanisms::PLAIN,
            slope_deg: 0.0,
            dt: Self::DEFAULT_DT,
            payload: 0.0,
            obstacles: Vec::new(),
            hard: Vec::new(),
            relief: None,
            memory: None,
        }
    }

    /// A flat scene of this sand.
    pub fn on(sand: &SandDescription) -> Self {
        let mut scene = Self::flat(sand.medium());
        scene.set_sand(sand);
        scene
    }

    /// Replaces medium, law and mechanisms.
    pub fn set_sand(&mut self, sand: &SandDescription) {
        (self.medium, self.law, self.mechanisms) = (sand.medium(), sand.law, sand.mechanisms);
    }

    /// Gives the sand memory, for `robot`. A cell's side is three quarters of a leg's width (our choice: half of it,
    /// with finer steps, changes walking speeds by at most 2 %), or larger if the square must be larger to contain the
    /// robot. Sand slides as around a body of twice a leg's width: our choice, between a leg's width and its length.
    /// A robot without strips counts as 1 cm wide, like `xplorer`: also our choice.
    pub fn remember(&mut self, robot: &Robot) {
        let width = robot.leg.link.iter().rev().find_map(|link| link.sand.as_ref()).map_or(0.01, |strip| strip.width);
        let long = |v: [f64; 3]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
        let legs: f64 = robot.leg.link.iter().map(|link| long(link.reach)).sum();
        let reach = robot.hip.iter().map(|hip| long(hip.position)).fold(0.0, f64::max) + legs;
        let cell = (0.75 * width).max(reach / WITHIN);
        self.memory = Some(MemorySettings::new(&self.medium, cell, BITS, 2.0 * width, None));
    }

    /// Gives the sand memory, for a tree robot. The square contains the robot in its standing pose, and sand slides as
    /// around a body of two cells: our choice, because the sizes of feet differ. 1 mm keeps the cell from being 0.
    pub fn remember_tree(&mut self, tree: &TreeModel) {
        let cell = tree.reach().max(1e-3) / WITHIN;
        self.memory = Some(MemorySettings::new(&self.medium, cell, BITS, 2.0 * cell, None));
    }

    /// The sand, ready for evaluation.
    pub fn ground<R: Real>(&self) -> SandBed<R> {
        SandBed::new(self.law, &self.medium, &self.surface).with(&self.mechanisms, &self.medium)
    }

    /// Refuses scenes for which sand with memory is not defined.
    fn check_memory(&self) -> Result<()> {
        let no = |reason: &str| Err(Error::invalid("memory", reason));
        if self.mechanisms.footprint != 0.0 {
            return no("the sand's footprint mechanism and memory describe the same thing: leave one out");
        }
        if !self.hard.is_empty() || self.relief.is_some() {
            return no("it is defined for flat sand: not with hard ground, dunes or a relief");
        }
        if !self.obstacles.is_empty() {
            return no("it is not defined for sand with obstacles");
        }
        Ok(())
    }

    /// Refuses numbers outside of bounds that catch wrong units (our choice), and scenes that are not defined.
    pub(super) fn validate(&self) -> Result<()> {
        check_range("slope_deg", self.slope_deg, -Self::MAX_SLOPE_DEG..=Self::MAX_SLOPE_DEG)?;
        self.mechanisms.validated()?;
        crate::sand::term::check(&self.medium.terms, &self.medium.coefficients, self.medium.bulk_density)?;
        check_range("dt", self.dt, 1e-6..=5e-3)?;
        check_range("payload", self.payload, 0.0..=Self::MAX_PAYLOAD)?;
        if let Some(memory) = &self.memory {
            memory.validate()?;
            self.check_memory()?;
        }
        check_range("surface.rest_speed", self.surface.rest_speed, 1e-9..=1e-2)?;
        check_range("surface.leading_edge_gate", self.surface.leading_edge_gate, 1e-3..=1.0)?;
        check_range("surface.sign_gate", self.surface.sign_gate, 1e-3..=1.0)?;
        let Some(friction) = self.surface.friction else { return Ok(()) };
        if self.law != Law::Agarwal2023 {
            return Err(Error::invalid("surface.friction", format!("{} has no friction cap", self.law.name())));
        }
        check_range("surface.friction", friction, 0.0..=10.0).map(drop)
    }
}
