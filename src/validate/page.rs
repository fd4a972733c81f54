//! The scoreboard as text, rows and figures.

use super::data::{DataSet, SteadyState, Wheel};
use super::fit;
use super::score::{FIGURES, ForceErrors, MeasuredPair, REGIMES, errors, intervals, predict, scatter};
use crate::error::Result;
use crate::plot::{Axis, Figure, FigurePanel, Mark, Style, color};
use crate::progress::{Latch, Progress};
use std::fmt::Write as _;

/// The series of a figure: measured and predicted values, if both exist.
type FigureOf = fn(&MeasuredPair) -> Option<[f64; 2]>;

/// The text above the scoreboard.
const INTRODUCTION: &str = "\
`sandgait validate --out DIR` writes this page. It computes the numbers; the text is fixed. *Not fitted* means that no number of the model
was fitted to the rows, although the model's authors knew the rows. *Left out* means that the model was fitted to rows of the same wheels
with other slip angles or other slip ratios. *Fitted* means that the model was fitted to the same rows, so this is no prediction. The slip
ratio of a wheel is positive when it spins, negative when it skids, and −1 when it is locked.

3D-RFT computes the force on each plate as if the plate moved alone. This assumption is wrong in three cases. A locked
wheel sinks 20 mm deeper than predicted, because sand is carried away from under it (`skid_loss`). A spinning wheel
sinks less than predicted, because a smooth surface that slides along itself carries more than in the law
(`slip_bearing`). A side face that moves nearly along itself carries less than in the law (`graze_loss`). With these
mechanisms the locked wheel at an angle still has the largest errors. A fit on these wheels has a `depth_power` below 0.
This value is not a property of the sand, because the resistance of discs in this sand grows faster than in proportion
to depth and size. So the fitted file does not apply to other sizes or loads. The grouser wheel is modelled as a
cylinder of its tip radius, with the friction of sand on sand. The program does not have the grouser wheel's rows at
positive slip ratios. So its sinkage at positive slip ratios and the pull of its grousers were never compared with
measurements.

The prediction for these wheels that is not fitted contains `slip_bearing`. Its value, 1, is not fitted, but its form is ours, and was
chosen for these wheels. Without it the errors of rows with spin are 43.5 % in Fz and 12.9 mm in sinkage (with it 13.6 % and 2.6 mm), and
those of all rows are 47.0 % and 9.8 mm (43.9 % and 8.6 mm).

To compare your own data, make a folder with a `validation.toml` like that in `tests/data/real_wheel`. It has title, source, licence, and an
`[[intruder]]` table for each body, with name, body, rows, sand and, if there is a fit, fitted. The rows have the columns vx, vy, wy, depth, Fx,
Fy, Fz, slip_angle_deg and slip. Then run `sandgait validate --data FOLDER --out DIR`.
";

/// One comparison: a title that says what was fitted, and the measured rows with their predictions.
struct Comparison {
    title: String,
    /// Title of its figure.
    short: &'static str,
    pairs: Vec<MeasuredPair>,
}

/// The whole scoreboard of one data set.
pub struct Scoreboard {
    data: DataSet,
    comparisons: Vec<Comparison>,
}

impl Scoreboard {
    /// Predicts every row. Also repeats the fit with each slip angle left out. An error of `progress` stops the work.
    pub fn new(data: DataSet, progress: &dyn Progress) -> Result<Self> {
        let latch = Latch::new(progress);
        latch.report(0.0, "measured rows")?;
        let mut comparisons = Vec::new();
        let each = |of: &dyn Fn(&Wheel) -> Option<crate::sand::SandDescription>| -> Vec<MeasuredPair> {
            let wheels = data.wheels.iter().enumerate();
            wheels.filter_map(|(k, w)| of(w).map(|sand| predict(k, w, &sand, &w.rows, &latch))).flatten().collect()
        };
        let names = |of: &dyn Fn(&Wheel) -> Option<String>| data.wheels.iter().find_map(of).unwrap_or_default();
        comparisons.push(Comparison {
            short: "Not fitted",
            title: format!("not fitted: {}", names(&|w| Some(w.sand.source.clone()))),
            pairs: each(&|w| Some(w.sand.clone())),
        });
        if data.wheels.iter().all(|w| w.fitted.is_some()) {
            let left_out = cross_validated(&data.wheels, &latch)?;
            comparisons.push(Comparison {
                short: "Left out: slip angles",
                title: "left out: each slip angle is predicted from a fit on the other slip angles of all wheels"
                    .into(),
                pairs: left_out,
            });
            let unseen = positive(&data.wheels, &latch)?;
            if !unseen.is_empty() {
                comparisons.push(Comparison {
                    short: "Left out: positive slip ratios",
                    title:
                        "left out: positive slip ratios are predicted from a fit on the other slip ratios of all wheels"
                            .into(),
                    pairs: unseen,
                });
            }
            comparisons.push(Comparison {
                short: "Fitted",
                title:
                    "fitted: the fit used the same rows, so these are the least errors of this model, not errors of a prediction"
                        .into(),
                pairs: each(&|w| w.fitted.clone()),
            });
        }
        latch.error().map_or(Ok(Self { data, comparisons }), Err)
    }

    /// The scoreboard as Markdown.
    pub fn text(&self) -> String {
        let d = &self.data;
        let mut text = format!("## {}\n\nData: {}. Licence: {}.\n\n", d.title, d.source, d.licence);
        let _ = writeln!(
            text,
            "Root mean square errors, with 95 % intervals over conditions in brackets. Forces are in % of the mean load.\n"
        );
        for c in &self.comparisons {
            let _ = writeln!(text, "**{}**\n\n{}", capital(&c.title), self.table(c));
        }
        let _ = writeln!(
            text,
            "Scatter of the measurements between repetitions, in the same units:\n\n{}",
            self.scatters()
        );
        text
    }

    fn table(&self, c: &Comparison) -> String {
        let mut text = format!("| rows | n | {} | no equilibrium |\n|{}\n", FIGURES.join(" | "), "---|".repeat(9));
        let mut line = |name: &str, pairs: &[MeasuredPair], with_intervals: bool| {
            if pairs.is_empty() {
                return;
            }
            let ForceErrors { rows, without_equilibrium, values } = errors(pairs);
            let ends = with_intervals.then(|| intervals(pairs));
            let cell = |k: usize| match &ends {
                Some(ends) => format!("{:.1} [{:.1}, {:.1}]", values[k], ends[k][0], ends[k][1]),
                None => format!("{:.1}", values[k]),
            };
            let cells: Vec<String> = (0..6).map(cell).collect();
            let _ = writeln!(text, "| {name} | {rows} | {} | {without_equilibrium} |", cells.join(" | "));
        };
        line("all", &c.pairs, true);
        for (k, wheel) in self.data.wheels.iter().enumerate() {
            line(&wheel.name, &select(c, |p| p.wheel == k), true);
        }
        for (name, belongs) in REGIMES {
            line(name, &select(c, |p| belongs(&p.row)), false);
        }
        text
    }

    fn scatters(&self) -> String {
        let mut text = format!("| rows | {} |\n|{}\n", FIGURES[..4].join(" | "), "---|".repeat(5));
        for (k, wheel) in self.data.wheels.iter().enumerate() {
            let values = scatter(&select(&self.comparisons[0], |p| p.wheel == k));
            let cells: Vec<String> = values.iter().map(|v| format!("{v:.1}")).collect();
            let _ = writeln!(text, "| {} | {} |", wheel.name, cells.join(" | "));
        }
        text
    }

    /// The first sentences of the page: they name the rows of the first comparison with the largest error in sinkage,
    /// and these errors.
    pub fn worst(&self) -> String {
        let c = &self.comparisons[0];
        let regimes = REGIMES.iter().map(|(name, belongs)| (name, select(c, |p| belongs(&p.row))));
        let all = regimes.filter(|(_, pairs)| !pairs.is_empty()).map(|(name, pairs)| (name, errors(&pairs).values));
        let worst = all.max_by(|a, b| a.1[3].total_cmp(&b.1[3]));
        worst.map_or_else(String::new, |(name, v)| {
            format!(
                "Largest errors without a fit on the wheels: {name}. They are {:.1} mm in sinkage, {:.0} % in Fz at the measured sinkage, \
                 and {:.0} % in Fx under the measured load.",
                v[3], v[2], v[4]
            )
        })
    }

    /// Every measured row in every comparison, with the number of the comparison and the name of the wheel.
    pub fn rows(&self) -> Vec<(usize, &str, MeasuredPair)> {
        let each = |(number, c): (usize, &'_ Comparison)| {
            c.pairs.iter().map(|p| (number, self.data.wheels[p.wheel].name.as_str(), *p)).collect::<Vec<_>>()
        };
        self.comparisons.iter().enumerate().flat_map(each).collect()
    }

    /// A figure of one comparison: predicted over measured values, with one panel for each quantity.
    fn figure(&self, c: &Comparison) -> Figure {
        let measured: [(&str, FigureOf); 4] = [
            ("Fx [N] at the measured sinkage", |p| Some([p.row.force[0], p.prediction.force[0]])),
            ("Fy [N] at the measured sinkage", |p| Some([p.row.force[1], p.prediction.force[1]])),
            ("Fz [N] at the measured sinkage", |p| Some([p.row.force[2], p.prediction.force[2]])),
            ("sinkage [mm] under the measured load", |p| p.prediction.carried.map(|c| [1e3 * p.row.depth, 1e3 * c.0])),
        ];
        let colors = [color::BLUE, color::VERMILION];
        let panels = measured.iter().map(|(name, of)| {
            let points = |k: usize| select(c, |p| p.wheel == k).iter().filter_map(of).collect::<Vec<_>>();
            let all: Vec<[f64; 2]> = c.pairs.iter().filter_map(of).collect();
            let ends = all.iter().flatten().fold([f64::MAX, f64::MIN], |[low, high], x| [low.min(*x), high.max(*x)]);
            let dots = |color| Style { width: 0.0, ..Style::line(color) }.with_dots();
            let mut marks = vec![Mark::line("equal", Style::line(color::BLACK), ends.map(|x| [x, x]).to_vec())];
            for (k, wheel) in self.data.wheels.iter().enumerate() {
                marks.push(Mark::line(&wheel.name, dots(colors[k % 2]), points(k)));
            }
            FigurePanel {
                x: Axis::new(&format!("measured {name}")),
                y: Axis::new("predicted"),
                marks,
                ..FigurePanel::default()
            }
        });
        Figure { title: c.short.into(), columns: 2, panels: panels.collect(), note: self.data.source.clone() }
    }

    /// `validation.md` with `others` at its end, and in `images/` a figure for each comparison: names and texts.
    pub fn files(&self, others: &str) -> Vec<(String, String)> {
        let mut page = format!("# Scoreboard\n\n{}\n\n{INTRODUCTION}\n{}", self.worst(), self.text().trim_end());
        page.push('\n');
        let mut files = Vec::new();
        for (number, c) in self.comparisons.iter().enumerate() {
            let name = format!("images/validation_{number}.svg");
            let _ = write!(page, "\n![{}]({name})\n", capital(&c.title));
            files.push((name, self.figure(c).svg()));
        }
        if !others.is_empty() {
            let _ = write!(page, "\n{}\n", others.trim_end());
        }
        files.push(("validation.md".to_owned(), page));
        files
    }
}

fn select(c: &Comparison, keep: impl Fn(&MeasuredPair) -> bool) -> Vec<MeasuredPair> {
    c.pairs.iter().filter(|p| keep(p)).copied().collect()
}

fn capital(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

/// Predicts the rows with positive slip ratios from a fit on all other rows.
fn positive(wheels: &[Wheel], latch: &Latch) -> Result<Vec<MeasuredPair>> {
    // The measured slip ratio of a wheel that rolls freely is up to 3 %.
    let split = |wheel: &Wheel, above: bool| -> Vec<SteadyState> {
        wheel.rows.iter().filter(|r| (r.slip > 0.03) == above).copied().collect()
    };
    let (kept, asked): (Vec<_>, Vec<_>) = wheels.iter().map(|w| (split(w, false), split(w, true))).unzip();
    if kept.iter().any(Vec::is_empty) || asked.iter().all(Vec::is_empty) {
        return Ok(Vec::new());
    }
    let parameters = fit::fit(wheels, &kept, latch)?;
    let mut pairs = Vec::new();
    for (k, wheel) in wheels.iter().enumerate() {
        pairs.extend(predict(k, wheel, &parameters.sand(wheel, "", "")?, &asked[k], latch));
    }
    Ok(pairs)
}

/// Predicts each slip angle from a fit on the other slip angles.
fn cross_validated(wheels: &[Wheel], latch: &Latch) -> Result<Vec<MeasuredPair>> {
    let angle = |row: &SteadyState| row.slip_angle.round() as i64;
    let mut angles: Vec<i64> = wheels.iter().flat_map(|w| w.rows.iter().map(angle)).collect();
    angles.sort_unstable();
    angles.dedup();
    let mut pairs = Vec::new();
    for left_out in angles {
        let kept = |w: &Wheel| w.rows.iter().filter(|r| angle(r) != left_out).copied().collect::<Vec<_>>();
        let parameters = fit::fit(wheels, &wheels.iter().map(kept).collect::<Vec<_>>(), latch)?;
        for (k, wheel) in wheels.iter().enumerate() {
            let rows: Vec<SteadyState> = wheel.rows.iter().filter(|r| angle(r) == left_out).copied().collect();
            pairs.extend(predict(k, wheel, &parameters.sand(wheel, "", "")?, &rows, latch));
        }
    }
    Ok(pairs)
}
