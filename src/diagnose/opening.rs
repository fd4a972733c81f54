//! The part of a report on the data and the plain model, and the texts that follow from a whole report.

use super::fit::Fit;
use super::forward::Feature;
use super::headline::{action, headline};
use super::report::{Recalibration, Report, RunMeans, Untestable};
use super::series::ends;
use super::study::FitInputs;
use super::summary::summary;
use super::{misfit, split};
use std::collections::BTreeMap;

/// The part of a report on the data and the plain model. If the data do not suffice for a verdict, this is the whole report; then
/// `lacks` says what they lack.
pub fn without_verdict(
    study: &FitInputs,
    untestable: Vec<Untestable>,
    data_sha256: String,
    notes: Vec<String>,
    lacks: Option<&str>,
) -> Report {
    let (observations, model, plain) = (study.observations, study.model, study.plain().prediction);
    let range = |f: Feature| (f.name.to_string(), ends(f.values.iter().flatten().copied()));
    let recalibration = split::factor(observations, &plain);
    let mut report = Report {
        schema: "sandgait.diagnosis.v4",
        misfit: misfit::misfit(observations, model, &plain, |_| true),
        split: split::split(observations, model, &plain),
        recalibration: recalibration.map(|(factor, ci95)| Recalibration {
            factor,
            ci95,
            coefficients: BTreeMap::new(),
        }),
        untestable,
        valid_range: model.features().into_iter().map(range).collect(),
        warnings: lacks.map(String::from).into_iter().collect(),
        notes,
        runs: runs(study, None),
        data_sha256,
        ..Report::default()
    };
    if model.experiment().file.states_interest() {
        report.notes.push("[nuisances] interest has no effect: every effect of measuring may be the answer".into());
    }
    report
}

/// Completes a report by the texts that follow from it.
pub fn worded(mut report: Report) -> Report {
    report.headline = headline(&report);
    report.action = action(&report);
    report.summary = summary(&report);
    report
}

/// Measured and predicted means of every condition, for runs, which have one number for each channel.
pub fn runs(study: &FitInputs, extended: Option<&Fit>) -> Vec<RunMeans> {
    let o = study.observations;
    if o.units.iter().any(|u| u.samples > 1) {
        return Vec::new();
    }
    let simulated = |prediction: &[f64]| study.model.as_simulated(prediction);
    let plain = simulated(&study.plain().prediction);
    let extended = extended.map(|f| simulated(&f.prediction));
    let groups = o.repetitions();
    let row = |(condition, units): (usize, &Vec<usize>), c: usize| {
        let mean =
            |stack: &[f64]| units.iter().map(|&u| stack[o.units[u].block(c).start]).sum::<f64>() / units.len() as f64;
        RunMeans {
            condition: o.conditions[condition].clone(),
            channel: o.channels[c].name.to_string(),
            unit: o.channels[c].unit.into(),
            measured: mean(&o.values),
            plain: mean(&plain),
            extended: extended.as_ref().map(|e| mean(e)),
        }
    };
    groups.iter().enumerate().flat_map(|g| (0..o.channels.len()).map(move |c| row(g, c))).collect()
}
