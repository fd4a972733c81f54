//! Design studies: how a robot's walk changes with its design and its sand.
//!
//! [`parameter`]: a number that can vary → [`grid`]: every design; [`run`]: its walks on lanes and cores →
//! [`figure`], or [`optimize`]: a search for the best design. After Li et al. 2012, section 5.

use sandgait_base::{error, parallel, progress};
use sandgait_plot as plot;
use sandgait_sand as sand;
use sandgait_sim as sim;

pub mod figure;
pub mod grid;
pub mod optimize;
pub mod parameter;
pub mod run;

pub use grid::grid;
pub use parameter::{Parameter, SweepAxis};
pub use run::walk_all;

use crate::error::{Error, Result};
use crate::sim::model::Scene;
use crate::sim::walk::{WalkResult, WalkTrial};
use crate::sim::{Model, Robot};

/// One robot on one sand at one stride frequency.
#[derive(Clone, Debug)]
pub struct Design {
    pub robot: Robot,
    pub scene: Scene,
    /// [Hz]
    pub frequency: f64,
    /// Angle that is added to every hip's starting angle [rad].
    pub phase: f64,
}

impl Design {
    /// Stride frequency [Hz] unless another is given: our choice, because legs of any shape walk at it.
    pub const FREQUENCY: f64 = 2.0;

    /// Sets parameters by their names, in order.
    pub fn set<'a>(&mut self, settings: impl IntoIterator<Item = (&'a str, &'a str)>) -> Result<()> {
        settings.into_iter().try_for_each(|(name, value)| Parameter::named(name)?.set(self, value))
    }

    pub fn trial(&self) -> Result<WalkTrial> {
        let model = Model::new(&self.robot, &self.scene)?;
        Ok(WalkTrial { phase: self.phase, ..WalkTrial::new(model, self.frequency) })
    }
}

/// The figure of a walk that a study compares.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SweepMeasure {
    Speed,
    CostOfTransport,
}

impl SweepMeasure {
    pub fn named(name: &str) -> Result<Self> {
        match name {
            "speed" => Ok(Self::Speed),
            "cost-of-transport" => Ok(Self::CostOfTransport),
            _ => Err(Error::unknown("measure", name, &[Self::Speed, Self::CostOfTransport].map(Self::name))),
        }
    }

    pub const fn name(self) -> &'static str {
        match self {
            Self::Speed => "speed",
            Self::CostOfTransport => "cost-of-transport",
        }
    }

    pub fn label(self) -> &'static str {
        match self {
            Self::Speed => "forward speed [cm/s]",
            Self::CostOfTransport => "cost of transport",
        }
    }

    /// The figure in the unit of its label.
    pub fn of(self, result: &WalkResult) -> f64 {
        match self {
            Self::Speed => 100.0 * result.speed,
            Self::CostOfTransport => result.cost_of_transport,
        }
    }

    /// The best of these walks; None if there are none.
    pub fn best(self, results: &[WalkResult]) -> Option<usize> {
        (0..results.len()).min_by(|a, b| self.cost(&results[*a]).total_cmp(&self.cost(&results[*b])))
    }

    /// Smaller is better. A walk that failed or went backward is the worst.
    pub fn cost(self, result: &WalkResult) -> f64 {
        let value = match self {
            Self::Speed => -result.speed,
            Self::CostOfTransport if result.speed > 0.0 => result.cost_of_transport,
            Self::CostOfTransport => f64::INFINITY,
        };
        if value.is_finite() { value } else { 1e9 }
    }
}
