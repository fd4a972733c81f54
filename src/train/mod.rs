//! Learning a gait: proximal policy optimization beside the environments, without Python.
//!
//! ```text
//!  settings ──▶ learner ──▶ rollouts (collect, normal) and updates (learn, loss, adam) in turn, over a crew of threads
//!                  │                         └── network, mirror, matrix
//!                  ├──▶ run: one training, with policy.onnx, checkpoints, learning curve, events, film
//!                  └──▶ design: many designs, a gait learnt for each
//! ```

use sandgait_base::{error, parallel, progress};
use sandgait_env as env;
use sandgait_evaluate as evaluate;
use sandgait_number as number;
use sandgait_plot as plot;
use sandgait_policy as policy;
use sandgait_sim as sim;
use sandgait_sweep as sweep;
use sandgait_view as view;

mod adam;
mod checkpoint;
mod collect;
mod crew;
mod curve;
pub mod design;
pub mod entry;
mod events;
mod export;
mod film;
#[cfg(test)]
mod gradients;
mod learn;
pub mod learner;
mod loss;
mod matrix;
mod mirror;
mod network;
mod normal;
mod run;
pub mod settings;
mod tensors;
mod yaml;

pub use export::onnx;
pub use learner::{Learnt, Plan, Report};
pub use run::{Outcome, Request};
pub use settings::Settings;
