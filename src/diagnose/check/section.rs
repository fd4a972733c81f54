//! The section of the page on the data and on the design of the experiment.

use super::Check;
use super::design::{APART, ExperimentDesign, PLAIN};
use super::finding::{Finding, Severity};
use crate::plot::escape;
use crate::words::{after, digits};
use std::fmt::Write;

/// Writes the section.
pub fn write(html: &mut String, check: &Check) {
    html.push_str("<h2>The data before any fit</h2>");
    match check.findings.is_empty() {
        true => html.push_str("<p>Units, signs, zeros, clocks and channels agree with each other.</p>"),
        false => {
            let all: String = check.findings.iter().map(|f| format!("<li>{}", words(f))).collect();
            let _ = write!(html, "<ul>{all}</ul>");
        }
    }
    design(html, &check.design);
}

fn words(finding: &Finding) -> String {
    let mark = if finding.severity == Severity::Note { "Note" } else { "Warning" };
    format!("<b>{mark}:</b> {}", escape(&finding.line()))
}

/// A table with a row for each cause: how well the motions show it, and what they do not tell it from.
fn design(html: &mut String, d: &ExperimentDesign) {
    let places = d.places.map_or("places not stated".into(), |n| format!("{n} places in the bed"));
    let _ = write!(
        html,
        "<p>{} trials: {} conditions, at least {} repetitions of each, {places}.</p><details><summary>What these motions can tell apart\
         </summary><p class=small>Computed from the motions and the experiment file, before the measured values are looked at, for noise of \
         5 % of the force. σ: distance of a cause at the given strength from the plain sand, and from the cause or nuisance that is most \
         like it. Below {APART} σ two effects are not told apart.</p><div class=wide><table><tr><th>cause<th>strength<th>from the \
         plain sand [σ]<th>most like it<th>from that [σ]<th>not told from</tr>",
        d.trials, d.conditions, d.repetitions
    );
    for (id, (value, unit)) in &d.sizes {
        let own = |(a, b, sigma): &(String, String, f64)| {
            let other = if a == id { b } else { a };
            ((a == id || b == id) && other != PLAIN).then(|| (other.clone(), *sigma))
        };
        let nearest = d.separable.iter().filter_map(own).min_by(|a, b| a.1.total_cmp(&b.1));
        let plain = d.separable.iter().find(|(a, b, _)| a == id && b == PLAIN);
        let confused = d.cannot_separate.iter().filter(|(a, b)| a == id || b == id);
        let confused: Vec<&str> = confused.map(|(a, b)| if a == id { b.as_str() } else { a.as_str() }).collect();
        let _ = write!(
            html,
            "<tr><td>{}<td>{}{}<td>{}<td>{}<td>{}<td>{}",
            escape(id),
            digits(*value),
            after(unit),
            plain.map_or(format!("&lt; {APART}"), |p| format!("{:.1}", p.2)),
            nearest.as_ref().map_or("–".into(), |n| escape(&n.0)),
            nearest.as_ref().map_or("–".into(), |n| format!("{:.1}", n.1)),
            escape(&confused.join(", ")),
        );
    }
    html.push_str("</table></div></details>");
}
