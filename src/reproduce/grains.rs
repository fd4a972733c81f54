//! Data that replace figure 3's measured curves: legs rotated through grains that were simulated one by one. This
//! is our simulated experiment, not the paper's; it uses no RFT code.

use super::ReportTable;
use super::claims::{extremes, signed};
use super::legs::{CHORD, COMPONENTS, Component, SEGMENTS, StandIn, WIDTH};
use crate::error::Result;
use crate::plot::{Axis, Figure, FigurePanel, Mark, Style, color};
use crate::sand::intrusion::{Load, rotating_leg};
use crate::sand::{Law, LegShape, Medium, Regularization, SandBed};
use crate::table::{self, HeaderColumn, Quantity, ReadOptions};

const DATA: &[u8] = include_bytes!("legs.csv");
/// ζ [N/cm³] from slow vertical plates in the same grains.
const ZETA: f64 = 0.46;
/// Height of the hip above the bed in the simulated experiment [m] (`legs.csv`).
const HIP: f64 = 0.02;
/// Width of the bins of leg angle [°]: our choice. Wider bins hide where a law is wrong; narrow ones have few samples.
const STRETCH: f64 = 15.0;

/// Mean over the beds, for one leg and one speed.
struct MeanRun {
    shape: String,
    /// [rad/s]
    omega: f64,
    /// θ [rad], mean load, and half the difference between the beds.
    samples: Vec<(f64, Load, Load)>,
}

fn runs() -> Result<Vec<MeanRun>> {
    const COLUMNS: [HeaderColumn; 5] = [
        HeaderColumn::needed("shape", Quantity::Text),
        HeaderColumn::needed("theta", Quantity::Angle),
        HeaderColumn::needed("omega", Quantity::AngularSpeed),
        HeaderColumn::needed("Fx", Quantity::Force),
        HeaderColumn::needed("Fz", Quantity::Force),
    ];
    let mut runs: Vec<MeanRun> = Vec::new();
    table::parse(std::path::Path::new("legs.csv"), DATA, &ReadOptions::new(&COLUMNS), |row| {
        let (shape, theta, omega) = (row.needed_text(0)?, row.needed(1)?, row.needed(2)?);
        let load = Load { fx: row.needed(3)?, fz: row.needed(4)?, ty: 0.0 };
        let k = runs.iter().position(|r| r.shape == shape && r.omega == omega).unwrap_or_else(|| {
            runs.push(MeanRun { shape: shape.to_owned(), omega, samples: Vec::new() });
            runs.len() - 1
        });
        // Both beds are sampled at the same angles. A row of the second bed is combined with the first bed's row at the
        // same angle: the result is the mean of both rows and half of their difference.
        match runs[k].samples.iter_mut().find(|s| (s.0 - theta).abs() < 1e-9) {
            Some((_, mean, half)) => {
                *half = Load { fx: (mean.fx - load.fx).abs() / 2.0, fz: (mean.fz - load.fz).abs() / 2.0, ty: 0.0 };
                *mean = Load { fx: (mean.fx + load.fx) / 2.0, fz: (mean.fz + load.fz) / 2.0, ty: 0.0 };
            }
            None => runs[k].samples.push((theta, load, Load::default())),
        }
        Ok(())
    })?;
    Ok(runs)
}

/// Errors of a law for one run and one component of the force.
struct LawFit {
    /// Root mean square error divided by the greatest measured force.
    rms: f64,
    /// Ratio of the greatest forces, law over measured.
    peaks: f64,
    /// Centre of the bin of θ with the largest mean error [°], and this error divided by the greatest measured force.
    worst: (f64, f64),
}

fn fit(run: &MeanRun, predicted: &[f64], of: Component) -> LawFit {
    let measured: Vec<f64> = run.samples.iter().map(|s| of(&s.1)).collect();
    let greatest = measured.iter().copied().fold(0.0, f64::max);
    let errors: Vec<f64> = predicted.iter().zip(&measured).map(|(p, m)| (p - m) / greatest).collect();
    let rms = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
    let mut worst = (0.0, 0.0);
    for k in -8..8 {
        let inside = |t: f64| (t.to_degrees() / STRETCH).floor() as i32 == k;
        let there: Vec<f64> = run.samples.iter().zip(&errors).filter(|(s, _)| inside(s.0)).map(|(_, e)| *e).collect();
        let mean = there.iter().sum::<f64>() / there.len().max(1) as f64;
        if mean.abs() > f64::abs(worst.1) {
            worst = ((f64::from(k) + 0.5) * STRETCH, mean);
        }
    }
    LawFit { rms, peaks: predicted.iter().copied().fold(0.0, f64::max) / greatest, worst }
}

fn predict(run: &MeanRun, law: Law, of: Component) -> Result<Vec<f64>> {
    let ground = SandBed::new(law, &Medium::generic(ZETA)?, &Regularization::default());
    let segments = LegShape::named(&run.shape)?.segments(CHORD, WIDTH, SEGMENTS)?;
    Ok(run.samples.iter().map(|s| of(&rotating_leg(&ground, &segments, s.0, run.omega, HIP))).collect())
}

fn name(shape: &str) -> &str {
    if shape == "L" { "L-leg" } else { "reversed L-leg" }
}

pub fn part() -> Result<StandIn> {
    let runs = runs()?;
    let mut table = ReportTable::new(
        "Simulated experiment: laws against legs rotated through about 35,000 grains simulated one by one, mean of two beds (not the paper's measurement). Errors in % of the greatest measured force; the paper reports agreement within 15 %.",
        &[
            "leg",
            "speed [rad/s]",
            "component",
            "scatter between beds",
            "law",
            "rms error",
            "peak, law / measured",
            "worst stretch of θ",
            "mean error there",
        ],
    );
    let mut errors = Vec::new();
    for run in &runs {
        for (component, of) in COMPONENTS {
            let greatest = run.samples.iter().map(|s| of(&s.1)).fold(0.0, f64::max);
            let scatter = run.samples.iter().map(|s| of(&s.2).powi(2)).sum::<f64>() / run.samples.len() as f64;
            for law in Law::ALL {
                let f = fit(run, &predict(run, law, of)?, of);
                let percent = |x: f64| format!("{} %", signed(100.0 * x));
                table.rows.push(vec![
                    name(&run.shape).into(),
                    format!("{}", run.omega),
                    component.into(),
                    percent(scatter.sqrt() / greatest),
                    law.name().into(),
                    percent(f.rms),
                    format!("{:.2}", f.peaks),
                    format!("{}° to {}°", signed(f.worst.0 - STRETCH / 2.0), signed(f.worst.0 + STRETCH / 2.0)),
                    percent(f.worst.1),
                ]);
                if law == Law::Li2013 {
                    errors.push((f.rms, name(&run.shape), run.omega, component, f.worst.0, f.worst.1));
                }
            }
        }
    }
    let ratio = |shape: &str| -> Result<f64> {
        let slow = runs.iter().filter(|r| r.shape == shape).min_by(|a, b| a.omega.total_cmp(&b.omega));
        let Some(run) = slow else { return Ok(f64::NAN) };
        let of = COMPONENTS[0].1;
        Ok(fit(run, &predict(run, Law::PenetrationDrag1d, of)?, of).peaks)
    };
    let lift_ratios = [ratio("L")?, ratio("revL")?];
    Ok(StandIn { figure: figure(&runs)?, table, summary: summary(&errors), lift_ratios })
}

/// The range of li2013's rms errors, with leg, speed, component and the worst angle.
fn summary(errors: &[(f64, &str, f64, &str, f64, f64)]) -> String {
    let of = |leg: &str| {
        let each = errors.iter().filter(|e| e.1 == leg);
        let [low, high] = extremes(each.map(|e| 100.0 * e.0));
        format!("{low:.0} to {high:.0} % of the greatest force on the {leg}")
    };
    let worst = errors.iter().max_by(|a, b| a.0.total_cmp(&b.0));
    let worst = worst.map_or_else(String::new, |(_, leg, omega, component, at, there)| {
        format!(
            "; it breaks most in the {component} of the {leg} at {omega} rad/s near θ = {}° (error {} % of the greatest force)",
            signed(*at),
            signed(100.0 * there)
        )
    });
    format!("RFT's rms error is {} and {}{worst}", of("L-leg"), of("reversed L-leg"))
}

fn figure(runs: &[MeanRun]) -> Result<Figure> {
    let mut panels = Vec::new();
    for shape in ["revL", "L"] {
        for (component, of) in COMPONENTS {
            let mut marks = Vec::new();
            for (run, hue) in runs.iter().filter(|r| r.shape == shape).zip([color::VERMILION, color::PURPLE]) {
                let points = run.samples.iter().map(|s| [s.0.to_degrees(), of(&s.1)]).collect();
                let label = format!("simulated grains, {} rad/s", run.omega);
                let band = run.samples.iter().map(|s| {
                    let (mean, half) = (of(&s.1), of(&s.2).abs());
                    [s.0.to_degrees(), mean - half, mean + half]
                });
                marks.push(Mark::band("", hue, band.collect()));
                marks.push(Mark::line(&label, Style::thin(hue).with_dots(), points));
            }
            let Some(run) = runs.iter().find(|r| r.shape == shape) else { continue };
            let looks =
                [Style::line(color::BLUE), Style::line(color::BLACK).dotted(), Style::line(color::GREEN).dashed()];
            for (law, style) in Law::ALL.into_iter().zip(looks) {
                let theta = run.samples.iter().map(|s| s.0.to_degrees());
                marks.push(Mark::line(
                    law.name(),
                    style,
                    theta.zip(predict(run, law, of)?).map(|(t, f)| [t, f]).collect(),
                ));
            }
            panels.push(FigurePanel {
                title: format!("{}: {component}", name(shape)),
                x: Axis::within("leg angle θ [°]", -120.0, 100.0),
                y: Axis::new(&format!("{component} [N]")),
                marks,
            });
        }
    }
    Ok(Figure {
        title: "Figure 3, stand-in: a simulated experiment, not the paper's".into(),
        columns: 2,
        panels,
        note: "Dots: legs (2R 7.6 cm, width 2.5 cm, 6 mm thick) through about 35,000 grains simulated one by one, mean of two beds, band between them. Lines: laws on the leg's mid-surface, ζ = 0.46 N/cm³ from slow plates in the same grains; generic coefficients.".into(),
    })
}
