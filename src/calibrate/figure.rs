//! Figures of penetration tests.

use super::Calibration;
use super::pushes::{Penetration, Pushes};
use crate::plot::{Axis, Figure, FigurePanel, Mark, Style, color};

/// The test and the line through it.
pub fn single(depth: &[f64], force: &[f64], c: &Calibration) -> Figure {
    let deepest = depth.iter().copied().fold(0.0, f64::max);
    let force_at = |zeta: f64, z: f64| zeta * 1e6 * z * c.area;
    let band = [0.0, deepest].map(|z| [1e3 * z, force_at(c.zeta_interval[0], z), force_at(c.zeta_interval[1], z)]);
    let line = [0.0, deepest].map(|z| [1e3 * z, force_at(c.zeta, z)]);
    let data = depth.iter().zip(force).map(|(z, f)| [1e3 * z, *f]).collect();
    let label = format!("ζ = {:.3} N/cm³", c.zeta);
    let marks = vec![
        Mark::band("95 % confidence", color::BLUE, band.to_vec()),
        Mark::line("measured", Style { width: 0.0, ..Style::line(color::VERMILION) }.with_dots(), data),
        Mark::line(&label, Style::line(color::BLUE), line.to_vec()),
    ];
    let note = format!("plate {:.2} cm², {} samples in the fit, r² = {:.3}", c.area * 1e4, c.samples, c.r_squared);
    over_depth("Penetration test", "force [N]", marks, note)
}

fn over_depth(title: &str, y: &str, marks: Vec<Mark>, note: String) -> Figure {
    let panel = FigurePanel { x: Axis::new("depth [mm]"), y: Axis::new(y), marks, ..FigurePanel::default() };
    Figure { title: title.into(), columns: 1, panels: vec![panel], note }
}

/// Pressure over depth of every push, one colour for each size.
pub fn several(pushes: &[Penetration], study: &Pushes) -> Figure {
    let mut marks = Vec::new();
    for (k, size) in study.sizes.iter().enumerate() {
        let style = Style::line(color::CYCLE[k % color::CYCLE.len()]);
        let label = format!("{:.0} mm, ζ {:.3} N/cm³", 1e3 * size.diameter, size.zeta);
        for (nth, push) in pushes.iter().filter(|p| (p.diameter - size.diameter).abs() < 1e-6).enumerate() {
            let points = push.points.iter().map(|[z, f]| [1e3 * z, f / push.area() * 1e-3]).collect();
            marks.push(Mark::line(if nth == 0 { &label } else { "" }, style.clone(), points));
        }
    }
    let note = format!("{} pushes; best law: {}", pushes.len(), study.law.formula());
    over_depth("Penetration tests", "pressure [kPa]", marks, note)
}
