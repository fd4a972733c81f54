//! Other comparisons: discs of several sizes, a simulation of single grains, and walks and robots by independent codes.

use super::{data, robots};
use crate::calibrate::pushes::{self, PressureLaw};
use crate::error::Result;
use crate::parallel;
use crate::progress::Progress;
use crate::reproduce;
use crate::sand::Medium;
use crate::sim::engine::EngineKind;
use crate::sim::model::Scene;
use crate::sim::walk::{self, WalkTrial};
use crate::sim::{Model, Robot};
use std::fmt::Write as _;

/// Stride frequencies of the walks [Hz]: those of the walks of the other implementations.
const FREQUENCIES: [f64; 4] = [1.0, 2.0, 3.0, 5.0];

/// Forward speeds [m/s] of `xplorer` on loose poppy seeds at [`FREQUENCIES`]. They come from two other implementations,
/// which share no code with this program; with explicit steps of 10⁻⁵ s, their results have converged. With L-legs and
/// a hard leading edge, MuJoCo 4.0.0 and rapier's multibodies agree with one of the two within 1 %.
const WALKS: [(&str, [f64; 4]); 2] =
    [("L", [0.1201, 0.2870, 0.4161, 0.7139]), ("revL", [0.0715, 0.1308, 0.2401, 0.4387])];

/// A comparison: its name, and what computes its text.
type ComparedPart = (&'static str, fn() -> Result<String>);

/// The comparisons as Markdown. An error of `progress` stops the work before the next one.
pub fn text(progress: &dyn Progress) -> Result<String> {
    const PARTS: [ComparedPart; 4] = [("discs", discs), ("grains", grains), ("walks", walks), ("robots", robots::text)];
    let part = |(k, (name, text)): (usize, &ComparedPart)| {
        progress.report(k as f64 / PARTS.len() as f64, name)?;
        text()
    };
    Ok(PARTS.iter().enumerate().map(part).collect::<Result<Vec<_>>>()?.join("\n"))
}

/// Compares laws for discs: each predicts pushes and disc sizes to which it was not fitted.
fn discs() -> Result<String> {
    let study = pushes::compare(&data::own_discs()?, None)?;
    let mut text = String::from(
        "## Discs of three sizes pushed into the wheels' sand\n\nThese measurements have the same source and licence. Errors are the root \
         mean square of ln(predicted/measured), without the first tenth of the depth. Each push is predicted from a fit on the other \
         pushes, and each size from a fit on the other sizes. The first row is plain theory.\n\n\
         | law | error for another push % | error for another size % |\n|---|---|---|\n",
    );
    for s in &study.laws {
        let size = s.other_size_percent.map_or("-".into(), |p| format!("{p:.1}"));
        let formula = s.formula.replace('|', "\\|");
        let _ = writeln!(text, "| {formula} | {:.1} | {size} |", s.other_push_percent);
    }
    let plain = study.sizes.iter().map(|s| format!("{:.2} at {:.0} mm", s.zeta, 1e3 * s.diameter));
    let _ = writeln!(text, "\nScale ζ of each disc [N/cm³]: {}.", plain.collect::<Vec<_>>().join(", "));
    let missed = study.laws.iter().filter(|s| s.law == PressureLaw::Proportional).find_map(|s| s.other_size_percent);
    if let Some(missed) = missed {
        let _ = writeln!(
            text,
            "Plain theory that is calibrated with one disc has an error of {missed:.0} % for a disc of another size."
        );
    }
    Ok(text)
}

/// The comparison with legs that rotate through simulated grains, from `sandgait reproduce`.
fn grains() -> Result<String> {
    let table = reproduce::grains()?;
    let mut text =
        format!("## ComparedPart with simulated grains\n\n{}\n\n| {} |\n", table.caption, table.head.join(" | "));
    let _ = writeln!(text, "|{}", "---|".repeat(table.head.len()));
    for row in &table.rows {
        let _ = writeln!(text, "| {} |", row.join(" | "));
    }
    text += "\nThe scale ζ was fitted to slow vertical plates in the same grains. No other number was fitted.\n";
    Ok(text)
}

/// Compares walking speeds with the results of independent codes.
fn walks() -> Result<String> {
    let trial = |leg: &str, frequency: f64| -> Result<WalkTrial> {
        let scene = Scene::flat(Medium::named("poppy-loose")?);
        Ok(WalkTrial::new(Model::new(&Robot::load("xplorer")?.with_leg_shape(leg)?, &scene)?, frequency))
    };
    let each = WALKS.iter().flat_map(|(leg, speeds)| FREQUENCIES.iter().zip(speeds).map(move |(f, v)| (*leg, *f, *v)));
    let trials = each.clone().map(|(leg, f, _)| trial(leg, f)).collect::<Result<Vec<_>>>()?;
    let speeds = parallel::map(&trials, |trial| walk::walk(EngineKind::Lanes, trial).map(|r| r.speed));
    let mut text = String::from(
        "## ComparedPart with walks of independent programs\n\nForward speed of `xplorer` on loose poppy seeds. The reference comes from two \
         other programs, which share no code with sandgait. They solve the same equations with explicit steps of 10⁻⁵ s, at which they \
         have converged. With a hard leading edge MuJoCo 4.0.0 and rapier's multibodies agree with them within 1 %. This is a test of \
         the integration and not of the sand, because no walk of a real robot was compared.\n\n\
         | leg | stride frequency [Hz] | reference [m/s] | sandgait [m/s] | difference % |\n|---|---|---|---|---|\n",
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
