//! Figures: line plots and heat maps as SVG.
//!
//! A [`Figure`] is data only; [`Figure::svg`] draws it. This module knows nothing of sand or robots.
//!
//! * [`axis`]: ranges, round ticks and the map from data to the page.
//! * [`draw`]: panels, marks and legend as SVG.
//! * [`color`]: palettes with colours that colour-blind readers can tell apart.

use sandgait_base::{error, files};

pub mod axis;
pub mod color;
mod draw;

/// One or more panels on a grid, with one legend for all.
#[derive(Clone, Debug, Default)]
pub struct Figure {
    pub title: String,
    pub panels: Vec<FigurePanel>,
    /// Panels side by side.
    pub columns: usize,
    /// Small print under the panels.
    pub note: String,
}

/// One pair of axes.
#[derive(Clone, Debug, Default)]
pub struct FigurePanel {
    pub title: String,
    pub x: Axis,
    pub y: Axis,
    pub marks: Vec<Mark>,
}

/// Label with unit, and range. If the range is none, the axis shows all data.
#[derive(Clone, Debug, Default)]
pub struct Axis {
    pub label: String,
    pub range: Option<[f64; 2]>,
}

impl Axis {
    pub fn new(label: &str) -> Self {
        Self { label: label.into(), range: None }
    }

    pub fn within(label: &str, low: f64, high: f64) -> Self {
        Self { label: label.into(), range: Some([low, high]) }
    }
}

/// How a line looks.
#[derive(Clone, Debug, PartialEq)]
pub struct Style {
    pub color: String,
    /// [px]
    pub width: f64,
    pub dash: Dash,
    /// Whether each data point has a dot.
    pub dots: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Dash {
    Solid,
    Dashed,
    Dotted,
}

impl Style {
    pub fn line(color: &str) -> Self {
        Self { color: color.into(), width: 2.0, dash: Dash::Solid, dots: false }
    }
    pub fn thin(color: &str) -> Self {
        Self { width: 1.2, ..Self::line(color) }
    }
    pub fn dashed(self) -> Self {
        Self { dash: Dash::Dashed, ..self }
    }
    pub fn dotted(self) -> Self {
        Self { dash: Dash::Dotted, ..self }
    }
    pub fn with_dots(self) -> Self {
        Self { dots: true, ..self }
    }
}

/// Something drawn in a panel. A mark with an empty label is not in the legend.
#[derive(Clone, Debug)]
pub enum Mark {
    Line {
        label: String,
        style: Style,
        points: Vec<[f64; 2]>,
    },
    /// The area between a lower and an upper curve: (x, low, high).
    Band {
        label: String,
        color: String,
        points: Vec<[f64; 3]>,
    },
    /// A straight line across the panel at one value of y, with a text beside it.
    Horizontal {
        at: f64,
        text: String,
    },
    /// A straight line across the panel at one value of x, with a text beside it.
    Vertical {
        at: f64,
        text: String,
    },
    /// A heat map: `values[j][i]` at (`x[i]`, `y[j]`); a value that is not finite is left blank.
    Cells {
        x: Vec<f64>,
        y: Vec<f64>,
        values: Vec<Vec<f64>>,
        label: String,
    },
}

impl Mark {
    pub fn line(label: &str, style: Style, points: Vec<[f64; 2]>) -> Self {
        Self::Line { label: label.into(), style, points }
    }

    pub fn band(label: &str, color: &str, points: Vec<[f64; 3]>) -> Self {
        Self::Band { label: label.into(), color: color.into(), points }
    }
}

/// Escapes the characters that have a meaning in SVG and HTML.
pub fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
