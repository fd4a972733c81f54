//! Recordings and pictures of a robot on sand, and the page that shows them.
//!
//! ```text
//!  Model + State ──▶ pose (bodies, sand's force on every segment) ──┬──▶ picture: RGB, drawn by the processor
//!                                                                   └──▶ recording: a file, or a live stream ──▶ page
//! ```
//!
//! * [`recording`]: the format; [`header`]: its description of robot and columns.
//! * [`picture`]: one moment as an image; [`camera`]: its point of view; [`text`]: letters on it.
//! * [`tree`]: any robot from a file as an image; [`solid`]: the same in the picture of a moment, with its ground;
//!   [`hard`]: colours of hard ground; [`raster`]: triangles for both.
//! * [`page`]: a recording as a page for browsers, and the page that follows a server.
//!
//! This crate uses models and states only; it has no tasks, sessions or messages.

use sandgait_base::error;
use sandgait_number as number;
use sandgait_plot as plot;
use sandgait_sand as sand;
use sandgait_sim as sim;

mod camera;
mod hard;
mod header;
pub mod page;
pub mod picture;
mod png;

mod raster;
pub mod recording;
mod solid;
mod text;
pub mod tree;

pub use crate::sim::pose::Pose;
pub use camera::CameraOptions;
pub use header::{About, header};
pub use picture::draw;
pub use png::{animation, png};
pub use recording::{MOST_UNPACKED, RecordedState, RecordingHeader, RecordingWriter, Section, read, row};
