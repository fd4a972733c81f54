//! A sweep's results as a figure.

use super::{SweepAxis, SweepMeasure};
use crate::plot::{self, Figure, FigurePanel, Mark, Style, color};
use crate::sim::walk::WalkResult;

/// The value on each axis of grid point `index`.
pub fn values(axes: &[SweepAxis], mut index: usize) -> Vec<&str> {
    let mut cells: Vec<&str> = Vec::new();
    for axis in axes.iter().rev() {
        cells.push(&axis.values[index % axis.values.len()]);
        index /= axis.values.len();
    }
    cells.reverse();
    cells
}

/// A heat map over two number axes, lines over one; an axis of names makes a line for each name.
pub fn figure(axes: &[SweepAxis], results: &[WalkResult], measure: SweepMeasure, title: &str) -> Figure {
    let at: Vec<f64> = results.iter().map(|r| measure.of(r)).collect();
    let panel = match axes {
        [rows, columns] => match (rows.numbers(), columns.numbers()) {
            (Some(y), Some(x)) if y.len() > 2 => heat_map(axes, x, y, &at, measure),
            _ => lines(Some(rows), columns, &at, measure),
        },
        [only] => lines(None, only, &at, measure),
        _ => FigurePanel::default(),
    };
    Figure { title: title.into(), panels: vec![panel], columns: 1, note: String::new() }
}

fn heat_map(axes: &[SweepAxis], x: Vec<f64>, y: Vec<f64>, at: &[f64], measure: SweepMeasure) -> FigurePanel {
    let values = at.chunks(x.len()).map(<[f64]>::to_vec).collect();
    FigurePanel {
        x: plot::Axis::new(&axes[1].parameter.label()),
        y: plot::Axis::new(&axes[0].parameter.label()),
        marks: vec![Mark::Cells { x, y, values, label: measure.label().into() }],
        ..FigurePanel::default()
    }
}

fn lines(families: Option<&SweepAxis>, along: &SweepAxis, at: &[f64], measure: SweepMeasure) -> FigurePanel {
    // Names are drawn at 1, 2, 3 … of the axis.
    let x = along.numbers().unwrap_or_else(|| (1..=along.values.len()).map(|i| i as f64).collect());
    let label = match along.numbers() {
        Some(_) => along.parameter.label(),
        None => {
            let names = along.values.iter().enumerate().map(|(i, v)| format!("{} {v}", i + 1));
            format!("{}: {}", along.parameter.name, names.collect::<Vec<_>>().join(", "))
        }
    };
    let line = |(k, values): (usize, &[f64])| {
        let name = families.map_or(String::new(), |f| format!("{} = {}", f.parameter.name, f.values[k]));
        let style = Style::line(color::CYCLE[k % color::CYCLE.len()]).with_dots();
        Mark::line(&name, style, x.iter().zip(values).map(|(x, y)| [*x, *y]).collect())
    };
    let marks = at.chunks(x.len()).enumerate().map(line).collect();
    FigurePanel { x: plot::Axis::new(&label), y: plot::Axis::new(measure.label()), marks, ..FigurePanel::default() }
}
