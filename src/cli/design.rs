//! `sandgait sweep --learn`: what a study of learnt gaits found, as files and for the terminal.

use sandgait::plot::{self, Figure, Mark, Panel, Style, color, png};
use sandgait::sweep::table::values;
use sandgait::train::design::{Between, Findings, Measure, Study};
use sandgait::{Error, Result};
use std::path::Path;

/// One line a design: each measure's mean over trainings with its interval, then the returns of the trainings.
fn csv(study: &Study, findings: &Findings) -> String {
    let mut head: Vec<String> = study.axes.iter().map(|a| a.parameter.label()).collect();
    for measure in Measure::ALL {
        let label = measure.label();
        head.extend([label.to_owned(), format!("{label} low"), format!("{label} high")]);
    }
    head.extend((0..study.trainings).map(|k| format!("return of training {k}")));
    head.push("steps of all trainings".into());
    let mut text = head.join(",") + "\n";
    for (design, trained) in findings.trained.iter().enumerate() {
        let mut cells: Vec<String> = values(&study.axes, design).iter().map(|v| (*v).to_owned()).collect();
        for place in 0..Measure::ALL.len() {
            let all: Vec<f64> = trained.iter().map(|t| t.chosen_by[place]).collect();
            let Between { mean, half } = Between::of(&all);
            cells.extend([mean, mean - half, mean + half].map(number));
        }
        cells.extend(trained.iter().map(|t| number(t.chosen_by[0])));
        cells.push(trained.iter().map(|t| t.steps).sum::<u64>().to_string());
        text += &(cells.join(",") + "\n");
    }
    text
}

/// Empty where it is not finite.
fn number(value: f64) -> String {
    if value.is_finite() { format!("{value:.6}") } else { String::new() }
}

/// The measure over one axis, each training as a dot, the means as a line; of two axes a line a value of the first.
fn figure(study: &Study, findings: &Findings, measure: Measure) -> Figure {
    let place = Measure::ALL.iter().position(|m| *m == measure).unwrap_or(0);
    let Some(along) = study.axes.last() else { return Figure::default() };
    let x = along.numbers().unwrap_or_else(|| (1..=along.values.len()).map(|i| i as f64).collect());
    let mut marks = Vec::new();
    for (k, row) in findings.trained.chunks(x.len()).enumerate() {
        let style = Style::line(color::CYCLE[k % color::CYCLE.len()]);
        let family =
            study.axes.iter().rev().nth(1).map_or("mean of the trainings".to_owned(), |axis| {
                format!("{} = {}", axis.parameter.name, axis.values[k])
            });
        let at = |trained: &Vec<_>| -> Vec<f64> {
            trained.iter().map(|t: &sandgait::train::design::Trained| t.chosen_by[place]).collect()
        };
        let means = x.iter().zip(row).map(|(x, t)| [*x, Between::of(&at(t)).mean]).collect();
        marks.push(Mark::line(&family, style.clone(), means));
        for (x, trained) in x.iter().zip(row) {
            // A line of one place is a dot.
            let dots = at(trained).into_iter().map(|y| [*x, y]).collect();
            marks.push(Mark::line("", Style { width: 0.5, ..style.clone() }.with_dots(), dots));
        }
    }
    let panel = Panel {
        x: plot::Axis::new(&along.parameter.label()),
        y: plot::Axis::new(measure.label()),
        marks,
        ..Panel::default()
    };
    let title = format!("a gait learnt for each design, {} trainings each", study.trainings);
    Figure { title, panels: vec![panel], columns: 1, note: String::new() }
}

/// Writes everything into `out`; gives what the terminal is told.
pub fn report(study: &Study, findings: &Findings, measure: Measure, out: &Path) -> Result<String> {
    let write = |name: &str, content: &[u8]| {
        let path = out.join(name);
        std::fs::write(&path, content).map_err(|e| Error::file(&path, e))
    };
    write("learnt.csv", csv(study, findings).as_bytes())?;
    png::write_both(&figure(study, findings, measure).svg(), &out.join("learnt.svg"))?;
    for (design, trained) in findings.trained.iter().enumerate() {
        for (k, trained) in trained.iter().enumerate() {
            write(&format!("design{design}-{k}.onnx"), &trained.onnx)?;
        }
    }
    let mut rows = vec![["design".to_owned(), "file".into()].to_vec()];
    rows[0].extend(Measure::ALL.map(|m| m.label().to_owned()));
    for compared in &findings.best {
        let named = study.axes.iter().zip(values(&study.axes, compared.design));
        let named: Vec<_> = named.map(|(axis, value)| format!("{} = {value}", axis.parameter.name)).collect();
        let mut cells = vec![named.join(", "), format!("design{}-*.onnx", compared.design)];
        cells.extend(compared.values.iter().map(|all| {
            let Between { mean, half } = Between::of(all);
            if half.is_nan() { format!("{mean:.3}") } else { format!("{mean:.3} ± {half:.3}") }
        }));
        rows.push(cells);
    }
    let text = format!(
        "best by {} on 100 seeds that neither training nor choice has seen:\n\n{}\n\
         ±: 95 % interval of the mean over trainings (Student's t)\n",
        measure.name(),
        super::table(&rows)
    );
    write("best.txt", text.as_bytes())?;
    Ok(text)
}
