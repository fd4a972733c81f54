//! Penetration tests from CSV: one push, or several with a column trial.

use super::pushes::{MOST_PUSHES, MOST_SAMPLES, Penetration};
use crate::error::{Error, Result, check_range};
use crate::table::{self, HeaderColumn, Quantity, ReadOptions, Row};
use std::collections::{BTreeMap, HashMap};
use std::path::Path;

/// Values beyond ±1e6 m or N are broken or in the wrong unit: our choice, as for force logs.
const MOST: f64 = 1e6;

const COLUMNS: [HeaderColumn; 7] = [
    HeaderColumn::needed("depth", Quantity::Length),
    HeaderColumn::needed("force", Quantity::Force),
    HeaderColumn { name: "trial", quantity: Quantity::Text, required: false },
    HeaderColumn { name: "diameter", quantity: Quantity::Length, required: false },
    HeaderColumn { name: "length", quantity: Quantity::Length, required: false },
    HeaderColumn { name: "width", quantity: Quantity::Length, required: false },
    HeaderColumn { name: "speed", quantity: Quantity::Speed, required: false },
];
/// Allowed diameters and sides of plates [m]: our choice; smaller or larger ones have a wrong unit.
const SIZES: std::ops::RangeInclusive<f64> = 1e-4..=1.0;
/// A push begins again if the depth falls by more than this share of the greatest depth so far from one row to the next: our
/// choice; noise and the way up fall by less.
const BEGINS_AGAIN: f64 = 0.5;

/// The contents of a file.
#[derive(Default)]
pub struct Tests {
    /// Depths of all rows [m].
    pub depth: Vec<f64>,
    /// The greatest depth so far [m].
    deepest: f64,
    /// Forces of all rows [N].
    pub force: Vec<f64>,
    /// Empty if the file has no column `trial`.
    pub pushes: Vec<Penetration>,
    /// Diameter of pushes that state no size [m].
    assumed: f64,
    /// Did a push state no size?
    pub without_size: bool,
    /// Index of each trial's push.
    places: HashMap<String, usize>,
    /// Number of samples of all pushes.
    samples: usize,
}

/// Diameter of the disc with the same area [m² → m].
pub fn diameter(area: f64) -> f64 {
    (area / std::f64::consts::FRAC_PI_4).sqrt()
}

/// Reads the `bytes` of a file; `path` names it in errors. `units` gives the units of depth and force if the header does not,
/// `area` [m²] the size of pushes that state none.
pub fn parse(path: &Path, bytes: &[u8], units: BTreeMap<String, String>, area: f64) -> Result<Tests> {
    // The same range as for one push.
    check_range("area", area, super::AREAS)?;
    let mut tests = Tests { assumed: diameter(area), ..Tests::default() };
    let asked = ReadOptions { units, ..ReadOptions::new(&COLUMNS) };
    table::parse(path, bytes, &asked, |row| tests.take(row))?;
    tests.checked(path)
}

impl Tests {
    fn checked(self, path: &Path) -> Result<Tests> {
        let rows = self.depth.len();
        if self.samples > 0 && self.samples < rows {
            return Err(Error::file(path, format!("column trial: blank in {} of {rows} rows", rows - self.samples)));
        }
        Ok(self)
    }

    fn take(&mut self, row: &Row) -> Result<()> {
        let (depth, force) = (row.needed_within(0, MOST)?, row.needed_within(1, MOST)?);
        let fall = self.depth.last().map_or(0.0, |last| last - depth);
        if row.text(2).is_none() && fall > BEGINS_AGAIN * self.deepest {
            return Err(
                row.error(0, "begins again: name each push in a column trial, or sort the rows of one push by depth")
            );
        }
        self.deepest = self.deepest.max(depth);
        self.depth.push(depth);
        self.force.push(force);
        let Some(name) = row.text(2) else { return Ok(()) };
        let side = |k: usize| {
            let refused = |e: Error| row.error(k, e);
            row.number(k)?.map(|x| check_range(COLUMNS[k].name, x, SIZES).map_err(refused)).transpose()
        };
        let diameter = match (side(3)?, side(4)?, side(5)?) {
            (Some(d), None, None) => d,
            (None, Some(length), Some(width)) => diameter(length * width),
            (None, None, None) => {
                self.without_size = true;
                self.assumed
            }
            _ => return Err(row.error(3, "give a diameter, or length and width, of each push")),
        };
        let speed = row.within(6, MOST)?.map(f64::abs);
        self.samples += 1;
        if self.samples > MOST_SAMPLES {
            return Err(row.error(0, format!("more than {} samples", MOST_SAMPLES)));
        }
        let new = self.pushes.len();
        let place = *self.places.entry(name.to_owned()).or_insert(new);
        if place == new {
            if new == MOST_PUSHES {
                return Err(row.error(2, format!("more than {} pushes", MOST_PUSHES)));
            }
            self.pushes.push(Penetration { name: name.to_owned(), diameter, points: Vec::new(), speeds: None });
        }
        let push = &mut self.pushes[place];
        // The rows of a push repeat its size, so only rounding may differ.
        if (push.diameter - diameter).abs() > 1e-9 {
            return Err(row.error(2, format!("{name} has two sizes")));
        }
        push.points.push([depth, force]);
        if let Some(speed) = speed {
            let [low, high] = push.speeds.unwrap_or([speed, speed]);
            push.speeds = Some([low.min(speed), high.max(speed)]);
        }
        Ok(())
    }
}
