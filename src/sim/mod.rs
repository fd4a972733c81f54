//! A legged robot on sand: immutable [`Model`], small [`State`], and engines that advance it.
//!
//! This crate has no rewards, randomness, threads or messages.
//!
//! * [`robot`]: a robot as a user's TOML file describes it.
//! * [`model`]: the same as numbers: bodies (`links`), joints, servos, sand, gravity, time step (`scene`).
//! * [`obstacle`]: rigid obstacles in the sand; [`solid`]: their geometry.
//! * [`overlap`]: how far a robot stands inside obstacles, for tests.
//! * [`state`]: positions and velocities of one robot.
//! * [`feet`]: positions and velocities of the legs' tips.
//! * [`frame`]: positions, velocities and velocity-product accelerations of the bodies.
//! * `memory`: memory of models and robots, for limits.
//! * [`pose`]: places of the bodies and forces of the ground at one moment.
//! * [`actuator`]: what a motor and its gear can do; [`motor`]: servo and motor of a robot.
//! * [`hardware`]: what is known of a robot's motors, sensors and delays, as a file.
//! * [`engine`]: the one interface to all engines; [`integrator`]: what each of them does.
//! * [`blocks`]: robots in lanes, for `lanes` and `tree`; [`spatial`]: their spatial algebra; [`stop`]: the ends of a joint's range.
//! * [`lanes`]: the fast engine, articulated bodies over SIMD lanes of robots.
//! * [`rapier`]: rapier3d multibodies, one world for each robot.
//! * [`carriage`]: a leg on a driven carriage; the sand's forces on it are measured.
//! * [`tree`]: any legged robot as a tree of bodies.
//! * `used`: sand that remembers, in lanes.
//! * [`walk`]: the speed protocol of the reference experiments.

use sandgait_base::error;
use sandgait_number as number;
use sandgait_sand as sand;

pub mod actuator;
pub mod blocks;
pub mod carriage;
pub mod command;
pub mod engine;
pub mod feet;
pub mod frame;
pub mod hardware;
mod hull;
pub mod integrator;
pub mod lanes;
mod links;
mod memory;
pub mod model;
pub mod motor;
pub mod obstacle;
pub mod overlap;
pub mod pose;
pub mod rapier;
pub mod robot;
mod scene;
pub mod solid;
pub mod spatial;
pub mod state;
pub mod stop;
pub mod tree;
mod used;
pub mod walk;

pub use memory::{MemoryCount, resident};
pub use model::Model;
pub use obstacle::Obstacle;
pub use robot::Robot;
pub use state::State;
