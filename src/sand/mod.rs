//! Granular resistive forces: the force of sand on a small flat piece of surface that moves through it.
//!
//! Pure functions over [`crate::number::Real`]; this crate has no robots, engines, time or randomness. Frame: x
//! along the surface (uphill on a slope), z along the surface's outward normal, sand at z < 0.
//!
//! * [`media`]: kinds of sand: stress coefficients with their sources.
//! * [`law`]: stress per depth from a segment's orientation and direction of motion; three published laws.
//! * [`contact`]: force on a segment, with the derivatives that an implicit integrator needs to keep it at rest.
//! * [`mechanism`]: the list of mechanisms that plain theory leaves out, with sources and bounds.
//! * [`mechanism_laws`]: the equations of the mechanisms that act in the sand.
//! * [`term`]: additional stress terms from `sand.toml`.
//! * [`memory`]: sand that stays where it was moved: heights of the surface, and compaction.
//! * [`shape`]: intruders (plates and legs) cut into segments.
//! * [`description`]: medium and mechanisms as a file, `sand.toml`.
//! * [`intruder`]: any rigid body in steady motion, from plates on its surface.
//! * [`intrusion`]: a leg rotated about a fixed hip, as on a force-measuring arm.

use sandgait_base::error;
use sandgait_number as number;

mod coefficients;
pub mod contact;
pub mod description;
mod friction;
mod functions;
pub mod intruder;
pub mod intrusion;
pub mod law;
pub mod mechanism;
pub mod mechanism_laws;
pub mod media;
pub mod memory;
pub mod shape;
pub mod term;

pub use coefficients::Coefficients;
pub use contact::{Contact, LawCoefficients, Regularization, SandBed};
pub use description::SandDescription;
pub use law::Law;
pub use mechanism::{Mechanism, Mechanisms};
pub use mechanism_laws::{Plain, SandMechanisms, SegmentState, StressModel};
pub use media::Medium;
pub use shape::{LegShape, Segment};
pub use term::Term;

/// Standard gravity [m/s²].
pub const GRAVITY: f64 = 9.80665;
