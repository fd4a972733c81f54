//! Figure 5: forward speed over the knee angle ξ.

use super::assumptions::variants;
use super::claims::{Claim, extremes};
use super::{FigureSection, ReportTable};
use crate::error::Result;
use crate::plot::{Axis, Figure, FigurePanel, Mark, Style, color};
use crate::progress::Silent;
use crate::sand::Law;
use crate::sim::engine::EngineKind;
use crate::sim::walk::WalkResult;
use crate::sweep::walk_all;

/// The paper's representative stride frequencies [Hz].
const FREQUENCIES: [f64; 2] = [1.0, 4.0];

/// Knee angles [°].
fn angles() -> Vec<f64> {
    (-15..=15).map(|k| f64::from(k) * 5.0).collect()
}

/// For each knee angle ξ, first the walk of the declared robot, then the walks of its variants.
fn walk(law: Law, frequency: f64) -> Result<Vec<Vec<WalkResult>>> {
    let (mut trials, mut width) = (Vec::new(), 1);
    for xi in angles() {
        let designs = variants(law, xi, frequency, false)?;
        width = designs.len();
        for design in designs {
            trials.push(design.trial()?);
        }
    }
    Ok(walk_all(EngineKind::Lanes, &trials, &Silent)?.chunks(width).map(<[WalkResult]>::to_vec).collect())
}

pub fn part() -> Result<FigureSection> {
    let mut panels = Vec::new();
    let mut claims = agreement();
    for (f, seed) in FREQUENCIES.into_iter().zip([3.0, 2.0]) {
        let (rft, one) = (walk(Law::Li2013, f)?, walk(Law::PenetrationDrag1d, f)?);
        panels.push(panel(f, &rft, &one));
        claims.push(positive_faster(f, &rft));
        claims.push(baseline(f, seed, &rft, &one));
    }
    let figure = Figure {
        title: "Figure 5: forward speed over leg shape".into(),
        columns: 2,
        panels,
        note: "ξ > 0: the convex side leads (L-leg); ξ < 0: reversed. Bands: assumptions varied one at a time. The paper's measured points are not public.".into(),
    };
    Ok(FigureSection {
        heading: "Figure 5: leg shape",
        figures: vec![("figure5", figure)],
        tables: Vec::<ReportTable>::new(),
        claims,
    })
}

fn panel(frequency: f64, rft: &[Vec<WalkResult>], one: &[Vec<WalkResult>]) -> FigurePanel {
    let line =
        |rows: &[Vec<WalkResult>]| angles().into_iter().zip(rows).map(|(x, r)| [x, 100.0 * r[0].speed]).collect();
    let band = |rows: &[Vec<WalkResult>]| {
        let ends = |r: &Vec<WalkResult>| extremes(r.iter().map(|w| 100.0 * w.speed));
        angles().into_iter().zip(rows).map(|(x, r)| (x, ends(r))).map(|(x, [l, h])| [x, l, h]).collect()
    };
    let mut marks = vec![
        Mark::band("RFT over the assumptions", color::BLUE, band(rft)),
        Mark::band("1D over the assumptions", color::GREY, band(one)),
        Mark::line("RFT", Style::line(color::BLUE).with_dots(), line(rft)),
        Mark::line("1D penetration and drag", Style::line(color::BLACK).dotted(), line(one)),
    ];
    if frequency > 2.0 {
        marks.push(Mark::Horizontal { at: 50.0, text: "RFT is valid below 0.5 m/s".into() });
    }
    FigurePanel {
        title: format!("f = {frequency:.0} Hz"),
        x: Axis::within("knee angle ξ [°]", -80.0, 80.0),
        y: Axis::new("forward speed v_x [cm/s]"),
        marks,
    }
}

fn agreement() -> Vec<Claim> {
    let why = "the measured speeds are in figure 5 only and not public";
    let ours = "curve computed, see figure 5";
    vec![
        Claim::no_data(
            "5.within_10_50",
            "Simulation captured v_x(ξ) within 10 % for ξ > 0 and within 50 % for ξ < 0",
            "10 %, 50 %",
            ours,
            why,
        ),
        Claim::no_data(
            "5.within_30_50",
            "Agreement within 30 % at 1 Hz and within 50 % at 4 Hz",
            "30 %, 50 %",
            ours,
            why,
        ),
    ]
}

/// Pairs of rows at +ξ and −ξ.
fn pairs(rows: &[Vec<WalkResult>]) -> impl Iterator<Item = (f64, &Vec<WalkResult>, &Vec<WalkResult>)> {
    let last = rows.len() - 1;
    let middle = rows.len() / 2;
    (middle + 1..rows.len()).map(move |i| (5.0 * (i - middle) as f64, &rows[i], &rows[last - i]))
}

fn positive_faster(frequency: f64, rft: &[Vec<WalkResult>]) -> Claim {
    let ratios: Vec<f64> = pairs(rft).map(|(_, p, n)| p[0].speed / n[0].speed).collect();
    let [low, high] = extremes(ratios.iter().copied());
    let [least, _] = extremes(pairs(rft).flat_map(|(_, p, n)| p.iter().zip(n).map(|(a, b)| a.speed / b.speed)));
    Claim::new(
        &format!("5.positive_faster_{frequency:.0}hz"),
        &format!("v_x is higher with positive ξ than with negative ξ, f = {frequency:.0} Hz"),
        "higher",
        format!("× {low:.3} to × {high:.3} at equal |ξ| from 5° to 75°"),
        low > 1.0,
        format!("15 pairs of legs; at least × {least:.3} over all assumptions"),
    )
}

fn baseline(frequency: f64, seed: f64, rft: &[Vec<WalkResult>], one: &[Vec<WalkResult>]) -> Claim {
    let highest = |k: usize| {
        let each = rft.iter().zip(one).zip(angles()).map(|((r, o), xi)| (o[k].speed / r[k].speed, xi));
        each.fold((0.0, 0.0), |best, now| if now.0 > best.0 { now } else { best })
    };
    let (ratio, at) = highest(0);
    let band = extremes((0..rft[0].len()).map(|k| highest(k).0));
    let value = format!("up to {:+.0} %", 100.0 * (seed - 1.0));
    let claim = format!("1D models over-predicted v_x(ξ) by {value} at f = {frequency:.0} Hz")
        .replace("by up to +", "by up to ");
    let note = format!("Largest ratio over ξ, at ξ = {at:.0}°; against RFT because the measurement is not public.")
        .replace("= -", "= −");
    Claim::ratio(&format!("5.1d_{frequency:.0}hz"), &claim, &value, seed, ratio, band, &note)
}
