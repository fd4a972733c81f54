//! Numbers of the paper's text without a figure: cost of computing, fitted parameters.

use super::assumptions::{XI_DEG, robot};
use super::{Claim, FigureSection, ReportTable};
use crate::error::Result;
use crate::sand::Law;
use crate::sim::engine::EngineKind;
use crate::sim::walk::walk;
use std::time::Instant;

/// Upper bounds of the cost of one simulated second [s]. `claims.json` gives the next bound above the measured time, so
/// that the file is the same in every run; the report gives the measured time. Powers of ten are our choice.
const COSTS: [f64; 4] = [0.1, 1.0, 10.0, 100.0];

pub fn part() -> FigureSection {
    let seconds = cost().unwrap_or(f64::NAN);
    let bound = COSTS.into_iter().find(|c| seconds < *c).unwrap_or(f64::INFINITY);
    let mut table = ReportTable::new(
        "Cost of computing, measured while this report was made.",
        &["simulation", "seconds for 1 s of walking"],
    );
    let row = |name: &str, cost: String| vec![name.to_owned(), cost];
    table.rows = vec![
        row("this program, one robot on one core", format!("{seconds:.4}")),
        row("the paper's multi-body simulation (MBDyn)", "~ 10".into()),
        row("the paper's estimate for discrete elements", "2.6 million (30 days)".into()),
    ];
    FigureSection {
        heading: "Sections 4 and 6: cost and parameters",
        figures: Vec::new(),
        tables: vec![table],
        claims: claims(bound),
    }
}

/// Wall-clock time for one simulated second of the declared robot (`assumptions::robot`) at 2 Hz [s], the least of three.
fn cost() -> Result<f64> {
    let trial = robot(Law::Li2013, XI_DEG, 2.0)?.trial()?;
    let once = || -> Result<f64> {
        let start = Instant::now();
        walk(EngineKind::Lanes, &trial)?;
        Ok(start.elapsed().as_secs_f64() / trial.duration())
    };
    Ok(once()?.min(once()?).min(once()?))
}

fn claims(bound: f64) -> Vec<Claim> {
    vec![
        Claim::new(
            "4.cost",
            "The simulation required ~ 10 s to simulate 1 s of locomotion",
            "~ 10 s",
            format!("less than {bound} s"),
            bound <= 10.0,
            "as fast or faster counts as reproduced; other code on another machine, the figure itself is in the report",
        ),
        Claim::new(
            "6.no_fit",
            "Without any fitting parameters",
            "0",
            "0",
            true,
            "published coefficients throughout; no constant was adjusted to the paper's results",
        ),
        Claim::no_data(
            "6.two_parameters",
            "A previous study with the vertical penetration model needed two fitting parameters",
            "2",
            "the 1D baseline here has none",
            "another paper's model of another robot",
        ),
        Claim::no_data(
            "6.dem",
            "Discrete elements: 5 million seeds and 30 days to simulate 1 s",
            "5 million, 30 days",
            "not computed",
            "an estimate for the paper's bed; our stand-in bed has about 35,000 grains of 4 mm and was computed elsewhere",
        ),
    ]
}
