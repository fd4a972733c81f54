//! Tables of the user: CSV with named columns and units, read row by row. The error of a bad cell names file, row and
//! column. Row 1 is the header; rows are numbered by lines of the file. Separator, decimal sign and a row of units are
//! found in the file ([`dialect`]), so all commands read the tables of the same programs.

use sandgait_base::{error, progress};

mod dialect;
mod header;
mod quantity;
#[cfg(test)]
mod tests;

pub use header::{HeaderColumn, ReadOptions};
pub use quantity::Quantity;

use crate::error::{Error, Result};
use dialect::{DecimalSign, Head, in_words};
use header::ColumnPosition;
use sha2::{Digest, Sha256};
use std::io::{BufRead, BufReader, Cursor, Read};
use std::path::Path;

/// Largest file [bytes]. A larger file is refused before it is read, and a stream is refused when it exceeds this size.
/// For the longest log that can be diagnosed this is more than 6 kB for each row. Our choice; it also bounds the memory
/// that a row without an end takes.
const MOST_BYTES: u64 = 256 << 20;
/// What to do with a longer file.
const ADVICE: &str = ": keep every n-th sample";
/// Rows between two reports of progress: our choice, some milliseconds' work.
const REPORT_ROWS: usize = 1000;
/// Largest time [s]: the seconds from 1970 reach it in the year 2286.
const LATEST: f64 = 1e10;
/// Characters of a bad cell or header that an error shows: our choice, so that the line stays readable.
const SHOWN: usize = 300;

/// One row; its cells have the order of the requested columns.
pub struct Row<'a> {
    file: &'a Path,
    columns: &'a [HeaderColumn<'a>],
    header: &'a [String],
    places: &'a [Option<ColumnPosition>],
    record: &'a csv::StringRecord,
    decimals: &'a DecimalSign,
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
        match self.decimals.number(cell, self.line).map(|value| value * place.factor) {
            Ok(value) if value.is_finite() => Ok(Some(value)),
            Ok(_) => Err(self.error(column, format!("{cell} is not finite"))),
            Err(reason) => Err(self.error(column, reason)),
        }
    }

    /// A time [s], which may count from 1970; an error if it is blank.
    pub fn needed_time(&self, column: usize) -> Result<f64> {
        let t = self.needed(column)?;
        if t.abs() <= LATEST {
            return Ok(t);
        }
        // Clocks of the years 2001 to 2286 in smaller units.
        let known = [("ms", 1e3), ("us", 1e6), ("ns", 1e9)];
        let unit = known.into_iter().find(|(_, share)| (1e9..LATEST).contains(&(t / share)));
        let name = self.columns[column].name;
        Err(self.error(
            column,
            match unit {
                Some((unit, _)) => format!("{t} counts {unit} from 1970: write {name} [{unit}] in the header"),
                None => format!("{t} is beyond ±{LATEST} s"),
            },
        ))
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
        match self.places[column] {
            Some(_) => self.error(column, "is blank"),
            None => self.error(column, format!("is missing; the header has {}", self.header.join(", "))),
        }
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
    /// How the file was read, where it is not the usual CSV.
    pub notes: Vec<String>,
}

/// Calls `take` with each row of the file, in the file's order.
pub fn read(path: &Path, asked: &ReadOptions, take: impl FnMut(&Row) -> Result<()>) -> Result<Summary> {
    let (file, _) = sandgait_base::files::open(path, MOST_BYTES, ADVICE)?;
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
    if let Some(reason) = other_format(path, source.fill_buf().map_err(|e| Error::file(path, e))?) {
        return Err(Error::file(path, reason));
    }
    let head = Head::read(&mut source).map_err(|e| Error::file(path, e))?;
    let separator = head.separator(asked);
    let text = Cursor::new(&head.text).chain(&mut source);
    let mut reader = csv::ReaderBuilder::new()
        .delimiter(separator)
        .comment(Some(b'#'))
        .trim(csv::Trim::Headers)
        .flexible(true)
        .from_reader(text);
    let header = reader.headers().map_err(|e| Error::file(path, reason(&e, head.skipped)))?;
    let header: Vec<String> = header.iter().map(str::to_owned).collect();
    let mut places = asked.places(path, &header)?;
    let (mut record, decimals) = (csv::StringRecord::new(), DecimalSign::default());
    let (mut rows, mut first, mut notes) = (0, true, Vec::new());
    if separator != b',' {
        notes.push(format!("columns are separated by {}", in_words(separator)));
    }
    while reader.read_record(&mut record).map_err(|e| Error::file(path, reason(&e, head.skipped)))? {
        if record.iter().all(|cell| cell.trim().is_empty()) {
            continue; // spreadsheets write blank rows below a table
        }
        let line = record.position().map_or(0, |p| p.line()) + head.skipped;
        check_width(&record, header.len(), separator).map_err(|e| Error::file(path, format!("row {line}: {e}")))?;
        if std::mem::take(&mut first) && asked.units_below(path, &mut places, &record, line)? {
            notes.push(format!("row {line} has the units"));
            continue;
        }
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
        let (columns, header, places, record) = (asked.columns, &header[..], &places[..], &record);
        take(&Row { file: path, columns, header, places, record, decimals: &decimals, line })?;
    }
    if rows == 0 {
        return Err(Error::file(path, "row 2: no rows below the header"));
    }
    if let Some(row) = decimals.doubtful() {
        let reason = "are its commas decimal, or between thousands? write one number with a decimal point";
        return Err(Error::file(path, format!("row {row}: {reason}")));
    }
    if decimals.is_comma() {
        notes.push("numbers have a decimal comma".into());
    }
    drop(reader);
    Ok(Summary { header, sha256: hexadecimal(source.into_inner().hash), notes })
}

/// Checks that a row has the header's columns; blank cells may follow them.
fn check_width(record: &csv::StringRecord, columns: usize, separator: u8) -> std::result::Result<(), String> {
    let surplus = record.iter().skip(columns).any(|cell| !cell.trim().is_empty());
    if record.len() >= columns && !surplus {
        return Ok(());
    }
    let hint = match surplus && separator == b',' {
        true => "; if it has decimal commas, separate the columns by ';'",
        false => "",
    };
    Err(format!("{} cells where the header has {columns} columns{hint}", record.len()))
}

/// What is wrong with a file that is no text in UTF-8, by its first bytes.
fn other_format(path: &Path, first: &[u8]) -> Option<String> {
    let name = path.file_name().map_or_else(Default::default, |n| n.to_string_lossy());
    let recording = |format: &str| {
        format!(
            "is {format}, not CSV: `python -m sandgait.logs {name} --out {name}.csv` converts it (pip install 'sandgait[logs]')"
        )
    };
    let known: [(&[u8], String); 7] = [
        (b"PAR1", recording("Parquet")),
        (b"\x89MCAP", recording("MCAP")),
        (b"#ROSBAG", recording("a ROS 1 bag")),
        (b"SQLite format 3\0", recording("an SQLite database, as a ROS 2 bag is")),
        (b"PK\x03\x04", "is a workbook or another archive, not CSV: save the sheet as CSV".into()),
        (b"\xff\xfe", "is text in UTF-16: save it as CSV in UTF-8".into()),
        (b"\xfe\xff", "is text in UTF-16: save it as CSV in UTF-8".into()),
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
    format!("more than the {} MiB that are read{ADVICE}", MOST_BYTES >> 20)
}

/// The first characters of a text, because the text may be very long.
fn shown(text: &str) -> String {
    match text.char_indices().nth(SHOWN) {
        Some((end, _)) => format!("{} …", &text[..end]),
        None => text.into(),
    }
}

/// One line for a malformed record, with its row; `skipped` lines stand before the reader's first.
fn reason(error: &csv::Error, skipped: u64) -> String {
    let row = error.position().map_or(String::new(), |p| format!("row {}: ", p.line() + skipped));
    match error.kind() {
        csv::ErrorKind::Utf8 { .. } => format!("{row}text is not UTF-8: save it as CSV in UTF-8"),
        _ => format!("{row}{error}"),
    }
}
