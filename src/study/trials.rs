//! `intrude` with a body: motions of the body, row by row.

use super::arguments::OutputPath;
use super::inputs::{Content, Inputs};
use super::result::{ColumnValues, StudyColumn, StudyFile, StudyResult, StudyTable, quoted};
use crate::error::{Error, Result, check_range};
use crate::number::Vec3;
use crate::parallel;
use crate::progress::Progress;
use crate::sand::SandDescription;
use crate::sand::intruder::path::{self, PathPoint};
use crate::sand::intruder::{self, DepthOrLoad, PlatedBody, Status, Trial, TrialOutcome, check_all};
use crate::table::{self, HeaderColumn, Quantity, ReadOptions, Row};
use std::collections::BTreeSet;
use std::path::Path;
use std::time::{Duration, Instant};

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

/// Columns of the result.
const RESULTS: [&str; 8] = ["Fx", "Fy", "Fz", "Tx", "Ty", "Tz", "depth", "status"];

/// Largest number of rows: our choice, because so many take ten minutes.
const MOST_ROWS: usize = 1_000_000;

/// Memory of a row [bytes]: a motion of 64, an outcome of 72, and in a table 64 of numbers and 56 of status.
const ROW: usize = 256;

/// Memory of a row of a path beside that [bytes]: its time, place and motion, and at most a path of its own with its name.
const MOMENT: usize = 240;

/// Memory of a cell that the result repeats [bytes]: a text in memory of its own, and a place in a list that doubles.
const CELL: usize = 80;

/// Memory of the sand of a path [bytes]: a square of 256 cells along a side.
const GRID: usize = 256 << 10;

/// Largest memory of the surface that a path leaves [bytes]: 36 for each cell of its square.
const SURFACE: usize = 36 << 16;

/// A part of the motions, after which the study reports and can be stopped, begins with so many for each processor, and
/// doubles while it takes less than this time: our choice.
const FIRST_TOGETHER: usize = 2;
const PART: Duration = Duration::from_millis(250);

/// Memory for a plate in a position of a period [bytes]: 300 MB were measured for 2,500,000 of them.
const PIECE: usize = 120;

/// Motions, and the columns of their file that the result repeats.
#[derive(Default)]
pub struct TrialRows {
    kept: Vec<StudyColumn>,
    trials: Vec<Trial>,
    /// With memory: the paths, in order.
    paths: Vec<(String, Vec<PathPoint>)>,
}

/// Sand that remembers.
pub struct SandMemory {
    pub repose_deg: Option<f64>,
    pub cell: Option<f64>,
    /// Diameter of the grains [m], if what passes of `sliding_face` is computed.
    pub grain_size: Option<f64>,
    /// File for the surface after each path.
    pub surface: Option<OutputPath>,
}

/// A body, and its motions through sand.
pub struct Trials {
    pub shape: String,
    pub body: PlatedBody,
    pub sand: SandDescription,
    pub rows: TrialRows,
    pub memory: Option<SandMemory>,
}

impl SandMemory {
    fn path<'a>(&self, body: &'a PlatedBody, sand: &'a SandDescription) -> Result<path::Path<'a>> {
        let path = path::Path::new(body, sand, self.repose_deg, self.cell)?;
        match self.grain_size {
            Some(diameter) => path.in_grains(diameter),
            None => Ok(path),
        }
    }
}

impl Trials {
    /// Refuses what cannot be computed.
    pub fn check(&self) -> Result<()> {
        let Self { body, sand, rows, memory, .. } = self;
        check_range("number of rows", rows.trials.len() as f64, 1.0..=MOST_ROWS as f64)?;
        check_all(sand, &rows.trials)?;
        let Some(memory) = memory else { return Ok(()) };
        memory.path(body, sand)?;
        rows.paths.iter().try_for_each(|(name, moments)| {
            path::check(body, sand, moments).map_err(|e| Error::invalid(format!("trial {name:?}"), e.to_string()))
        })
    }

    pub fn run(self, progress: &dyn Progress) -> Result<StudyResult> {
        let (outcomes, surface) = match &self.memory {
            None => (self.steady(progress)?, None),
            Some(memory) => self.follow(memory, progress)?,
        };
        let lost = outcomes.iter().filter(|o| o.status == Status::NoEquilibrium).count();
        let Self { shape, body, sand, rows, .. } = self;
        let summary = format!(
            "{shape} in {}: {} plates of {:.2} mm, area {:.4e} m², volume {:.4e} m³; {} rows, {lost} without equilibrium\n",
            sand.name,
            body.plates.len(),
            1e3 * body.plate_size,
            body.area(),
            body.volume(),
            outcomes.len(),
        );
        let table = StudyTable::new("trials", [rows.kept, columns(&outcomes)].concat());
        Ok(StudyResult { summary, named_files: surface.into_iter().collect(), ..StudyResult::table(table) })
    }

    /// Steady motions, each alone.
    fn steady(&self, progress: &dyn Progress) -> Result<Vec<TrialOutcome>> {
        let trials = &self.rows.trials;
        let mut outcomes = Vec::with_capacity(trials.len());
        let mut together = FIRST_TOGETHER * parallel::processors();
        while outcomes.len() < trials.len() {
            progress.report(outcomes.len() as f64 / trials.len() as f64, "trials")?;
            let (rest, start) = (&trials[outcomes.len()..], Instant::now());
            let part = &rest[..together.min(rest.len())];
            outcomes.extend(parallel::map(part, |trial| intruder::compute(&self.body, &self.sand, trial)));
            together *= if start.elapsed() < PART { 2 } else { 1 };
        }
        Ok(outcomes)
    }

    /// The forces along all paths, and the surfaces that they leave.
    fn follow(&self, memory: &SandMemory, progress: &dyn Progress) -> Result<(Vec<TrialOutcome>, Option<StudyFile>)> {
        let followed = parallel::map(&self.rows.paths, |(name, moments)| -> Result<_> {
            let mut path = memory.path(&self.body, &self.sand)?;
            let mut outcomes = Vec::with_capacity(moments.len());
            for moment in moments {
                progress.report(0.0, "trials")?;
                outcomes.push(path.step(moment));
            }
            Ok((outcomes, memory.surface.as_ref().map(|_| heights(name, &mut path))))
        });
        let followed = followed.into_iter().collect::<Result<Vec<_>>>()?;
        let lines: String = followed.iter().filter_map(|(_, lines)| lines.as_deref()).collect();
        let surface = memory
            .surface
            .as_ref()
            .map(|OutputPath(name)| StudyFile::new(name.clone(), format!("trial,x,y,height\n{lines}")));
        Ok((followed.into_iter().flat_map(|(outcomes, _)| outcomes).collect(), surface))
    }
}

/// The cells that a path has moved as lines of CSV, after the sand has come to rest.
fn heights(name: &str, path: &mut path::Path) -> String {
    path.settle();
    let grid = &path.moved.grid;
    let middle = |i: i32| (f64::from(i) + 0.5) * grid.frame.cell;
    let moved = grid.cells().filter(|(_, height)| *height != 0.0);
    let line =
        |([x, y], height): ([i32; 2], f64)| format!("{},{:.5},{:.5},{height:.6}\n", quoted(name), middle(x), middle(y));
    moved.map(line).collect()
}

fn columns(outcomes: &[TrialOutcome]) -> Vec<StudyColumn> {
    let numbers = StudyColumn::of_rows(
        outcomes,
        &[
            (RESULTS[0], "N", |o| o.force[0]),
            (RESULTS[1], "N", |o| o.force[1]),
            (RESULTS[2], "N", |o| o.force[2]),
            (RESULTS[3], "N·m", |o| o.torque[0]),
            (RESULTS[4], "N·m", |o| o.torque[1]),
            (RESULTS[5], "N·m", |o| o.torque[2]),
            (RESULTS[6], "m", |o| o.depth),
        ],
    );
    let status = StudyColumn::names(RESULTS[7], outcomes.iter().map(|o| o.status.name()));
    numbers.into_iter().chain([status]).collect()
}

/// The motions of a file or of a table in memory.
pub fn read(name: &str, inputs: &Inputs, memory: bool) -> Result<TrialRows> {
    match inputs.get(name)? {
        Content::Bytes(bytes) => from_file(Path::new(name), bytes, memory),
        Content::Table(table) => from_table(table, memory),
    }
}

/// Memory of the motions in a file or a table, and of the table that comes of them [bytes]. Every mark that may separate cells counts
/// as one.
pub fn cost(name: &str, inputs: &Inputs, memory: bool) -> usize {
    let row = ROW + if memory { MOMENT } else { 0 };
    match inputs.get(name) {
        Ok(Content::Table(table)) => row * table.rows(),
        Ok(Content::Bytes(text)) => {
            let count = |marks: &[u8]| text.iter().filter(|byte| marks.contains(byte)).count();
            let rows = 1 + count(b"\n\r");
            row * rows + CELL * (rows + count(b",;\t "))
        }
        Err(_) => 0,
    }
}

impl TrialRows {
    /// Memory of the body in the dearest motion [bytes]: of its plates in each position of a period, if it turns and is not
    /// round.
    pub fn body_bytes(&self, body: &PlatedBody) -> usize {
        let turns = |trial: &Trial| {
            let spin = Vec3::<f64>::splat(trial.spin);
            let rate = spin.norm_squared().sqrt();
            rate > 0.0 && !body.is_round_about(spin * (1.0 / rate))
        };
        let positions = if self.trials.iter().any(turns) { body.turns() } else { 1 };
        PIECE * body.plates.len() * positions
    }

    /// Memory of the sand of all paths [bytes]: of one for each core, and of the surfaces that are kept.
    pub fn sand_bytes(&self, memory: Option<&SandMemory>) -> usize {
        let kept = memory.and_then(|memory| memory.surface.as_ref()).map_or(0, |_| SURFACE * self.paths.len());
        kept + GRID * self.paths.len().min(parallel::processors())
    }

    /// Adds a motion to the path of its trial. `again`: the error for a trial that has ended before.
    fn add_moment(
        &mut self,
        names: &mut BTreeSet<String>,
        name: &str,
        moment: PathPoint,
        again: impl Fn(String) -> Error,
    ) -> Result<()> {
        if self.paths.last().is_none_or(|(last, _)| last != name) {
            if !names.insert(name.to_owned()) {
                return Err(again(format!("{name:?} comes again: the rows of a trial belong together")));
            }
            self.paths.push((name.to_owned(), Vec::new()));
        }
        if let Some((_, moments)) = self.paths.last_mut() {
            moments.push(moment);
        }
        Ok(())
    }
}

fn given(depth: Option<f64>, load: Option<f64>) -> std::result::Result<DepthOrLoad, &'static str> {
    match (depth, load) {
        (Some(depth), None) => Ok(DepthOrLoad::Depth(depth)),
        (None, Some(load)) => Ok(DepthOrLoad::Load(load)),
        (None, None) => Err("neither depth nor load is given"),
        (Some(_), Some(_)) => Err("both depth and load are given: leave one blank"),
    }
}

fn from_file(path: &Path, bytes: &[u8], memory: bool) -> Result<TrialRows> {
    let columns = if memory { &COLUMNS[..] } else { &COLUMNS[..STEADY] };
    let asked = ReadOptions { most_rows: Some(MOST_ROWS), ..ReadOptions::new(columns) };
    let (mut rows, mut names) = (TrialRows::default(), BTreeSet::new());
    // By columns; each row has a cell in all columns of the header.
    let mut cells: Vec<Vec<String>> = Vec::new();
    let summary = table::parse(path, bytes, &asked, |row| {
        let trial = trial_of(path, row)?;
        rows.trials.push(trial);
        if memory {
            let place = match (row.number(PLACE[0])?, row.number(PLACE[1])?) {
                (None, None) => None,
                (x, y) => Some([x.unwrap_or(0.0), y.unwrap_or(0.0)]),
            };
            let moment = PathPoint { time: row.needed(TIME)?, place, trial };
            let name = row.text(TRIAL).unwrap_or_default();
            rows.add_moment(&mut names, name, moment, |reason| row.error(TRIAL, reason))?;
        }
        for (k, cell) in row.cells().enumerate() {
            if k == cells.len() {
                cells.push(Vec::new());
            }
            cells[k].push(cell.to_owned());
        }
        Ok(())
    })?;
    // The result has one column `depth`. Where the file gives a depth, both are the same.
    let is_depth = |name: &str| name.split(['[', '(']).next().is_some_and(|n| n.trim() == "depth");
    let column = |(name, cells): (&String, Vec<String>)| {
        let given = if RESULTS.contains(&name.as_str()) { "_given" } else { "" };
        StudyColumn::names(&format!("{name}{given}"), cells)
    };
    rows.kept = summary.header.iter().zip(cells).filter(|(name, _)| !is_depth(name)).map(column).collect();
    Ok(rows)
}

fn trial_of(path: &Path, row: &Row) -> Result<Trial> {
    let mut motion = [0.0; DEPTH];
    for (k, value) in motion.iter_mut().enumerate() {
        *value = row.number(k)?.unwrap_or(0.0);
    }
    let given = given(row.number(DEPTH)?, row.number(LOAD)?).map_err(|reason| row.error(DEPTH, reason))?;
    let [vx, vy, vz, wx, wy, wz] = motion;
    let trial = Trial { velocity: [vx, vy, vz], spin: [wx, wy, wz], given };
    trial.validated().map_err(|e| Error::file(path, format!("row {}: {e}", row.line)))
}

/// Rows of a table in memory; NaN is blank.
fn from_table(table: &StudyTable, memory: bool) -> Result<TrialRows> {
    let known = COLUMNS.map(|column| column.name);
    let known = if memory { &known[..] } else { &known[..STEADY] };
    let mut columns: [Option<&[f64]>; COLUMNS.len()] = [None; COLUMNS.len()];
    for column in &table.columns {
        let unknown = || Error::unknown("rows: column", &column.name, known);
        let place = known.iter().position(|name| *name == column.name).ok_or_else(unknown)?;
        match &column.values {
            ColumnValues::Numbers(numbers) => columns[place] = Some(numbers),
            ColumnValues::Names(_) => return Err(Error::invalid(&column.name, "texts where numbers are expected")),
        }
    }
    check_range("number of rows", table.rows() as f64, 1.0..=MOST_ROWS as f64)?;
    let (mut rows, mut names) = (TrialRows::default(), BTreeSet::new());
    for k in 0..table.rows() {
        let cell = |column: usize| columns[column].map(|numbers| numbers[k]).filter(|x| !x.is_nan());
        let wrong = |reason: &str| Error::invalid(format!("trial {}", k + 1), reason);
        let [vx, vy, vz, wx, wy, wz] = [0, 1, 2, 3, 4, 5].map(|column| cell(column).unwrap_or(0.0));
        let given = given(cell(DEPTH), cell(LOAD)).map_err(wrong)?;
        let trial = Trial { velocity: [vx, vy, vz], spin: [wx, wy, wz], given };
        rows.trials.push(trial);
        if memory {
            let place = match PLACE.map(cell) {
                [None, None] => None,
                place => Some(place.map(|x| x.unwrap_or(0.0))),
            };
            let time = cell(TIME).ok_or_else(|| wrong("no time t is given"))?;
            let name = cell(TRIAL).map_or_else(String::new, |number| number.to_string());
            rows.add_moment(&mut names, &name, PathPoint { time, place, trial }, |reason| wrong(&reason))?;
        }
    }
    Ok(rows)
}
