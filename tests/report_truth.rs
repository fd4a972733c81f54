//! The check of reports finds what is wrong: each of these reports has one contradiction.

#[path = "testbed/truth.rs"]
mod truth;

use serde_json::{Value, json};
use truth::contradictions;

/// A sound report that names a cause.
fn sound() -> Value {
    json!({
        "schema": "sandgait.diagnosis.v4", "verdict": "named", "written": "cause",
        "headline": "A drag that grows with the square of the speed", "action": "Simulate with sand.toml.", "summary": "…",
        "causes": [{"id": "inertial_drag", "kind": "sand", "value": 1.0, "ci95": [0.8, 1.2]}],
        "ambiguity_set": [["inertial_drag"]], "untestable": [], "upper_limits": [],
        "next_experiment": {"why": "…", "decides": ["a", "b"], "conditions": [{}], "expected": 4.0},
        "recalibration": {"factor": 0.9, "ci95": [0.8, 1.0], "coefficients": {}},
        "gain": {"reduction": 0.4, "ci95": [0.2, 0.5], "held_out_rmse_plain": 1.0, "held_out_rmse_recalibrated": 0.9, "noise_floor": 0.5},
        "evidence": [
            {"ids": [], "terms": [], "difference": -90.0, "standard_error": 8.0, "written": false},
            {"ids": ["inertial_drag"], "terms": [], "difference": 0.0, "standard_error": 0.0, "written": true},
            {"ids": ["rate_log"], "terms": [], "difference": -40.0, "standard_error": 5.0, "written": false},
        ],
    })
}

/// The sound report of another verdict.
fn quiet() -> Value {
    let mut r = sound();
    (r["verdict"], r["written"]) = (json!("noise_floor"), json!("plain"));
    (r["causes"], r["ambiguity_set"]) = (json!([]), json!([]));
    (r["gain"]["reduction"], r["gain"]["ci95"]) = (json!(0.0), json!([0.0, 0.0]));
    r["evidence"] = json!([{"ids": [], "terms": [], "difference": -2.0, "standard_error": 2.0, "written": true}]);
    r["next_experiment"] = Value::Null;
    r
}

#[test]
fn sound_reports_pass() {
    assert_eq!(contradictions(&sound()), Vec::<String>::new());
    assert_eq!(contradictions(&quiet()), Vec::<String>::new());
}

/// A change that makes a report false: its name, the report, and the change.
type Seed = (&'static str, fn() -> Value, fn(&mut Value));

#[test]
fn every_contradiction_is_found() {
    let seeds: Vec<Seed> = vec![
        ("an interval that holds 0", sound, |r| r["causes"][0]["ci95"] = json!([-0.1, 2.0])),
        ("a negative gain", sound, |r| r["gain"]["reduction"] = json!(-0.2)),
        ("an uncertain gain", sound, |r| r["gain"]["ci95"] = json!([-0.1, 0.5])),
        ("a rival", sound, |r| r["evidence"][2]["difference"] = json!(-5.0)),
        ("no kind", sound, |r| r["causes"][0]["kind"] = Value::Null),
        ("named without a cause", sound, |r| r["causes"] = json!([])),
        ("two explanations", sound, |r| r["ambiguity_set"] = json!([["inertial_drag"], ["rate_log"]])),
        ("no next experiment", sound, |r| r["next_experiment"] = Value::Null),
        ("an empty next experiment", sound, |r| r["next_experiment"]["conditions"] = json!([])),
        ("a long headline", sound, |r| r["headline"] = json!("x".repeat(161))),
        ("no action", sound, |r| r["action"] = json!("")),
        ("an older schema", sound, |r| r["schema"] = json!("sandgait.diagnosis.v3")),
        ("words against the name", sound, |r| r["summary"] = json!("errors are no larger than noise may cause")),
        ("a gain that raises", sound, |r| r["summary"] = json!("it raises the error by 18 %")),
        ("plain sand, beaten", sound, |r| r["written"] = json!("plain")),
        ("nothing written", sound, |r| r["evidence"][1]["written"] = json!(false)),
        ("no plain model", sound, |r| r["evidence"][0]["ids"] = json!(["slope"])),
        ("something else recalibrated", sound, |r| r["verdict"] = json!("recalibrated")),
        ("noise, beaten", quiet, |r| r["evidence"][0]["difference"] = json!(-30.0)),
        ("noise, with fitted coefficients far better", quiet, |r| r["gain"]["held_out_rmse_recalibrated"] = json!(0.2)),
        ("noise, with a gain", quiet, |r| r["gain"]["reduction"] = json!(0.3)),
        ("noise, with a cause", quiet, |r| r["causes"] = sound()["causes"].clone()),
        ("a far set", sound, |r| {
            r["verdict"] = json!("ambiguous");
            r["ambiguity_set"] = json!([["inertial_drag"], ["rate_log"]]);
        }),
        ("a cause without data", sound, |r| r["verdict"] = json!("insufficient_data")),
        ("a limit below what the fit absorbed", sound, |r| {
            (r["verdict"], r["written"], r["causes"]) = (json!("recalibrated"), json!("recalibrated"), json!([]));
            r["recalibration"]["factor"] = json!(0.7);
            r["upper_limits"] = json!([{"id": "scale", "value": 0.03}]);
        }),
    ];
    for (what, report, break_it) in seeds {
        let mut r = report();
        break_it(&mut r);
        assert!(!contradictions(&r).is_empty(), "not found: {what}");
    }
}
