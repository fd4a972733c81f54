//! Tables of numbers that users bring: CSV with named columns, units in brackets, every bad cell named by its line.

use crate::error::{Error, Result};
use std::path::Path;

/// Files beyond this many bytes are refused unread: our choice, some million rows.
const MOST_BYTES: u64 = 256 << 20;

/// A CSV file as text cells.
pub struct Table {
    path: std::path::PathBuf,
    /// As in the file.
    pub header: Vec<String>,
    /// Line in the file, and its cells.
    pub rows: Vec<(u64, Vec<String>)>,
}

/// Unit and its factor to SI.
pub type Unit = (&'static str, f64);
pub const LENGTH: &[Unit] = &[("m", 1.0), ("cm", 1e-2), ("mm", 1e-3), ("in", 0.0254)];
pub const FORCE: &[Unit] =
    &[("N", 1.0), ("mN", 1e-3), ("kN", 1e3), ("gf", 9.80665e-3), ("kgf", 9.80665), ("lbf", 4.4482216152605)];
pub const ANGLE: &[Unit] = &[("rad", 1.0), ("deg", std::f64::consts::PI / 180.0)];

impl Table {
    pub fn read(path: &Path) -> Result<Self> {
        let bytes = std::fs::metadata(path).map_err(|e| Error::file(path, e))?.len();
        if bytes > MOST_BYTES {
            return Err(Error::file(
                path,
                format!("{} MiB is more than the {} read here", bytes >> 20, MOST_BYTES >> 20),
            ));
        }
        let text = std::fs::read(path).map_err(|e| Error::file(path, e))?;
        Self::parse(path, &text)
    }

    /// A table from bytes; `path` names it in errors.
    pub fn parse(path: &Path, text: &[u8]) -> Result<Self> {
        let mut reader = csv::ReaderBuilder::new().comment(Some(b'#')).trim(csv::Trim::All).from_reader(text);
        let named = |line: Option<u64>, e: &csv::Error| {
            let line = line.map_or(String::new(), |l| format!("line {l}: "));
            Error::file(
                path,
                match e.kind() {
                    csv::ErrorKind::UnequalLengths { expected_len, len, .. } => {
                        format!("{line}{len} cells where the header has {expected_len}")
                    }
                    csv::ErrorKind::Utf8 { .. } => format!("{line}not UTF-8 text"),
                    _ => format!("{line}{e}"),
                },
            )
        };
        let header = reader.headers().map_err(|e| named(Some(1), &e))?;
        let header = header.iter().map(|h| h.trim_start_matches('\u{feff}').to_owned()).collect();
        let mut rows = Vec::new();
        for record in reader.records() {
            let record = record.map_err(|e| named(e.position().map(|p| p.line()), &e))?;
            rows.push((record.position().map_or(0, |p| p.line()), record.iter().map(str::to_owned).collect()));
        }
        if rows.is_empty() {
            return Err(Error::file(path, "no rows below a header line"));
        }
        Ok(Self { path: path.into(), header, rows })
    }

    /// Does the header name this column?
    pub fn has(&self, name: &str) -> bool {
        self.header.iter().any(|h| split(h).0 == name)
    }

    /// The column's numbers in SI. Its header is `name` or `name [unit]`; without a unit it is `assumed`, or SI.
    pub fn numbers(&self, name: &str, units: &[Unit], assumed: Option<&str>) -> Result<Vec<f64>> {
        let mut places = self.header.iter().enumerate().filter(|(_, h)| split(h).0 == name);
        let (place, header) = places.next().ok_or_else(|| self.missing(name))?;
        if places.next().is_some() {
            return Err(Error::file(&self.path, format!("column {name} stands there twice")));
        }
        let factor = match split(header).1.or(assumed) {
            None => 1.0,
            Some(unit) => units
                .iter()
                .find(|u| u.0 == unit)
                .map(|u| u.1)
                .ok_or_else(|| Error::unknown("unit", unit, &units.iter().map(|u| u.0).collect::<Vec<_>>()))?,
        };
        let number = |(line, cells): &(u64, Vec<String>)| match cells[place].parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(value * factor),
            _ => Err(Error::file(
                &self.path,
                format!("line {line}, column {name}: {:?} is no finite number", cells[place]),
            )),
        };
        self.rows.iter().map(number).collect()
    }

    /// The column's cells as they stand.
    pub fn texts(&self, name: &str) -> Result<Vec<&str>> {
        let place = self.header.iter().position(|h| h == name).ok_or_else(|| self.missing(name))?;
        Ok(self.rows.iter().map(|(_, cells)| cells[place].as_str()).collect())
    }

    fn missing(&self, name: &str) -> Error {
        Error::file(&self.path, format!("no column {name}; the header has {}", self.header.join(", ")))
    }
}

/// Name and unit of `name [unit]` or `name (unit)`.
fn split(header: &str) -> (&str, Option<&str>) {
    let Some((name, rest)) = header.split_once(['[', '(']) else { return (header, None) };
    (name.trim(), Some(rest.trim_end_matches([']', ')']).trim()))
}
