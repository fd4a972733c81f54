//! Writes the results of a diagnosis: `report.json`, `sand.toml`, and `report.html`, one self-contained page.

use super::misfit::Misfit;
use super::report::{Curves, Diagnosis, Report};
use super::words::{after, digits, span};
use crate::error::{Error, Result};
use crate::plot::{Axis, Figure, Mark, Panel, Style, color, escape};
use std::fmt::Write;
use std::path::Path;

const STYLE: &str = "body{font:15px/1.5 system-ui,sans-serif;max-width:1080px;margin:2em auto;padding:0 1em;color:#222}\
h1{font-size:1.3em}h2{font-size:1.05em;margin-top:2em;border-bottom:1px solid #ddd}\
table{border-collapse:collapse}td,th{padding:.15em .8em;text-align:right;border-bottom:1px solid #eee}\
td:first-child,th:first-child{text-align:left}.verdict{font-size:1.15em;padding:.6em 1em;background:#f4f1ea;border-left:5px solid #b5803a}\
.charts{display:flex;flex-wrap:wrap;gap:14px}.charts text{font:12px system-ui,sans-serif;fill:#333}\
svg{background:#fff;max-width:100%;height:auto}small{color:#666}.key{display:inline-block;width:.8em;height:.8em;margin:0 .3em 0 1em}";

impl Diagnosis {
    /// Writes report.json, report.html and sand.toml. All contents are made before the first file is written.
    pub fn write(&self, out: &Path) -> Result<()> {
        let json = self.json()?;
        let html = page(self, &json);
        let sand = format!("# {}\n{}", self.report.summary.replace('\n', " "), self.sand.to_toml()?);
        std::fs::create_dir_all(out).map_err(|e| Error::file(out, e))?;
        for (name, text) in [("report.json", &json), ("report.html", &html), ("sand.toml", &sand)] {
            let path = out.join(name);
            std::fs::write(&path, text).map_err(|e| Error::file(&path, e))?;
        }
        Ok(())
    }
}

/// The page; it embeds `json`, so that it contains all results.
fn page(diagnosis: &Diagnosis, json: &str) -> String {
    let r = &diagnosis.report;
    let mut html = format!(
        "<!doctype html><html lang=en><meta charset=utf-8><title>sandgait diagnosis</title><style>{STYLE}</style>\
         <h1>Where the simulation disagrees with the data</h1><p class=verdict>{}</p>",
        escape(&r.summary)
    );
    for warning in &r.warnings {
        let _ = write!(html, "<p><b>Warning:</b> {}</p>", escape(warning));
    }
    let unit = diagnosis.curves.observations.channels.iter().find(|c| c.in_rmse).map_or("", |c| c.unit);
    gain(&mut html, r, unit);
    causes(&mut html, r);
    form(&mut html, r);
    charts(&mut html, &r.misfit);
    curves(&mut html, &diagnosis.curves);
    if !r.runs.is_empty() {
        runs(&mut html, r);
    }
    rivals(&mut html, r);
    beside(&mut html, r);
    unknowns(&mut html, r);
    let _ = write!(html, "<script type=application/json id=report>{}</script></html>", json.replace("</", "<\\/"));
    html
}

fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or("–".into(), |v| format!("{v:.digits$}"))
}

fn measure(value: Option<f64>) -> String {
    value.map_or("–".into(), digits)
}

fn gain(html: &mut String, r: &Report, unit: &str) {
    let g = &r.gain;
    let percent = |v: Option<f64>| v.map_or("–".into(), |v| format!("{:.1} %", 100.0 * v));
    let interval = g.ci95.map_or("–".into(), |c| format!("{:.1} to {:.1} %", 100.0 * c[0], 100.0 * c[1]));
    let _ = write!(
        html,
        "<h2>Gain on held-out conditions</h2><table><tr><td>error of the plain model<td>{} {unit}\
         <tr><td>error with coefficients fitted within their prior<td>{} {unit}<tr><td>error of the extended model<td>{} {unit}\
         <tr><td>scatter between repetitions, which no model removes<td>{} {unit}\
         <tr><td>reduction of the error (95 % interval)<td>{} ({interval})<tr><td>reduction, relative to that of a perfect model<td>{}\
         <tr><td>lack of fit: plain model, extended model, limit<td>{}, {}, {}</table>",
        measure(g.held_out_rmse_plain),
        measure(g.held_out_rmse_recalibrated),
        measure(g.held_out_rmse_extended),
        measure(g.noise_floor),
        percent(g.reduction),
        percent(g.achievable_fraction),
        number(r.lack_of_fit.plain, 2),
        number(r.lack_of_fit.extended, 2),
        number(r.lack_of_fit.limit, 2),
    );
}

fn causes(html: &mut String, r: &Report) {
    if r.causes.is_empty() {
        return;
    }
    html.push_str("<h2>Cause</h2><table><tr><th>id<th>value<th>95 % interval<th>unit");
    for c in &r.causes {
        let _ = write!(
            html,
            "<tr><td>{}<td>{}<td>{} to {}<td>{}",
            c.id,
            digits(c.value),
            digits(c.ci95[0]),
            digits(c.ci95[1]),
            escape(after(&c.unit).trim_start())
        );
    }
    html.push_str("</table>");
}

/// Writes the result on the exponent of the speed in the nearest law.
fn form(html: &mut String, r: &Report) {
    let Some(form) = &r.form else { return };
    let [low, high] = form.ci95;
    let said = match (form.excluded, form.told_apart) {
        (true, _) => "the data exclude the law's power",
        (false, true) => "the data agree with the law's power",
        (false, false) => "the data do not distinguish the law's power from others",
    };
    let _ = write!(
        html,
        "<h2>Form of the law</h2><table><tr><th>power of the speed in {}<th>power in the law<th>best fit<th>95 % interval\
         <tr><td>{said}<td>{}<td>{:.2}<td>{low:.2} to {high:.2}</table>",
        form.id, form.law, form.found
    );
}

/// The channels that the bars show: forces, without the torque, which has another unit.
fn charted(misfit: &[Misfit]) -> Vec<&str> {
    let mut channels: Vec<&str> = Vec::new();
    for m in misfit.iter().filter(|m| m.channel != "Ty") {
        if !channels.contains(&m.channel.as_str()) {
            channels.push(&m.channel);
        }
    }
    channels
}

fn charts(html: &mut String, misfit: &[Misfit]) {
    let channels = charted(misfit);
    html.push_str("<h2>Errors of the plain model</h2><p><small>mean error along the predicted direction, in % of the mean predicted size:");
    for (k, channel) in channels.iter().enumerate() {
        let _ = write!(
            html,
            "<span class=key style='background:{}'></span>{channel}",
            color::CYCLE[k % color::CYCLE.len()]
        );
    }
    html.push_str("</small></p><div class=charts>");
    let mut features: Vec<&str> = misfit.iter().map(|m| m.by.as_str()).collect();
    features.dedup();
    for by in features {
        chart(html, by, misfit, &channels);
    }
    html.push_str("</div>");
}

/// Horizontal position in a chart at which its bars start: the line of zero error [px].
const ZERO: f64 = 222.0;
/// Length of a chart's longest bar [px].
const LONGEST: f64 = 62.0;
/// Width of a chart [px].
const CHART: usize = 344;
/// Height of a bar with the space below it [px].
const BAR: usize = 17;

/// Draws a bar chart of the mean relative error in each range of one feature's values.
fn chart(html: &mut String, by: &str, misfit: &[Misfit], channels: &[&str]) {
    let rows: Vec<_> = misfit
        .iter()
        .filter(|m| m.by == by)
        .filter_map(|m| Some((m.relative?, channels.iter().position(|c| *c == m.channel)?, m)))
        .collect();
    // A feature with a single value has no trend.
    let several = rows.iter().any(|r| r.2.place() != rows[0].2.place());
    let Some(top) = rows.iter().map(|r| r.0.abs()).reduce(f64::max).filter(|_| several) else { return };
    let height = BAR * rows.len() + 30;
    let _ = write!(html, "<svg width={CHART} height={height}><text x=4 y=15 font-weight=bold>by {by}</text>");
    let mut before = String::new();
    for (k, (relative, channel, m)) in rows.iter().enumerate() {
        let y = 24 + BAR * k;
        let label = m.place();
        if label != before {
            let _ = write!(html, "<text x=4 y={}>{}</text>", y + 12, escape(&label.replace('-', "−")));
        }
        before = label;
        let length = LONGEST * relative.abs() / top.max(0.05);
        let x = if *relative < 0.0 { ZERO - length } else { ZERO };
        let fill = color::CYCLE[channel % color::CYCLE.len()];
        let percent = format!("{:+.0} %", 100.0 * relative).replace('-', "−");
        let _ = write!(
            html,
            "<rect x={x:.1} y={y} width={length:.1} height={} fill='{fill}'/><text x={} y={} text-anchor=end>{percent}</text>",
            BAR - 3,
            CHART - 2,
            y + 12,
        );
    }
    let _ = write!(html, "<line x1={ZERO} x2={ZERO} y1=22 y2={} stroke='#888'/></svg>", height - 6);
}

/// Largest number of conditions in a figure: our choice, so that the page stays readable. Those with the largest errors
/// of the plain model are shown.
const CURVES: usize = 9;

/// Largest number of samples of a trial in a figure: our choice; more cannot be distinguished.
const DRAWN: usize = 100;

fn curves(html: &mut String, c: &Curves) {
    html.push_str("<h2>Measured and predicted</h2>");
    // A run of a robot has one number for each channel, a trial of a force log has many.
    let figures = if c.observations.units.iter().all(|u| u.samples == 1) { by_condition(c) } else { by_progress(c) };
    figures.iter().for_each(|f| html.push_str(&f.svg()));
}

fn measured(points: Vec<[f64; 2]>) -> Mark {
    Mark::line("measured", Style { width: 0.0, ..Style::line(color::BLACK).with_dots() }, points)
}

/// A figure for each force: load over progress, one panel for each of the conditions with the largest errors of the
/// plain model.
fn by_progress(c: &Curves) -> Vec<Figure> {
    let o = &c.observations;
    let error = |u: usize| {
        o.span(&o.units[u]).map(|k| ((o.values[k] - c.plain[k]) / c.band[k].max(1e-12)).powi(2)).sum::<f64>()
    };
    let mut firsts: Vec<usize> = o.repetitions().iter().filter_map(|g| g.first().copied()).collect();
    firsts.sort_by(|a, b| error(*b).total_cmp(&error(*a)));
    firsts.truncate(CURVES);
    let figure = |channel: usize| Figure {
        title: format!("{}: the conditions with the largest errors of the plain model", o.channels[channel].name),
        panels: firsts.iter().map(|&u| panel(c, u, channel)).collect(),
        columns: 3,
        note: "Dots: every repetition. Band: the model ± one standard deviation of a repetition.".into(),
    };
    (0..o.channels.len()).filter(|k| o.channels[*k].in_rmse).map(figure).collect()
}

fn panel(c: &Curves, u: usize, channel: usize) -> Panel {
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
    // The band may be far wider than all curves, so it does not set the scale.
    let shown = dots.iter().copied().chain(at(&|k| c.plain[k])).chain(at(&|k| model[k])).map(|p| p[1]);
    let [least, most] = shown.fold([f64::MAX, f64::MIN], |r, v| [r[0].min(v), r[1].max(v)]);
    let air = 0.08 * (most - least).max(1e-9);
    let low = at(&|k| model[k] - c.band[k]);
    let band = low.iter().zip(at(&|k| model[k] + c.band[k])).map(|(l, h)| [l[0], l[1], h[1]]).collect();
    let mut marks = vec![Mark::band("one σ of a repetition", color::VERMILION, band), measured(dots)];
    marks.push(Mark::line("plain", Style::line(color::BLUE).dashed(), at(&|k| c.plain[k])));
    if c.extended.is_some() {
        marks.push(Mark::line("extended", Style::line(color::VERMILION), at(&|k| model[k])));
    }
    let label = format!("{} [{}]", o.channels[channel].name, o.channels[channel].unit);
    Panel {
        title: format!("{}, condition {}", c.groups[u], o.conditions[unit.condition]),
        x: Axis::new("angle [rad] or position along the path [m]"),
        y: Axis::within(&label, least - air, most + air),
        marks,
    }
}

/// A unit after a name; empty if dimensionless.
fn bracketed(unit: &str) -> String {
    if unit == "1" { String::new() } else { format!(" [{unit}]") }
}

/// One figure: every channel over the conditions in their order.
fn by_condition(c: &Curves) -> Vec<Figure> {
    let o = &c.observations;
    let panel = |channel: usize| {
        // Markers are side by side, so that equal values do not hide each other.
        let at = |values: &[f64], aside: f64| -> Vec<[f64; 2]> {
            o.units.iter().map(|u| [u.condition as f64 + 1.0 + aside, values[u.block(channel).start]]).collect()
        };
        let dots = |label: &str, hue: &str, points: Vec<[f64; 2]>| {
            Mark::line(label, Style { width: 0.0, ..Style::line(hue).with_dots() }, points)
        };
        let mut marks = vec![measured(at(&o.values, 0.0)), dots("plain", color::BLUE, at(&c.plain, -0.25))];
        marks.extend(c.extended.as_ref().map(|e| dots("extended", color::VERMILION, at(e, 0.25))));
        // In a figure an underscore would start a subscript.
        let name = o.channels[channel].name.replace('_', " ");
        let y = Axis::new(&format!("{name}{}", bracketed(o.channels[channel].unit)));
        Panel { title: name, x: Axis::new("number of the condition, in the order of the data"), y, marks }
    };
    let panels = (0..o.channels.len()).map(panel).collect();
    vec![Figure { title: "Every run and its predictions".into(), panels, columns: 2, note: String::new() }]
}

/// Writes a table after the figure, for runs, which have one number for each channel.
fn runs(html: &mut String, r: &Report) {
    html.push_str("<details><summary>The same data as a table: means over repetitions</summary><table><tr><th>condition<th>channel<th>measured<th>plain<th>extended<th>unit");
    for run in &r.runs {
        let _ = write!(
            html,
            "<tr><td>{}<td>{}<td>{}<td>{}<td>{}<td>{}",
            escape(&run.condition),
            run.channel,
            digits(run.measured),
            digits(run.plain),
            measure(run.extended),
            run.unit
        );
    }
    html.push_str("</table></details>");
}

fn rivals(html: &mut String, r: &Report) {
    html.push_str("<h2>Candidate causes</h2><table><tr><th>cause<th>value<th>Δχ²<th>ΔAIC<th>ΔBIC<th>held-out gain<th>lack of fit<th>distance to the best, σ");
    for c in r.candidates.iter().take(16) {
        let values: Vec<_> = c.values.iter().map(|v| digits(*v)).collect();
        let _ = write!(
            html,
            "<tr><td>{}<td>{}<td>{:.1}<td>{:.1}<td>{:.1}<td>{}<td>{}<td>{}",
            c.ids.join(" + "),
            values.join(", "),
            c.delta_chi2,
            c.delta_aic,
            c.delta_bic,
            c.cv_gain.map_or("–".into(), |g| format!("{:.1} %", 100.0 * g)),
            number(c.lack_of_fit, 2),
            number(c.distance_to_best, 1)
        );
    }
    html.push_str("</table>");
}

fn beside(html: &mut String, r: &Report) {
    for term in &r.terms {
        let _ = write!(
            html,
            "<h2>Law found in the data</h2><p>{}</p><p><code>{}</code></p>",
            escape(&term.formula),
            escape(&term.tex)
        );
    }
    if let Some(rest) = r.remainder.as_ref().filter(|rest| rest.significant) {
        let text = format!(
            "{:.0} % of the plain model's misfit remains (lack of fit {}; with noise alone it is at most {}). {}",
            100.0 * rest.fraction,
            digits(rest.lack_of_fit),
            digits(rest.limit),
            rest.place
        );
        let _ = write!(html, "<h2>What remains</h2><p>{}</p>", escape(&text));
    }
    html.push_str("<h2>Nuisances</h2><p><small>effects of the measurement; fits marginalise over them, and they are not causes</small></p><ul>");
    for n in &r.nuisances {
        let channel = n.channel.as_ref().map_or(String::new(), |c| format!(" {c}"));
        let unit = after(n.unit);
        let value = if n.level == "log" { format!("{} ± ", digits(n.value)) } else { "scatters by ".into() };
        let _ = write!(html, "<li>{}{channel} ({}): {value}{}{unit}", n.id, n.level, digits(n.sd));
    }
    html.push_str("</ul>");
    if !r.upper_limits.is_empty() {
        html.push_str(
            "<h2>Causes that were not found</h2><p><small>upper limits of their strengths, at 95 %</small></p><ul>",
        );
        for limit in &r.upper_limits {
            let _ = write!(html, "<li>{} &lt; {}{}", limit.id, digits(limit.value), after(&limit.unit));
        }
        html.push_str("</ul>");
    }
}

fn unknowns(html: &mut String, r: &Report) {
    html.push_str("<h2>What these data cannot decide</h2>");
    if r.ambiguity_set.len() < 2 && r.untestable.is_empty() {
        html.push_str("<p>no open questions</p>");
    }
    html.push_str("<ul>");
    if r.ambiguity_set.len() > 1 {
        let set: Vec<_> = r.ambiguity_set.iter().map(|ids| ids.join(" + ")).collect();
        let _ = write!(html, "<li>which of these explanations is right: {}", set.join(" | "));
    }
    for u in &r.untestable {
        let _ = write!(html, "<li>{}: {}", u.id, escape(&u.why));
    }
    html.push_str("</ul>");
    if let Some(next) = &r.next_experiment {
        let _ = write!(html, "<h2>Next experiment</h2><p>{}</p><ul>", escape(&next.why));
        for p in &next.conditions {
            let _ = write!(html, "<li>{} × {}: {:.1} σ", p.repetitions, escape(&p.condition), p.expected_separation);
        }
        html.push_str("</ul>");
    }
    if !r.correlates_with.is_empty() {
        html.push_str("<h2>Correlations of the residual</h2><p><small>they are not causes</small></p><ul>");
        for c in &r.correlates_with {
            let _ = write!(html, "<li>{} with {} (Δχ² {:.0})", c.channel, escape(&c.feature), c.delta_chi2);
        }
        html.push_str("</ul>");
    }
    let units = |name: &str| r.misfit.iter().find(|m| m.by == name).map_or("", |m| m.unit.as_str());
    let ranges: Vec<_> =
        r.valid_range.iter().map(|(name, v)| format!("{name} {}", span(*v, units(name)).replace('-', "−"))).collect();
    let _ = write!(
        html,
        "<h2>Range of validity</h2><p>{}</p><p><small>data SHA-256 {}</small></p>",
        ranges.join(" · "),
        r.data_sha256
    );
}
