//! Tasks: observations, actions and rewards.
//!
//! This crate turns simulated robots into episodes. It has no threads, sessions or messages.
//!
//! * [`spec`]: observation, action and info tables; they generate vectors, replies, Python spaces and docs.
//! * [`task`]: the trait a task implements; `setup`: a task with its options; [`registry`]: the list of tasks.
//! * [`options`]: how a task declares its keywords, [`feature`]: the numbers of its rows, [`reward`]: its reward's
//!   terms.
//! * [`locomotion`], [`walking`]: the parts that walking tasks share; [`gait`]: the task HexapodGait, [`legs`]:
//!   HexapodLegs, [`rocks`]: HexapodRocks.
//! * [`terrain`]: the task HexapodTerrain; [`ground`]: its patches and footprints; [`stroke`]: the task LegStroke.
//! * [`legged`]: the task LeggedVelocity, of any robot from a file.
//! * [`control`]: control modes of hips; [`clock`]: the mode with a gait's parameters as action;
//!   [`reference`](mod@reference): how the servos' references move.
//! * [`sensors`]: from exact values to observations, and the delay of actions.
//! * [`shard`]: environments that advance together on one engine; reset, autoreset; `stepping`: a step, in parts. [`episode`]: what each of them
//!   goes on from; [`snapshot`]: episodes as data; [`rollout`]: many steps in one call.
//! * [`look`]: one environment for viewers.
//! * [`random`]: the stream of random numbers of an episode.

pub use sandgait_base::error;

use sandgait_sand as sand;
use sandgait_sim as sim;

pub mod clock;
pub mod control;
pub mod episode;
pub mod feature;
pub mod gait;
pub mod ground;
pub mod legged;
pub mod legs;
pub mod locomotion;
pub mod look;
pub mod options;
pub mod random;
pub mod reference;
pub mod registry;
pub mod reward;
pub mod rocks;
pub mod rollout;
mod rows;
pub mod sensors;
mod setup;
pub mod shard;
pub mod snapshot;
pub mod spec;
mod stepping;
pub mod stroke;
pub mod task;
pub mod terrain;
mod unfinished;
pub mod walking;

pub use look::EnvView;
pub use options::ResetOptions;
pub use shard::Shard;
pub use spec::{Column, Spec};
pub use task::{AnyTask, Task};
