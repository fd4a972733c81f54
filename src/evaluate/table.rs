//! Results as columns, and as a text table.

use super::{Estimate, EvaluationRow};

/// Every figure: its name in files, its heading and unit in the text table, and its decimals.
const FIGURES: [FigureFormat; 6] = [
    FigureFormat { name: "return", heading: "return", digits: 1, of: |r| r.figures.total_reward },
    FigureFormat { name: "speed", heading: "speed [m/s]", digits: 3, of: |r| r.figures.speed },
    FigureFormat { name: "speed_error", heading: "speed error [m/s]", digits: 3, of: |r| r.figures.speed_error },
    FigureFormat {
        name: "cost_of_transport",
        heading: "cost of transport",
        digits: 2,
        of: |r| r.figures.cost_of_transport,
    },
    FigureFormat { name: "slip", heading: "slip", digits: 3, of: |r| r.figures.slip },
    FigureFormat { name: "falls", heading: "falls", digits: 2, of: |r| r.figures.falls },
];

struct FigureFormat {
    name: &'static str,
    heading: &'static str,
    digits: usize,
    of: fn(&EvaluationRow) -> Estimate,
}

/// A column of numbers: name, unit, one number for each row.
pub struct FigureColumn {
    pub name: String,
    pub unit: &'static str,
    pub values: Vec<f64>,
}

/// All columns except the media's names.
pub fn columns(rows: &[EvaluationRow]) -> Vec<FigureColumn> {
    let column = |name: &str, unit, of: &dyn Fn(&EvaluationRow) -> f64| FigureColumn {
        name: name.into(),
        unit,
        values: rows.iter().map(of).collect(),
    };
    let mut all = vec![column("slope_deg", "°", &|r| r.slope_deg)];
    if rows.iter().any(|r| r.rate.is_some()) {
        all.push(column("rate", "Hz", &|r| r.rate.unwrap_or(f64::NAN)));
    }
    all.push(column("episodes", "1", &|r| r.figures.episodes as f64));
    for FigureFormat { name, of, .. } in FIGURES {
        let unit = if name.starts_with("speed") { "m/s" } else { "1" };
        all.push(column(name, unit, &|r| of(r).mean));
        all.push(column(&format!("{name}_low"), unit, &|r| of(r).low));
        all.push(column(&format!("{name}_high"), unit, &|r| of(r).high));
    }
    all.push(column("diverged", "1", &|r| r.figures.diverged as f64));
    all
}

/// Cells of the text table, the heading first.
pub fn cells(rows: &[EvaluationRow]) -> Vec<Vec<String>> {
    let searched = rows.iter().any(|r| r.rate.is_some());
    let mut heading = vec!["medium".to_owned(), "slope [°]".into()];
    heading.extend(searched.then(|| "rate [Hz]".into()));
    heading.extend(FIGURES.iter().map(|f| f.heading.to_owned()));
    let line = |row: &EvaluationRow| {
        let mut cells = vec![row.medium.clone(), row.slope_deg.to_string()];
        cells.extend(row.rate.map(|rate| rate.to_string()));
        cells.extend(FIGURES.iter().map(|f| cell((f.of)(row), f.digits)));
        cells
    };
    std::iter::once(heading).chain(rows.iter().map(line)).collect()
}

fn cell(Estimate { mean, low, high }: Estimate, digits: usize) -> String {
    if mean.is_nan() {
        return "none".into();
    }
    let high = if high.is_nan() { "∞".into() } else { format!("{high:.digits$}") };
    format!("{mean:.digits$} [{low:.digits$}, {high}]")
}

/// Notes below the table; one line each.
pub fn notes(rows: &[EvaluationRow]) -> Vec<String> {
    let mut notes = vec!["[95 % intervals]: bootstrap over episodes; falls: Wilson".to_owned()];
    if rows.iter().any(|r| r.figures.cost_of_transport.mean.is_nan()) {
        notes.push("no cost of transport: the robot did not go forward".into());
    }
    if rows.iter().any(|r| r.figures.slip.mean.is_nan()) {
        notes.push("no slip: the feet did not push backward".into());
    }
    let diverged: usize = rows.iter().map(|r| r.figures.diverged).sum();
    if diverged > 0 {
        notes.push(format!("{diverged} episodes diverged: they count until then"));
    }
    notes
}
