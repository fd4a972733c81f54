//! `sandgait intrude --body … --trials …`: steady motions of any body, row by row.

use sandgait::sand::SandDescription;
use sandgait::sand::intruder::{Body, BodyShape, Given, Outcome, Status, Trial, compute_all};
use sandgait::table::{self, Asked, Column, Quantity};
use sandgait::{Error, Result};
use std::fmt::Write as _;
use std::path::Path;

const fn optional(name: &'static str, quantity: Quantity) -> Column<'static> {
    Column { name, quantity, required: false }
}

const COLUMNS: [Column; 8] = [
    optional("vx", Quantity::Speed),
    optional("vy", Quantity::Speed),
    optional("vz", Quantity::Speed),
    optional("wx", Quantity::AngularSpeed),
    optional("wy", Quantity::AngularSpeed),
    optional("wz", Quantity::AngularSpeed),
    optional("depth", Quantity::Length),
    optional("load", Quantity::Force),
];
const DEPTH: usize = 6;
const LOAD: usize = 7;

/// Columns that are added to each row.
const RESULTS: [&str; 8] = ["Fx", "Fy", "Fz", "Tx", "Ty", "Tz", "depth", "status"];

/// Largest number of rows: our choice, because so many take ten minutes.
const MOST_ROWS: usize = 1_000_000;

/// The unchanged rows of a file, and the motions that they describe.
struct Rows {
    header: Vec<String>,
    cells: Vec<String>,
    trials: Vec<Trial>,
}

/// Computes every row and writes the table to `csv`, if this is given. Returns the number of rows without equilibrium.
pub fn run(
    shape: &str,
    plate_size: Option<f64>,
    sand: &SandDescription,
    trials: &Path,
    csv: Option<&Path>,
) -> Result<String> {
    let body = Body::cut(&BodyShape::named(shape)?, plate_size)?;
    let rows = read(trials)?;
    let outcomes = compute_all(&body, sand, &rows.trials)?;
    if let Some(path) = csv {
        std::fs::write(path, rows.with(&outcomes)).map_err(|e| Error::file(path, e))?;
    }
    let lost = outcomes.iter().filter(|o| o.status == Status::NoEquilibrium).count();
    Ok(format!(
        "{shape} in {}: {} plates of {:.2} mm, area {:.4e} m², volume {:.4e} m³; {} rows, {lost} without equilibrium\n",
        sand.name,
        body.plates.len(),
        1e3 * body.plate_size,
        body.area(),
        body.volume(),
        outcomes.len(),
    ))
}

fn read(path: &Path) -> Result<Rows> {
    let asked = Asked { most_rows: Some(MOST_ROWS), ..Asked::new(&COLUMNS) };
    let (mut cells, mut trials) = (Vec::new(), Vec::new());
    let mut keep = Vec::new();
    let summary = table::read(path, &asked, |row| {
        let mut motion = [0.0; DEPTH];
        for (k, value) in motion.iter_mut().enumerate() {
            *value = row.number(k)?.unwrap_or(0.0);
        }
        let given = match (row.number(DEPTH)?, row.number(LOAD)?) {
            (Some(depth), None) => Given::Depth(depth),
            (None, Some(load)) => Given::Load(load),
            (None, None) => return Err(row.error(DEPTH, "neither depth nor load is given")),
            (Some(_), Some(_)) => return Err(row.error(DEPTH, "both depth and load are given: leave one blank")),
        };
        let [vx, vy, vz, wx, wy, wz] = motion;
        let trial = Trial { velocity: [vx, vy, vz], spin: [wx, wy, wz], given };
        trials.push(trial.validated().map_err(|e| Error::file(path, format!("row {}: {e}", row.line)))?);
        keep.push(row.cells().map(str::to_owned).collect::<Vec<_>>());
        Ok(())
    })?;
    // The output has one column `depth`, which this program writes. Where the input gives a depth, both are the same.
    let is_depth = |name: &str| name.split(['[', '(']).next().is_some_and(|n| n.trim() == "depth");
    let kept: Vec<usize> = (0..summary.header.len()).filter(|k| !is_depth(&summary.header[*k])).collect();
    let named = |k: &usize| match &summary.header[*k] {
        name if RESULTS.contains(&name.as_str()) => format!("{name}_given"),
        name => name.clone(),
    };
    for row in keep {
        cells.push(kept.iter().filter_map(|k| row.get(*k)).map(|c| quoted(c)).collect::<Vec<_>>().join(","));
    }
    Ok(Rows { header: kept.iter().map(named).collect(), cells, trials })
}

/// A cell in CSV format.
fn quoted(cell: &str) -> String {
    if cell.contains([',', '"', '\n', '\r']) { format!("\"{}\"", cell.replace('"', "\"\"")) } else { cell.into() }
}

impl Rows {
    fn with(&self, outcomes: &[Outcome]) -> String {
        let mut text = String::new();
        let mut header: Vec<String> = self.header.iter().map(|name| quoted(name)).collect();
        header.extend(RESULTS.map(String::from));
        text.push_str(&header.join(","));
        for (cells, o) in self.cells.iter().zip(outcomes) {
            text.push('\n');
            text.push_str(cells);
            for value in o.force {
                let _ = write!(text, ",{value:.6}");
            }
            for value in o.torque {
                let _ = write!(text, ",{value:.8}");
            }
            let _ = write!(text, ",{:.8},{}", o.depth, o.status.name());
        }
        text.push('\n');
        text
    }
}
