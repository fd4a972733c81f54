//! Tasks: what a learner sees, does and is paid for.
//!
//! This layer turns simulated robots into episodes. It knows nothing of threads, sessions or messages.
//!
//! * [`spec`]: observation, action and info tables; they generate vectors, replies, Python spaces and docs.
//! * [`task`]: the trait a task implements; [`registry`]: which tasks there are.
//! * [`options`]: how a task declares its keywords, [`feature`]: the numbers of its rows, [`reward`]: its reward's terms.
//! * [`locomotion`], [`walking`]: what walking tasks share; [`gait`]: the task HexapodGait, [`legs`]: HexapodLegs, [`rocks`]: HexapodRocks.
//! * [`terrain`]: the task HexapodTerrain; [`ground`]: what its episodes remember; [`stroke`]: the task LegStroke.
//! * [`legged`]: the task LeggedVelocity, of any robot from a file.
//! * [`control`]: ways of driving hips; [`clock`]: the one that is a gait as parameters; [`reference`](mod@reference): how far references go.
//! * [`shard`]: environments that advance together on one engine; reset, step, autoreset.
//! * [`snapshot`]: episodes as data; [`rollout`]: many steps with actions that are known beforehand.
//! * [`look`]: one environment for those who only look.
//! * [`random`]: the stream of random numbers of an episode.

use sandgait_base::error;
use sandgait_sand as sand;
use sandgait_sim as sim;

pub mod clock;
pub mod control;
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
pub mod shard;
pub mod snapshot;
pub mod spec;
pub mod stroke;
pub mod task;
pub mod terrain;
pub mod walking;

pub use look::Look;
pub use options::ResetOptions;
pub use shard::Shard;
pub use spec::{Column, Spec};
pub use task::{AnyTask, Task};
