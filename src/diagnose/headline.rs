//! The first lines of a report: what is wrong, how much, how sure, and what to do.

use super::nuisance::{CauseKind, NuisanceKind, kind};
use super::report::{Cause, Report};
use super::split::percent;
use super::verdict::{Verdict, Written};
use super::words::{after, capital, digits, of};
use crate::sand::mechanism::{CATALOG, Side};

/// Most characters of a headline.
pub const MOST: usize = 160;

/// What each mechanism is, in words that need no list of identifiers.
const PHRASES: [(&str, &str); 19] = [
    ("inertial_drag", "a drag that grows with the square of the speed"),
    ("concave_fill", "grains held in the concave side of the leg"),
    ("footprint", "ground that was used before"),
    ("added_mass", "sand that is accelerated with the intruder"),
    ("depth_power", "a stress that grows with another power of the depth"),
    ("cohesion", "cohesion of the sand"),
    ("size_power", "a stress that grows with the size of the intruder"),
    ("scale", "sand of another strength"),
    ("packing_grad", "packing that changes along the bed"),
    ("slope", "a sloping surface"),
    ("rate_log", "a stress that grows with the logarithm of the speed"),
    ("friction_clip", "a smooth surface of the intruder"),
    ("skid_loss", "less support where the body skids"),
    ("graze_loss", "less support of faces that travel along themselves"),
    ("slip_bearing", "more support where the body slips"),
    ("compliance", "an elastic mounting of the leg"),
    ("motor_torque_limit", "motors that saturate"),
    ("bias_x", "the zero of the load cell is off"),
    ("bias_z", "the zero of the load cell is off"),
];

/// Ids of effects of measuring that have the name of a mechanism of the sensor.
const SENSOR: [(&str, &str); 3] = [("sensor_tilt", "tilt"), ("bias_x", "offset"), ("bias_z", "offset")];

/// The kind of nuisance that an answer's id stands for.
fn nuisance(id: &str) -> &str {
    SENSOR.iter().find(|s| s.0 == id).map_or(id, |s| s.1)
}

/// What an answer of unknown value is, in words.
fn phrase(id: &str) -> String {
    let known = PHRASES.iter().find(|p| p.0 == id).map(|p| p.1.to_string());
    known.or_else(|| kind(nuisance(id)).map(|k| k.said(None))).unwrap_or("a law of another form".into())
}

/// Is what is wrong the sand, the measurement or the robot?
pub fn kind_of_mechanism(id: usize) -> CauseKind {
    match (CATALOG[id].side, CATALOG[id].id) {
        (Side::Sand, _) => CauseKind::Sand,
        (Side::Drive, "motor_torque_limit") => CauseKind::Robot,
        _ => CauseKind::Measurement,
    }
}

/// A cause in words, with its value: `the plate or leg is tilted (attitude of Pn 0.036 rad ± 0.003)`.
fn found(c: &Cause) -> String {
    let of = of(c.of.as_deref());
    let half = 0.5 * (c.ci95[1] - c.ci95[0]);
    let what = kind(&c.id).map_or_else(|| phrase(&c.id), |kind| kind.said(Some(c.value)));
    let degrees = match (&*c.unit, c.kind) {
        ("rad", CauseKind::Measurement) => format!(" by {:.1}° (±{:.1}°)", c.value.to_degrees(), half.to_degrees()),
        _ => String::new(),
    };
    format!("{what}{degrees} ({}{of} {} ± {}{})", c.id, digits(c.value), digits(half), after(&c.unit))
}

/// Joins clauses while they fit into a headline.
fn fitting(clauses: impl IntoIterator<Item = String>) -> String {
    let mut all = String::new();
    for clause in clauses {
        let next = if all.is_empty() { clause } else { format!("{all}; {clause}") };
        if next.chars().count() <= MOST {
            all = next;
        } else if all.is_empty() {
            all = next.chars().take(MOST - 1).chain(['…']).collect();
        }
    }
    capital(&all)
}

/// How far measured forces are from the prediction. A robot's readings are no forces, so how strong its sand is.
pub fn below(r: &Report) -> Option<String> {
    let Some(recalibration) = &r.recalibration else { return None };
    let [low, high] = recalibration.ci95;
    if r.verdict == Verdict::Recalibrated && (low..=high).contains(&1.0) {
        return Some("the sand is as strong as stated on average, but single coefficients differ".into());
    }
    let share = 100.0 * (recalibration.factor - 1.0);
    let [side, than] = if share < 0.0 { ["below", "weaker"] } else { ["above", "stronger"] };
    let forces = r.gain.in_units.as_ref().is_none_or(|gain| gain.unit == "N");
    Some(match forces {
        true => format!("measured forces are {:.0} % {side} the prediction", share.abs()),
        false => format!("the sand is {:.0} % {than} than stated", share.abs()),
    })
}

/// What is wrong, how much and how sure: at most [`MOST`] characters.
pub fn headline(r: &Report) -> String {
    let gain = r.gain.reduction.map(|share| format!("left-out error {}", percent(-share)));
    let gain = gain.filter(|_| r.written != Written::Plain);
    let split = r.split.as_ref().map(|s| format!("forces err by {}", s.said()));
    let alarm = r.warnings.iter().find_map(|w| w.strip_prefix(ALARM)).map(String::from);
    let mut clauses = Vec::new();
    match r.verdict {
        Verdict::InsufficientData => {
            clauses.push("too few data to name a cause".into());
            clauses.extend(below(r));
            clauses.extend(r.warnings.last().filter(|_| alarm.is_none()).cloned());
        }
        Verdict::NoiseFloor => {
            clauses.push("no error of the sand shows: the plain model is as good as the repetitions allow".into());
        }
        Verdict::Recalibrated => {
            clauses.extend(below(r));
            clauses.push("the law fits, and the sand file has the fitted coefficients".into());
        }
        Verdict::Named => {
            let bed = |c: &Cause| kind(&c.id).is_some_and(NuisanceKind::may_be_of_beds);
            let sand = r.causes.iter().any(|c| c.kind == CauseKind::Sand || bed(c));
            clauses.push(r.causes.iter().map(found).collect::<Vec<_>>().join(" and "));
            clauses.extend((!sand).then(|| "not the sand".to_string()));
        }
        Verdict::Ambiguous => {
            let sets = r.ambiguity_set.iter().take(2);
            let all = sets.map(|ids| ids.iter().map(|id| phrase(id)).collect::<Vec<_>>().join(" with "));
            let names = r.ambiguity_set.iter().map(|ids| ids.join(" + ")).collect::<Vec<_>>().join(" or ");
            clauses.push(format!("{}: these data cannot tell", all.collect::<Vec<_>>().join(", or ")));
            clauses.push(names);
        }
        Verdict::Described => {
            clauses.push("no known cause explains the error; a law found in the data describes it".into());
        }
        Verdict::NoneOfThese => {
            clauses.push("no known cause explains the error".into());
            clauses.extend(below(r).filter(|_| r.written == Written::Recalibrated));
            clauses.extend(split);
        }
    }
    let first = clauses.len().min(1);
    clauses.splice(first..first, alarm);
    clauses.extend(gain);
    fitting(clauses)
}

/// The beginning of a warning that the headline must have; what follows is in the headline.
pub const ALARM: &str = "Attention: ";

/// What to do.
pub fn action(r: &Report) -> String {
    let remedy = |c: &Cause| {
        let of = c.of.as_ref().map_or_else(|| c.id.clone(), |of| format!("{of}: {}", c.id));
        kind(nuisance(&c.id)).map(|k| format!("{} ({of} {}{})", k.remedy, digits(c.value), after(&c.unit)))
    };
    let next = || {
        let first = r.next_experiment.as_ref().and_then(|next| next.conditions.first());
        first
            .map_or("Make the next experiment".into(), |p| format!("Measure {} ({} times)", p.condition, p.repetitions))
    };
    match r.verdict {
        Verdict::InsufficientData => next(),
        Verdict::NoiseFloor => {
            "Use the stated sand. More accurate data, or more repetitions, could still show a cause.".into()
        }
        Verdict::Recalibrated => "Simulate with sand.toml, which has the fitted coefficients.".into(),
        Verdict::Named => {
            let measured: Vec<String> =
                r.causes.iter().filter(|c| c.kind != CauseKind::Sand).filter_map(remedy).collect();
            let bed = |c: &Cause| kind(&c.id).is_some_and(NuisanceKind::may_be_of_beds);
            let sand = r.causes.iter().any(|c| c.kind == CauseKind::Sand || bed(c));
            let file = "Simulate with sand.toml, within its range of validity";
            let mut all = measured;
            all.extend(sand.then(|| file.to_string()));
            if all.is_empty() { format!("{file}.") } else { format!("{}.", all.join(". ")) }
        }
        Verdict::Ambiguous => {
            format!("{}: it separates the explanations. Until then sand.toml has the best of them.", next())
        }
        Verdict::Described => {
            "Simulate with sand.toml, within its range of validity. Its law describes these data and names no cause."
                .into()
        }
        Verdict::NoneOfThese => match r.split.as_ref() {
            Some(split) => {
                let stand_in = if r.written == Written::Plain { "" } else { " sand.toml is a stand-in until then." };
                format!("Look for what differs {}, against {}.{stand_in}", split.parts[1].name, split.parts[0].name)
            }
            None => next(),
        },
    }
}
