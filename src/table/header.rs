//! Finds the requested columns and their units in a header.

use super::quantity::Quantity;
use super::shown;
use crate::error::{Error, Result, unknown_name};
use crate::progress::{Progress, Silent};
use std::collections::{BTreeMap, HashSet};
use std::path::Path;

/// A column that a reader requests.
#[derive(Clone, Copy, Debug)]
pub struct HeaderColumn<'a> {
    pub name: &'a str,
    pub quantity: Quantity,
    /// Must the header have this column? (Single cells may still be blank where the quantity does not apply.)
    pub required: bool,
}

impl<'a> HeaderColumn<'a> {
    /// A required column.
    pub const fn needed(name: &'a str, quantity: Quantity) -> Self {
        Self { name, quantity, required: true }
    }
}

/// Largest number of columns of a file: our choice, some ten times as many as a robot's log with every joint's quantities has.
const MOST_COLUMNS: usize = 4096;

/// The columns that a reader requests from a table.
#[derive(Clone)]
pub struct ReadOptions<'a> {
    pub columns: &'a [HeaderColumn<'a>],
    /// Our column name → the file's name for it, where it differs.
    pub renamed: BTreeMap<String, String>,
    /// Column, by our name or the file's → unit. The header may give the unit too: `depth [mm]` or `depth (mm)`.
    pub units: BTreeMap<String, String>,
    /// Longer tables are refused.
    pub most_rows: Option<usize>,
    /// Gets reports while rows are read. Its error stops the reading.
    pub progress: &'a dyn Progress,
}

/// Column of the file, and the factor from its numbers to SI.
pub(super) struct ColumnPosition {
    pub index: usize,
    pub factor: f64,
    /// Is the unit stated?
    pub stated: bool,
}

impl<'a> ReadOptions<'a> {
    /// Columns under our own names, in a file of any length, with units from the header alone.
    pub fn new(columns: &'a [HeaderColumn<'a>]) -> Self {
        Self { columns, renamed: BTreeMap::new(), units: BTreeMap::new(), most_rows: None, progress: &Silent }
    }

    /// Index of each column in `header`; None for an optional column that is absent.
    pub(super) fn places(&self, path: &Path, header: &[String]) -> Result<Vec<Option<ColumnPosition>>> {
        if header.iter().all(String::is_empty) {
            return Err(Error::file(path, "row 1: is empty; it must have the names of the columns"));
        }
        if header.len() > MOST_COLUMNS {
            return Err(Error::file(path, format!("row 1: {} columns are more than {MOST_COLUMNS}", header.len())));
        }
        let mut before = HashSet::new();
        if let Some(name) = header.iter().find(|name| !name.is_empty() && !before.insert(name.as_str())) {
            return Err(Error::file(path, format!("row 1, column {}: is in the header twice", shown(name))));
        }
        for ours in self.renamed.keys() {
            if !self.columns.iter().any(|c| c.name == ours) {
                let known: Vec<_> = self.columns.iter().map(|c| c.name).collect();
                return Err(Error::unknown("column", ours, &known));
            }
        }
        for name in self.units.keys() {
            if !self.columns.iter().any(|c| c.name == name || self.theirs(c) == name) {
                return Err(Error::file(path, format!("units: column {name} is not one of this kind of data")));
            }
        }
        self.columns.iter().map(|column| self.place(path, header, column)).collect()
    }

    /// Number of requested columns whose name the header has.
    pub(super) fn named_in(&self, header: &[String]) -> usize {
        let has = |column: &HeaderColumn| {
            let name = self.theirs(column);
            let is = |cell: &str| split(cell).0 == name || is_alike(split_loosely(cell, column).0, name);
            header.iter().any(|cell| cell == name || is(cell))
        };
        self.columns.iter().filter(|column| has(column)).count()
    }

    /// Reads the units in the first row below the header, if it has units and no numbers. Returns whether it has.
    pub(super) fn units_below(
        &self,
        path: &Path,
        places: &mut [Option<ColumnPosition>],
        record: &csv::StringRecord,
        line: u64,
    ) -> Result<bool> {
        let mut units = Vec::new();
        for (k, (column, place)) in self.columns.iter().zip(places.iter()).enumerate() {
            let Some(place) = place.as_ref().filter(|_| column.quantity != Quantity::Text) else { continue };
            let cell = record.get(place.index).unwrap_or_default().trim();
            if plain(&cell.replace(',', ".")).is_some() {
                return Ok(false);
            }
            let unit = cell.trim_matches(['[', ']', '(', ')', ' ']);
            if !matches!(unit, "" | "-" | "–") {
                units.push((k, unit));
            }
        }
        for &(k, unit) in &units {
            let (column, place) = (&self.columns[k], &mut places[k]);
            let wrong = |reason: &str| {
                Error::file(path, format!("row {line}, column {}: {:?} {reason}", self.theirs(column), brief(unit)))
            };
            let Some(factor) = column.quantity.factor(unit) else {
                let known: Vec<_> = column.quantity.units().iter().map(|u| u.0).collect();
                return Err(wrong(&format!("is no number, and no unit of this column; known: {}", known.join(", "))));
            };
            match place {
                Some(place) if place.stated && place.factor != factor => {
                    return Err(wrong("is another unit than the one that is stated in the header or separately"));
                }
                Some(place) => (place.factor, place.stated) = (factor, true),
                None => (),
            }
        }
        Ok(!units.is_empty())
    }

    fn theirs<'b>(&'b self, column: &HeaderColumn<'b>) -> &'b str {
        self.renamed.get(column.name).map_or(column.name, String::as_str)
    }

    fn place(&self, path: &Path, header: &[String], column: &HeaderColumn) -> Result<Option<ColumnPosition>> {
        let theirs = self.theirs(column);
        let wrong = |reason: String| Error::file(path, format!("row 1, column {theirs}: {reason}"));
        let exact = header.iter().any(|h| h == theirs);
        let loose = !exact && !header.iter().any(|cell| split(cell).0 == theirs);
        let parts = |cell| if loose { split_loosely(cell, column) } else { split(cell) };
        // A header with the same name and a unit is a duplicate. With other words in brackets it is another column.
        let doubles = |(name, unit): (&str, Option<&str>)| {
            name == theirs && unit.is_some_and(|unit| column.quantity.factor(unit).is_some())
        };
        let is = |cell| match (exact, loose) {
            (true, _) => cell == theirs || doubles(split(cell)),
            (false, true) => is_alike(parts(cell).0, theirs),
            (false, false) => split(cell).0 == theirs,
        };
        let mut found = header.iter().enumerate().filter(|(_, cell)| is(cell.as_str()));
        let place = found.next();
        if found.next().is_some() {
            return Err(wrong("is in the header twice".into()));
        }
        let Some((index, cell)) = place else {
            if column.required || self.renamed.contains_key(column.name) {
                return Err(wrong(format!("missing; the header has {}", shown(&header.join(", ")))));
            }
            return Ok(None);
        };
        let given = self.units.get(column.name).or_else(|| self.units.get(theirs));
        let given = given.map(|unit| factor(column, unit).map_err(wrong)).transpose()?;
        let own = match parts(cell).1 {
            // If the requested name has brackets, they may be part of the name.
            Some(unit) if exact => column.quantity.factor(unit),
            Some(unit) if column.quantity != Quantity::Text => Some(factor(column, unit).map_err(wrong)?),
            _ => None,
        };
        match (given, own) {
            (Some(given), Some(own)) if given != own => {
                Err(wrong("the header gives another unit than the one that is stated separately".into()))
            }
            _ => {
                let unit = given.or(own);
                Ok(Some(ColumnPosition { index, factor: unit.unwrap_or(1.0), stated: unit.is_some() }))
            }
        }
    }
}

/// Factor from this column's unit to SI, or the error.
fn factor(column: &HeaderColumn, unit: &str) -> std::result::Result<f64, String> {
    let known: Vec<_> = column.quantity.units().iter().map(|u| u.0).collect();
    column.quantity.factor(unit).ok_or_else(|| match known.is_empty() {
        true => format!("unit {unit:?} is given, but this column has no unit"),
        false => format!("unit {}", unknown_name(unit, &known)),
    })
}

/// Name and unit of `name [unit]` or `name (unit)`.
fn split(header: &str) -> (&str, Option<&str>) {
    let Some((name, rest)) = header.split_once(['[', '(']) else { return (header, None) };
    (name.trim(), Some(rest.trim_end_matches([']', ')']).trim()))
}

/// The same, or name and unit of `name_unit` or, as physicists write, `name / unit`, if the column has such a unit.
fn split_loosely<'a>(header: &'a str, column: &HeaderColumn) -> (&'a str, Option<&'a str>) {
    let is_unit = |unit: &str| column.quantity.factor(unit).is_some();
    let underscore = header.rsplit_once('_').filter(|(_, unit)| is_unit(unit));
    // The unit may have a slash, too: `v / (m/s)`.
    let mut slashes = header.match_indices('/').map(|(k, _)| {
        let unit = header[k + 1..].trim().trim_matches(['(', ')', '[', ']']).trim();
        (header[..k].trim(), unit)
    });
    let found = underscore.or_else(|| slashes.find(|(name, unit)| !name.is_empty() && is_unit(unit)));
    found.map_or_else(|| split(header), |(name, unit)| (name, Some(unit)))
}

/// Are two names the same but for small and capital letters? Names of one letter are not: t is the time, T a temperature.
fn is_alike(name: &str, ours: &str) -> bool {
    name == ours || (ours.len() > 1 && name.eq_ignore_ascii_case(ours))
}

/// The beginning of a cell, for a message: our choice, longer than any unit.
fn brief(cell: &str) -> String {
    shown(cell).chars().take(40).collect()
}

/// A number with a decimal point. Some programs write the mathematical sign for minus.
pub fn plain(cell: &str) -> Option<f64> {
    cell.parse().ok().or_else(|| cell.contains('\u{2212}').then(|| cell.replace('\u{2212}', "-").parse().ok())?)
}
