//! Tables of the user: CSV with named columns and units, read row by row. The error of a bad cell names file, row and
//! column. Row 1 is the header; rows are numbered by lines of the file.

use sandgait_base::{error, progress};

mod header;
mod quantity;

pub use header::{HeaderColumn, ReadOptions};
pub use quantity::Quantity;

use crate::error::{Error, Result};
use header::ColumnPosition;
use sha2::{Digest, Sha256};
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

/// Largest file [bytes]. A larger file is refused before it is read, and a stream is refused when it exceeds this size.
/// For the longest log that can be diagnosed this is more than 6 kB for each row. Our choice; it also bounds the memory
/// that a row without an end takes.
const MOST_BYTES: u64 = 256 << 20;
/// Rows between two reports of progress: our choice, some milliseconds' work.
const REPORT_ROWS: usize = 1000;
/// Characters of a bad cell or header that an error shows: our choice, so that the line stays readable.
const SHOWN: usize = 300;

/// One row; its cells have the order of the requested columns.
pub struct Row<'a> {
    file: &'a Path,
    columns: &'a [HeaderColumn<'a>],
    places: &'a [Option<ColumnPosition>],
    record: &'a csv::StringRecord,
    /// Line in the file; the header is 1.
    pub line: u64,
}

impl Row<'_> {
    /// The cell's text; `None` if it is blank or the column is absent.
    pub fn text(&self, column: usize) -> Option<&str> {
        let place = self.places[column].as_ref()?;
        self.record.get(place.index).map(str::trim).filter(|cell| !cell.is_empty())
    }

    /// The cell in SI units; `None` if it is blank or the column is absent.
    pub fn number(&self, column: usize) -> Result<Option<f64>> {
        let (Some(cell), Some(place)) = (self.text(column), &self.places[column]) else { return Ok(None) };
        match cell.parse::<f64>().map(|value| value * place.factor) {
            Ok(value) if value.is_finite() => Ok(Some(value)),
            Ok(_) => Err(self.error(column, format!("{cell} is not finite"))),
            Err(_) => Err(self.error(column, format!("{:?} is no number", shown(cell)))),
        }
    }

    /// The cell in SI units, refused beyond ±`most`. Such a number is broken or in the wrong unit, and its square
    /// may overflow.
    pub fn within(&self, column: usize, most: f64) -> Result<Option<f64>> {
        match self.number(column)? {
            Some(value) if value.abs() > most => Err(self.error(column, format!("{value} is beyond ±{most}"))),
            value => Ok(value),
        }
    }

    /// The same as [`Self::within`], but a blank cell is an error.
    pub fn needed_within(&self, column: usize, most: f64) -> Result<f64> {
        self.within(column, most)?.ok_or_else(|| self.blank(column))
    }

    /// The cell in SI units; an error if it is blank.
    pub fn needed(&self, column: usize) -> Result<f64> {
        self.number(column)?.ok_or_else(|| self.blank(column))
    }

    /// The cell's text; an error if it is blank.
    pub fn needed_text(&self, column: usize) -> Result<&str> {
        self.text(column).ok_or_else(|| self.blank(column))
    }

    /// The error of a cell that must not be blank.
    pub fn blank(&self, column: usize) -> Error {
        self.error(column, "is blank")
    }

    /// The text of every cell of the file's row, requested or not.
    pub fn cells(&self) -> impl Iterator<Item = &str> {
        self.record.iter().map(str::trim)
    }

    pub fn error(&self, column: usize, reason: impl std::fmt::Display) -> Error {
        let reason = shown(&reason.to_string());
        Error::file(self.file, format!("row {}, column {}: {reason}", self.line, self.columns[column].name))
    }
}

/// Facts about a table that was read.
pub struct Summary {
    /// All columns of the file, in its order.
    pub header: Vec<String>,
    /// Hexadecimal SHA-256 of the file.
    pub sha256: String,
}

/// Calls `take` with each row of the file, in the file's order.
pub fn read(path: &Path, asked: &ReadOptions, take: impl FnMut(&Row) -> Result<()>) -> Result<Summary> {
    let file = File::open(path).map_err(|e| Error::file(path, e))?;
    let bytes = file.metadata().map_err(|e| Error::file(path, e))?.len();
    if bytes > MOST_BYTES {
        return Err(Error::file(path, format!("{} MiB is {}", bytes >> 20, too_long())));
    }
    parse(path, file, asked, take)
}

/// The same as [`read`], from any source; `path` is the name in errors.
pub fn parse(
    path: &Path,
    source: impl Read,
    asked: &ReadOptions,
    mut take: impl FnMut(&Row) -> Result<()>,
) -> Result<Summary> {
    let mut source = BufReader::with_capacity(1 << 20, Hashed { inner: source, hash: Sha256::new(), bytes: 0 });
    if let Some(format) = other_format(source.fill_buf().map_err(|e| Error::file(path, e))?) {
        let name = path.file_name().map_or_else(Default::default, |n| n.to_string_lossy());
        let how = format!("`python -m sandgait.logs {name} --out {name}.csv`");
        return Err(Error::file(
            path,
            format!("is {format}, not CSV: {how} converts it (pip install 'sandgait[logs]')"),
        ));
    }
    let mut reader = csv::ReaderBuilder::new().comment(Some(b'#')).trim(csv::Trim::Headers).from_reader(&mut source);
    let header = reader.headers().map_err(|e| Error::file(path, reason(&e)))?;
    let header: Vec<String> = header.iter().map(|h| h.trim_start_matches('\u{feff}').to_owned()).collect();
    let places = asked.places(path, &header)?;
    let mut record = csv::StringRecord::new();
    let mut rows = 0;
    while reader.read_record(&mut record).map_err(|e| Error::file(path, reason(&e)))? {
        rows += 1;
        if asked.most_rows.is_some_and(|most| rows > most) {
            return Err(Error::file(
                path,
                format!("more than {} rows: keep every n-th sample and try again", rows - 1),
            ));
        }
        if rows % REPORT_ROWS == 0 {
            asked.progress.report(0.0, "reading the table")?;
        }
        let line = record.position().map_or(0, |p| p.line());
        take(&Row { file: path, columns: asked.columns, places: &places, record: &record, line })?;
    }
    if rows == 0 {
        return Err(Error::file(path, "row 2: no rows below the header"));
    }
    drop(reader);
    Ok(Summary { header, sha256: hexadecimal(source.into_inner().hash) })
}

/// The format of a recording that is no CSV, by its first bytes.
fn other_format(first: &[u8]) -> Option<&'static str> {
    let known: [(&[u8], &str); 4] = [
        (b"PAR1", "Parquet"),
        (b"\x89MCAP", "MCAP"),
        (b"#ROSBAG", "a ROS 1 bag"),
        (b"SQLite format 3\0", "an SQLite database, as a ROS 2 bag is"),
    ];
    known.into_iter().find(|(mark, _)| first.starts_with(mark)).map(|k| k.1)
}

fn hexadecimal(hash: Sha256) -> String {
    hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

/// A reader that hashes all bytes and fails if there are too many.
struct Hashed<R> {
    inner: R,
    hash: Sha256,
    bytes: u64,
}

impl<R: Read> Read for Hashed<R> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let count = self.inner.read(buffer)?;
        self.hash.update(&buffer[..count]);
        self.bytes += count as u64;
        if self.bytes > MOST_BYTES { Err(std::io::Error::other(too_long())) } else { Ok(count) }
    }
}

fn too_long() -> String {
    format!("more than the {} MiB this reads: keep every n-th sample", MOST_BYTES >> 20)
}

/// The first characters of a text, because the text may be very long.
fn shown(text: &str) -> String {
    match text.char_indices().nth(SHOWN) {
        Some((end, _)) => format!("{} …", &text[..end]),
        None => text.into(),
    }
}

/// One line for a malformed record, with its row.
fn reason(error: &csv::Error) -> String {
    let row = error.position().map_or(String::new(), |p| format!("row {}: ", p.line()));
    match error.kind() {
        csv::ErrorKind::UnequalLengths { expected_len, len, .. } => {
            format!("{row}{len} cells where the header has {expected_len} columns")
        }
        csv::ErrorKind::Utf8 { .. } => format!("{row}text is not UTF-8"),
        _ => format!("{row}{error}"),
    }
}
