//! `report.html`: the diagnosis as one self-contained page, made for looking.

use super::misfit::Misfit;
use super::observations::Channel;
use super::report::{Curves, Diagnosis, Report, digits};
use std::fmt::Write;

const STYLE: &str = "body{font:15px/1.5 system-ui,sans-serif;max-width:1080px;margin:2em auto;padding:0 1em;color:#222}\
h1{font-size:1.3em}h2{font-size:1.05em;margin-top:2em;border-bottom:1px solid #ddd}\
table{border-collapse:collapse}td,th{padding:.15em .8em;text-align:right;border-bottom:1px solid #eee}\
td:first-child,th:first-child{text-align:left}.verdict{font-size:1.15em;padding:.6em 1em;background:#f4f1ea;border-left:5px solid #b5803a}\
.maps,.curves{display:flex;flex-wrap:wrap;gap:14px}svg{background:#fff}text{font:11px system-ui,sans-serif;fill:#444}small{color:#666}";

/// The page; `json` is embedded so that the page is the whole record.
pub fn page(diagnosis: &Diagnosis, json: &str) -> String {
    let r = &diagnosis.report;
    let mut html = format!(
        "<!doctype html><html lang=en><meta charset=utf-8><title>sandgait diagnosis</title><style>{STYLE}</style>\
         <h1>What the simulation gets wrong</h1><p class=verdict>{}</p>",
        escape(&r.summary)
    );
    for warning in &r.warnings {
        let _ = write!(html, "<p><b>Warning:</b> {}</p>", escape(warning));
    }
    let unit = diagnosis.curves.observations.channels.iter().find(|c| c.in_rmse).map_or("", |c| c.unit);
    gain(&mut html, r, unit);
    causes(&mut html, r);
    html.push_str("<h2>Where the plain model errs</h2><p><small>mean error along the prediction, in % of it; bars: channels that count in the held-out error</small></p><div class=maps>");
    let mut features: Vec<&str> = r.misfit.iter().map(|m| m.by.as_str()).collect();
    features.dedup(); // the table stands feature by feature
    let counting: Vec<&Channel> = diagnosis.curves.observations.channels.iter().filter(|c| c.in_rmse).collect();
    for by in features {
        map(&mut html, by, &r.misfit, &counting);
    }
    html.push_str("</div>");
    match r.runs.is_empty() {
        true => curves(&mut html, &diagnosis.curves),
        false => runs(&mut html, r),
    }
    rivals(&mut html, r);
    unknowns(&mut html, r);
    let _ = write!(html, "<script type=application/json id=report>{}</script></html>", json.replace("</", "<\\/"));
    html
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
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
        "<h2>Gain on conditions held out</h2><table><tr><td>error of the simulation as it stands<td>{} {unit}\
         <tr><td>with coefficients adjusted within their prior<td>{} {unit}<tr><td>extended<td>{} {unit}\
         <tr><td>scatter between repetitions, which no model removes<td>{} {unit}\
         <tr><td>reduction (95 % interval)<td>{} ({interval})<tr><td>share of what a perfect model would remove<td>{}\
         <tr><td>lack of fit: plain, extended, limit<td>{}, {}, {}</table>",
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
            escape(&c.unit)
        );
    }
    html.push_str("</table>");
}

/// Bars of the mean relative error over the ranges of one feature.
fn map(html: &mut String, by: &str, misfit: &[Misfit], counting: &[&Channel]) {
    let rows = misfit.iter().filter(|m| m.by == by && counting.iter().any(|c| c.name == m.channel));
    let rows: Vec<_> = rows.filter_map(|m| m.relative.map(|r| (r, m))).collect();
    if rows.is_empty() {
        return;
    }
    let top = rows.iter().map(|r| r.0.abs()).fold(0.05, f64::max);
    let height = 18 * rows.len() + 26;
    let _ = write!(html, "<svg width=330 height={height}><text x=4 y=14 font-weight=bold>by {by}</text>");
    for (k, (relative, m)) in rows.iter().enumerate() {
        let y = 22 + 18 * k;
        let label = match (&m.range, &m.group) {
            (Some(range), _) => format!("{:.3}…{:.3} {}", range[0], range[1], m.unit),
            (None, group) => group.clone().unwrap_or_default(),
        };
        let length = 80.0 * relative.abs() / top;
        let x = if *relative < 0.0 { 230.0 - length } else { 230.0 };
        let color = if m.channel == counting[0].name { "#4a7fb5" } else { "#b5803a" };
        let _ = write!(
            html,
            "<text x=4 y={}>{} {}</text><rect x={x:.1} y={y} width={length:.1} height=13 fill='{color}'/><text x=312 y={} text-anchor=end>{:+.0} %</text>",
            y + 11,
            m.channel,
            escape(&label),
            y + 11,
            100.0 * relative
        );
    }
    let _ = write!(html, "<line x1=230 x2=230 y1=20 y2={height} stroke='#888'/></svg>");
}

/// Conditions drawn at most, those where the plain model errs most: our choice, a page is to be read.
const CURVES: usize = 12;

fn curves(html: &mut String, c: &Curves) {
    html.push_str(
        "<h2>Measured (dots), plain (grey), extended (red) with one-σ band of a repetition</h2><div class=curves>",
    );
    let o = &c.observations;
    let error = |u: usize| {
        o.span(&o.units[u]).map(|k| ((o.values[k] - c.plain[k]) / c.band[k].max(1e-12)).powi(2)).sum::<f64>()
    };
    let mut firsts: Vec<usize> = o.repetitions().iter().filter_map(|g| g.first().copied()).collect();
    firsts.sort_by(|a, b| error(*b).total_cmp(&error(*a)));
    for &u in firsts.iter().take(CURVES) {
        for channel in 0..o.channels.len().min(2) {
            curve(html, c, u, channel);
        }
    }
    html.push_str("</div>");
}

fn curve(html: &mut String, c: &Curves, u: usize, channel: usize) {
    let (o, unit) = (&c.observations, &c.observations.units[u]);
    let block = unit.block(channel);
    let model = c.extended.as_ref().unwrap_or(&c.plain);
    let group: Vec<_> = o.units.iter().filter(|v| v.condition == unit.condition).collect();
    let mut low = f64::MAX;
    let mut high = f64::MIN;
    let all = block.clone().flat_map(|k| [c.plain[k], model[k] + c.band[k], model[k] - c.band[k]]);
    let measured = group.iter().flat_map(|v| v.block(channel)).map(|k| o.values[k]);
    all.chain(measured).for_each(|v| (low, high) = (low.min(v), high.max(v)));
    let (first, last) = (unit.progress[0], unit.progress[unit.samples - 1]);
    let x = |p: f64| 6.0 + 248.0 * (p - first) / (last - first).max(1e-12);
    let y = |v: f64| 150.0 - 128.0 * (v - low) / (high - low).max(1e-12);
    let _ = write!(
        html,
        "<svg width=260 height=160><text x=6 y=12>{} · condition {} · {} {:.2}…{:.2} N</text>",
        escape(&c.groups[u]),
        escape(&o.conditions[unit.condition]),
        o.channels[channel].name,
        low,
        high
    );
    let line = |values: &dyn Fn(usize) -> f64, back: bool| -> String {
        let points: Vec<String> =
            block.clone().zip(&unit.progress).map(|(k, p)| format!("{:.1},{:.1}", x(*p), y(values(k)))).collect();
        if back { points.into_iter().rev().collect::<Vec<_>>().join(" ") } else { points.join(" ") }
    };
    let band = format!("{} {}", line(&|k| model[k] + c.band[k], false), line(&|k| model[k] - c.band[k], true));
    let _ = write!(html, "<polygon points='{band}' fill='#f3d9d3'/>");
    for v in group {
        for (k, p) in v.block(channel).zip(&v.progress) {
            let _ = write!(html, "<circle cx={:.1} cy={:.1} r=1.1 fill='#333'/>", x(*p), y(o.values[k]));
        }
    }
    let _ =
        write!(html, "<polyline points='{}' fill=none stroke='#999' stroke-width=1.6 />", line(&|k| c.plain[k], false));
    if c.extended.is_some() {
        let _ = write!(
            html,
            "<polyline points='{}' fill=none stroke='#c0392b' stroke-width=1.6 />",
            line(&|k| model[k], false)
        );
    }
    html.push_str("</svg>");
}

/// Of runs each is one number a channel: a table in place of curves.
fn runs(html: &mut String, r: &Report) {
    html.push_str("<h2>Measured and predicted, means over repetitions</h2><table><tr><th>condition<th>channel<th>measured<th>plain<th>extended<th>unit");
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
    html.push_str("</table>");
}

fn rivals(html: &mut String, r: &Report) {
    html.push_str("<h2>Causes tried</h2><table><tr><th>cause<th>value<th>Δχ²<th>ΔAIC<th>ΔBIC<th>held-out gain<th>lack of fit<th>distance to the best, σ");
    for c in r.candidates.iter().take(16) {
        let values: Vec<_> = c.values.iter().map(|v| digits(*v)).collect();
        let _ = write!(
            html,
            "<tr><td>{}<td>{}<td>{:.1}<td>{:.1}<td>{:.1}<td>{}<td>{:.2}<td>{}",
            c.ids.join(" + "),
            values.join(", "),
            c.delta_chi2,
            c.delta_aic,
            c.delta_bic,
            c.cv_gain.map_or("–".into(), |g| format!("{:.1} %", 100.0 * g)),
            c.lack_of_fit,
            number(c.distance_to_best, 1)
        );
    }
    html.push_str("</table>");
}

fn unknowns(html: &mut String, r: &Report) {
    html.push_str("<h2>What these data cannot tell</h2><ul>");
    if r.ambiguity_set.len() > 1 {
        let set: Vec<_> = r.ambiguity_set.iter().map(|ids| ids.join(" + ")).collect();
        let _ = write!(html, "<li>apart: {}", set.join(" | "));
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
        html.push_str("<h2>The residual correlates with</h2><p><small>not causes</small></p><ul>");
        for c in &r.correlates_with {
            let _ = write!(html, "<li>{} with {} (Δχ² {:.0})", c.channel, escape(&c.feature), c.delta_chi2);
        }
        html.push_str("</ul>");
    }
    let ranges: Vec<_> = r.valid_range.iter().map(|(name, v)| format!("{name} {:.4} to {:.4}", v[0], v[1])).collect();
    let _ = write!(
        html,
        "<h2>Valid for</h2><p>{}</p><p><small>data SHA-256 {}</small></p>",
        ranges.join(" · "),
        r.data_sha256
    );
}
