//! Statements that hold for every report. Tests and studies check them on every report that they make; the
//! program does so in debug builds.

use super::report::{EvidenceRow, Report};
use super::select::FACTORS;
use super::summary::summary;
use super::verdict::{Verdict, Written};

/// The statements that a report violates; empty for a sound one.
pub fn violations(r: &Report) -> Vec<String> {
    let mut found = Vec::new();
    let mut holds = |holds: bool, what: String| {
        if !holds {
            found.push(what);
        }
    };
    if r.verdict == Verdict::InsufficientData {
        holds(
            r.evidence.is_empty() && r.written == Written::Plain,
            "without a verdict nothing is compared or written".into(),
        );
        return found;
    }
    let Some(plain) = r.evidence.first().filter(|c| c.ids.is_empty() && c.terms.is_empty()) else {
        return vec!["the table does not begin with the plain model".into()];
    };
    let behind = |c: &EvidenceRow| -c.difference > 2.0 * c.standard_error;
    // 1. The verdict is noise only if no model predicts better and the errors of the plain model are no larger than noise may cause.
    let noise = r.verdict == Verdict::NoiseFloor;
    let within = r.lack_of_fit.plain.zip(r.lack_of_fit.limit).is_some_and(|(lack, limit)| lack <= limit);
    holds(
        !noise || (!behind(plain) && within),
        format!(
            "noise_floor, but the plain model is behind by {} ± {}, its lack of fit {:?}",
            -plain.difference, plain.standard_error, r.lack_of_fit
        ),
    );
    // 2. If a model predicts better than the plain one, a model is written, and the reported gain is the gain of the written model.
    holds(
        !behind(plain) || r.written != Written::Plain,
        "a model predicts better than the plain one, but the plain one is written".into(),
    );
    let row = r.evidence.iter().position(|c| c.written);
    holds(
        row.is_some_and(|k| (k == 0) == (r.written == Written::Plain))
            && r.evidence.iter().filter(|c| c.written).count() == 1,
        "the table does not say what is written".into(),
    );
    holds(
        within || -plain.difference <= plain.standard_error || r.written != Written::Plain,
        "there is a misfit and a model that predicts better, but the plain one is written".into(),
    );
    let same = r.gain.held_out_rmse_extended == r.gain.held_out_rmse_plain;
    holds(
        (r.written != Written::Plain) || (same && r.gain.reduction.unwrap_or(0.0) == 0.0),
        "the gain is not that of the plain model, which is written".into(),
    );
    holds(
        matches!(r.written, Written::Cause | Written::Plain) || r.gain.reduction.is_some_and(|gain| gain > 0.0),
        "what is written without being the cause raises the error".into(),
    );
    let named = matches!(r.verdict, Verdict::Named | Verdict::Ambiguous);
    holds(
        named == (r.written == Written::Cause)
            && (r.verdict == Verdict::Described) <= (r.written == Written::Description),
        format!("{:?} with {:?} written", r.verdict, r.written),
    );
    holds(named != r.causes.is_empty(), "causes without a name, or a name without causes".into());
    // 3. A cause is named only if no cause that these data cannot test could look the same.
    if r.verdict == Verdict::Named {
        let untested = |c: &&EvidenceRow| c.ids.iter().any(|id| r.untestable.iter().any(|u| u.id == *id));
        let near: Vec<_> =
            r.evidence.iter().filter(untested).filter(|c| !behind(c)).map(|c| c.ids.join(" + ")).collect();
        holds(near.is_empty(), format!("named, but {} cannot be tested and predicts as well", near.join(", ")));
        holds(r.ambiguity_set.len() == 1, "named, with several explanations".into());
        let scaled = r.causes.iter().any(|c| c.id == "scale");
        let hidden = r
            .untestable
            .iter()
            .any(|u| FACTORS.contains(&u.id.as_str()) && u.why.starts_with("the data have no column"));
        holds(!scaled || !hidden, "scale is named, but what cannot be tested may look the same".into());
    }
    holds(
        (r.verdict == Verdict::Ambiguous) == (r.ambiguity_set.len() > 1),
        "the set does not agree with the verdict".into(),
    );
    // 4. The report's sentence follows from the table.
    holds(r.summary == summary(r), format!("the sentence is not made from the report: {}", r.summary));
    found
}
