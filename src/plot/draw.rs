//! Panels, marks and legend as SVG.

use super::axis::{label, range, ticks};
use super::{Axis, Dash, Figure, FigurePanel, Mark, Style, color, escape};
use crate::error::Result;
use crate::files;
use std::fmt::Write;
use std::path::Path;

/// Size of a panel without margins, the margins, and the font size [px]: our choice. The margins have room for titles,
/// ticks and labels of this font; larger panels make the font smaller on a page.
const WIDTH: f64 = 380.0;
const HEIGHT: f64 = 270.0;
const LEFT: f64 = 70.0;
const RIGHT: f64 = 24.0;
const TOP: f64 = 34.0;
const TOP_UNTITLED: f64 = 14.0;
const BOTTOM: f64 = 54.0;
const COLORBAR: f64 = 82.0;
const TITLE: f64 = 36.0;
const LEGEND_ROW: f64 = 22.0;
const FONT: f64 = 13.0;
/// Mean width of a letter of DejaVu Sans divided by the font size: gives the width of a legend's text.
const ADVANCE: f64 = 0.58;

impl Figure {
    /// The whole figure as a standalone SVG document.
    pub fn svg(&self) -> String {
        let columns = self.columns.clamp(1, self.panels.len().max(1));
        let rows = self.panels.len().div_ceil(columns);
        let bar = if self.panels.iter().any(|p| cells(p).is_some()) { COLORBAR } else { 0.0 };
        let top = if self.panels.iter().all(|p| p.title.is_empty()) { TOP_UNTITLED } else { TOP };
        let (cell_w, cell_h) = (LEFT + WIDTH + RIGHT + bar, top + HEIGHT + BOTTOM);
        let width = cell_w * columns as f64;
        let (legend, legend_height) = legend(&self.panels, width);
        let notes = wrap(&self.note, (width - 2.0 * RIGHT) / (ADVANCE * 11.0));
        let title = if self.title.is_empty() { 0.0 } else { TITLE };
        let height = title + legend_height + cell_h * rows as f64 + 16.0 * notes.len() as f64 + 8.0;
        let mut svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width:.0}\" height=\"{height:.0}\" viewBox=\"0 0 {width:.0} {height:.0}\" \
             font-family=\"DejaVu Sans, sans-serif\" font-size=\"{FONT}\" fill=\"{0}\">\n\
             <rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n",
            color::BLACK
        );
        text(&mut svg, [width / 2.0, 24.0], "middle", 16.0, &self.title, "font-weight=\"bold\"");
        let _ = write!(svg, "<g transform=\"translate(0 {title})\">{legend}</g>");
        for (i, panel) in self.panels.iter().enumerate() {
            let x = (i % columns) as f64 * cell_w + LEFT;
            let y = title + legend_height + (i / columns) as f64 * cell_h + top;
            let _ = write!(svg, "<g transform=\"translate({x:.1} {y:.1})\">");
            draw_panel(&mut svg, panel, i);
            svg.push_str("</g>\n");
        }
        for (i, line) in notes.iter().enumerate() {
            let y = title + legend_height + cell_h * rows as f64 + 12.0 + 16.0 * i as f64;
            text(&mut svg, [RIGHT, y], "start", 11.0, line, "fill=\"#555555\"");
        }
        svg.push_str("</svg>\n");
        svg
    }

    /// Writes [`Self::svg`] to `path`.
    pub fn write(&self, path: &Path) -> Result<()> {
        files::write(path, self.svg().as_bytes())
    }
}

fn text(svg: &mut String, [x, y]: [f64; 2], anchor: &str, size: f64, content: &str, extra: &str) {
    let content = subscripts(&escape(content), size);
    let _ = writeln!(
        svg,
        "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\" font-size=\"{size}\" {extra}>{content}</text>"
    );
}

/// Makes a subscript of the letter after each underscore: `v_x`, `α_z`.
fn subscripts(escaped: &str, size: f64) -> String {
    let mut parts = escaped.split('_');
    let mut text = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let cut = part.chars().next().map_or(0, char::len_utf8);
        let (low, rest) = part.split_at(cut);
        // Both shifts are in units of the outer font size, so that the text continues at its old height.
        let (small, shift) = (0.75 * size, 0.25 * size);
        let _ = write!(
            text,
            "<tspan dy=\"{shift}\" font-size=\"{small}\">{low}</tspan><tspan dy=\"-{shift}\">{rest}</tspan>"
        );
    }
    text
}

/// Breaks a note into lines of at most `most` characters.
fn wrap(note: &str, most: f64) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in note.split_whitespace() {
        match lines.last_mut() {
            Some(line) if ((line.chars().count() + 1 + word.chars().count()) as f64) <= most => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.into()),
        }
    }
    lines
}

fn cells(panel: &FigurePanel) -> Option<(&[Vec<f64>], &str)> {
    panel.marks.iter().find_map(|m| match m {
        Mark::Cells { values, label, .. } => Some((values.as_slice(), label.as_str())),
        _ => None,
    })
}

/// The legend of all panels, and its height: each label once, with a sample of its mark, in centred rows.
fn legend(panels: &[FigurePanel], width: f64) -> (String, f64) {
    let mut entries: Vec<(&str, &Mark)> = Vec::new();
    for mark in panels.iter().flat_map(|p| &p.marks) {
        if let Mark::Line { label, .. } | Mark::Band { label, .. } = mark
            && !label.is_empty()
            && entries.iter().all(|e| e.0 != label)
        {
            entries.push((label, mark));
        }
    }
    let length = |label: &str| 34.0 + label.chars().count() as f64 * ADVANCE * 12.0 + 20.0;
    let mut rows: Vec<Vec<(&str, &Mark)>> = Vec::new();
    let mut used = f64::INFINITY;
    for entry in entries {
        if used + length(entry.0) > width - 20.0 {
            rows.push(Vec::new());
            used = 0.0;
        }
        used += length(entry.0);
        if let Some(row) = rows.last_mut() {
            row.push(entry);
        }
    }
    let mut svg = String::new();
    for (r, row) in rows.iter().enumerate() {
        let total: f64 = row.iter().map(|e| length(e.0)).sum();
        let mut x = (width - total) / 2.0 + 10.0;
        let y = LEGEND_ROW * r as f64 + 11.0;
        for (label, mark) in row {
            match mark {
                Mark::Line { style, .. } => {
                    polyline(&mut svg, style, &[[x, y], [x + 26.0, y]]);
                    if style.dots {
                        dot(&mut svg, style, [x + 13.0, y]);
                    }
                }
                Mark::Band { color, .. } => {
                    let top = y - 6.0;
                    let _ = write!(
                        svg,
                        "<rect x=\"{x:.1}\" y=\"{top:.1}\" width=\"26\" height=\"12\" fill=\"{color}\" fill-opacity=\"0.22\"/>"
                    );
                }
                _ => {}
            }
            text(&mut svg, [x + 32.0, y + 4.0], "start", 12.0, label, "");
            x += length(label);
        }
    }
    (svg, LEGEND_ROW * rows.len() as f64)
}

fn draw_panel(svg: &mut String, panel: &FigurePanel, index: usize) {
    let (xr, yr) = (range(&panel.x, &panel.marks, 0), range(&panel.y, &panel.marks, 1));
    let sx = |x: f64| (x - xr[0]) / (xr[1] - xr[0]) * WIDTH;
    let sy = |y: f64| HEIGHT - (y - yr[0]) / (yr[1] - yr[0]) * HEIGHT;
    let to_page = |[x, y]: [f64; 2]| [sx(x), sy(y)];
    let heat = cells(panel).is_some();
    let _ = write!(svg, "<clipPath id=\"panel{index}\"><rect width=\"{WIDTH}\" height=\"{HEIGHT}\"/></clipPath>");
    if !heat {
        grid(svg, panel, [xr, yr], &to_page);
    }
    let _ = write!(svg, "<g clip-path=\"url(#panel{index})\">");
    for mark in &panel.marks {
        draw_mark(svg, mark, &to_page);
    }
    svg.push_str("</g>");
    if let Some((values, label)) = cells(panel) {
        colorbar(svg, values, label);
    }
    frame(svg, panel, [xr, yr], &to_page);
}

fn is_degrees(axis: &Axis) -> bool {
    axis.label.contains("[°]")
}

fn grid(svg: &mut String, panel: &FigurePanel, [xr, yr]: [[f64; 2]; 2], to_page: &impl Fn([f64; 2]) -> [f64; 2]) {
    for x in ticks(xr, 7, is_degrees(&panel.x)) {
        let [x, _] = to_page([x, 0.0]);
        let _ = write!(svg, "<line x1=\"{x:.1}\" y1=\"0\" x2=\"{x:.1}\" y2=\"{HEIGHT}\" stroke=\"#e8e8e8\"/>");
    }
    for y in ticks(yr, 6, is_degrees(&panel.y)) {
        let heavy = if y == 0.0 { "#bbbbbb" } else { "#e8e8e8" };
        let [_, y] = to_page([0.0, y]);
        let _ = write!(svg, "<line x1=\"0\" y1=\"{y:.1}\" x2=\"{WIDTH}\" y2=\"{y:.1}\" stroke=\"{heavy}\"/>");
    }
}

/// Draws a panel's box, ticks, labels and title.
fn frame(svg: &mut String, panel: &FigurePanel, [xr, yr]: [[f64; 2]; 2], to_page: &impl Fn([f64; 2]) -> [f64; 2]) {
    let _ = write!(svg, "<rect width=\"{WIDTH}\" height=\"{HEIGHT}\" fill=\"none\" stroke=\"#444444\"/>");
    let (xs, ys) = (ticks(xr, 7, is_degrees(&panel.x)), ticks(yr, 6, is_degrees(&panel.y)));
    let step = |t: &[f64]| if t.len() > 1 { t[1] - t[0] } else { 1.0 };
    for x in &xs {
        let [px, _] = to_page([*x, 0.0]);
        let _ = write!(
            svg,
            "<line x1=\"{px:.1}\" y1=\"{HEIGHT}\" x2=\"{px:.1}\" y2=\"{}\" stroke=\"#444444\"/>",
            HEIGHT + 5.0
        );
        text(svg, [px, HEIGHT + 19.0], "middle", 12.0, &label(*x, step(&xs)), "");
    }
    for y in &ys {
        let [_, py] = to_page([0.0, *y]);
        let _ = write!(svg, "<line x1=\"-5\" y1=\"{py:.1}\" x2=\"0\" y2=\"{py:.1}\" stroke=\"#444444\"/>");
        text(svg, [-9.0, py + 4.0], "end", 12.0, &label(*y, step(&ys)), "");
    }
    text(svg, [WIDTH / 2.0, HEIGHT + 42.0], "middle", FONT, &panel.x.label, "");
    let turned = format!("transform=\"rotate(-90 -52 {0})\"", HEIGHT / 2.0);
    text(svg, [-52.0, HEIGHT / 2.0], "middle", FONT, &panel.y.label, &turned);
    text(svg, [WIDTH / 2.0, -10.0], "middle", FONT, &panel.title, "font-weight=\"bold\"");
}

/// Attributes of text over marks: a white outline makes it readable.
const HALO: &str =
    "fill=\"#555555\" stroke=\"#ffffff\" stroke-width=\"3\" stroke-linejoin=\"round\" paint-order=\"stroke\"";

fn draw_mark(svg: &mut String, mark: &Mark, to_page: &impl Fn([f64; 2]) -> [f64; 2]) {
    match mark {
        Mark::Line { style, points, .. } => {
            let place: Vec<_> =
                points.iter().filter(|p| p[0].is_finite() && p[1].is_finite()).map(|p| to_page(*p)).collect();
            if style.width > 0.0 {
                polyline(svg, style, &place);
            }
            if style.dots {
                place.iter().for_each(|p| dot(svg, style, *p));
            }
        }
        Mark::Band { color, points, .. } => {
            let low = points.iter().map(|p| to_page([p[0], p[1]]));
            let high = points.iter().rev().map(|p| to_page([p[0], p[2]]));
            let path: Vec<_> = low.chain(high).map(|[x, y]| format!("{x:.2},{y:.2}")).collect();
            let _ = write!(svg, "<polygon points=\"{}\" fill=\"{color}\" fill-opacity=\"0.22\"/>", path.join(" "));
        }
        Mark::Horizontal { at, text: content } => {
            let [_, y] = to_page([0.0, *at]);
            polyline(svg, &Style::thin(color::GREY).dashed(), &[[0.0, y], [WIDTH, y]]);
            // The text is under the line if there is no room above it.
            let y = if y < 18.0 { y + 14.0 } else { y - 5.0 };
            text(svg, [6.0, y], "start", 11.0, content, HALO);
        }
        Mark::Vertical { at, text: content } => {
            let [x, _] = to_page([*at, 0.0]);
            polyline(svg, &Style::thin(color::GREY).dashed(), &[[x, 0.0], [x, HEIGHT]]);
            text(svg, [x + 5.0, 14.0], "start", 11.0, content, HALO);
        }
        Mark::Cells { x, y, values, .. } => draw_cells(svg, x, y, values, to_page),
    }
}

fn polyline(svg: &mut String, style: &Style, points: &[[f64; 2]]) {
    let path: Vec<_> = points.iter().map(|[x, y]| format!("{x:.2},{y:.2}")).collect();
    let dash = match style.dash {
        Dash::Solid => "",
        Dash::Dashed => " stroke-dasharray=\"7 4\"",
        Dash::Dotted => " stroke-dasharray=\"2 3\"",
    };
    let _ = write!(
        svg,
        "<polyline points=\"{}\" fill=\"none\" stroke=\"{}\" stroke-width=\"{}\" stroke-linejoin=\"round\"{dash}/>",
        path.join(" "),
        style.color,
        style.width
    );
}

fn dot(svg: &mut String, style: &Style, [x, y]: [f64; 2]) {
    // Dots without a line are many and close together, so they are smaller.
    let radius = if style.width > 0.0 { 2.8 } else { 1.7 };
    let _ = write!(svg, "<circle cx=\"{x:.2}\" cy=\"{y:.2}\" r=\"{radius}\" fill=\"{}\"/>", style.color);
}

/// Least and greatest value of a heat map; the interval is never empty.
fn extremes(values: &[Vec<f64>]) -> [f64; 2] {
    let finite = values.iter().flatten().copied().filter(|v| v.is_finite());
    let [low, high] = finite.fold([f64::INFINITY, f64::NEG_INFINITY], |[l, h], v| [l.min(v), h.max(v)]);
    if low < high { [low, high] } else { [low.min(0.0), low.max(0.0) + 1.0] }
}

fn draw_cells(svg: &mut String, x: &[f64], y: &[f64], values: &[Vec<f64>], to_page: &impl Fn([f64; 2]) -> [f64; 2]) {
    let [low, high] = extremes(values);
    let half = |v: &[f64]| if v.len() > 1 { (v[v.len() - 1] - v[0]) / (v.len() - 1) as f64 / 2.0 } else { 0.5 };
    let (hx, hy) = (half(x), half(y));
    for (j, row) in values.iter().enumerate() {
        for (i, value) in row.iter().enumerate().filter(|(_, v)| v.is_finite()) {
            let ([x0, y0], [x1, y1]) = (to_page([x[i] - hx, y[j] + hy]), to_page([x[i] + hx, y[j] - hy]));
            let fill = color::viridis((value - low) / (high - low));
            let _ = write!(
                svg,
                "<rect x=\"{x0:.2}\" y=\"{y0:.2}\" width=\"{:.2}\" height=\"{:.2}\" fill=\"{fill}\"/>",
                (x1 - x0).abs() + 0.4,
                (y1 - y0).abs() + 0.4
            );
        }
    }
}

fn colorbar(svg: &mut String, values: &[Vec<f64>], name: &str) {
    let [low, high] = extremes(values);
    let x = WIDTH + 14.0;
    for k in 0..64 {
        let fill = color::viridis((f64::from(k) + 0.5) / 64.0);
        let y = HEIGHT * (1.0 - f64::from(k + 1) / 64.0);
        let _ = write!(
            svg,
            "<rect x=\"{x}\" y=\"{y:.2}\" width=\"14\" height=\"{:.2}\" fill=\"{fill}\"/>",
            HEIGHT / 64.0 + 0.4
        );
    }
    let marks = ticks([low, high], 5, false);
    let step = if marks.len() > 1 { marks[1] - marks[0] } else { 1.0 };
    for value in &marks {
        let y = HEIGHT * (1.0 - (value - low) / (high - low));
        text(svg, [x + 19.0, y + 4.0], "start", 11.0, &label(*value, step), "");
    }
    let place = [x + 66.0, HEIGHT / 2.0];
    let turned = format!("transform=\"rotate(-90 {} {})\"", place[0], place[1]);
    text(svg, place, "middle", FONT, name, &turned);
}
