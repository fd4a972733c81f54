//! Does a report contradict itself, or the contract? This program knows `report.json` alone, and the contract of version 4: it
//! shares nothing with the verdict's code, so an error there cannot hide itself here.

use serde_json::Value;

/// Two standard errors: the distance at which one model predicts better than another.
const APART: f64 = 2.0;

fn number(value: &Value) -> Option<f64> {
    value.as_f64()
}

fn texts(value: &Value) -> Vec<&str> {
    value.as_array().into_iter().flatten().filter_map(Value::as_str).collect()
}

fn pair(value: &Value) -> Option<[f64; 2]> {
    Some([number(&value[0])?, number(&value[1])?])
}

fn behind(row: &Value) -> Option<f64> {
    Some(-number(&row["difference"])? / number(&row["standard_error"])?.max(1e-9))
}

/// The contradictions of a report; none for a sound one.
pub fn contradictions(r: &Value) -> Vec<String> {
    let mut all = Vec::new();
    let rows: &[Value] = r["evidence"].as_array().map_or(&[], Vec::as_slice);
    shape(r, rows, &mut all);
    if r["verdict"] == "insufficient_data" {
        if !texts(&r["causes"]).is_empty() || r["causes"].as_array().is_some_and(|c| !c.is_empty()) {
            all.push("too few data, but a cause is given".into());
        }
        return all;
    }
    table(r, rows, &mut all);
    answer(r, rows, &mut all);
    gain(r, &mut all);
    all
}

/// Keys, lengths and texts.
fn shape(r: &Value, rows: &[Value], all: &mut Vec<String>) {
    if r["schema"] != "sandgait.diagnosis.v4" {
        all.push(format!("schema {}", r["schema"]));
    }
    let headline = r["headline"].as_str().unwrap_or_default();
    if headline.is_empty() || headline.chars().count() > 160 {
        all.push(format!("the headline has {} characters", headline.chars().count()));
    }
    if r["action"].as_str().unwrap_or_default().is_empty() {
        all.push("no action".into());
    }
    let next = &r["next_experiment"];
    if next.is_null() && r["verdict"] != "noise_floor" {
        all.push(format!("{} without a next experiment", r["verdict"]));
    }
    if !next.is_null() {
        let conditions = next["conditions"].as_array().map_or(0, Vec::len);
        let said = next["why"].as_str().is_some_and(|why| !why.is_empty());
        if conditions == 0 || !said || texts(&next["decides"]).len() < 2 {
            all.push("a next experiment without conditions, reason or question".into());
        }
    }
    let written = rows.iter().filter(|row| row["written"] == true).count();
    if !rows.is_empty() && written != 1 {
        all.push(format!("{written} rows are written"));
    }
    let text = format!("{} {headline}", r["summary"].as_str().unwrap_or_default());
    let named = r["verdict"] == "named";
    if named && (text.contains("no larger than noise") || text.contains("within the scatter")) {
        all.push("says that the error is no larger than noise, and names a cause of it".into());
    }
    if text.contains("raises the error") {
        all.push("says that what it writes raises the error".into());
    }
}

/// The table against the verdict.
fn table(r: &Value, rows: &[Value], all: &mut Vec<String>) {
    let Some(plain) = rows.first().filter(|row| texts(&row["ids"]).is_empty() && texts(&row["terms"]).is_empty())
    else {
        all.push("the table does not begin with the plain model".into());
        return;
    };
    let beaten = behind(plain).is_some_and(|errors| errors > APART);
    if beaten && r["verdict"] == "noise_floor" {
        all.push("noise_floor, but a model predicts left-out conditions better".into());
    }
    if beaten && r["written"] == "plain" {
        all.push("plain sand is written, but a model predicts left-out conditions better".into());
    }
    if (plain["written"] == true) != (r["written"] == "plain") {
        all.push("the table and `written` disagree".into());
    }
    let [plain, fitted, floor] =
        ["held_out_rmse_plain", "held_out_rmse_recalibrated", "noise_floor"].map(|key| number(&r["gain"][key]));
    if let (Some(plain), Some(fitted)) = (plain, fitted)
        && r["verdict"] == "noise_floor"
        && fitted < 0.8 * plain
        && plain > 1.2 * floor.unwrap_or(0.0)
    {
        all.push(format!("noise_floor, but fitted coefficients lower the error from {plain} to {fitted}"));
    }
}

/// Causes, sets and rivals.
fn answer(r: &Value, rows: &[Value], all: &mut Vec<String>) {
    let causes: &[Value] = r["causes"].as_array().map_or(&[], Vec::as_slice);
    let given = r["verdict"] == "named" || r["verdict"] == "ambiguous";
    if given == causes.is_empty() {
        all.push(format!("{} with {} causes", r["verdict"], causes.len()));
    }
    for cause in causes {
        let holds = pair(&cause["ci95"]).is_none_or(|[low, high]| low <= 0.0 && high >= 0.0);
        if holds {
            all.push(format!("{} is given, but its interval holds 0", cause["id"]));
        }
        if !["sand", "measurement", "robot"].contains(&cause["kind"].as_str().unwrap_or_default()) {
            all.push(format!("{} has no kind", cause["id"]));
        }
    }
    let named: Vec<&str> = causes.iter().filter_map(|c| c["id"].as_str()).collect();
    if r["verdict"] == "named" {
        let rival = |row: &&Value| {
            let ids = texts(&row["ids"]);
            !ids.is_empty() && !named.iter().all(|id| ids.contains(id)) && behind(row).is_some_and(|b| b < APART)
        };
        all.extend(rows.iter().filter(rival).map(|row| format!("named, but {} predicts as well", row["ids"])));
        if r["ambiguity_set"].as_array().is_none_or(|set| set.len() != 1) {
            all.push("named, with several explanations".into());
        }
    }
    if r["verdict"] == "ambiguous" {
        let set: Vec<Vec<&str>> = r["ambiguity_set"].as_array().into_iter().flatten().map(texts).collect();
        for ids in &set {
            let own = rows.iter().find(|row| texts(&row["ids"]) == *ids && texts(&row["terms"]).is_empty());
            let untested = r["untestable"]
                .as_array()
                .into_iter()
                .flatten()
                .any(|u| ids.contains(&u["id"].as_str().unwrap_or_default()));
            if !untested && own.and_then(behind).is_some_and(|errors| errors > 2.0 * APART) {
                all.push(format!("ambiguous with {ids:?}, which is far worse"));
            }
        }
    }
}

/// The gain of what is written.
fn gain(r: &Value, all: &mut Vec<String>) {
    let (reduction, ci) = (number(&r["gain"]["reduction"]), pair(&r["gain"]["ci95"]));
    let written = r["written"].as_str().unwrap_or_default();
    if written == "plain" && reduction.is_some_and(|share| share != 0.0) {
        all.push("plain sand is written, but a gain is reported".into());
    }
    let answer = ["cause", "description"].contains(&written) || r["verdict"] == "recalibrated";
    if answer && reduction.is_some_and(|share| share < 0.0) {
        all.push(format!("{written} is written, although it raises the left-out error"));
    }
    if r["verdict"] == "named" {
        if reduction.is_none_or(|share| share <= 0.0) {
            all.push("named, but what is written does not lower the left-out error".into());
        }
        if ci.is_none_or(|ci| ci[0] <= 0.0) {
            all.push("named, but the interval of the gain reaches 0".into());
        }
    }
    if (r["verdict"] == "recalibrated") && (written != "recalibrated" || r["recalibration"].is_null()) {
        all.push("recalibrated, but something else is written, or nothing is said of it".into());
    }
    let limits = r["upper_limits"].as_array().into_iter().flatten();
    let scale = limits.filter(|limit| limit["id"] == "scale").filter_map(|limit| number(&limit["value"]));
    // What coefficients absorbed is a part of the limit of the strength.
    if let Some(factor) = number(&r["recalibration"]["factor"]).filter(|_| written == "recalibrated") {
        let moved = (factor - 1.0).abs();
        all.extend(
            scale
                .filter(|most| *most < 0.5 * moved)
                .map(|most| format!("scale < {most}, but forces are off by {moved}")),
        );
    }
}
