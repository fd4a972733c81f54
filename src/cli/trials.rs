//! `sandgait intrude --body … --trials …`: steady motions of any body, row by row.

use sandgait::parallel;
use sandgait::sand::SandDescription;
use sandgait::sand::intruder::path::{self, PathPoint};
use sandgait::sand::intruder::{BodyShape, DepthOrLoad, PlatedBody, Status, Trial, TrialOutcome, compute_all};
use sandgait::table::{self, HeaderColumn, Quantity, ReadOptions};
use sandgait::{Error, Result};
use std::fmt::Write as _;
use std::path::Path;

const fn optional(name: &'static str, quantity: Quantity) -> HeaderColumn<'static> {
    HeaderColumn { name, quantity, required: false }
}

const COLUMNS: [HeaderColumn; 12] = [
    optional("vx", Quantity::Speed),
    optional("vy", Quantity::Speed),
    optional("vz", Quantity::Speed),
    optional("wx", Quantity::AngularSpeed),
    optional("wy", Quantity::AngularSpeed),
    optional("wz", Quantity::AngularSpeed),
    optional("depth", Quantity::Length),
    optional("load", Quantity::Force),
    optional("trial", Quantity::Text),
    optional("t", Quantity::Time),
    optional("x", Quantity::Length),
    optional("y", Quantity::Length),
];
const DEPTH: usize = 6;
const LOAD: usize = 7;
const TRIAL: usize = 8;
const TIME: usize = 9;
const PLACE: [usize; 2] = [10, 11];
/// Number of columns of steady motions; the columns after them are for paths.
const STEADY: usize = 8;

/// Columns that are added to each row.
const RESULTS: [&str; 8] = ["Fx", "Fy", "Fz", "Tx", "Ty", "Tz", "depth", "status"];

/// Largest number of rows: our choice, because so many take ten minutes.
const MOST_ROWS: usize = 1_000_000;

/// The unchanged rows of a file, and the motions that they describe.
struct TrialRows {
    header: Vec<String>,
    cells: Vec<String>,
    trials: Vec<Trial>,
    /// With memory: the paths, in order.
    paths: Vec<(String, Vec<PathPoint>)>,
}

/// Options of `--memory`.
pub struct Memory<'a> {
    pub repose_deg: Option<f64>,
    pub cell: Option<f64>,
    /// File for the surface after each path.
    pub surface: Option<&'a Path>,
}

/// Computes every row and writes the table to `csv`, if this is given. Returns the number of rows without equilibrium.
pub fn run(
    shape: &str,
    plate_size: Option<f64>,
    sand: &SandDescription,
    trials: &Path,
    csv: Option<&Path>,
    memory: Option<&Memory>,
) -> Result<String> {
    let body = PlatedBody::cut(&BodyShape::named(shape)?, plate_size)?;
    let rows = read(trials, memory.is_some())?;
    let outcomes = match memory {
        None => compute_all(&body, sand, &rows.trials)?,
        Some(memory) => follow(&body, sand, &rows.paths, memory)?,
    };
    if let Some(path) = csv {
        std::fs::write(path, rows.with(&outcomes)).map_err(|e| Error::unwritten(path, &e))?;
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

/// The forces along all paths; writes the surfaces that they leave.
fn follow(
    body: &PlatedBody,
    sand: &SandDescription,
    paths: &[(String, Vec<PathPoint>)],
    memory: &Memory,
) -> Result<Vec<TrialOutcome>> {
    paths.iter().try_for_each(|(name, moments)| {
        path::check(body, sand, moments).map_err(|e| Error::invalid(format!("trial {name:?}"), e.to_string()))
    })?;
    path::Path::new(body, sand, memory.repose_deg, memory.cell)?;
    let followed = parallel::map(paths, |(name, moments)| -> Result<_> {
        let mut path = path::Path::new(body, sand, memory.repose_deg, memory.cell)?;
        let outcomes: Vec<TrialOutcome> = moments.iter().map(|m| path.step(m)).collect();
        Ok((outcomes, memory.surface.map(|_| lines(name, &mut path))))
    });
    let followed = followed.into_iter().collect::<Result<Vec<_>>>()?;
    if let Some(file) = memory.surface {
        let lines: String = followed.iter().filter_map(|(_, lines)| lines.as_deref()).collect();
        std::fs::write(file, format!("trial,x,y,height\n{lines}")).map_err(|e| Error::unwritten(file, &e))?;
    }
    Ok(followed.into_iter().flat_map(|(outcomes, _)| outcomes).collect())
}

/// The cells that a path has moved as lines of CSV, after the sand has come to rest.
fn lines(name: &str, path: &mut path::Path) -> String {
    path.settle();
    let grid = &path.moved.grid;
    let middle = |i: i32| (f64::from(i) + 0.5) * grid.frame.cell;
    let moved = grid.cells().filter(|(_, height)| *height != 0.0);
    let line =
        |([x, y], height): ([i32; 2], f64)| format!("{},{:.5},{:.5},{height:.6}\n", quoted(name), middle(x), middle(y));
    moved.map(line).collect()
}

fn read(path: &Path, memory: bool) -> Result<TrialRows> {
    let columns = if memory { &COLUMNS[..] } else { &COLUMNS[..STEADY] };
    let asked = ReadOptions { most_rows: Some(MOST_ROWS), ..ReadOptions::new(columns) };
    let (mut cells, mut trials) = (Vec::new(), Vec::new());
    let mut paths: Vec<(String, Vec<PathPoint>)> = Vec::new();
    let mut names = std::collections::BTreeSet::new();
    let mut keep = Vec::new();
    let summary = table::read(path, &asked, |row| {
        let mut motion = [0.0; DEPTH];
        for (k, value) in motion.iter_mut().enumerate() {
            *value = row.number(k)?.unwrap_or(0.0);
        }
        let given = match (row.number(DEPTH)?, row.number(LOAD)?) {
            (Some(depth), None) => DepthOrLoad::Depth(depth),
            (None, Some(load)) => DepthOrLoad::Load(load),
            (None, None) => return Err(row.error(DEPTH, "neither depth nor load is given")),
            (Some(_), Some(_)) => return Err(row.error(DEPTH, "both depth and load are given: leave one blank")),
        };
        let [vx, vy, vz, wx, wy, wz] = motion;
        let trial = Trial { velocity: [vx, vy, vz], spin: [wx, wy, wz], given };
        let trial = trial.validated().map_err(|e| Error::file(path, format!("row {}: {e}", row.line)))?;
        trials.push(trial);
        if memory {
            let place = match (row.number(PLACE[0])?, row.number(PLACE[1])?) {
                (None, None) => None,
                (x, y) => Some([x.unwrap_or(0.0), y.unwrap_or(0.0)]),
            };
            let moment = PathPoint { time: row.needed(TIME)?, place, trial };
            let name = row.text(TRIAL).unwrap_or_default();
            if paths.last().is_none_or(|(last, _)| last != name) {
                if !names.insert(name.to_owned()) {
                    return Err(row.error(TRIAL, format!("{name:?} comes again: the rows of a trial belong together")));
                }
                paths.push((name.to_owned(), Vec::new()));
            }
            if let Some((_, moments)) = paths.last_mut() {
                moments.push(moment);
            }
        }
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
    Ok(TrialRows { header: kept.iter().map(named).collect(), cells, trials, paths })
}

/// A cell in CSV format.
fn quoted(cell: &str) -> String {
    if cell.contains([',', '"', '\n', '\r']) { format!("\"{}\"", cell.replace('"', "\"\"")) } else { cell.into() }
}

impl TrialRows {
    fn with(&self, outcomes: &[TrialOutcome]) -> String {
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
