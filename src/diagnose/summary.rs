//! Makes one sentence from the table of a report.

use super::headline::below;
use super::report::{Cause, EvidenceRow, Report};
use super::verdict::{Verdict, Written};
use super::words::{after, digits, of};

/// The verdict in one sentence.
pub fn summary(r: &Report) -> String {
    [clauses(r), r.whereabouts.clone()].concat().join("; ")
}

/// The clauses of the sentence, without those of the whereabouts.
pub fn clauses(r: &Report) -> Vec<String> {
    let mut all: Vec<String> = match r.verdict {
        Verdict::InsufficientData => {
            let why = r.warnings.last().map_or("no condition is repeated", String::as_str);
            let mut all = vec![format!("{why}: no cause can be named")];
            all.extend(below(r));
            all
        }
        Verdict::Recalibrated => {
            let mut all: Vec<String> = below(r).into_iter().collect();
            all.push("the law fits with other coefficients, which the sand file has".into());
            all
        }
        Verdict::NoiseFloor => vec![
            "no significant misfit: neither fitted coefficients nor a cause or law predict left-out conditions better than the plain \
             model"
                .into(),
        ],
        Verdict::Named => vec![format!("the misfit is explained by {}", found(r))],
        Verdict::Ambiguous => vec![ambiguous(r)],
        Verdict::Described => {
            vec!["no known cause explains the misfit".into(), format!("a law found in the data does: {}", law(r))]
        }
        Verdict::NoneOfThese => none(r),
    };
    all.extend(lowers(r).filter(|_| r.written != Written::Plain));
    all.extend(next_best(r).filter(|_| r.verdict == Verdict::Named));
    all.extend(r.withheld.iter().map(withheld));
    if matches!(r.verdict, Verdict::Named | Verdict::Ambiguous) {
        let rest = r.remainder.as_ref().filter(|rest| rest.significant);
        all.extend(rest.map(|rest| format!("misfit beyond noise remains ({:.0} % of it)", 100.0 * rest.fraction)));
        let beside = (!r.terms.is_empty()).then(|| law(r));
        all.extend(beside.map(|law| format!("a law found in the data describes a part of the rest: {law}")));
    }
    all.extend(r.form.as_ref().and_then(|form| form.said()));
    all
}

/// The causes with their values.
fn found(r: &Report) -> String {
    let said = |c: &Cause| {
        let of = of(c.of.as_deref());
        let [value, low, high] = [c.value, c.ci95[0], c.ci95[1]].map(digits);
        format!("{}{of} = {value}{} (95 % interval {low} to {high})", c.id, after(&c.unit))
    };
    r.causes.iter().map(said).collect::<Vec<_>>().join(" with ")
}

fn law(r: &Report) -> String {
    let said = |t: &super::report::TermFound| {
        let [low, high] = t.ci95.map(digits);
        format!("extra stress {} (95 % interval of the coefficient {low} to {high})", t.formula)
    };
    r.terms.iter().map(said).collect::<Vec<_>>().join(" and ")
}

/// The gain of the written model.
fn lowers(r: &Report) -> Option<String> {
    let (share, [low, high]) = r.gain.reduction.zip(r.gain.ci95)?;
    if share <= 0.0 {
        return Some("it does not lower the error on held-out conditions".into());
    }
    let [share, low, high] = [share, low, high].map(|v| format!("{:.0}", 100.0 * v));
    Some(format!("on held-out conditions it lowers the error by {share} % (95 % interval {low} to {high} %)"))
}

fn ambiguous(r: &Report) -> String {
    let others: Vec<String> = r.ambiguity_set.iter().skip(1).map(|ids| ids.join(" + ")).collect();
    let untestable = |id: &str| r.untestable.iter().find(|u| u.id == id);
    let cannot: Vec<String> = r
        .ambiguity_set
        .iter()
        .flatten()
        .filter_map(|id| untestable(id))
        .map(|u| format!("{} cannot be tested: {}", u.id, u.why))
        .collect();
    let cannot = if cannot.is_empty() { String::new() } else { format!(" ({})", cannot.join("; ")) };
    format!(
        "the misfit is explained by {}, or by {}: these data cannot distinguish them{cannot}",
        found(r),
        others.join(", or by ")
    )
}

fn none(r: &Report) -> Vec<String> {
    let unexplained = "no known cause explains the main part of the misfit".to_string();
    match r.written {
        Written::Plain => vec![
            "misfit remains, and no cause or law predicts left-out conditions better than the plain model, so the sand stays plain"
                .into(),
        ],
        Written::Recalibrated => vec![unexplained, "fitted coefficients predict better, and sand.toml has them".into()],
        Written::Description => vec![unexplained, format!("the best description, {}, does not either", law(r))],
        _ => {
            let own = r.evidence.iter().find(|c| c.written).map_or(String::new(), |c| c.ids.join(" with "));
            let law = if r.terms.is_empty() { String::new() } else { format!(" with {}", law(r)) };
            // A stand-in that must not be named has no row of evidence.
            let what = if own.is_empty() && law.is_empty() { "a mechanism of sand.toml".into() } else { own + &law };
            vec![unexplained, format!("as a stand-in and not as the cause, {what} is written")]
        }
    }
}

/// A model that leads but is not named, and why.
fn withheld(w: &super::report::Withheld) -> String {
    let name = w.ids.iter().chain(&w.terms).cloned().collect::<Vec<_>>().join(" with ");
    let why = w.why.join(", and ");
    match name.is_empty() {
        true => format!("the law does not fit with other coefficients either, because {why}"),
        false => format!("{name} is not named, because {why}"),
    }
}

/// The best explanation besides the named one, and how much worse it predicts.
fn next_best(r: &Report) -> Option<String> {
    let own = r.ambiguity_set.first()?;
    let rival =
        |c: &&EvidenceRow| c.model == "causes" && c.ids.len() == own.len() && c.ids != *own && c.terms.is_empty();
    let next = r.evidence.iter().filter(rival).max_by(|a, b| a.elpd.total_cmp(&b.elpd))?;
    let name = next.ids.join(" + ");
    let best = r.evidence.iter().find(|c| c.ids == *own && c.terms.is_empty()).filter(|c| c.difference < 0.0);
    Some(match best {
        // The standard errors of the table are of differences to the best row.
        Some(named) => {
            format!(
                "the next best, {name}, predicts them worse by {} (difference of elpd)",
                digits(named.elpd - next.elpd)
            )
        }
        None => {
            let errors = digits(-next.difference / next.standard_error.max(1e-9));
            format!("the next best, {name}, predicts them worse by {errors} standard errors")
        }
    })
}
