//! The learning curve as a file and a figure. It gets a point whenever enough episodes have ended.

use super::plan::UpdateReport;
use crate::error::{Error, Result};
use crate::files;
use crate::plot::{Axis, Figure, FigurePanel, Mark, Style, color};
use std::fs::File;
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// Steps and seconds so far, and the mean return of the episodes that ended since the point before.
#[derive(Clone, Debug, PartialEq)]
pub struct CurvePoint {
    pub steps: u64,
    pub seconds: f64,
    pub mean_return: f64,
    /// Mean level of the task's curriculum, if it has one.
    pub level: Option<f64>,
    /// Each reward term with its mean per step since the point before. A mean per step, and not the sum over an
    /// episode, is our choice: it is known even if no episode has ended, and it does not depend on how long episodes
    /// are.
    pub terms: Vec<(String, f64)>,
}

/// Sums since the last point of the curve, for its next point.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct OpenPoint {
    /// Sum of the returns of episodes, and number of these episodes.
    pub episodes: [f64; 2],
    /// Number of updates.
    pub updates: f64,
    /// Each reward term with the sum of its means, one mean for each update.
    pub terms: Vec<(String, f64)>,
}

/// A growing curve, in memory and in its file.
pub struct LearningCurve {
    pub points: Vec<CurvePoint>,
    file: File,
    path: PathBuf,
    /// Names of the reward terms, which are the last columns.
    terms: Vec<String>,
    pub open: OpenPoint,
    /// Number of episodes in a point.
    enough: f64,
    /// What was left out of an earlier file.
    pub notice: Option<String>,
}

/// What an earlier curve's file has.
#[derive(Default)]
struct EarlierCurve {
    terms: Vec<String>,
    points: Vec<CurvePoint>,
    /// Number of lines that are no points.
    broken: usize,
}

impl LearningCurve {
    /// A curve in `path`. In a continued training it keeps the earlier points up to `until` steps, and goes on with `open`.
    pub fn new(path: &Path, until: Option<u64>, open: OpenPoint, envs: usize) -> Result<Self> {
        let earlier = if until.is_some() { read(path)? } else { EarlierCurve::default() };
        let EarlierCurve { terms, mut points, broken } = earlier;
        points.retain(|p| Some(p.steps) <= until);
        let said = |lines: usize| match lines {
            1 => "1 line that is no point was".to_owned(),
            n => format!("{n} lines that are no points were"),
        };
        let notice = (broken > 0).then(|| format!("{}: {} left out", path.display(), said(broken)));
        let file = begun(path, &terms, &points)?;
        // A point has an eighth as many episodes as there are environments, as in the curves of examples/train.py.
        let enough = envs.div_ceil(8) as f64;
        Ok(Self { points, file, path: path.into(), terms, open, enough, notice })
    }

    /// Adds the episodes of an update.
    pub fn note(&mut self, report: &UpdateReport) -> Result<()> {
        let open = &mut self.open;
        if report.episodes > 0 {
            open.episodes[0] += report.mean_return * report.episodes as f64;
            open.episodes[1] += report.episodes as f64;
        }
        open.updates += 1.0;
        for (name, mean) in &report.terms {
            match open.terms.iter_mut().find(|(known, _)| known == name) {
                Some((_, sum)) => *sum += mean,
                None => open.terms.push((name.clone(), *mean)),
            }
        }
        if open.episodes[1] < self.enough {
            return Ok(());
        }
        let OpenPoint { episodes: [sum, count], updates, terms } = std::mem::take(open);
        let point = CurvePoint {
            steps: report.steps,
            seconds: report.seconds,
            mean_return: sum / count,
            level: report.level,
            terms: terms.into_iter().map(|(name, sum)| (name, sum / updates)).collect(),
        };
        let new: Vec<_> = point.terms.iter().map(|(name, _)| name).filter(|name| !self.terms.contains(name)).collect();
        if !new.is_empty() {
            // The names of another program's terms are known only when the first terms come.
            self.terms.extend(new.into_iter().cloned());
            self.file = begun(&self.path, &self.terms, &self.points)?;
        }
        let written = self.file.write_all(line(&point, &self.terms).as_bytes());
        self.points.push(point);
        written.map_err(|e| Error::unwritten(&self.path, &e))
    }

    /// Writes all points to the disk.
    pub fn sync(&self) -> Result<()> {
        self.file.sync_data().map_err(|e| Error::unwritten(&self.path, &e))
    }

    /// Draws the curve, and a line at the return of the policy without noise, as SVG.
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
        figure.write(path)
    }
}

/// The file with its header and `points`, to which more are added.
fn begun(path: &Path, terms: &[String], points: &[CurvePoint]) -> Result<File> {
    let header = ["steps,seconds,return,level"].into_iter().chain(terms.iter().map(String::as_str));
    let lines = points.iter().map(|point| line(point, terms));
    let text = header.collect::<Vec<_>>().join(",") + "\n" + &lines.collect::<String>();
    files::write(path, text.as_bytes())?;
    File::options().append(true).open(path).map_err(|e| Error::unwritten(path, &e))
}

fn line(point: &CurvePoint, terms: &[String]) -> String {
    let level = point.level.map_or(String::new(), |level| format!("{level:.3}"));
    let mean = |name: &String| point.terms.iter().find(|(known, _)| known == name);
    let terms = terms.iter().map(|name| mean(name).map_or(",".into(), |(_, mean)| format!(",{}", *mean as f32)));
    format!("{},{:.2},{:.3},{level}{}\n", point.steps, point.seconds, point.mean_return, terms.collect::<String>())
}

/// The columns that every curve has; those of earlier versions have no level.
const COLUMNS: &str = "steps,seconds,return";

/// The curve in a file, if there is one. A training goes on without the lines that are no points, because its checkpoint
/// has all that it needs. A last line without an end was cut off when a process was killed, and does not count as broken.
fn read(path: &Path) -> Result<EarlierCurve> {
    let bytes = match std::fs::read(path) {
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(EarlierCurve::default()),
        bytes => bytes.map_err(|e| Error::file(path, e))?,
    };
    let text = String::from_utf8_lossy(&bytes);
    let whole = text.rsplit_once('\n').map_or("", |(whole, _)| whole);
    let mut lines = whole.lines().peekable();
    let header = lines.next_if(|line| line.starts_with(COLUMNS)).unwrap_or_default();
    let terms: Vec<String> = header.split(',').skip(4).map(str::to_owned).collect();
    let mut earlier = EarlierCurve { terms, ..EarlierCurve::default() };
    for line in lines {
        match point(line, &earlier.terms) {
            Some(point) => earlier.points.push(point),
            None => earlier.broken += 1,
        }
    }
    Ok(earlier)
}

/// The point in a line; None: it is none.
fn point(line: &str, terms: &[String]) -> Option<CurvePoint> {
    let cells: Vec<_> = line.split(',').collect();
    let [steps, seconds, mean_return, ref more @ ..] = cells[..] else { return None };
    let number = |cell: &str| cell.parse::<f64>().ok().filter(|x| x.is_finite());
    let term = |(name, cell): (&String, &&str)| Some((name.clone(), number(cell)?));
    Some(CurvePoint {
        steps: steps.parse().ok()?,
        seconds: number(seconds)?,
        mean_return: number(mean_return)?,
        level: more.first().and_then(|cell| number(cell)),
        terms: terms.iter().zip(more.iter().skip(1)).filter_map(term).collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn report(steps: u64, terms: &[(&str, f64)]) -> UpdateReport {
        let terms = terms.iter().map(|(name, mean)| ((*name).to_owned(), *mean)).collect();
        UpdateReport { steps, episodes: 1, mean_return: 2.0, terms, ..UpdateReport::default() }
    }

    /// A damaged file keeps its good points, and the training goes on.
    #[test]
    fn lines_that_are_no_points_are_left_out() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("curve.csv");
        let good = "steps,seconds,return,level\n8,1.00,-3.000,\n";
        for (text, kept, notice) in [
            (
                format!("{good}garbage\n\0\u{fffd},,\n16,nan,2,\n24,3.00,1.000,\n32,"),
                2,
                "3 lines that are no points were",
            ),
            (format!("{good}x\n"), 1, "1 line that is no point was"),
            ("\0garbage\n8,1.00,-3.000,\nmore\n".into(), 1, "2 lines that are no points were"),
            (good.into(), 1, ""),
        ] {
            std::fs::write(&path, &text).unwrap();
            let curve = LearningCurve::new(&path, Some(100), OpenPoint::default(), 16).unwrap();
            assert_eq!(curve.points.len(), kept, "{text:?}");
            assert!(curve.notice.clone().unwrap_or_default().contains(notice), "{:?}", curve.notice);
            assert_eq!(curve.notice.is_none(), notice.is_empty());
            let again = LearningCurve::new(&path, Some(100), OpenPoint::default(), 16).unwrap();
            assert!(again.notice.is_none() && again.points == curve.points, "the file was repaired");
        }
    }

    /// Terms are means over the updates since the point before. They get columns when they first come, also in a file
    /// of an earlier version, and can be read back.
    #[test]
    fn terms_get_columns() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("curve.csv");
        let text = || std::fs::read_to_string(&path).unwrap();
        for (old, head) in
            [("steps,seconds,return\n", "8,1.00,-3.000"), ("steps,seconds,return,level\n", "8,1.00,-3.000,")]
        {
            std::fs::write(&path, format!("{old}{head}\n16,2.")).unwrap();
            let mut curve = LearningCurve::new(&path, Some(8), OpenPoint::default(), 16).unwrap();
            assert_eq!(text(), "steps,seconds,return,level\n8,1.00,-3.000,\n");
            curve.note(&report(16, &[("reward_a", 1.0), ("reward_b", -0.25)])).unwrap();
            curve.note(&report(24, &[("reward_a", 2.0), ("reward_b", -0.75)])).unwrap();
            curve.note(&report(32, &[("reward_c", 1e-7)])).unwrap();
            curve.note(&report(40, &[("reward_c", 1e-7)])).unwrap();
            let end = "24,0.00,2.000,,1.5,-0.5,\n40,0.00,2.000,,,,0.0000001\n";
            assert_eq!(
                text(),
                format!("steps,seconds,return,level,reward_a,reward_b,reward_c\n8,1.00,-3.000,,,,\n{end}")
            );
            let again = LearningCurve::new(&path, Some(24), OpenPoint::default(), 16).unwrap();
            assert_eq!(again.points[1].terms, [("reward_a".to_owned(), 1.5), ("reward_b".to_owned(), -0.5)]);
            assert!(text().ends_with("reward_c\n8,1.00,-3.000,,,,\n24,0.00,2.000,,1.5,-0.5,\n"));
        }
    }
}
