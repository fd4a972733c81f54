//! The last look at a report before it is given out. A report that contradicts its own numbers would be a defect of this program;
//! then it names nothing, and says so. The tests have a check of their own (tests/testbed/truth.rs), which shares nothing with this one.

use super::headline::{ALARM, action, headline};
use super::nuisance::CauseKind;
use super::report::Report;
use super::summary::summary;
use super::verdict::{Verdict, Written};

/// The contradictions of a report.
fn contradictions(r: &Report) -> Vec<String> {
    let mut all = Vec::new();
    let behind = |difference: f64, error: f64| -difference > 2.0 * error;
    let plain = r.evidence.first().is_some_and(|plain| behind(plain.difference, plain.standard_error));
    let reduction = r.gain.reduction;
    let sand = r.causes.iter().any(|c| c.kind == CauseKind::Sand);
    if r.verdict == Verdict::InsufficientData {
        return all;
    }
    if plain && r.written == Written::Plain {
        all.push("a model predicts better than the plain one, which is written".into());
    }
    if r.verdict == Verdict::Named {
        if !reduction.is_some_and(|share| share > 0.0) {
            all.push("what is named does not lower the left-out error".into());
        }
        if sand && !r.gain.ci95.is_some_and(|ci| ci[0] > 0.0) {
            all.push("the gain of a named cause is not certain".into());
        }
        let absent = |c: &&super::report::Cause| c.ci95[0] <= 0.0 && c.ci95[1] >= 0.0;
        all.extend(r.causes.iter().filter(absent).map(|c| format!("the interval of {} holds 0", c.id)));
        let mut ids: Vec<&String> = r.causes.iter().map(|c| &c.id).collect();
        ids.sort();
        let rival = |row: &&super::report::EvidenceRow| {
            !row.ids.is_empty()
                && !ids.iter().all(|id| row.ids.contains(id))
                && !behind(row.difference, row.standard_error)
        };
        all.extend(r.evidence.iter().filter(rival).map(|row| format!("{} predicts as well", row.ids.join(" + "))));
    }
    let stands = matches!(r.written, Written::Cause | Written::Description);
    if stands && reduction.is_some_and(|share| share < 0.0) {
        all.push("what is written raises the left-out error".into());
    }
    if (r.verdict == Verdict::Recalibrated) != (r.written == Written::Recalibrated)
        && r.verdict == Verdict::Recalibrated
    {
        all.push("recalibrated, but something else is written".into());
    }
    if r.next_experiment.is_none() && r.verdict != Verdict::NoiseFloor {
        all.push("no next experiment".into());
    }
    all
}

/// Withdraws the name of a report that contradicts itself. Returns the contradictions.
pub fn guard(r: &mut Report) -> Vec<String> {
    let found = contradictions(r);
    if !found.is_empty() {
        let said = found.join("; ");
        r.warnings
            .insert(0, format!("{ALARM}this report contradicted itself, which is a defect of this program: {said}"));
        if matches!(r.verdict, Verdict::Named | Verdict::Ambiguous | Verdict::Described) {
            r.verdict = Verdict::NoneOfThese;
            r.causes.clear();
            r.ambiguity_set.clear();
            if r.written == Written::Cause {
                r.written = Written::Proxy;
            }
        }
        r.headline = headline(r);
        r.action = action(r);
        r.summary = summary(r);
    }
    found
}
