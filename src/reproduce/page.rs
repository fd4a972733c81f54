//! `report.html`: one self-contained page.

use super::{Claim, ClaimVerdict, FigureSection, ReportTable};
use crate::plot::escape;
use std::fmt::Write;

const STYLE: &str = "body{font:15px/1.5 system-ui,sans-serif;max-width:1080px;margin:2em auto;padding:0 1em;color:#222}\
h1{font-size:1.5em}h2{font-size:1.2em;margin-top:2.2em;border-bottom:1px solid #ddd}\
svg{display:block;margin:1em auto;max-width:100%;height:auto}sub{line-height:0}table{border-collapse:collapse;margin:1em 0;font-size:.92em}caption{text-align:left;color:#555;padding-bottom:.4em}\
th,td{text-align:left;vertical-align:top;padding:.25em .7em;border-bottom:1px solid #eee}th{border-bottom:2px solid #ccc}\
.v{white-space:nowrap;border-radius:3px;padding:.1em .5em;font-size:.9em}.reproduced{background:#d8f0e3}\
.not{background:#fbdcd0}.none{background:#eee}";

pub fn page(parts: &[FigureSection]) -> String {
    let mut html = format!(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><title>A resistive force model, side by side</title><style>{STYLE}</style>\
         <h1>Li, Zhang &amp; Goldman 2012, side by side</h1>\
         <p>“A resistive force model for legged locomotion on granular media”, its figures and its sentences with numbers, computed by sandgait {}. \
         Nothing is fitted to the paper. Where the paper's numbers stand in its figures only, they are public nowhere, and the row says no data.</p>",
        env!("CARGO_PKG_VERSION")
    );
    let count = |v: ClaimVerdict| parts.iter().flat_map(|p| &p.claims).filter(|c| c.verdict == v).count();
    let _ = write!(
        html,
        "<p><b>{}</b> sentences reproduced, <b>{}</b> not reproduced, <b>{}</b> without data to compare. A number counts as reproduced within {:.0} % of the paper's.</p>",
        count(ClaimVerdict::Reproduced),
        count(ClaimVerdict::NotReproduced),
        count(ClaimVerdict::NoData),
        100.0 * super::claims::TOLERANCE
    );
    for part in parts {
        let _ = write!(html, "<h2>{}</h2>", escape(part.heading));
        for (_, figure) in &part.figures {
            html += &figure.svg();
        }
        claims(&mut html, &part.claims);
        part.tables.iter().filter(|t| !t.rows.is_empty()).for_each(|t| table(&mut html, t));
    }
    html + "</html>\n"
}

/// HTML-escaped, with the letter after an underscore as a subscript: `v_x`, `α_z`.
fn prose(text: &str) -> String {
    let escaped = escape(text);
    let mut parts = escaped.split('_');
    let mut html = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let cut = part.chars().next().map_or(0, char::len_utf8);
        let (low, rest) = part.split_at(cut);
        let _ = write!(html, "<sub>{low}</sub>{rest}");
    }
    html
}

fn claims(html: &mut String, claims: &[Claim]) {
    *html += "<table><tr><th>the paper<th>value<th>here<th>verdict<th>why</tr>";
    for c in claims {
        let (class, word) = match c.verdict {
            ClaimVerdict::Reproduced => ("reproduced", "reproduced"),
            ClaimVerdict::NotReproduced => ("not", "not reproduced"),
            ClaimVerdict::NoData => ("none", "no data"),
        };
        let _ = write!(
            html,
            "<tr><td>{}<td>{}<td>{}<td><span class=\"v {class}\">{word}</span><td>{}</tr>",
            prose(&c.claim),
            prose(&c.seed_value),
            prose(&c.ours),
            prose(&c.why)
        );
    }
    *html += "</table>";
}

fn table(html: &mut String, t: &ReportTable) {
    let _ = write!(html, "<table><caption>{}</caption><tr>", escape(&t.caption));
    t.head.iter().for_each(|h| *html += &format!("<th>{}", escape(h)));
    for row in &t.rows {
        *html += "</tr><tr>";
        row.iter().for_each(|c| *html += &format!("<td>{}", escape(c)));
    }
    *html += "</tr></table>";
}
