//! Sand's forces on rigid bodies that another simulator moves.
//!
//! The caller has poses and velocities of bodies, and gets the force and torque of the sand on each, with its drag:
//! the derivative that an implicit integrator needs to keep a body at rest. Frame: the caller's world, z up. Sand
//! fills the space below a plane, which may be inclined, or below a field of heights.
//!
//! ```
//! use sandgait_bodies::{Bodies, GroundOptions, Motions, BodyPart, SandGround};
//! use sandgait_sand::SandDescription;
//!
//! # fn main() -> sandgait_base::error::Result<()> {
//! let sand = SandGround::new(SandDescription::named("poppy-loose", "agarwal2023")?, GroundOptions::default())?;
//! let bodies = Bodies::new(vec![("foot".into(), vec![BodyPart::named("sphere:radius=0.02")?])], None)?;
//! // A ball with its centre 1 cm deep, which moves down at 10 cm/s.
//! let motions = Motions::contiguous(&[0.0, 0.0, -0.01], &[1.0, 0.0, 0.0, 0.0], &[0.0, 0.0, -0.1], &[0.0; 3]);
//! let mut wrench = [0.0; 6];
//! bodies.wrench(&sand, &motions, 1, &mut wrench, None)?;
//! assert!(wrench[2] > 0.1);
//! # Ok(())
//! # }
//! ```
//!
//! * [`ground`]: the sand and its surface; [`part`]: shapes by their names; [`body`]: bodies cut into plates.
//! * [`wrench`]: forces on many bodies in many states; `force`: the force on one body;
//!   [`exact`]: the force law for each plate by itself.
//! * [`joints`]: the same in the joint space of a tree of bodies, for MuJoCo.

use sandgait_base::error;
use sandgait_number as number;
use sandgait_robots as robots;
use sandgait_sand as sand;
use sandgait_sim as sim;

pub mod body;
pub mod exact;
mod force;
pub mod ground;
pub mod joints;
pub mod part;
pub mod wrench;

#[cfg(test)]
mod tests;

pub use body::Bodies;
pub use ground::{GroundOptions, SandGround};
pub use joints::JointSand;
pub use part::BodyPart;
pub use wrench::{Motions, Precision, Strided};
