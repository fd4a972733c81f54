//! Learning a gait: proximal policy optimization beside the environments, without Python.
//!
//! ```text
//!  settings ──▶ learner ──▶ rollouts (collect, normal) and updates (learn, loss, adam) in turn, over a crew of threads
//!                  │                         └── network, mirror, matrix
//!                  ├──▶ run: one training, with policy.onnx, checkpoints, learning curve, events, film
//!                  └──▶ design: many designs, a gait learnt for each
//! ```

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
