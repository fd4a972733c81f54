//! `sandgait sweep --learn`: writes the results of a study of learnt gaits as files and as text.

use sandgait::plot::{self, Figure, FigurePanel, Mark, Style, color, png};
use sandgait::sweep::SweepAxis;
use sandgait::train::design::{DesignComparison, DesignStudy, Findings, GaitMeasure, Trained, TrainingMean};
use sandgait::{Error, Result};
use std::path::Path;

/// One line for each design: each measure's mean over trainings with its interval, then the returns of the trainings.
fn csv(study: &DesignStudy, findings: &Findings) -> String {
    let mut head: Vec<String> = study.axes.iter().map(|a| a.parameter.label()).collect();
    for measure in GaitMeasure::ALL {
        let label = measure.label();
        head.extend([label.to_owned(), format!("{label} low"), format!("{label} high")]);
    }
    head.extend((0..study.trainings).map(|k| format!("return of training {k}")));
    head.push("steps of all trainings".into());
    let mut text = head.join(",") + "\n";
    for (design, trained) in findings.trained.iter().enumerate() {
        let mut cells = findings.designs[design].clone();
        for place in 0..GaitMeasure::ALL.len() {
            let all: Vec<f64> = trained.iter().map(|t| t.chosen_by[place]).collect();
            let TrainingMean { mean, half } = TrainingMean::of(&all);
            cells.extend([mean, mean - half, mean + half].map(number));
        }
        cells.extend(trained.iter().map(|t| number(t.chosen_by[0])));
        cells.push(trained.iter().map(|t| t.steps).sum::<u64>().to_string());
        text += &(cells.join(",") + "\n");
    }
    text
}

/// The mean and, if there is an interval, half of its width.
fn between(all: &[f64]) -> String {
    let TrainingMean { mean, half } = TrainingMean::of(all);
    if half.is_nan() { format!("{mean:.3}") } else { format!("{mean:.3} ± {half:.3}") }
}

/// All designs and the comparison of the best ones, as Markdown.
fn markdown(study: &DesignStudy, findings: &Findings, measure: GaitMeasure, best: &[Vec<String>]) -> String {
    let table = |rows: &[Vec<String>]| {
        let line = |row: &Vec<String>| format!("| {} |\n", row.join(" | "));
        let rule = rows.first().map_or(String::new(), |head| "|---".repeat(head.len()) + "|\n");
        rows.iter()
            .enumerate()
            .map(|(k, row)| if k == 1 { rule.clone() + &line(row) } else { line(row) })
            .collect::<String>()
    };
    let mut head: Vec<String> = study.axes.iter().map(|a| a.parameter.label()).collect();
    head.extend(GaitMeasure::ALL.map(|m| m.label().to_owned()));
    let row = |(values, trained): (&Vec<String>, &Vec<Trained>)| {
        let measures = GaitMeasure::ALL.map(|m| between(&measured(m, trained)));
        values.iter().cloned().chain(measures).collect::<Vec<_>>()
    };
    let all: Vec<_> = std::iter::once(head).chain(findings.designs.iter().zip(&findings.trained).map(row)).collect();
    let best: Vec<Vec<String>> = best.iter().map(|row| [&row[..1], &row[2..]].concat()).collect();
    format!(
        "The best designs by {} on 100 seeds that were used neither for training nor for the choice (±: 95 % interval of the \
         mean over {} trainings, Student's t):\n\n{}\nAll designs on the 32 seeds for the choice of the best designs:\n\n{}",
        measure.name(),
        study.trainings,
        table(&best),
        table(&all)
    )
}

/// The value as text; empty if it is not finite.
fn number(value: f64) -> String {
    if value.is_finite() { format!("{value:.6}") } else { String::new() }
}

/// The measure of each training of `trained`.
fn measured(measure: GaitMeasure, trained: &[Trained]) -> Vec<f64> {
    let place = GaitMeasure::ALL.iter().position(|m| *m == measure).unwrap_or(0);
    trained.iter().map(|t| t.chosen_by[place]).collect()
}

/// Draws the measure over one axis: each training as a dot, the means as a line with their intervals. With two axes
/// there is a line for each value of the first axis.
fn figure(study: &DesignStudy, findings: &Findings, measure: GaitMeasure) -> Figure {
    let title = format!("a gait learnt for each design, {} trainings each", study.trainings);
    let panels = match study.search {
        Some(_) => (0..study.axes.len()).map(|k| searched(study, findings, measure, k)).collect(),
        None => study.axes.last().map(|along| lines(study, findings, measure, along)).into_iter().collect(),
    };
    let note = match study.trainings {
        1 => String::new(),
        _ => "Dots: one training each. Line: their mean, with its 95 % interval (Student's t). Evaluated on the seeds for the choice of the best designs.".into(),
    };
    Figure { title, panels, columns: 2, note }
}

fn lines(study: &DesignStudy, findings: &Findings, measure: GaitMeasure, along: &SweepAxis) -> FigurePanel {
    let x = along.numbers().unwrap_or_else(|| (1..=along.values.len()).map(|i| i as f64).collect());
    let mut marks = Vec::new();
    for (k, row) in findings.trained.chunks(x.len()).enumerate() {
        let shade = color::CYCLE[k % color::CYCLE.len()];
        let style = Style::line(shade);
        let family =
            study.axes.iter().rev().nth(1).map_or("mean of the trainings".to_owned(), |axis| {
                format!("{} = {}", axis.parameter.name, axis.values[k])
            });
        let between: Vec<TrainingMean> =
            row.iter().map(|trained| TrainingMean::of(&measured(measure, trained))).collect();
        if study.trainings > 1 {
            let points = x.iter().zip(&between).map(|(x, b)| [*x, b.mean - b.half, b.mean + b.half]).collect();
            marks.push(Mark::band("", shade, points));
        }
        marks.push(Mark::line(&family, style, x.iter().zip(&between).map(|(x, b)| [*x, b.mean]).collect()));
        let dots = x.iter().zip(row).flat_map(|(x, t)| measured(measure, t).into_iter().map(|y| [*x, y])).collect();
        marks.push(Mark::line("", dotted(shade), dots));
    }
    let (x, y) = (plot::Axis::new(&along.parameter.label()), plot::Axis::new(measure.label()));
    FigurePanel { x, y, marks, ..FigurePanel::default() }
}

/// All designs of a search over axis `k`.
fn searched(study: &DesignStudy, findings: &Findings, measure: GaitMeasure, k: usize) -> FigurePanel {
    let at = |values: &Vec<String>| values[k].parse().unwrap_or(f64::NAN);
    let all = findings.designs.iter().zip(&findings.trained);
    let dots = all.flat_map(|(values, t)| measured(measure, t).into_iter().map(move |y| [at(values), y])).collect();
    let (x, y) = (plot::Axis::new(&study.axes[k].parameter.label()), plot::Axis::new(measure.label()));
    FigurePanel { x, y, marks: vec![Mark::line("a training", dotted(color::BLUE), dots)], ..FigurePanel::default() }
}

/// A style of dots without a line.
fn dotted(color: &'static str) -> Style {
    Style { width: 0.0, ..Style::line(color) }.with_dots()
}

/// Writes all files into `out`; returns the text for the terminal.
pub fn report(study: &DesignStudy, findings: &Findings, measure: GaitMeasure, out: &Path) -> Result<String> {
    let write = |name: &str, content: &[u8]| {
        let path = out.join(name);
        std::fs::write(&path, content).map_err(|e| Error::unwritten(&path, &e))
    };
    write("learnt.csv", csv(study, findings).as_bytes())?;
    png::write_both(&figure(study, findings, measure).svg(), &out.join("learnt.svg"))?;
    let mut rows = vec![["design".to_owned(), "file".into()].to_vec()];
    rows[0].extend(GaitMeasure::ALL.map(|m| m.label().to_owned()));
    for DesignComparison { design, values } in &findings.best {
        let named = study.axes.iter().zip(&findings.designs[*design]);
        let named: Vec<_> = named.map(|(axis, value)| format!("{} = {value}", axis.parameter.name)).collect();
        let mut cells = vec![named.join(", "), format!("design{design}-*.onnx")];
        cells.extend(values.iter().map(|all| between(all)));
        rows.push(cells);
    }
    write("learnt.md", markdown(study, findings, measure, &rows).as_bytes())?;
    let text = format!(
        "best designs by {} on 100 seeds that were used neither for training nor for the choice:\n\n{}\n\
         ±: 95 % interval of the mean over trainings (Student's t)\n",
        measure.name(),
        super::layout::narrow_table(&rows, 1)
    );
    write("best.txt", text.as_bytes())?;
    Ok(text)
}
