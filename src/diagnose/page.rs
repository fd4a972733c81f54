//! Writes the results of a diagnosis: `report.json`, `sand.toml`, and `report.html`, one self-contained page.

use super::report::{Diagnosis, EvidenceRow, NuisanceValue, Report, RunMeans, Tried};
use super::series::root_mean_square;
use super::summary::clauses;
use super::verdict::Verdict;
use super::words::{after, capital, digits, span};
use super::{check, figures};
use crate::error::{Error, Result};
use crate::plot::{color, escape};
use crate::sand::mechanism::{CATALOG, Mechanism};
use std::collections::BTreeSet;
use std::fmt::Write;
use std::path::Path;

const STYLE: &str = include_str!("page.css");

/// Papers of the mechanisms' sources, by their authors and year, with their DOIs.
const PAPERS: [(&str, &str); 6] = [
    ("Agarwal et al. 2021", "10.1126/sciadv.abe0631"),
    ("Li, Zhang & Goldman 2013", "10.1126/science.1229163"),
    ("Agarwal, Goldman & Kamrin 2023", "10.1073/pnas.2214017120"),
    ("Aguilar & Goldman 2016", "10.1038/nphys3568"),
    ("Gravish, Umbanhowar & Goldman 2010", "10.1103/PhysRevLett.105.128301"),
    ("Hill, Yeung & Koehler 2005", "10.1209/epl/i2005-10203-3"),
];

impl Diagnosis {
    /// Writes report.json, report.html, sand.toml and hardware.toml. All contents are made before the first file is written.
    pub fn write(&self, out: &Path) -> Result<()> {
        let json = self.json()?;
        let html = page(self, &json);
        let sand = format!("# {}\n{}", self.report.summary.replace('\n', " "), self.sand.to_toml()?);
        std::fs::create_dir_all(out).map_err(|e| Error::unwritten(out, &e))?;
        let hardware = self.hardware.to_toml();
        let files =
            [("report.json", &json), ("report.html", &html), ("sand.toml", &sand), ("hardware.toml", &hardware)];
        for (name, text) in files {
            let path = out.join(name);
            std::fs::write(&path, text).map_err(|e| Error::unwritten(&path, &e))?;
        }
        Ok(())
    }
}

/// The page; it embeds `json`, so that it contains all results.
fn page(diagnosis: &Diagnosis, json: &str) -> String {
    let r = &diagnosis.report;
    let mut html = format!(
        "<!doctype html><html lang=en><meta charset=utf-8><meta name=viewport content='width=device-width'>\
         <title>Diagnosis of {0}</title><style>{STYLE}</style><h1>Diagnosis of {0}: where the simulation disagrees with the data, and why</h1>",
        escape(&diagnosis.name)
    );
    let details = verdict(&mut html, r);
    next(&mut html, r, !diagnosis.hardware.quantities.is_empty());
    figures::curves(&mut html, &diagnosis.curves);
    found(&mut html, r);
    gain(&mut html, diagnosis);
    if !details.is_empty() {
        let _ = write!(html, "<h2>In detail</h2>{}", list(details.iter().map(|clause| sentence(clause))));
    }
    figures::misfit(&mut html, &r.misfit);
    if !r.runs.is_empty() {
        runs(&mut html, diagnosis);
    }
    check::section::write(&mut html, &r.check);
    compared(&mut html, r);
    beside(&mut html, r);
    unknowns(&mut html, r);
    foot(&mut html, diagnosis);
    let _ = write!(html, "<script type=application/json id=report>{}</script></html>", json.replace("</", "<\\/"));
    html
}

/// A text for the page that begins with a capital.
fn sentence(text: &str) -> String {
    escape(&capital(text))
}

fn list(items: impl IntoIterator<Item = String>) -> String {
    format!("<ul>{}</ul>", items.into_iter().map(|item| format!("<li>{item}")).collect::<String>())
}

/// A table of cells in HTML, row by row under its heads.
fn table<const N: usize>(heads: [&str; N], rows: impl IntoIterator<Item = [String; N]>) -> String {
    let heads: String = heads.iter().map(|head| format!("<th>{head}")).collect();
    let row = |cells: [String; N]| format!("<tr>{}", cells.map(|cell| format!("<td>{cell}")).concat());
    let rows: String = rows.into_iter().map(row).collect();
    format!("<div class=wide><table><tr>{heads}{rows}</table></div>")
}

/// Writes the beginning of the summary, and returns its other clauses.
fn verdict(html: &mut String, r: &Report) -> Vec<String> {
    let own = clauses(r);
    let _ = write!(html, "<p class=verdict>{}.</p>", escape(&r.headline));
    if let Some(split) = &r.split {
        let _ = write!(html, "<p>Measured against predicted forces of the plain model: {}.</p>", escape(&split.said()));
    }
    for warning in &r.warnings {
        let _ = write!(html, "<p><b>Warning:</b> {}</p>", escape(warning));
    }
    [own, r.whereabouts.clone()].concat()
}

/// What to do, by the verdict.
fn next(html: &mut String, r: &Report, hardware: bool) {
    let found = match hardware {
        true => " Train with <code>hardware.toml</code>: it has what was found of motors, sensors and delays.",
        false => "",
    };
    let _ = write!(html, "<div class=next><p><b>What to do next.</b> {}{found}</p>", escape(&r.action));
    if let Some(next) = &r.next_experiment {
        let trials = next.conditions.iter().map(|p| {
            let expected = p.expected_separation.map_or(String::new(), |sigma| format!(": {sigma:.1} σ"));
            format!("{} × {}{expected}", p.repetitions, escape(&p.condition))
        });
        let decides = escape(&next.decides.join(" or "));
        let _ = write!(
            html,
            "<p><b>Next experiment</b>, to decide between {decides}. {}:</p>{}",
            sentence(&next.why),
            list(trials)
        );
    }
    if matches!(r.verdict, Verdict::Named | Verdict::Ambiguous | Verdict::Described) {
        html.push_str(
            "<p><code>sandgait walk --leg L --frequency 3 --sand sand.toml</code> on the command line, \
             <code>gymnasium.make(\"sandgait/HexapodGait-v1\", sand=\"sand.toml\")</code> in Python.</p>",
        );
    }
    html.push_str("</div>");
}

/// The causes with their laws.
fn found(html: &mut String, r: &Report) {
    for term in &r.terms {
        let _ = write!(
            html,
            "<h2>Law found in the data</h2><p>Extra stress {}</p><p class=small>as TeX: <code>{}</code></p>",
            escape(&term.formula),
            escape(&term.tex)
        );
    }
    if r.causes.is_empty() {
        return;
    }
    html.push_str("<h2>Causes and their values</h2>");
    for c in &r.causes {
        let entry = CATALOG.iter().find(|m| m.id == c.id);
        let _ = write!(
            html,
            "<p><b>{}</b>: {} = {}{}, 95 % interval {} to {}{}.<br>{}.<br><span class=small>Source: {}</span></p>",
            c.of.as_ref().map_or_else(|| c.id.clone(), |of| format!("{} of {}", c.id, escape(of))),
            entry.map_or("value", |m| m.symbol),
            digits(c.value),
            after(&c.unit),
            digits(c.ci95[0]),
            digits(c.ci95[1]),
            if after(&c.unit).is_empty() { ", without unit" } else { "" },
            entry.map_or(String::new(), |m| sentence(m.law)),
            entry.map_or(String::new(), source)
        );
    }
    html.push_str(
        "<p class=small>n: outward normal of a leading face, v_n ≥ 0: speed along it, |z|: depth, ρ: bulk density. \
         All laws: docs/physics.md, “Mechanisms beyond plain theory”.</p>",
    );
    let Some(form) = &r.form else { return };
    let [low, high] = form.ci95;
    let said = match (form.excluded, form.told_apart) {
        (true, _) => "the data exclude the law's power",
        (false, true) => "the data agree with the law's power",
        (false, false) => "the data do not distinguish the law's power from others",
    };
    let _ = write!(
        html,
        "<p>Power of the speed in {}: {} in the law, {:.2} fits best (95 % interval {low:.2} to {high:.2}); {said}.</p>",
        form.id, form.law, form.found
    );
}

/// The source of a mechanism, with a link to the paper.
fn source(entry: &Mechanism) -> String {
    let text = escape(entry.source);
    let paper = PAPERS.iter().map(|(name, doi)| (escape(name), doi)).find(|(name, _)| text.contains(name.as_str()));
    paper
        .map_or(text.clone(), |(name, doi)| text.replace(&name, &format!("<a href='https://doi.org/{doi}'>{name}</a>")))
}

/// Errors on left-out conditions, and in all data by shape.
fn gain(html: &mut String, diagnosis: &Diagnosis) {
    let g = &diagnosis.report.gain;
    let unit = diagnosis.curves.observations.error_unit();
    let rows = [
        ("plain model", g.held_out_rmse_plain, color::BLUE),
        ("coefficients fitted within their prior", g.held_out_rmse_recalibrated, color::BLUE),
        ("extended model", g.held_out_rmse_extended, color::VERMILION),
        ("noise, which no model removes", g.noise_floor, "#999"),
    ];
    let of = |(name, value, hue): (&str, Option<f64>, _)| value.map(|v| (name.to_string(), v, digits(v), hue));
    let rows: Vec<_> = rows.into_iter().filter_map(of).collect();
    if rows.is_empty() {
        return;
    }
    html.push_str("<h2>Error on left-out conditions</h2><p class=small>Root mean square in units of the noise: 1 is what a perfect model would leave. Each condition is predicted by models that were chosen and fitted without it.</p>");
    figures::bars(html, &rows);
    if let (Some(reduction), Some([low, high])) = (g.reduction, g.ci95) {
        let [reduction, low, high] = [reduction, low, high].map(|v| 100.0 * v);
        let _ = write!(
            html,
            "<p>The extended model's error is {reduction:.1} % smaller (95 % interval {low:.1} to {high:.1} %)."
        );
        match g.achievable_fraction {
            Some(share) if share > 1.0 => html.push_str(
                " This is all that a perfect model could remove: the error is even slightly below the scatter, by chance, because the \
                 scatter is itself estimated from few repetitions.",
            ),
            Some(share) => {
                let _ = write!(html, " This is {:.0} % of what a perfect model would remove.", 100.0 * share.max(0.0));
            }
            None => {}
        }
        html.push_str("</p>");
    }
    if let Some(raw) = &g.in_units {
        let [plain, extended, floor] =
            [raw.plain, raw.extended, raw.noise_floor].map(|v| digits(v) + &after(&raw.unit));
        let _ = write!(
            html,
            "<p>The readings themselves: {plain} with the plain model, {extended} with the extended one; repetitions scatter by {floor}.</p>"
        );
    }
    by_shape(html, diagnosis, unit);
}

/// The errors of each shape, and of all together, which is the error above.
fn by_shape(html: &mut String, diagnosis: &Diagnosis, unit: &str) {
    let c = &diagnosis.curves;
    let o = &c.observations;
    let shapes: BTreeSet<&str> = c.groups.iter().map(String::as_str).collect();
    let rms = |prediction: &[f64], shape: Option<&str>| {
        let own = o.units.iter().zip(&c.groups).filter(|(_, group)| shape.is_none_or(|s| s == *group));
        root_mean_square(o.counted(own.map(|(unit, _)| unit)).map(|k| o.values[k] - prediction[k]))
    };
    let extended = |shape| c.extended.as_ref().map_or("–".into(), |e| digits(rms(e, shape)));
    let all = shapes.iter().map(|s| (*s, Some(*s))).chain([("all", None)]);
    let rows = all.map(|(name, shape)| [escape(name), digits(rms(&c.plain, shape)), extended(shape)]);
    let heads = ["shape".into(), format!("plain model [{unit}]"), format!("extended model [{unit}]")];
    let _ = write!(
        html,
        "<p class=small>The same error by shape, in all data. The extended model was fitted to them, so that its error over all is \
         somewhat smaller here than on left-out conditions.</p>{}",
        table(heads.each_ref().map(String::as_str), rows)
    );
}

/// Writes a table for runs, which have one number for each channel.
fn runs(html: &mut String, diagnosis: &Diagnosis) {
    let c = &diagnosis.curves;
    let row = |run: &RunMeans| {
        let condition = c.observations.conditions.iter().position(|name| *name == run.condition);
        let condition = condition.map_or(&run.condition, |k| &c.conditions[k]);
        let extended = run.extended.map_or("–".into(), digits);
        let numbers = (digits(run.measured), digits(run.plain), extended);
        [escape(condition), run.channel.clone(), numbers.0, numbers.1, numbers.2, run.unit.clone()]
    };
    let heads = ["condition", "channel", "measured", "plain", "extended", "unit"];
    let rows = table(heads, diagnosis.report.runs.iter().map(row));
    let _ = write!(html, "<details><summary>Means over repetitions as a table</summary>{rows}</details>");
}

fn compared(html: &mut String, r: &Report) {
    if !r.evidence.is_empty() {
        let row = |m: &EvidenceRow| {
            let parts: Vec<&str> = m.ids.iter().chain(&m.terms).map(String::as_str).collect();
            let name = match (parts.is_empty(), m.model) {
                (true, "plain") => "plain model".into(),
                (true, _) => "fitted coefficients".into(),
                _ => escape(&parts.join(" + ")),
            };
            let name = if m.written { format!("<b>{name}</b>") } else { name };
            let [elpd, difference, error] = [m.elpd, m.difference, m.standard_error].map(|v| format!("{v:.1}"));
            [name, elpd, difference, error]
        };
        let heads = ["model", "elpd", "difference to the best", "standard error"];
        let _ = write!(
            html,
            "<h2>Evidence</h2><p class=small>elpd: log density that a model gives left-out conditions, summed. The difference is \
             that to the best model; a model is clearly worse if its difference is more than twice the standard error. \
             sand.toml holds the model in bold.</p>{}",
            table(heads, r.evidence.iter().map(row))
        );
    }
    let row = |c: &Tried| {
        let values: Vec<_> = c.values.iter().map(|v| digits(*v)).collect();
        let [chi2, aic, bic] = [c.delta_chi2, c.delta_aic, c.delta_bic].map(|v| format!("{v:.1}"));
        let gain = c.cv_gain.map_or("–".into(), |g| format!("{:+.1} %", -100.0 * g).replace('-', "−"));
        let distance = c.distance_to_best.map_or("–".into(), |d| format!("{d:.1}"));
        [c.ids.join(" + "), values.join(", "), chi2, aic, bic, gain, distance]
    };
    let heads = ["cause", "value", "Δχ²", "ΔAIC", "ΔBIC", "error on left-out conditions", "distance to the best [σ]"];
    let _ = write!(html, "<h2>Candidate causes</h2>{}", table(heads, r.candidates.iter().take(16).map(row)));
}

fn beside(html: &mut String, r: &Report) {
    if let Some(rest) = r.remainder.as_ref().filter(|rest| rest.significant) {
        let text =
            format!("{:.0} % of the plain model's misfit remains. {}", 100.0 * rest.fraction, capital(&rest.place));
        let _ = write!(html, "<h2>What remains</h2><p>{}</p>", escape(&text));
    }
    let nuisance = |n: &NuisanceValue| {
        let channel = n.of.as_ref().map_or(String::new(), |c| format!(" {c}"));
        let value = if n.level == "log" { format!("{} ± ", digits(n.value)) } else { "scatters by ".into() };
        format!("{}{channel} ({}): {value}{}{}", n.id, n.level, digits(n.sd), after(n.unit))
    };
    let _ = write!(
        html,
        "<h2>Nuisances</h2><p class=small>Effects of the measurement. Fits marginalise over them, and they are not causes.</p>{}",
        list(r.nuisances.iter().map(nuisance))
    );
    if !r.upper_limits.is_empty() {
        let limits = r.upper_limits.iter();
        let limits = limits.map(|l| format!("{} &lt; {}{}", l.id, digits(l.value), after(&l.unit)));
        let _ = write!(
            html,
            "<h2>Causes that were not found</h2><p class=small>Upper limits of their strengths, at 95 %. They contain what fitted coefficients and effects of measuring may have taken from them.</p>{}",
            list(limits)
        );
    }
}

fn unknowns(html: &mut String, r: &Report) {
    let set: Vec<_> = r.ambiguity_set.iter().map(|ids| ids.join(" + ")).collect();
    let rivals = (set.len() > 1).then(|| format!("which of these explanations is right: {}", set.join(" | ")));
    let untestable = r.untestable.iter().map(|u| format!("{}: {}", u.id, escape(&u.why)));
    let undecided: Vec<String> = rivals.into_iter().chain(untestable).collect();
    if !undecided.is_empty() {
        let _ = write!(html, "<h2>What these data cannot decide</h2>{}", list(undecided));
    }
    let units = |name: &str| r.misfit.iter().find(|m| m.by == name).map_or("", |m| m.unit.as_str());
    let ranges: Vec<_> =
        r.valid_range.iter().map(|(name, v)| format!("{name} {}", span(*v, units(name)).replace('-', "−"))).collect();
    let _ = write!(html, "<h2>Range of validity</h2><p>{}</p>", ranges.join(" · "));
    if !r.notes.is_empty() {
        let _ = write!(html, "<h2>Notes</h2>{}", list(r.notes.iter().map(|n| sentence(n))));
    }
}

/// What was diagnosed, by which version, and when.
fn foot(html: &mut String, diagnosis: &Diagnosis) {
    let o = &diagnosis.curves.observations;
    let _ = write!(
        html,
        "<footer><p>{}: {} trials of {} conditions, {} measured numbers, sand {}. sandgait {}, {}. SHA-256 of the data {}.</p></footer>",
        escape(&diagnosis.name),
        o.units.len(),
        o.repetitions().iter().filter(|units| !units.is_empty()).count(),
        o.values.len(),
        escape(&diagnosis.curves.medium),
        env!("CARGO_PKG_VERSION"),
        time::OffsetDateTime::now_utc().date(),
        diagnosis.report.data_sha256
    );
}
