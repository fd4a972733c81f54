//! Figures of the page: measured and predicted loads, and bars. They are HTML with pictures of one panel each, so that they fit
//! a phone.

use super::misfit::Misfit;
use super::report::Curves;
use super::series::ends;
use super::words::digits;
use crate::plot::{Axis, Figure, FigurePanel, Mark, Style, color, escape};
use std::fmt::Write;

/// Number of conditions in a figure, and of further conditions that a click shows: our choice, so that the page stays
/// readable. The conditions with the largest errors of the plain model come first.
const CURVES: [usize; 2] = [3, 6];

/// Largest number of samples of a trial in a figure: our choice; more cannot be distinguished.
const DRAWN: usize = 100;

/// Number of channels in a figure: our choice. A robot's log has dozens of channels.
const CHANNELS: usize = 6;

const COLORS: [&str; 3] = [color::BLACK, color::BLUE, color::VERMILION];

/// Measured and predicted loads.
pub fn curves(html: &mut String, c: &Curves) {
    let third = if c.sand_is_plain { "plain model with the hardware that was found" } else { "extended model" };
    let shown =
        ["measured", "plain model", third].into_iter().zip(COLORS).take(if c.extended.is_some() { 3 } else { 2 });
    let keys = shown.map(|(name, hue)| format!("<span class=key style='background:{hue}'></span>{name}"));
    let _ = write!(html, "<h2>Measured and predicted</h2><p class=small>{}", keys.collect::<String>());
    // A run of a robot has one number for each channel, a trial of a force log has many.
    match c.observations.units.iter().all(|u| u.samples == 1) {
        true => by_condition(html, c),
        false => by_progress(html, c),
    }
}

/// For each of the conditions with the largest errors of the plain model, a panel for each force: load over progress.
fn by_progress(html: &mut String, c: &Curves) {
    let o = &c.observations;
    let error = |u: usize| {
        o.span(&o.units[u]).map(|k| ((o.values[k] - c.plain[k]) / c.band[k].max(1e-12)).powi(2)).sum::<f64>()
    };
    let mut firsts: Vec<usize> = o.repetitions().iter().filter_map(|g| g.first().copied()).collect();
    firsts.sort_by(|a, b| error(*b).total_cmp(&error(*a)));
    let channels: Vec<usize> = (0..o.channels.len()).filter(|k| o.channels[*k].in_rmse).take(CHANNELS).collect();
    let _ = write!(
        html,
        "; dots: every repetition; band: one standard deviation of a repetition. Conditions with the largest errors of the plain \
         model, {} of {}.</p>",
        CURVES[0].min(firsts.len()),
        firsts.len()
    );
    let card = |html: &mut String, u: usize| {
        let _ = write!(html, "<h3>{}</h3><div class=panels>", escape(&c.conditions[o.units[u].condition]));
        for &channel in &channels {
            let figure = Figure { panels: vec![panel(c, u, channel)], columns: 1, ..Figure::default() };
            html.push_str(&figure.svg());
        }
        html.push_str("</div>");
    };
    let (first, rest) = firsts.split_at(CURVES[0].min(firsts.len()));
    first.iter().for_each(|&u| card(html, u));
    if !rest.is_empty() {
        html.push_str("<details><summary>More conditions</summary>");
        rest.iter().take(CURVES[1]).for_each(|&u| card(html, u));
        html.push_str("</details>");
    }
}

fn panel(c: &Curves, u: usize, channel: usize) -> FigurePanel {
    let (o, unit) = (&c.observations, &c.observations.units[u]);
    let model = c.extended.as_ref().unwrap_or(&c.plain);
    let block = unit.block(channel);
    let at = |values: &dyn Fn(usize) -> f64| -> Vec<[f64; 2]> {
        let points = block.clone().zip(&unit.progress).map(|(k, p)| [*p, values(k)]);
        points.step_by(unit.samples.div_ceil(DRAWN)).collect()
    };
    let repetitions = o.units.iter().filter(|v| v.condition == unit.condition);
    let dots = repetitions.flat_map(|v| {
        v.block(channel).zip(&v.progress).map(|(k, p)| [*p, o.values[k]]).step_by(v.samples.div_ceil(DRAWN))
    });
    let dots: Vec<[f64; 2]> = dots.collect();
    // The band may be far wider than all curves, so it does not set the scale. The margin is our choice.
    let shown = dots.iter().copied().chain(at(&|k| c.plain[k])).chain(at(&|k| model[k])).map(|p| p[1]);
    let [least, most] = ends(shown);
    let air = 0.08 * (most - least).max(1e-9);
    let low = at(&|k| model[k] - c.band[k]);
    let band = low.iter().zip(at(&|k| model[k] + c.band[k])).map(|(l, h)| [l[0], l[1], h[1]]).collect();
    let measured = Style { width: 0.0, ..Style::line(color::BLACK).with_dots() };
    let mut marks = vec![Mark::band("", color::VERMILION, band), Mark::line("", measured, dots)];
    marks.push(Mark::line("", Style::line(color::BLUE).dashed(), at(&|k| c.plain[k])));
    if c.extended.is_some() {
        marks.push(Mark::line("", Style::line(color::VERMILION), at(&|k| model[k])));
    }
    let name = format!("{}{}", o.channels[channel].name, bracketed(o.channels[channel].unit));
    FigurePanel {
        title: String::new(),
        x: Axis::new("angle [rad] or position along the path [m]"),
        y: Axis::within(&name, least - air, most + air),
        marks,
    }
}

/// A unit after a name; empty if dimensionless.
fn bracketed(unit: &str) -> String {
    if matches!(unit, "" | "1") { String::new() } else { format!(" [{unit}]") }
}

/// For each channel a scale, with a row of dots for each condition.
fn by_condition(html: &mut String, c: &Curves) {
    let o = &c.observations;
    html.push_str("; a row is a condition, and its repetitions are the dots.</p>");
    for (k, channel) in o.channels.iter().enumerate() {
        let stacks: Vec<&[f64]> = [&o.values, &c.plain].into_iter().chain(&c.extended).map(Vec::as_slice).collect();
        let all = o.units.iter().map(|u| u.block(k).start).flat_map(|i| stacks.iter().map(move |s| s[i]));
        let [low, high] = ends(all);
        let at = |v: f64| 2.0 + 96.0 * (v - low) / (high - low).max(1e-300);
        let open = if k == 0 { " open" } else { "" };
        let _ = write!(
            html,
            "<details{open}><summary>{}{}: {} to {}</summary><table class=dots>",
            channel.name,
            bracketed(channel.unit),
            digits(low),
            digits(high)
        );
        for (condition, units) in o.repetitions().iter().enumerate().filter(|g| !g.1.is_empty()) {
            let _ = write!(html, "<tr><td>{}<td><div>", escape(&c.conditions[condition]));
            for (stack, hue) in stacks.iter().zip(COLORS) {
                for &u in units {
                    let _ = write!(
                        html,
                        "<i style='left:{:.1}%;background:{hue}'></i>",
                        at(stack[o.units[u].block(k).start])
                    );
                }
            }
            html.push_str("</div>");
        }
        html.push_str("</table></details>");
    }
}

/// A row of a table of bars: name, value, the value's text, colour.
pub type BarRow = (String, f64, String, &'static str);

/// Bars with one scale.
pub fn bars(html: &mut String, rows: &[BarRow]) {
    let top = rows.iter().map(|r| r.1.abs()).fold(1e-300, f64::max);
    let signed = rows.iter().any(|r| r.1 < 0.0);
    html.push_str("<table class=bars>");
    for (name, value, text, hue) in rows {
        let length = value.abs() / top * if signed { 50.0 } else { 100.0 };
        let left = if !signed {
            0.0
        } else if *value < 0.0 {
            50.0 - length
        } else {
            50.0
        };
        let _ = write!(
            html,
            "<tr><td>{}<td><div><i style='left:{left:.1}%;width:{length:.1}%;background:{hue}'></i></div><td>{}",
            escape(name),
            text.replace('-', "−")
        );
    }
    html.push_str("</table>");
}

/// The mean relative error of the plain model over each feature. All bars have the same scale.
pub fn misfit(html: &mut String, misfit: &[Misfit]) {
    let mut channels: Vec<&str> = Vec::new();
    // The torque is left out: it has another unit than the forces, and shows nothing that the forces do not show.
    for m in misfit.iter().filter(|m| m.channel != "Ty") {
        if !channels.contains(&m.channel.as_str()) {
            channels.push(&m.channel);
        }
    }
    channels.truncate(CHANNELS);
    let mut rows: Vec<(&str, BarRow)> = Vec::new();
    let mut before = String::new();
    for m in misfit {
        let (Some(relative), Some(channel)) = (m.relative, channels.iter().position(|c| *c == m.channel)) else {
            continue;
        };
        let place = m.place().replace('-', "−");
        let label = if place == before { String::new() } else { place.clone() };
        before = place;
        let text = format!("{:+.0} %", 100.0 * relative);
        rows.push((&m.by, (label, relative, text, color::CYCLE[channel % color::CYCLE.len()])));
    }
    let mut features: Vec<&str> = rows.iter().map(|r| r.0).collect();
    features.dedup();
    // A feature with a single value has no trend.
    features.retain(|by| rows.iter().filter(|r| r.0 == *by && !r.1.0.is_empty()).count() > 1);
    rows.retain(|r| features.contains(&r.0));
    let top = rows.iter().map(|r| r.1.1.abs()).fold(0.0, f64::max);
    html.push_str("<h2>Errors of the plain model</h2><p class=small>Mean error along the predicted direction, in % of the mean predicted size.");
    for (k, channel) in channels.iter().enumerate() {
        let hue = color::CYCLE[k % color::CYCLE.len()];
        let _ = write!(html, " <span class=key style='background:{hue}'></span>{channel}");
    }
    let _ = write!(html, ". The longest bar is {:.0} %, and all have one scale.</p><div class=panels>", 100.0 * top);
    for by in features {
        let mut own: Vec<_> = rows.iter().filter(|r| r.0 == by).map(|r| r.1.clone()).collect();
        // An invisible bar of the greatest length gives all tables the same scale.
        own.push((String::new(), -top, String::new(), "none"));
        let _ = write!(html, "<div><h3>by {}</h3>", by.replace('_', " "));
        bars(html, &own);
        html.push_str("</div>");
    }
    html.push_str("</div>");
}
