//! A diagnosis in one sentence.

use super::described::Described;
use super::fit::{COEFFICIENTS, Fit};
use super::report::Cause;
use super::select::Selection;
use super::speed_exponent::SpeedExponent;
use super::study::Study;
use super::verdict::Verdict;
use super::words::{after, digits};
use crate::sand::mechanism::CATALOG;

/// Ids of a fit's causes.
pub fn names(fit: &Fit) -> Vec<String> {
    fit.ids.iter().map(|&id| CATALOG[id].id.to_string()).collect()
}

/// The verdict in one sentence, and the ranges with the largest errors of the plain model.
pub fn summary(study: &Study, selection: Option<&Selection>, causes: &[Cause], whereabouts: Option<&str>) -> String {
    let Some(selection) = selection else {
        let why = match study.observations.has_replicates() {
            true => "repetitions are copies of each other, so their scatter is no noise floor",
            false => "no condition is repeated",
        };
        return format!("{why}: without a noise floor there is no verdict");
    };
    let said = |c: &Cause| {
        let [value, low, high] = [c.value, c.ci95[0], c.ci95[1]].map(digits);
        format!("{} = {value}{} (95 % interval {low} to {high})", c.id, after(&c.unit))
    };
    let found = causes.iter().map(said).collect::<Vec<_>>().join(" with ");
    let verdict = match selection.verdict {
        Verdict::NoiseFloor => {
            "no significant misfit: the plain model's error is within the scatter of the repetitions".into()
        }
        Verdict::Named => format!("the misfit is explained by {found}{}", nearest_rival(selection)),
        Verdict::Ambiguous => {
            let rivals: Vec<_> =
                selection.set.iter().skip(1).map(|&k| names(&selection.fitted.candidates[k].fit).join(" + ")).collect();
            format!(
                "the misfit is explained by {found}, or by {}: these data cannot distinguish them",
                rivals.join(", or by ")
            )
        }
        Verdict::NoneOfThese => not_enough(study, selection),
        Verdict::Described => {
            let law = |law: &Described| {
                let [low, high] = law.ci95.map(digits);
                format!(
                    "no known cause explains the misfit; a law found in the data does: extra stress {} (95 % interval of the coefficient \
                         {low} to {high})",
                    law.term.formula()
                )
            };
            selection.law().map_or(String::new(), law)
        }
        Verdict::InsufficientData => String::new(),
    };
    let evidence = &selection.judged.evidence;
    let named = matches!(selection.verdict, Verdict::Named | Verdict::Ambiguous) && evidence.remainder;
    let verdict = match named {
        true => format!("{verdict}, but {:.0} % of the misfit remains", 100.0 * (1.0 - evidence.explained)),
        false => verdict,
    };
    let beside = selection.refined.as_ref().and_then(|r| r.law.as_ref());
    let verdict = verdict
        + &beside.map_or(String::new(), |law| {
            format!("; a law found in the data describes a part of the rest: extra stress {}", law.term.formula())
        });
    // If other misfit remains, the exponent is fitted to that misfit too, so it is not stated.
    let form = selection.judged.form.as_ref().filter(|form| form.lack_of_fit <= selection.screened.gates.lack_of_fit);
    let verdict = verdict + &form.map_or(String::new(), SpeedExponent::said);
    whereabouts.map_or(verdict.clone(), |place| format!("{verdict}; {place}"))
}

/// A clause on the proxy that stands for an unknown cause: the gain of its predictions on held-out conditions.
fn stand_in(study: &Study, selection: &Selection) -> String {
    let Some(best) = selection.fitted.best() else { return String::new() };
    let (plain, chosen) = (selection.plain_errors(), &selection.judged.nested[1].errors);
    let unit = after(study.observations.channels.iter().find(|c| c.in_rmse).map_or("", |c| c.unit));
    let (before, now) = (plain.rmse(), chosen.rmse());
    let [low, high] = plain.reduction_interval(chosen).map(|share| format!("{:.0}", 100.0 * share));
    let name = names(&best.fit).join(" with ");
    let gain = format!(
        "from {} to {}{unit} on held-out conditions ({:.0} %, 95 % interval {low} to {high} %)",
        digits(before),
        digits(now),
        100.0 * (1.0 - now / before)
    );
    match selection.extension() {
        None if now >= before => "; none of them predicts held-out conditions better than the plain model".into(),
        Some(_) => format!("; as a stand-in and not as the cause, {name} lowers the error {gain}"),
        None => {
            format!(
                "; no cause reduces the error with certainty: the best one, {name}, changes the error {gain}, so the sand stays plain"
            )
        }
    }
}

fn not_enough(study: &Study, selection: &Selection) -> String {
    let limit = selection.screened.gates.lack_of_fit;
    let excluded = selection.judged.form.as_ref().filter(|form| form.excluded);
    match selection.fitted.best() {
        Some(best) if excluded.is_some_and(|form| selection.judged.lacks[1].mean.min(form.lack_of_fit) <= limit) => {
            let name = names(&best.fit).join(" with ");
            format!("none of the known causes has the right form: {name} comes nearest") + &stand_in(study, selection)
        }
        Some(best) if best.delta_chi2 > selection.screened.gates.single => {
            format!(
                "none of the known causes is enough: the nearest, {}, leaves a lack of fit of {}; with noise alone it is at most {}",
                names(&best.fit).join(" with "),
                digits(selection.judged.lacks[1].mean),
                digits(selection.screened.gates.lack_of_fit)
            ) + &stand_in(study, selection)
        }
        _ => "misfit remains and none of the known causes explains any of it".into(),
    }
}

/// A warning if the fit needs coefficients beyond three of their declared standard deviations: our choice.
pub fn far_coefficients(fit: &Fit) -> Option<String> {
    let furthest = fit.deviations[..COEFFICIENTS].iter().copied().max_by(|a, b| a.abs().total_cmp(&b.abs()))?;
    (furthest.abs() > 3.0).then(|| {
        format!(
            "the fit moves a stress coefficient by {furthest:+.1} of its declared standard deviations: the medium's table or \
             coefficient_sd does not fit this sand"
        )
    })
}

/// The nearest rival of the one named cause, and its distance.
fn nearest_rival(selection: &Selection) -> String {
    let nearest = selection.rivals().min_by(|a, b| a.1.total_cmp(&b.1));
    nearest.map_or(String::new(), |(rival, away)| {
        format!("; the nearest rival, {}, is {} σ away", names(&rival.fit).join(" + "), digits(away))
    })
}
