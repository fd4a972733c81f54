//! A measured table: CSV with named columns and units, read row by row; every bad cell is named by file, row, column.

use super::experiment::Experiment;
use crate::error::{Error, Result};
use sha2::{Digest, Sha256};
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

/// Rows beyond this are refused: the fits of a log so long fill most of 1 GiB. Our choice.
pub const MOST_ROWS: usize = 40_000;
/// Files beyond this many bytes are refused unread: over 6 kB a row at [`MOST_ROWS`]. Our choice.
const MOST_BYTES: u64 = 256 << 20;

/// Kind of quantity in a column: decides which units it takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    Text,
    Number,
    Length,
    Time,
    Angle,
    /// Angles that the column's name says to be in degrees.
    Degrees,
    AngularSpeed,
    Speed,
    Force,
    Torque,
    Mass,
    Frequency,
}

impl Quantity {
    /// Units and their factor to the first, which is SI but for degrees.
    fn units(self) -> &'static [(&'static str, f64)] {
        const DEGREE: f64 = std::f64::consts::PI / 180.0;
        match self {
            Quantity::Text => &[],
            Quantity::Number => &[("1", 1.0), ("%", 0.01)],
            Quantity::Length => &[("m", 1.0), ("cm", 1e-2), ("mm", 1e-3), ("um", 1e-6), ("µm", 1e-6), ("in", 0.0254)],
            Quantity::Time => &[("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("µs", 1e-6), ("min", 60.0)],
            Quantity::Angle => &[("rad", 1.0), ("deg", DEGREE), ("°", DEGREE), ("mrad", 1e-3)],
            Quantity::Degrees => &[("deg", 1.0), ("°", 1.0), ("rad", 1.0 / DEGREE)],
            Quantity::AngularSpeed => {
                &[("rad/s", 1.0), ("deg/s", DEGREE), ("°/s", DEGREE), ("rpm", 6.0 * DEGREE), ("Hz", 360.0 * DEGREE)]
            }
            Quantity::Speed => &[("m/s", 1.0), ("cm/s", 1e-2), ("mm/s", 1e-3)],
            Quantity::Force => {
                &[("N", 1.0), ("mN", 1e-3), ("kN", 1e3), ("gf", 9.80665e-3), ("kgf", 9.80665), ("lbf", 4.4482216152605)]
            }
            Quantity::Torque => &[
                ("N·m", 1.0),
                ("N*m", 1.0),
                ("N m", 1.0),
                ("Nm", 1.0),
                ("mN·m", 1e-3),
                ("mN*m", 1e-3),
                ("mNm", 1e-3),
                ("N·cm", 1e-2),
                ("N*cm", 1e-2),
                ("Ncm", 1e-2),
                ("N·mm", 1e-3),
                ("N*mm", 1e-3),
                ("Nmm", 1e-3),
            ],
            Quantity::Mass => &[("kg", 1.0), ("g", 1e-3)],
            Quantity::Frequency => &[("Hz", 1.0), ("1/s", 1.0), ("1/min", 1.0 / 60.0)],
        }
    }
}

/// A column that a reader asks for.
#[derive(Clone, Copy, Debug)]
pub struct Column {
    pub name: &'static str,
    pub quantity: Quantity,
    /// Must the header have it? (Its cells may still be blank where the quantity does not apply.)
    pub required: bool,
}

/// One row, its cells in the order of the asked columns.
pub struct Row<'a> {
    file: &'a Path,
    columns: &'a [Column],
    places: &'a [Option<usize>],
    factors: &'a [f64],
    record: &'a csv::StringRecord,
    /// Line in the file; the header is 1.
    pub line: u64,
}

impl Row<'_> {
    /// The cell's text, `None` where blank or the column is absent.
    pub fn text(&self, column: usize) -> Option<&str> {
        self.places[column].and_then(|p| self.record.get(p)).map(str::trim).filter(|cell| !cell.is_empty())
    }

    /// The cell in SI units, `None` where blank or absent.
    pub fn number(&self, column: usize) -> Result<Option<f64>> {
        let Some(cell) = self.text(column) else { return Ok(None) };
        match cell.parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(Some(value * self.factors[column])),
            Ok(_) => Err(self.error(column, format!("{cell} is not finite"))),
            Err(_) => Err(self.error(column, format!("{cell:?} is no number"))),
        }
    }

    /// The cell in SI units; blank is an error.
    pub fn needed(&self, column: usize) -> Result<f64> {
        self.number(column)?.ok_or_else(|| self.error(column, "is blank"))
    }

    /// The cell's text; blank is an error.
    pub fn needed_text(&self, column: usize) -> Result<&str> {
        self.text(column).ok_or_else(|| self.error(column, "is blank"))
    }

    pub fn error(&self, column: usize, reason: impl std::fmt::Display) -> Error {
        Error::file(self.file, format!("row {}, column {}: {reason}", self.line, self.columns[column].name))
    }
}

/// Reads through to a hash of everything read.
struct Hashed<R> {
    inner: R,
    hash: Sha256,
}

impl<R: Read> Read for Hashed<R> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let count = self.inner.read(buffer)?;
        self.hash.update(&buffer[..count]);
        Ok(count)
    }
}

/// What is known of the table once it is read.
pub struct Summary {
    /// Hexadecimal SHA-256 of the file.
    pub sha256: String,
    /// Which of the asked columns the header has.
    pub present: Vec<bool>,
}

/// Hands each row to `take`, in the file's order.
pub fn read(
    path: &Path,
    experiment: &Experiment,
    columns: &[Column],
    mut take: impl FnMut(&Row) -> Result<()>,
) -> Result<Summary> {
    let file = File::open(path).map_err(|e| Error::file(path, e))?;
    let bytes = file.metadata().map_err(|e| Error::file(path, e))?.len();
    if bytes > MOST_BYTES {
        let most = MOST_BYTES >> 20;
        return Err(Error::file(
            path,
            format!("{} MiB is more than the {most} MiB this reads: keep every n-th sample", bytes >> 20),
        ));
    }
    let mut source = Hashed { inner: BufReader::with_capacity(1 << 20, file), hash: Sha256::new() };
    let mut reader = csv::ReaderBuilder::new().comment(Some(b'#')).trim(csv::Trim::Headers).from_reader(&mut source);
    let headers = reader.headers().map_err(|e| Error::file(path, format!("row 1: {}", reason(&e))))?.clone();
    let places = places(path, experiment, columns, &headers)?;
    let factors = factors(path, experiment, columns)?;
    let mut record = csv::StringRecord::new();
    let mut rows = 0;
    loop {
        let more = reader.read_record(&mut record).map_err(|e| Error::file(path, reason(&e)))?;
        if !more {
            break;
        }
        rows += 1;
        if rows > MOST_ROWS {
            return Err(Error::file(path, format!("more than {MOST_ROWS} rows: keep every n-th sample and try again")));
        }
        let line = record.position().map_or(0, |p| p.line());
        take(&Row { file: path, columns, places: &places, factors: &factors, record: &record, line })?;
    }
    if rows == 0 {
        return Err(Error::file(path, "row 2: no rows below the header"));
    }
    drop(reader);
    let sha256 = source.hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect();
    Ok(Summary { sha256, present: places.iter().map(Option::is_some).collect() })
}

/// One line for a malformed record, with its row.
fn reason(error: &csv::Error) -> String {
    let row = error.position().map_or(String::new(), |p| format!("row {}: ", p.line()));
    match error.kind() {
        csv::ErrorKind::UnequalLengths { expected_len, len, .. } => {
            format!("{row}{len} cells where the header has {expected_len} columns")
        }
        csv::ErrorKind::Utf8 { .. } => format!("{row}text is not UTF-8"),
        _ => format!("{row}{error}").replace('\n', " "),
    }
}

/// Where each asked column stands in the header.
fn places(
    path: &Path,
    experiment: &Experiment,
    columns: &[Column],
    headers: &csv::StringRecord,
) -> Result<Vec<Option<usize>>> {
    for ours in experiment.columns.keys() {
        if !columns.iter().any(|c| c.name == ours) {
            let known: Vec<_> = columns.iter().map(|c| c.name).collect();
            return Err(Error::unknown("column", ours, &known));
        }
    }
    columns
        .iter()
        .map(|column| {
            let theirs = experiment.columns.get(column.name).map_or(column.name, String::as_str);
            let mut found = headers.iter().enumerate().filter(|(_, h)| h.trim_start_matches('\u{feff}') == theirs);
            let place = found.next().map(|(index, _)| index);
            if found.next().is_some() {
                return Err(Error::file(path, format!("row 1, column {theirs}: stands there twice")));
            }
            if place.is_none() && (column.required || experiment.columns.contains_key(column.name)) {
                return Err(Error::file(path, format!("row 1, column {theirs}: missing")));
            }
            Ok(place)
        })
        .collect()
}

/// Factor to SI of each asked column.
fn factors(path: &Path, experiment: &Experiment, columns: &[Column]) -> Result<Vec<f64>> {
    let theirs = |c: &Column| experiment.columns.get(c.name).map_or(c.name, String::as_str).to_string();
    for name in experiment.units.keys() {
        if !columns.iter().any(|c| c.name == name || &theirs(c) == name) {
            return Err(Error::file(path, format!("units: column {name} is not one of this kind of data")));
        }
    }
    columns
        .iter()
        .map(|column| {
            let Some(unit) = experiment.units.get(column.name).or_else(|| experiment.units.get(&theirs(column))) else {
                return Ok(1.0);
            };
            let known = column.quantity.units();
            known.iter().find(|u| u.0 == unit).map(|u| u.1).ok_or_else(|| {
                let names: Vec<_> = known.iter().map(|u| u.0).collect();
                Error::file(
                    path,
                    format!("column {}: unit {unit:?} is unknown; known: {}", column.name, names.join(", ")),
                )
            })
        })
        .collect()
}
