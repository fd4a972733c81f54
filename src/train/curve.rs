//! The learning curve: a point whenever enough episodes have ended, as a file and a figure.

use super::plan::UpdateReport;
use crate::error::{Error, Result};
use crate::files;
use crate::plot::{Axis, Figure, FigurePanel, Mark, Style, color, png};
use std::fs::File;
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// Steps and seconds so far, and the mean return of the episodes that ended since the point before.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CurvePoint {
    pub steps: u64,
    pub seconds: f64,
    pub mean_return: f64,
    /// Mean level of the task's curriculum, if it has one.
    pub level: Option<f64>,
}

/// A growing curve, in memory and in its file.
pub struct LearningCurve {
    pub points: Vec<CurvePoint>,
    file: File,
    path: PathBuf,
    /// Sum of returns and number of the episodes after the last point.
    pub open: [f64; 2],
    /// Number of episodes in a point.
    enough: f64,
}

impl LearningCurve {
    /// A curve in `path`. In a continued training it keeps the earlier points up to `until` steps, and starts with the
    /// sums `open` of the episodes after them.
    pub fn new(path: &Path, until: Option<u64>, open: [f64; 2], envs: usize) -> Result<Self> {
        let points = match until {
            Some(until) => read(path)?.into_iter().filter(|p| p.steps <= until).collect(),
            None => Vec::new(),
        };
        let text: String =
            std::iter::once("steps,seconds,return,level\n".to_owned()).chain(points.iter().map(line)).collect();
        files::write(path, text.as_bytes())?;
        let file = File::options().append(true).open(path).map_err(|e| Error::file(path, e))?;
        // A point has an eighth as many episodes as there are environments, as in the curves of examples/train.py.
        Ok(Self { points, file, path: path.into(), open, enough: envs.div_ceil(8) as f64 })
    }

    /// Adds the episodes of an update.
    pub fn note(&mut self, report: &UpdateReport) -> Result<()> {
        if report.episodes > 0 {
            self.open[0] += report.mean_return * report.episodes as f64;
            self.open[1] += report.episodes as f64;
        }
        if self.open[1] < self.enough {
            return Ok(());
        }
        let [sum, count] = std::mem::take(&mut self.open);
        let point =
            CurvePoint { steps: report.steps, seconds: report.seconds, mean_return: sum / count, level: report.level };
        self.points.push(point);
        self.file.write_all(line(&point).as_bytes()).map_err(|e| Error::file(&self.path, e))
    }

    /// Writes all points to the disk.
    pub fn sync(&self) -> Result<()> {
        self.file.sync_data().map_err(|e| Error::file(&self.path, e))
    }

    /// Draws the curve, and a line at the return of the policy without noise, as SVG and PNG.
    pub fn draw(&self, path: &Path, title: &str, reached: Option<f64>) -> Result<()> {
        let points = self.points.iter().map(|p| [p.steps as f64 / 1e6, p.mean_return]).collect();
        let mut marks = vec![Mark::line("while it explores", Style::line(color::BLUE), points)];
        if let Some(at) = reached {
            marks.push(Mark::Horizontal { at, text: "without noise, unseen seeds".into() });
        }
        let seconds = self.points.last().map_or(0.0, |p| p.seconds);
        let figure = Figure {
            title: title.into(),
            panels: vec![FigurePanel {
                title: String::new(),
                x: Axis::new(&format!("environment steps [millions], {seconds:.0} s in all")),
                y: Axis::new("mean return of an episode"),
                marks,
            }],
            columns: 1,
            note: String::new(),
        };
        png::write_both(&figure.svg(), path)
    }
}

fn line(point: &CurvePoint) -> String {
    let level = point.level.map_or(String::new(), |level| format!("{level:.3}"));
    format!("{},{:.2},{:.3},{level}\n", point.steps, point.seconds, point.mean_return)
}

/// The points of a file, if there is one. A last line without an end was cut off when a process was killed, and is left
/// out.
fn read(path: &Path) -> Result<Vec<CurvePoint>> {
    let bytes = match std::fs::read(path) {
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        bytes => bytes.map_err(|e| Error::file(path, e))?,
    };
    let text = String::from_utf8_lossy(&bytes);
    let whole = text.rsplit_once('\n').map_or("", |(whole, _)| whole);
    let point = |(k, line): (usize, &str)| {
        let cells: Vec<_> = line.split(',').collect();
        let read = || {
            // Curves of earlier versions have no level.
            let [steps, seconds, mean_return, ref level @ ..] = cells[..] else { return None };
            Some(CurvePoint {
                steps: steps.parse().ok()?,
                seconds: seconds.parse().ok()?,
                mean_return: mean_return.parse().ok()?,
                level: level.first().and_then(|level| level.parse().ok()),
            })
        };
        read().ok_or_else(|| Error::file(path, format!("line {}: not steps, seconds and a return", k + 1)))
    };
    whole.lines().enumerate().skip(1).map(point).collect()
}
