//! Policies that users upload: feed-forward networks as ONNX, computed in the process of the environments.
//!
//! This crate uses the tables of a task; it has no threads, sessions or messages.
//!
//! * [`format`]: the parts of an ONNX file that are read or written.
//! * [`read`]: from a file to a program of checked steps; [`constant`]: its weights.
//! * [`operator`]: the operators of steps, and the widths of their results.
//! * [`price`]: what a file and its network cost at most.
//! * [`network`]: runs the program.
//! * [`write`]: ONNX files of our own.
//!
//! A network is computed for [`LANES`] environments at a time, one in each lane. Sums are computed in the order of the
//! weights. So an action depends, to the last bit, only on the environment's own observation, and not on its
//! neighbours, the batch or the threads.
//!
//! The crate tract also computes ONNX files, but would add 35 crates and more than 80 s of processor time to a build.

use sandgait_base::error;
use sandgait_env as env;

mod constant;
mod format;
mod network;
mod operator;
mod price;
mod read;
#[cfg(test)]
mod tests;
pub mod write;

pub use network::Network;
pub use price::{Price, reading_bytes};

/// Number of environments that are computed side by side: as many as a shard of engine `lanes` has.
const LANES: usize = 16;

/// One number for each lane.
type Lanes = [f32; LANES];

/// Largest file [bytes]: a million weights, some ten times what walking needs. Our choice.
pub const MOST_BYTES: usize = 4 << 20;
