//! Other comparisons: discs of several sizes, a simulation of single grains, and walks and robots by independent codes.

use super::{data, robots};
use crate::calibrate::pushes::{self, Law as PushLaw};
use crate::error::Result;
use crate::parallel;
use crate::reproduce;
use crate::sand::Medium;
use crate::sim::engine::EngineKind;
use crate::sim::model::Scene;
use crate::sim::walk::{self, Trial};
use crate::sim::{Model, Robot};
use std::fmt::Write as _;

/// Stride frequencies of the walks [Hz].
const FREQUENCIES: [f64; 4] = [1.0, 2.0, 3.0, 5.0];

/// Forward speeds [m/s] of `xplorer` on loose poppy seeds at [`FREQUENCIES`], from two implementations that share no code with
/// this one, converged with explicit steps of 10⁻⁵ s; the same robots with a hard leading edge in MuJoCo 4.0.0 and in rapier's
/// multibodies agree with one of them within 1 % (L).
const WALKS: [(&str, [f64; 4]); 2] =
    [("L", [0.1201, 0.2870, 0.4161, 0.7139]), ("revL", [0.0715, 0.1308, 0.2401, 0.4387])];

/// The comparisons as Markdown.
pub fn text() -> Result<String> {
    Ok(format!("{}\n{}\n{}\n{}", discs()?, grains()?, walks()?, robots::text()?))
}

/// ζ of one disc, compared with the other discs.
fn discs() -> Result<String> {
    let study = pushes::compare(&data::own_discs()?, None)?;
    let mut text = String::from(
        "## Discs of three sizes pushed into the wheels' sand\n\nMeasured, same source and licence. Root mean square of \
         ln(predicted/measured) below the first tenth of the depth; fitted on the other pushes, or on the other sizes. Plain theory \
         is the first row.\n\n| law | another push % | another size % |\n|---|---|---|\n",
    );
    for s in &study.laws {
        let size = s.other_size_percent.map_or("-".into(), |p| format!("{p:.1}"));
        let formula = s.formula.replace('|', "\\|");
        let _ = writeln!(text, "| {formula} | {:.1} | {size} |", s.other_push_percent);
    }
    let plain = study.sizes.iter().map(|s| format!("{:.2} at {:.0} mm", s.zeta, 1e3 * s.diameter));
    let _ = writeln!(text, "\nζ in N/cm³: {}.", plain.collect::<Vec<_>>().join(", "));
    let missed = study.laws.iter().filter(|s| s.law == PushLaw::Proportional).find_map(|s| s.other_size_percent);
    if let Some(missed) = missed {
        let _ =
            writeln!(text, "Plain theory, calibrated with one disc, errs by {missed:.0} % for a foot of another size.");
    }
    Ok(text)
}

/// Legs rotated through grains, from `sandgait reproduce`.
fn grains() -> Result<String> {
    let table = reproduce::grains()?;
    let mut text = format!("## Grains simulated one by one\n\n{}\n\n| {} |\n", table.caption, table.head.join(" | "));
    let _ = writeln!(text, "|{}", "---|".repeat(table.head.len()));
    for row in &table.rows {
        let _ = writeln!(text, "| {} |", row.join(" | "));
    }
    text += "\nζ comes from slow vertical plates in the same grains; nothing else was fitted.\n";
    Ok(text)
}

/// Walking speeds compared with those of independent codes.
fn walks() -> Result<String> {
    let trial = |leg: &str, frequency: f64| -> Result<Trial> {
        let scene = Scene::flat(Medium::named("poppy-loose")?);
        Ok(Trial::new(Model::new(&Robot::load("xplorer")?.with_leg_shape(leg)?, &scene)?, frequency))
    };
    let each = WALKS.iter().flat_map(|(leg, speeds)| FREQUENCIES.iter().zip(speeds).map(move |(f, v)| (*leg, *f, *v)));
    let trials = each.clone().map(|(leg, f, _)| trial(leg, f)).collect::<Result<Vec<_>>>()?;
    let speeds = parallel::map(&trials, |trial| walk::walk(EngineKind::Lanes, trial).map(|r| r.speed));
    let mut text = String::from(
        "## Walks by independent codes\n\nForward speed of `xplorer` on loose poppy seeds. The reference is from two other codes, \
         which share nothing with this one and solve the same equations with explicit steps of 10⁻⁵ s, at which they have \
         converged. MuJoCo 4.0.0 and rapier's multibodies agree with them within 1 % where the leading edge is hard. This \
         compares the integration, not the sand: no walk of a real robot was compared.\n\n| leg | stride frequency [Hz] | reference [m/s] | sandgait [m/s] | off by % |\n|---|---|---|---|---|\n",
    );
    for ((leg, frequency, reference), speed) in each.zip(speeds) {
        let speed = speed?;
        let _ = writeln!(
            text,
            "| {leg} | {frequency} | {reference:.4} | {speed:.4} | {:+.1} |",
            100.0 * (speed / reference - 1.0)
        );
    }
    Ok(text)
}
