//! Recordings: the motion of a robot, moment by moment, as a file or as a stream.
//!
//! ```text
//!  file   = gzip(stream)
//!  stream = block, block, …           block = kind, length u32, content
//!    "HEAD"  a section begins: JSON, UTF-8; names, units and shapes of the columns, geometry of the robot
//!    "ROWS"  moments: rows of f32, all columns one after the other
//! ```
//!
//! All numbers are little-endian. A section is an episode, or the rest of an episode; sections may differ in robot and
//! rocks. To read the numbers, a reader needs only `format`, `version` and `columns` of the header.

use crate::error::{Error, Result};
use crate::sim::frame::V;
use crate::sim::pose::Pose;
use crate::sim::{Model, State};
use flate2::Compression;
use flate2::read::MultiGzDecoder;
use flate2::write::GzEncoder;
use serde_json::Value;
use std::io::{self, Read as _, Write};

/// The header's `format` and `version`; a reader refuses any other.
pub const FORMAT: &str = "sandgait recording";
pub const VERSION: u32 = 1;

const HEAD: &[u8; 4] = b"HEAD";
const ROWS: &[u8; 4] = b"ROWS";

/// Largest block that is read [bytes]: our choice, a thousand times a usual header.
const MOST: usize = 64 << 20;

/// Largest unpacked size of a file [bytes]: our choice, some hours of one robot.
const MOST_UNPACKED: u64 = 1 << 30;

/// One moment of a robot, and the task's info of the step that led to it.
#[derive(Clone, Copy, Debug)]
pub struct RecordedState<'a> {
    /// Time since the episode began [s].
    pub time: f64,
    pub state: &'a State,
    /// See [`Pose::of`].
    pub footing: &'a [f64],
    pub action: &'a [f32],
    pub reward: f32,
    pub info: &'a [f32],
}

/// The numbers of a moment, in the order of the header's columns.
pub fn row(model: &Model, moment: &RecordedState) -> Vec<f32> {
    let (state, pose) = (moment.state, Pose::of(model, moment.state, moment.footing));
    let mut row = Vec::with_capacity(32 + 4 * state.angles.len() + 3 * pose.loads.len());
    let mut extend = |numbers: &[f64]| row.extend(numbers.iter().map(|x| *x as f32));
    extend(&[moment.time]);
    extend(&state.position);
    extend(&state.orientation);
    extend(&state.velocity);
    extend(&state.angular_velocity);
    for joints in [&state.angles, &state.rates, &state.references, &state.torques] {
        extend(joints);
    }
    row.extend(moment.action);
    row.push(moment.reward);
    row.extend(moment.info);
    row.extend(pose.stance.iter().map(|s| f32::from(u8::from(*s))));
    let objects = state.objects.iter().flat_map(|o| o.position.iter().chain(&o.orientation));
    row.extend(objects.map(|x| *x as f32));
    let mut vectors =
        |all: &mut dyn Iterator<Item = V>| row.extend(all.flat_map(|v| [v.x, v.y, v.z]).map(|x| x as f32));
    vectors(&mut pose.loads.iter().map(|load| load.force));
    vectors(&mut pose.contacts.iter().map(|load| load.force));
    vectors(&mut pose.contacts.iter().map(|load| load.position));
    if model.scene.memory.is_some() {
        row.extend(heights(state));
    }
    row
}

/// Number of heights along each side of a moment's field of heights: our choice, a power of two as the grid's side is,
/// and 4 KiB a moment.
pub const HEIGHTS: usize = 32;

/// x and y of the first node and the distance between nodes [m], then the heights of the sand around the robot, rows
/// along y. Only some cells of the square of sand are nodes, at equal distances. All numbers are zero without sand.
fn heights(state: &State) -> Vec<f32> {
    let mut all = vec![0.0; 3 + HEIGHTS * HEIGHTS];
    let Some(sand) = &state.sand else { return all };
    let (cell, side) = (sand.grid.frame.cell, sand.grid.frame.side());
    let by = side / HEIGHTS;
    for (k, ([i, j], height)) in sand.grid.cells().enumerate() {
        let (x, y) = (k % side, k / side);
        if k == 0 {
            let at = |i: i32| ((f64::from(i) + 0.5) * cell) as f32;
            (all[0], all[1], all[2]) = (at(i), at(j), (by as f64 * cell) as f32);
        }
        if x % by == 0 && y % by == 0 {
            all[3 + y / by * HEIGHTS + x / by] = height as f32;
        }
    }
    all
}

/// A block of the stream.
fn block(kind: &[u8; 4], content: &[u8]) -> Vec<u8> {
    let length = u32::try_from(content.len()).unwrap_or(u32::MAX);
    [kind, &length.to_le_bytes()[..], content].concat()
}

/// The block that begins a section.
pub fn head_block(header: &str) -> Vec<u8> {
    block(HEAD, header.as_bytes())
}

/// The block of one row, or of several.
pub fn rows_block(rows: &[f32]) -> Vec<u8> {
    block(ROWS, &rows.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<_>>())
}

/// Writes a file.
pub struct RecordingWriter<W: Write> {
    out: GzEncoder<W>,
}

impl<W: Write> RecordingWriter<W> {
    /// A file that begins with `header`.
    pub fn new(out: W, header: &str) -> io::Result<Self> {
        let mut writer = Self { out: GzEncoder::new(out, Compression::default()) };
        writer.section(header)?;
        Ok(writer)
    }

    /// Begins another section with this header.
    pub fn section(&mut self, header: &str) -> io::Result<()> {
        self.out.write_all(&head_block(header))
    }

    pub fn row(&mut self, row: &[f32]) -> io::Result<()> {
        self.out.write_all(&rows_block(row))
    }

    /// Completes the file.
    pub fn finish(self) -> io::Result<W> {
        self.out.finish()
    }
}

/// A section that was read.
#[derive(Clone, Debug)]
pub struct Section {
    pub header: Value,
    /// f32 [rows, width]
    pub rows: Vec<f32>,
    /// Numbers in a row.
    pub width: usize,
}

impl Section {
    fn new(json: &[u8]) -> Result<Self> {
        let header: Value = serde_json::from_slice(json).map_err(|e| broken(format!("its header: {e}")))?;
        if header["format"] != FORMAT || header["version"] != VERSION {
            let (format, version) = (&header["format"], &header["version"]);
            return Err(broken(format!("it is {format} {version}, not \"{FORMAT}\" {VERSION}")));
        }
        let columns = header["columns"].as_array().ok_or_else(|| broken("its header has no columns"))?;
        let count = |column: &Value| {
            let shape = column["shape"].as_array()?.iter().map(Value::as_u64).collect::<Option<Vec<_>>>()?;
            shape.iter().try_fold(1_u64, |product, n| product.checked_mul(*n).filter(|p| *p <= MOST as u64))
        };
        let width = columns.iter().map(count).sum::<Option<u64>>().filter(|w| (1..=MOST as u64).contains(w));
        let width = width.ok_or_else(|| broken("its columns have no shapes"))? as usize;
        Ok(Self { header, rows: Vec::new(), width })
    }

    fn extend(&mut self, content: &[u8]) -> Result<()> {
        let (numbers, rest) = content.as_chunks();
        if !rest.is_empty() || numbers.len() % self.width != 0 {
            return Err(broken(format!("{} bytes are no rows of {} numbers", content.len(), self.width)));
        }
        self.rows.extend(numbers.iter().map(|b| f32::from_le_bytes(*b)));
        Ok(())
    }

    /// Number of moments.
    pub fn len(&self) -> usize {
        self.rows.len() / self.width
    }

    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// The numbers of column `name` at moment `index`; None if there is no such column or moment.
    pub fn at(&self, name: &str, index: usize) -> Option<&[f32]> {
        let mut start = index.checked_mul(self.width)?;
        for column in self.header["columns"].as_array()? {
            let shape = column["shape"].as_array()?;
            let length = shape.iter().filter_map(Value::as_u64).product::<u64>() as usize;
            if column["name"] == name {
                return self.rows.get(start..start + length);
            }
            start += length;
        }
        None
    }
}

fn broken(why: impl std::fmt::Display) -> Error {
    Error::invalid("recording", why.to_string())
}

/// The sections of a file.
///
/// # Errors
/// If the file is not a recording, has another version, is damaged or cut off, or is larger than 1 GiB.
pub fn read(file: &[u8]) -> Result<Vec<Section>> {
    let mut stream = Vec::new();
    let unpacked = MultiGzDecoder::new(file).take(MOST_UNPACKED).read_to_end(&mut stream);
    unpacked.map_err(|e| {
        broken(if e.kind() == io::ErrorKind::UnexpectedEof {
            "it is cut off".into()
        } else {
            format!("this is not one of sandgait's recordings ({e})")
        })
    })?;
    if stream.len() as u64 == MOST_UNPACKED {
        return Err(broken(format!("it has more than {MOST_UNPACKED} bytes")));
    }
    let mut sections: Vec<Section> = Vec::new();
    let mut rest = &stream[..];
    while !rest.is_empty() {
        let (kind, after) = rest.split_first_chunk::<4>().ok_or_else(|| broken("it is cut off"))?;
        let (length, after) = after.split_first_chunk::<4>().ok_or_else(|| broken("it is cut off"))?;
        let length = u32::from_le_bytes(*length) as usize;
        let (content, after) = after.split_at_checked(length).ok_or_else(|| broken("it is cut off"))?;
        match (kind, sections.last_mut()) {
            (HEAD, _) => sections.push(Section::new(content)?),
            (ROWS, Some(section)) => section.extend(content)?,
            _ => return Err(broken("this is not one of sandgait's recordings")),
        }
        rest = after;
    }
    if sections.is_empty() {
        return Err(broken("it is empty"));
    }
    Ok(sections)
}
