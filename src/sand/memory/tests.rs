//! Passes over used sand against simulated grains (`tests/data/memory`), and laws that hold for any motion.

use super::*;
use crate::SandDescription;
use crate::intruder::path::{Moment, Path};
use crate::intruder::{Body, BodyShape, Given, Outcome, Trial};

/// Angle of repose of the grains [°]: spheres with friction 0.4; the sides of their furrows are at 20 to 26°.
const GRAINS_REPOSE: f64 = 25.0;

fn table(text: &str) -> Vec<Vec<f64>> {
    text.lines().skip(1).map(|l| l.split(',').map(|c| c.parse().unwrap()).collect()).collect()
}

struct Passes {
    moments: Vec<Moment>,
    rows: Vec<Vec<f64>>,
    outcomes: Vec<Outcome>,
    /// Surface after each pass: x, y, height of the grains, height of the model.
    surfaces: Vec<Vec<[f64; 4]>>,
}

fn run(shape: &str, rows: &str, surface: &str, repose: f64, cell: Option<f64>) -> Passes {
    let sand = SandDescription::named("glass-beads", "li2013").unwrap();
    let body = Body::cut(&BodyShape::named(shape).unwrap(), Some(0.0015)).unwrap();
    let mut path = Path::new(&body, &sand, repose, cell).unwrap();
    let (rows, grains) = (table(rows), table(surface));
    let mut all = Passes { moments: Vec::new(), rows, outcomes: Vec::new(), surfaces: Vec::new() };
    for pass in 1..=3 {
        for row in all.rows.iter().filter(|r| r[0] == f64::from(pass)) {
            let trial =
                Trial { velocity: [row[4], 0.0, row[5]], spin: [0.0; 3], given: Given::Depth(-row[3]) };
            let moment = Moment { time: 10.0 * f64::from(pass) + row[1], place: Some([row[2], 0.0]), trial };
            all.moments.push(moment);
            all.outcomes.push(path.step(&moment));
        }
        path.settle();
        let grid = &path.moved.grid;
        let height = |x: f64, y: f64| grid.height(grid.frame.cell_at([x, y]));
        let of = grains.iter().filter(|r| r[0] == f64::from(pass));
        all.surfaces.push(of.map(|r| [r[1], r[2], r[3], height(r[1], r[2])]).collect());
    }
    all
}

impl Passes {
    /// Rms of the difference of the heights after each pass [mm], without grains that lie on the plate.
    fn heights(&self) -> Vec<f64> {
        let rms = |s: &Vec<[f64; 4]>| {
            let d: Vec<f64> = s.iter().filter(|c| c[2].abs() < 0.025).map(|c| (c[3] - c[2]).powi(2)).collect();
            1e3 * (d.iter().sum::<f64>() / d.len() as f64).sqrt()
        };
        self.surfaces.iter().map(rms).collect()
    }

    fn mean(&self, keep: impl Fn(&[f64]) -> bool, of: impl Fn(&[f64], &Outcome) -> f64) -> f64 {
        let kept: Vec<f64> =
            self.rows.iter().zip(&self.outcomes).filter(|(r, _)| keep(r)).map(|(r, o)| of(r, o)).collect();
        kept.iter().sum::<f64>() / kept.len() as f64
    }
}

fn thirds(p: &Passes) -> Vec<[f64; 3]> {
    let mut out = Vec::new();
    let edges = [-0.0501, -0.0167, 0.0167, 0.0501];
    let m = |pass: f64, t: usize, model: bool| {
        let keep = |r: &[f64]| r[0] == pass && r[4] > 0.1 && r[2] > edges[t] && r[2] <= edges[t + 1];
        p.mean(keep, |r, o| if model { o.force[0] } else { r[6] })
    };
    for pass in [2.0, 3.0] {
        for t in 0..3 {
            out.push([m(pass, t, false) / m(1.0, t, false), m(pass, t, true) / m(1.0, t, true), 0.0]);
        }
    }
    for t in 0..3 {
        out.push([m(1.0, t, false), m(1.0, t, true), m(1.0, t, true) / m(1.0, 0, true)]);
    }
    out
}

fn force_at(p: &Passes, pass: f64, depth: f64, model: bool) -> f64 {
    let near = |r: &[f64]| r[0] == pass && r[5] < -0.05 && (r[3] + depth).abs() < 0.0006;
    p.mean(near, |r, o| if model { o.force[2] } else { r[7] })
}

#[test]
fn grains() {
    for repose in [GRAINS_REPOSE] {
        let p = run(
            "box:length=0.006,width=0.025,height=0.038",
            include_str!("../../../tests/data/memory/plough.csv"),
            include_str!("../../../tests/data/memory/plough_surface.csv"),
            repose,
            None,
        );
        println!("repose {repose} plough rms {:.1?}", p.heights());
        for t in thirds(&p) {
            println!("   grains {:.2} model {:.2} {:.2}", t[0], t[1], t[2]);
        }
        for s in &p.surfaces {
            let line = |x0: f64| {
                let v: Vec<String> = s
                    .iter()
                    .filter(|c| (c[0] - x0).abs() < 1e-6)
                    .step_by(3)
                    .map(|c| format!("{:.0}/{:.0}", 1e3 * c[2], 1e3 * c[3]))
                    .collect();
                v.join(" ")
            };
            println!("     x=0.002 {}", line(0.002));
            println!("     x=0.058 {}", line(0.058));
        }
        let p = run(
            "box:length=0.038,width=0.025,height=0.006",
            include_str!("../../../tests/data/memory/press.csv"),
            include_str!("../../../tests/data/memory/press_surface.csv"),
            repose,
            None,
        );
        println!("repose {repose} press rms {:.1?}", p.heights());
        for d in [0.005, 0.01, 0.015, 0.02, 0.025, 0.028] {
            let f = |pass, model| force_at(&p, pass, d, model) / force_at(&p, 1.0, d, model);
            println!(
                "   {d}: second {:.2} model {:.2}; third {:.2} model {:.2}; first {:.2} model {:.2}",
                f(2.0, false),
                f(2.0, true),
                f(3.0, false),
                f(3.0, true),
                force_at(&p, 1.0, d, false),
                force_at(&p, 1.0, d, true)
            );
        }
        let s = &p.surfaces[2];
        let line = |x0: f64| {
            let v: Vec<String> = s
                .iter()
                .filter(|c| (c[0] - x0).abs() < 1e-6)
                .step_by(2)
                .map(|c| format!("{:.0}/{:.0}", 1e3 * c[2], 1e3 * c[3]))
                .collect();
            v.join(" ")
        };
        println!("     x=-0.014 {}", line(-0.014));
    }
}

#[test]
fn profile() {
    let p = run(
        "box:length=0.006,width=0.025,height=0.038",
        include_str!("../../../tests/data/memory/plough.csv"),
        include_str!("../../../tests/data/memory/plough_surface.csv"),
        GRAINS_REPOSE,
        None,
    );
    for k in 0..10 {
        let lo = -0.05 + 0.01 * f64::from(k);
        let m = |pass: f64, model: bool| {
            let keep = |r: &[f64]| r[0] == pass && r[4] > 0.1 && r[2] > lo && r[2] <= lo + 0.01;
            p.mean(keep, |r, o| if model { o.force[0] } else { r[6] })
        };
        println!("x {lo:.2}: grains {:.2} {:.2} {:.2}  model {:.2} {:.2} {:.2}", m(1., false), m(2., false), m(3., false), m(1., true), m(2., true), m(3., true));
    }
}
