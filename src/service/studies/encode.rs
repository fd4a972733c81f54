//! Turns results into tables: columns of f64 with names and units.

use crate::diagnose::report::Curves;
use crate::evaluate::{self, EvaluationRow};
use crate::proto::{Series, Table};
use crate::sand::intruder::{Status, TrialOutcome};
use crate::sand::intrusion::Load;
use crate::sim::walk::{WalkResult, WalkTrial};
use crate::sweep::optimize::Optimum;
use crate::sweep::{SweepAxis, table::values};

pub fn table(columns: Vec<Series>, warnings: Vec<String>) -> Table {
    Table { columns, warnings }
}

fn numbers(name: &str, unit: &str, values: impl Iterator<Item = f64>) -> Series {
    let unit = if unit.is_empty() { "1" } else { unit };
    let numbers = values.flat_map(f64::to_le_bytes).collect::<Vec<_>>().into();
    Series { name: name.into(), unit: unit.into(), numbers, names: Vec::new() }
}

fn names<'a>(name: &str, values: impl Iterator<Item = &'a str>) -> Series {
    Series { name: name.into(), names: values.map(str::to_owned).collect(), ..Series::default() }
}

pub fn loads(rows: &[(f64, Load)]) -> Vec<Series> {
    vec![
        numbers("theta", "rad", rows.iter().map(|r| r.0)),
        numbers("Fx", "N", rows.iter().map(|r| r.1.fx)),
        numbers("Fz", "N", rows.iter().map(|r| r.1.fz)),
        numbers("Ty", "N·m", rows.iter().map(|r| r.1.ty)),
    ]
}

pub fn trials(rows: &[TrialOutcome]) -> Vec<Series> {
    type Of = fn(&TrialOutcome) -> f64;
    let columns: [(&str, &str, Of); 8] = [
        ("Fx", "N", |o| o.force[0]),
        ("Fy", "N", |o| o.force[1]),
        ("Fz", "N", |o| o.force[2]),
        ("Tx", "N·m", |o| o.torque[0]),
        ("Ty", "N·m", |o| o.torque[1]),
        ("Tz", "N·m", |o| o.torque[2]),
        ("depth", "m", |o| o.depth),
        ("no_equilibrium", "1", |o| f64::from(o.status == Status::NoEquilibrium)),
    ];
    columns.iter().map(|(name, unit, of)| numbers(name, unit, rows.iter().map(of))).collect()
}

pub fn frequencies(trials: &[WalkTrial]) -> Series {
    numbers("frequency", "Hz", trials.iter().map(|t| t.frequency))
}

/// The cost of transport of a robot that stands is undefined: NaN.
pub fn walks(results: &[WalkResult]) -> Vec<Series> {
    type Of = fn(&WalkResult) -> f64;
    let columns: [(&str, &str, Of); 8] = [
        ("speed", "m/s", |r| r.speed),
        ("base_height", "m", |r| r.base_height),
        ("pitch_rms", "rad", |r| r.pitch_rms),
        ("hip_torque_rms", "N·m", |r| r.hip_torque_rms),
        ("hip_speed_error_rms", "rad/s", |r| r.hip_speed_error_rms),
        ("cost_of_transport", "1", |r| r.cost_of_transport),
        ("sink", "m", |r| r.sink),
        ("drift", "m", |r| r.drift),
    ];
    columns.iter().map(|(name, unit, of)| numbers(name, unit, results.iter().map(of))).collect()
}

pub fn grid(axes: &[SweepAxis], results: &[WalkResult]) -> Vec<Series> {
    let axis = |(k, axis): (usize, &SweepAxis)| {
        let cells = (0..results.len()).map(|i| values(axes, i)[k]);
        let parameter = &axis.parameter;
        match axis.numbers() {
            Some(_) => numbers(parameter.name, parameter.unit, cells.filter_map(|c| c.parse().ok())),
            None => names(parameter.name, cells),
        }
    };
    axes.iter().enumerate().map(axis).chain(walks(results)).collect()
}

pub fn optimum(axes: &[SweepAxis], best: &Optimum) -> Vec<Series> {
    let value =
        |(axis, value): (&SweepAxis, &f64)| numbers(axis.parameter.name, axis.parameter.unit, [*value].into_iter());
    axes.iter().zip(&best.values).map(value).chain(walks(&[best.result])).collect()
}

pub fn evaluation(rows: &[EvaluationRow]) -> Vec<Series> {
    let media = names("medium", rows.iter().map(|r| r.medium.as_str()));
    let columns = evaluate::table::columns(rows).into_iter().map(|c| numbers(&c.name, c.unit, c.values.into_iter()));
    std::iter::once(media).chain(columns).collect()
}

/// One row for each sample, in the order of the observations.
pub fn curves(c: &Curves) -> Vec<Series> {
    let o = &c.observations;
    let each = |of: &dyn Fn(usize) -> String| -> Vec<String> {
        o.units.iter().enumerate().flat_map(|(u, unit)| std::iter::repeat_n(of(u), unit.samples)).collect()
    };
    let mut columns = vec![
        Series { name: "trial".into(), names: each(&|u| o.units[u].id.clone()), ..Series::default() },
        Series {
            name: "condition".into(),
            names: each(&|u| o.conditions[o.units[u].condition].clone()),
            ..Series::default()
        },
        Series { name: "shape".into(), names: each(&|u| c.groups[u].clone()), ..Series::default() },
        numbers("progress", "rad or m", o.units.iter().flat_map(|u| u.progress.iter().copied())),
    ];
    for (k, channel) in o.channels.iter().enumerate() {
        let stack = |name: String, values: &[f64]| {
            numbers(&name, channel.unit, o.units.iter().flat_map(|u| u.block(k)).map(|i| values[i]))
        };
        columns.push(stack(channel.name.to_string(), &o.values));
        columns.push(stack(format!("{}_plain", channel.name), &c.plain));
        columns.push(stack(format!("{}_extended", channel.name), c.extended.as_ref().unwrap_or(&c.plain)));
        columns.push(stack(format!("{}_sd", channel.name), &c.band));
    }
    columns
}
