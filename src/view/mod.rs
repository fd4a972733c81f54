//! What is seen of a robot on sand: recordings, pictures, and the page that shows them.
//!
//! ```text
//!  Model + State ──▶ pose (bodies, sand's force on every segment) ──┬──▶ picture: RGB, drawn by the processor
//!                                                                   └──▶ recording: a file, or a live stream ──▶ page
//! ```
//!
//! * [`pose`]: the one place that computes what is seen.
//! * [`recording`]: the format; [`header`]: what stands in it beside the numbers of each moment.
//! * [`picture`]: one moment as an image; [`camera`]: from where; [`text`]: letters on it.
//! * [`tree`]: a robot of any kind as an image.
//! * [`page`]: a recording as a page for browsers, and the page that follows a server.
//!
//! Knows models and states only: no tasks, sessions or messages.

use sandgait_base::error;
use sandgait_number as number;
use sandgait_plot as plot;
use sandgait_sand as sand;
use sandgait_sim as sim;

mod camera;
mod header;
pub mod page;
pub mod picture;
pub mod pose;
pub mod recording;
mod text;
pub mod tree;

pub use header::{About, header};
pub use picture::draw;
pub use pose::Pose;
pub use recording::{Moment, Section, Writer, read, row};
