//! Makes one sentence from the table of a report.

use super::report::{EvidenceRow, Report};
use super::verdict::{Verdict, Written};
use super::words::{after, digits};

/// The verdict in one sentence.
pub fn summary(r: &Report) -> String {
    let verdict = match r.verdict {
        Verdict::InsufficientData => {
            let why = r.warnings.last().map_or("no condition is repeated", String::as_str);
            return format!("{why}: without a noise floor there is no verdict");
        }
        Verdict::NoiseFloor => {
            "no significant misfit: no cause or law predicts left-out conditions better than the plain model, whose error is \
             within the scatter of the repetitions"
                .into()
        }
        Verdict::Named => format!("the misfit is explained by {}{}{}", found(r), lowers(r), next_best(r)),
        Verdict::Ambiguous => ambiguous(r),
        Verdict::Described => format!("no known cause explains the misfit; a law found in the data does: {}{}", law(r), lowers(r)),
        Verdict::NoneOfThese => none(r),
    };
    let named = matches!(r.verdict, Verdict::Named | Verdict::Ambiguous);
    let rest = r.remainder.as_ref().filter(|rest| named && rest.significant);
    let rest = rest
        .map_or(String::new(), |rest| format!("; misfit beyond noise remains ({:.0} % of it)", 100.0 * rest.fraction));
    let beside = if named && !r.terms.is_empty() {
        format!("; a law found in the data describes a part of the rest: {}", law(r))
    } else {
        String::new()
    };
    let form = r.form.as_ref().map_or(String::new(), |form| form.said());
    let place = r.whereabouts.as_ref().map_or(String::new(), |place| format!("; {place}"));
    verdict + &rest + &beside + &form + &place
}

/// The causes with their values.
fn found(r: &Report) -> String {
    let said = |c: &super::report::Cause| {
        let [value, low, high] = [c.value, c.ci95[0], c.ci95[1]].map(digits);
        format!("{} = {value}{} (95 % interval {low} to {high})", c.id, after(&c.unit))
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
fn lowers(r: &Report) -> String {
    let (Some(share), Some([low, high])) = (r.gain.reduction, r.gain.ci95) else { return String::new() };
    let verb = if share >= 0.0 { "lowers" } else { "raises" };
    let [share, low, high] = [share.abs(), low, high].map(|v| format!("{:.0}", 100.0 * v));
    let interval = if verb == "lowers" { format!(" (95 % interval {low} to {high} %)") } else { String::new() };
    format!("; on held-out conditions it {verb} the error by {share} %{interval}")
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
        "the misfit is explained by {}, or by {}: these data cannot distinguish them{cannot}{}",
        found(r),
        others.join(", or by "),
        lowers(r)
    )
}

fn none(r: &Report) -> String {
    let names = |c: &EvidenceRow| c.ids.join(" with ");
    match r.written {
        Written::Plain => {
            "misfit remains, and no cause or law predicts left-out conditions better than the plain model, so the sand stays plain".into()
        }
        Written::Description => format!("no known cause explains the main part of the misfit; the best description, {}, does not either{}", law(r), lowers(r)),
        _ => {
            let own = r.evidence.iter().find(|c| c.written).map_or(String::new(), names);
            let law = if r.terms.is_empty() { String::new() } else { format!(" with {}", law(r)) };
            format!("no known cause explains the main part of the misfit; as a stand-in and not as the cause, {own}{law} is written{}", lowers(r))
        }
    }
}

/// The best explanation besides the named one, and how much worse it predicts.
fn next_best(r: &Report) -> String {
    let Some([own, ..]) = r.ambiguity_set.first_chunk::<1>() else { return String::new() };
    let rival = |c: &&EvidenceRow| c.ids.len() == own.len() && c.ids != *own && c.terms.is_empty();
    let Some(next) = r.evidence.iter().filter(rival).max_by(|a, b| a.elpd.total_cmp(&b.elpd)) else {
        return String::new();
    };
    format!(
        "; the next best, {}, predicts them worse by {} standard errors",
        next.ids.join(" + "),
        digits(-next.difference / next.standard_error.max(1e-9))
    )
}
