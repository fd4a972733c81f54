//! Ranges, round ticks and the map from data to the page.

use super::{Axis, Mark};

/// Least and greatest finite value.
fn extent(values: impl Iterator<Item = f64>) -> Option<[f64; 2]> {
    values.filter(|v| v.is_finite()).fold(None, |e, v| match e {
        None => Some([v, v]),
        Some([low, high]) => Some([f64::min(low, v), f64::max(high, v)]),
    })
}

fn half_step(values: &[f64]) -> f64 {
    match values {
        [first, .., last] => (last - first) / (values.len() - 1) as f64 / 2.0,
        _ => 0.5,
    }
}

/// x and y extents of one mark.
fn of_mark(mark: &Mark) -> [Option<[f64; 2]>; 2] {
    let padded = |v: &[f64]| {
        let half = half_step(v);
        extent(v.iter().flat_map(move |c| [c - half, c + half]))
    };
    match mark {
        Mark::Line { points, .. } => [extent(points.iter().map(|p| p[0])), extent(points.iter().map(|p| p[1]))],
        Mark::Band { points, .. } => {
            [extent(points.iter().map(|p| p[0])), extent(points.iter().flat_map(|p| [p[1], p[2]]))]
        }
        Mark::Horizontal { at, .. } => [None, Some([*at, *at])],
        Mark::Vertical { at, .. } => [Some([*at, *at]), None],
        Mark::Cells { x, y, .. } => [padded(x), padded(y)],
    }
}

/// The range of an axis: the range that it states, or else the range of all marks with a margin of at most 5 % (no margin for heat maps).
pub fn range(axis: &Axis, marks: &[Mark], which: usize) -> [f64; 2] {
    if let Some(range) = axis.range {
        return range;
    }
    let ends = marks.iter().filter_map(|m| of_mark(m)[which]).flatten();
    let Some([low, high]) = extent(ends) else { return [0.0, 1.0] };
    let cells = marks.iter().any(|m| matches!(m, Mark::Cells { .. }));
    let span = if high > low { high - low } else { high.abs().max(1.0) };
    let dots = marks.iter().any(|m| matches!(m, Mark::Line { style, .. } if style.dots));
    let air = match (which, cells) {
        (_, true) => 0.0,
        (0, _) if high > low => {
            if dots {
                0.02 * span
            } else {
                0.0
            }
        }
        _ => 0.05 * span,
    };
    [low - air, high + air]
}

/// About `count` round values inside the range. Their step is 1, 2, 2.5 or 5 times a power of ten, or for degrees also 15, 30, 45,
/// 60 or 90.
pub fn ticks([low, high]: [f64; 2], count: usize, degrees: bool) -> Vec<f64> {
    let rough = (high - low) / count as f64;
    let power = 10f64.powf(rough.abs().max(1e-300).log10().floor());
    let steps: &[f64] =
        if degrees && rough > 10.0 { &[15.0, 30.0, 45.0, 60.0, 90.0] } else { &[1.0, 2.0, 2.5, 5.0, 10.0] };
    let unit = if degrees && rough > 10.0 { 1.0 } else { power };
    let step = steps.iter().map(|s| s * unit).find(|s| *s >= rough * 0.999).unwrap_or(10.0 * power);
    let first = (low / step - 1e-9).ceil() as i64;
    let last = (high / step + 1e-9).floor() as i64;
    (first..=last).map(|k| k as f64 * step).collect()
}

/// The text at a tick, with no more digits than `step` needs.
pub fn label(value: f64, step: f64) -> String {
    if value != 0.0 && !(1e-4..1e5).contains(&value.abs()) {
        return format!("{value:.1e}").replace('-', "−");
    }
    let digits =
        (0..6).find(|d| (step * 10f64.powi(*d)).fract().abs().min(1.0 - (step * 10f64.powi(*d)).fract().abs()) < 1e-6);
    format!("{value:.*}", digits.unwrap_or(3) as usize).replace('-', "−")
}
