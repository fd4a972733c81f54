//! Sand of another strength than stated: how strong it is, how sure that is, and when the law does not fit with any coefficients.

use super::testbed::{self, Hidden};
use super::{changed, file, sound};
use sandgait::diagnose::experiment::Experiment;
use sandgait::diagnose::report::Diagnosis;
use sandgait::diagnose::verdict::{Verdict, Written};

/// The diagnosis of a log whose coefficients are stated with this relative standard deviation.
fn stated(log: &str, coefficient_sd: f64) -> Diagnosis {
    let directory = tempfile::tempdir().unwrap();
    let text = testbed::EXPERIMENT.replace("coefficient_sd = 0.08", &format!("coefficient_sd = {coefficient_sd}"));
    sound(&file(directory.path(), log), &Experiment::from_toml(&text).unwrap())
}

/// A log of sand that is 30 % weaker than its table.
fn weaker() -> String {
    testbed::log(11, &Hidden { causes: vec![("scale", -0.3)] }, 0.0).noisy
}

/// The sand is 30 % weaker than its table, which is within the stated uncertainty: the answer is another table, and not "no misfit". No
/// upper limit excludes what the fit absorbed (`contradictions`).
#[test]
fn another_table_is_the_answer_if_only_coefficients_are_wrong() {
    let d = stated(&weaker(), 0.3);
    let r = &d.report;
    assert_eq!((r.verdict, r.written), (Verdict::Recalibrated, Written::Recalibrated), "{}", r.summary);
    let found = r.recalibration.as_ref().unwrap();
    assert!((found.factor - 0.7).abs() < 0.05 && found.coefficients.len() == 9, "{found:?}");
    assert!(r.gain.reduction.unwrap() > 0.3, "{:?}", r.gain);
    assert!(r.headline.contains("below the prediction"), "{}", r.headline);
    assert!((d.sand.coefficients.to_array()[0] / 51e3 - 0.7).abs() < 0.1, "{:?}", d.sand.coefficients);
}

/// A load cell with a gain of 1.03, which its stated uncertainty of 2 % allows, makes the sand look stronger than it is. So the interval of
/// its strength must be at least as wide as the gain is uncertain.
#[test]
fn the_strength_of_the_sand_is_no_more_certain_than_the_load_cell() {
    let d = stated(&changed(&weaker(), &["Fx", "Fz", "Ty"], |force| 1.03 * force), 0.3);
    let found = d.report.recalibration.unwrap();
    let [low, high] = found.ci95;
    assert!((low..=high).contains(&0.7) && (low..=high).contains(&found.factor), "{found:?}");
    assert!(high / low < 1.25, "an interval of no use: {found:?}");
}

/// A wall that no cause or law describes: forces at the wall stay too great, so the sand is not said to be another one.
#[test]
fn a_law_that_does_not_fit_is_not_recalibrated() {
    let d = stated(&testbed::log(11, &Hidden { causes: vec![("wall", 1.0)] }, 0.0).noisy, 0.3);
    let r = &d.report;
    assert_eq!(r.verdict, Verdict::NoneOfThese, "{}", r.summary);
    assert!(r.causes.is_empty(), "{}", r.summary);
}
