//! Figure 2: stress per depth over intrusion angle and attack angle.

use super::FigureSection;
use super::claims::{Claim, extremes, signed};
use crate::error::Result;
use crate::number::Vec3;
use crate::plot::{Axis, Figure, FigurePanel, Mark, Style, color};
use crate::sand::{Law, Medium, Regularization, SandBed};
use std::f64::consts::PI;

/// Attack angles of the paper's panels (a, c) [rad] and intrusion angles of its panels (b, d).
const BETAS: [f64; 6] = [0.0, 0.52, 1.05, PI / 2.0, 2.09, 2.62];
const GAMMAS: [f64; 13] =
    [PI / 2.0, 1.25, 0.98, PI / 4.0, 0.59, 0.32, 0.0, -0.32, -0.59, -PI / 4.0, -0.98, -1.25, -PI / 2.0];

/// [α_x, α_z] in N/cm³.
fn alpha(ground: &SandBed<f64>, beta: f64, gamma: f64) -> [f64; 2] {
    let motion = ground.motion(Vec3::new(gamma.cos(), 0.0, -gamma.sin()));
    let f = ground.stress(Vec3::new(beta.sin(), 0.0, -beta.cos()), &motion);
    [-f.x * 1e-6, f.z * 1e-6]
}

pub fn part() -> Result<FigureSection> {
    let ground = SandBed::new(Law::Li2013, &Medium::named("poppy-loose")?, &Regularization::BARE);
    let mut claims = set_up();
    claims.extend([stronger_downward(&ground, 1), stronger_downward(&ground, 0)]);
    claims.extend([asymmetry(&ground), symmetric_exceptions(&ground)]);
    Ok(FigureSection {
        heading: "Figure 2: stresses",
        figures: vec![("figure2", figure(&ground))],
        tables: Vec::new(),
        claims,
    })
}

fn figure(ground: &SandBed<f64>) -> Figure {
    let names = ["horizontal stress α_x [N/cm³]", "vertical stress α_z [N/cm³]"];
    let degrees = |a: f64| format!("{:.0}°", a.to_degrees()).replace('-', "−");
    let grid = |from: f64, to: f64| (0..=90).map(move |i| from + (to - from) * f64::from(i) / 90.0);
    let panel = |title: &str, which: usize, over_gamma: bool| {
        let family: &[f64] = if over_gamma { &BETAS } else { &GAMMAS };
        let line = |(k, fixed): (usize, &f64)| {
            let (symbol, span) = if over_gamma { ("β", grid(-PI / 2.0, PI / 2.0)) } else { ("γ", grid(0.0, PI)) };
            let at = |a: f64| if over_gamma { alpha(ground, *fixed, a) } else { alpha(ground, a, *fixed) };
            let style = Style::thin(&color::rainbow(k as f64 / (family.len() - 1) as f64));
            let style = if over_gamma { style } else { style.dashed() };
            // A thin plate at β = 180° is the plate at β = 0, so both have one curve.
            let twin = if over_gamma && k == 0 { ", 180°" } else { "" };
            let label = format!("{symbol} = {}{twin}", degrees(*fixed));
            Mark::line(&label, style, span.map(|a| [a.to_degrees(), at(a)[which]]).collect())
        };
        let x = if over_gamma {
            Axis::within("intrusion angle γ [°]", -90.0, 90.0)
        } else {
            Axis::within("attack angle β [°]", 0.0, 180.0)
        };
        FigurePanel {
            title: title.into(),
            x,
            y: Axis::new(names[which]),
            marks: family.iter().enumerate().map(line).collect(),
        }
    };
    Figure {
        title: "Figure 2: stress per depth, loosely packed poppy seeds".into(),
        columns: 2,
        panels: vec![panel("(a)", 1, true), panel("(b)", 1, false), panel("(c)", 0, true), panel("(d)", 0, false)],
        note: "Nine-coefficient fit of Li, Zhang & Goldman 2013 to measurements of this kind; the paper's own points are not public.".into(),
    }
}

/// Sentences about the experiment, which models cannot predict.
fn set_up() -> Vec<Claim> {
    let input = "describes the experiment: an input, nothing to predict";
    vec![
        Claim::no_data(
            "2.plate",
            "A plate of 3.8 × 2.5 cm², 0.6 cm thick, moved at 1 cm/s",
            "9.5 cm², 1 cm/s",
            "the law takes any area; speed does not enter",
            input,
        ),
        Claim::no_data(
            "2.packing",
            "Loosely packed poppy seeds, volume fraction 0.58",
            "0.58",
            "medium poppy-loose",
            input,
        ),
        Claim::no_data(
            "2.linear_in_depth",
            "Forces are approximately proportional to depth for all β and γ, on the way in and out",
            "F ∝ |z|",
            "F = α |z| A exactly",
            "the law assumes it; the measured curves (figure 1d) are not public",
        ),
        super::legs::inertia_claim(),
    ]
}

/// "For all β, both α_z and α_x had larger magnitudes for positive γ than for negative γ." The sentence has two
/// readings: literally, it compares plates at the same β; or it compares plates that meet the grains at the same
/// incidence on the way down and up, (β, γ) with (−β, −γ).
fn stronger_downward(ground: &SandBed<f64>, which: usize) -> Claim {
    let (mut all, mut mirrored, mut fewer, mut worst) = (0, 0, Vec::new(), (0.0, 0.0, 0.0));
    for beta in (-90..90).step_by(5).map(f64::from) {
        for gamma in (5..=90).step_by(5).map(f64::from) {
            let at = |b: f64, g: f64| alpha(ground, b.to_radians(), g.to_radians())[which].abs();
            let excess = at(beta, -gamma) - at(beta, gamma);
            all += 1;
            mirrored += i32::from(at(-beta, -gamma) <= at(beta, gamma) + 1e-6);
            if excess > 1e-6 {
                fewer.push(beta);
                worst = if excess > worst.2 { (beta, gamma, excess) } else { worst };
            }
        }
    }
    let share = 100.0 * (1.0 - fewer.len() as f64 / f64::from(all));
    let [low, high] = extremes(fewer.iter().copied());
    let name = ["α_x", "α_z"][which];
    let why = format!(
        "the published fit has exceptions at β from {}° to {}°, where the plate goes edge-on down and face-on up; largest at β = {}°, γ = ±{:.0}° by {:.3} N/cm³. At equal incidence, (β, γ) against (−β, −γ), it holds on {:.1} % of the grid",
        signed(low),
        signed(high),
        signed(worst.0),
        worst.1,
        worst.2,
        100.0 * f64::from(mirrored) / f64::from(all),
    );
    let id = ["2.downward_stronger_x", "2.downward_stronger_z"][which];
    let claim = format!("For all β, |{name}| is larger for positive γ than for negative γ");
    Claim::new(id, &claim, "all β and γ", format!("{share:.1} % of a grid of 5°"), fewer.is_empty(), why)
}

fn difference(ground: &SandBed<f64>, gamma: f64) -> f64 {
    let sides = |b: f64, which: usize| alpha(ground, b, gamma)[which].abs() - alpha(ground, -b, gamma)[which].abs();
    let angles = (5..90).step_by(5).map(|b| f64::from(b).to_radians());
    angles.flat_map(|b| [sides(b, 0).abs(), sides(b, 1).abs()]).fold(0.0, f64::max)
}

/// "For all γ but γ = 0 and π/2, the magnitudes … were asymmetric about β = 0."
fn asymmetry(ground: &SandBed<f64>) -> Claim {
    let gammas = (-85..90).step_by(5).filter(|g| *g != 0).map(|g| f64::from(g).to_radians());
    let least = gammas.map(|g| difference(ground, g)).fold(f64::INFINITY, f64::min);
    let ours = format!("largest difference over β at least {least:.3} N/cm³ at every γ");
    let claim = "Magnitudes of the stresses are asymmetric about β = 0 for all γ but 0 and π/2";
    Claim::new("2.asymmetric", claim, "asymmetric", ours, least > 1e-3, "grid of 5° in β and γ")
}

fn symmetric_exceptions(ground: &SandBed<f64>) -> Claim {
    let (at_zero, at_right) = (difference(ground, 0.0), difference(ground, PI / 2.0));
    let ours = format!("differences up to {at_zero:.3} N/cm³ at γ = 0 and {at_right:.3} N/cm³ at γ = π/2");
    let why = "the nine-term fit is symmetric at γ = π/2, but its D10 and B terms leave γ = 0 asymmetric; whether the measured points are symmetric there stands in figure 2 only";
    let claim = "… and symmetric at the exceptions γ = 0 and γ = π/2";
    Claim::new("2.symmetric_exceptions", claim, "symmetric", ours, at_zero.max(at_right) < 5e-3, why)
}
