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
use serde::Deserialize;
use std::io::{self, BufRead as _, BufReader, Read as _, Write};

/// The header's `format` and `version`; a reader refuses any other.
pub const FORMAT: &str = "sandgait recording";
pub const VERSION: u32 = 1;

const HEAD: &[u8; 4] = b"HEAD";
const ROWS: &[u8; 4] = b"ROWS";

/// Largest number of numbers in a row: our choice, a thousand times those of a usual robot.
const MOST_WIDE: u64 = 1 << 20;

/// Largest unpacked size of a file [bytes]: our choice, some hours of one robot.
pub const MOST_UNPACKED: u64 = 1 << 30;

/// Largest numbers of sections, of bytes of all headers, and of commas and opening brackets in them, each of which is a
/// value at most. Our choice: a day of episodes of 10 s has a tenth of these sections, and four hours of a hexapod have
/// some 5 million values. They bound what a small file can make a reader take: Python needs up to 120 bytes for a value.
/// `python_client/sandgait/recording.py` has the same numbers.
const MOST_SECTIONS: usize = 100_000;
const MOST_HEADERS: u64 = 128 << 20;
const MOST_VALUES: usize = 8_000_000;

/// Largest number of blocks: our choice, eleven hours of a program that writes each state at 50 Hz by itself. A small file can
/// have many empty blocks, which take time. Python has the same number.
const MOST_BLOCKS: u64 = 2_000_000;

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
    pub header: RecordingHeader,
    /// f32 [rows, width]
    pub rows: Vec<f32>,
    /// Numbers in a row.
    pub width: usize,
}

/// The parts of a header that a reader of the numbers needs. The robot's geometry, which may be large, is left out.
#[derive(Clone, Debug, Deserialize)]
pub struct RecordingHeader {
    format: Option<String>,
    version: Option<u32>,
    columns: Option<Vec<RecordedColumn>>,
    pub task: Option<String>,
    pub robot: Option<String>,
    pub medium: Option<String>,
    pub seed: Option<u64>,
    pub episode: Option<u64>,
    pub rate: Option<f64>,
}

/// A column of a section's rows.
#[derive(Clone, Debug, Deserialize)]
struct RecordedColumn {
    name: String,
    shape: Vec<u64>,
}

impl RecordedColumn {
    /// Numbers in a row; None: too many.
    fn length(&self) -> Option<u64> {
        self.shape.iter().try_fold(1_u64, |product, n| product.checked_mul(*n).filter(|p| *p <= MOST_WIDE))
    }
}

impl Section {
    fn new(json: &[u8]) -> Result<Self> {
        let header: RecordingHeader = serde_json::from_slice(json).map_err(|e| broken(format!("its header: {e}")))?;
        if header.format.as_deref() != Some(FORMAT) || header.version != Some(VERSION) {
            let format = header.format.as_deref().unwrap_or("no format");
            let version = header.version.map_or("without version".into(), |v| v.to_string());
            return Err(broken(format!("it is {format:?} {version}, not \"{FORMAT}\" {VERSION}")));
        }
        let columns = header.columns.as_ref().ok_or_else(|| broken("its header has no columns"))?;
        let width = columns.iter().map(RecordedColumn::length).sum::<Option<u64>>();
        let width = width.filter(|w| (1..=MOST_WIDE).contains(w));
        let width = width.ok_or_else(|| broken(format!("its rows have not 1 to {MOST_WIDE} numbers")))? as usize;
        Ok(Self { header, rows: Vec::new(), width })
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
        for column in self.header.columns.iter().flatten() {
            let length = column.length()? as usize;
            if column.name == name {
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
/// If the file is not a recording, has another version, is damaged or cut off, or is larger than the bounds above.
pub fn read(file: &[u8]) -> Result<Vec<Section>> {
    let stream = BufReader::new(MultiGzDecoder::new(file));
    let mut unpacked = Unpacked { stream, left: MOST_UNPACKED, headers: MOST_HEADERS, values: MOST_VALUES, blocks: 0 };
    let mut sections: Vec<Section> = Vec::new();
    while let Some((kind, length)) = unpacked.block()? {
        match (&kind, sections.last_mut()) {
            (HEAD, _) => sections.push(Section::new(&unpacked.header(length)?)?),
            (ROWS, Some(section)) => unpacked.rows(length, section)?,
            _ => return Err(broken(FOREIGN)),
        }
        if sections.len() > MOST_SECTIONS {
            return Err(broken(format!("it has more than {MOST_SECTIONS} sections")));
        }
    }
    if sections.is_empty() {
        return Err(broken("it is empty"));
    }
    Ok(sections)
}

const FOREIGN: &str = "this is not one of sandgait's recordings";

/// A file's stream, which is unpacked while it is read, and how much of it may still come.
struct Unpacked<'a> {
    stream: BufReader<MultiGzDecoder<&'a [u8]>>,
    left: u64,
    headers: u64,
    values: usize,
    /// Number of blocks so far.
    blocks: u64,
}

impl Unpacked<'_> {
    /// Kind and length of the next block; None at the end.
    fn block(&mut self) -> Result<Option<([u8; 4], u64)>> {
        if self.stream.fill_buf().map_err(|e| unreadable(&e))?.is_empty() {
            return Ok(None);
        }
        self.blocks += 1;
        if self.blocks > MOST_BLOCKS {
            return Err(broken(format!("it has more than {MOST_BLOCKS} blocks")));
        }
        let (mut kind, mut length) = ([0; 4], [0; 4]);
        self.exactly(&mut kind)?;
        self.exactly(&mut length)?;
        Ok(Some((kind, u32::from_le_bytes(length).into())))
    }

    fn exactly(&mut self, bytes: &mut [u8]) -> Result<()> {
        self.stream.read_exact(bytes).map_err(|e| unreadable(&e))
    }

    fn header(&mut self, length: u64) -> Result<Vec<u8>> {
        let mut json = Vec::new();
        let most = length.min(self.headers + 1);
        self.stream.by_ref().take(most).read_to_end(&mut json).map_err(|e| unreadable(&e))?;
        if (json.len() as u64) < most {
            return Err(broken(CUT_OFF));
        }
        let values = json.iter().filter(|b| matches!(b, b',' | b'[' | b'{')).count();
        let left = self.headers.checked_sub(length).zip(self.values.checked_sub(values));
        (self.headers, self.values) = left.ok_or_else(|| {
            broken(format!("its headers have more than {MOST_HEADERS} bytes or {MOST_VALUES} values"))
        })?;
        Ok(json)
    }

    fn rows(&mut self, length: u64, section: &mut Section) -> Result<()> {
        let wide = 4 * section.width as u64;
        if !length.is_multiple_of(wide) {
            return Err(broken(format!("{length} bytes are no rows of {} numbers", section.width)));
        }
        self.left = self
            .left
            .checked_sub(length)
            .ok_or_else(|| broken(format!("its rows have more than {MOST_UNPACKED} bytes")))?;
        let (mut left, mut piece) = (length as usize, [0; 4096]);
        while left > 0 {
            let piece = &mut piece[..left.min(4096)];
            self.exactly(piece)?;
            left -= piece.len();
            section.rows.extend(piece.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)));
        }
        Ok(())
    }
}

const CUT_OFF: &str = "it is cut off";

fn unreadable(error: &io::Error) -> Error {
    match error.kind() {
        io::ErrorKind::UnexpectedEof => broken(CUT_OFF),
        _ => broken(format!("{FOREIGN} ({error})")),
    }
}
