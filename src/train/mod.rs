//! Learns gaits by proximal policy optimization, in the same process as the environments and without Python.
//!
//! ```text
//!  settings ──▶ plan, learner ──▶ training: rollouts (collect, normal, remote) and updates (learn, loss, adam) in turn, over a crew
//!                  │                         └── network, mirror, matrix            of threads; saved_environments: to go on bit-identically
//!                  └──▶ run: one training, with policy.onnx, checkpoints, learning curve, events, film
//! ```
//!
//! A training calls `Observer` every few milliseconds; an error of the observer ends the training between parts of an update,
//! and the checkpoint has the state after the last one.

use sandgait_base::{error, files, progress};
use sandgait_env as env;
use sandgait_evaluate as evaluate;
use sandgait_number as number;
use sandgait_plot as plot;
use sandgait_policy as policy;
use sandgait_session as session;
use sandgait_sim as sim;
use sandgait_view as view;

mod adam;
mod checkpoint;
mod collect;
mod crew;
mod curve;
pub mod describe;
pub mod entry;
mod events;
mod export;
mod film;
pub mod golden;
#[cfg(test)]
mod gradients;
mod learn;
mod learner;
mod loss;
mod matrix;
mod mirror;
mod network;
mod normal;
mod outlook;
pub mod plan;
pub mod remote;
mod run;
mod saved_environments;
pub mod settings;
mod spec;
pub mod teacher;
mod tensors;
mod training;
mod work;
mod yaml;

pub use curve::CurvePoint;
pub use export::onnx;
pub use mirror::Mirror;
pub use plan::{Observer, TrainingPlan, TrainingState, UpdateReport};
pub use run::{Connect, PolicyScore, TrainingOutcome, TrainingRequest};
pub use settings::Hyperparameters;
pub use spec::{ExternalSpaces, TrainingSpec};
