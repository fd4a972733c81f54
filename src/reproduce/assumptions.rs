//! Values that the paper does not state, and the ranges in which we vary them. The declared model has one value of each
//! quantity. Every band in the figures and claims is the envelope over models in each of which one value differs from
//! the declared one.

use super::ReportTable;
use crate::error::Result;
use crate::sand::{Law, Medium};
use crate::sim::Robot;
use crate::sim::model::Scene;
use crate::sweep::{Design, Parameter};

/// Declared knee angle of the L-leg [°]: both pieces have the same length, as in the paper's figure.
pub const XI_DEG: f64 = 45.0;
/// Knee angles tried [°]: our choice, up to 15° to each side of the declared angle.
pub const XI_RANGE: [f64; 5] = [30.0, 37.5, 45.0, 52.5, 60.0];
/// Declared hip height of the force measurements [m], and the heights tried: our choice, from a hip at the surface to
/// twice the declared height.
pub const HIP: f64 = 0.02;
pub const HIP_RANGE: [f64; 5] = [0.0, 0.01, 0.02, 0.03, 0.04];

/// Changes of the walking robot, one at a time: our choice of what the paper leaves open.
pub const WALKING: [(&str, &str); 10] = [
    ("phase", "0.7854"),
    ("phase", "1.5708"),
    ("phase", "2.3562"),
    ("chord", "0.035"),
    ("chord", "0.045"),
    ("hip-height", "-0.005"),
    ("hip-height", "0.005"),
    ("width", "0.008"),
    ("width", "0.012"),
    ("belly", "0.015"),
];

/// Knee angles tried for the walking L-leg, in addition to the declared angle [°]: our choice, as in [`XI_RANGE`].
pub const WALKING_XI: [f64; 4] = [30.0, 37.5, 52.5, 60.0];

/// The design with the declared value of every quantity, except for the legs' knee angle `xi_deg` [°]: robot `xplorer`
/// on the paper's medium, loose poppy seeds.
pub fn robot(law: Law, xi_deg: f64, frequency: f64) -> Result<Design> {
    let mut scene = Scene::flat(Medium::named("poppy-loose")?);
    scene.law = law;
    let robot = Robot::load("xplorer")?.with_leg_shape(&format!("xi={xi_deg}"))?;
    Ok(Design { robot, scene, frequency, phase: 0.0 })
}

/// The declared design, then designs in each of which one of the assumptions in [`WALKING`] is changed; with `knees`,
/// also other knee angles of the same sign.
pub fn variants(law: Law, xi_deg: f64, frequency: f64, knees: bool) -> Result<Vec<Design>> {
    let declared = robot(law, xi_deg, frequency)?;
    let mut designs = vec![declared.clone()];
    for (name, value) in WALKING {
        let mut changed = declared.clone();
        Parameter::named(name)?.set(&mut changed, value)?;
        designs.push(changed);
    }
    if knees {
        for xi in WALKING_XI {
            designs.push(robot(law, xi.copysign(xi_deg), frequency)?);
        }
    }
    Ok(designs)
}

/// The list for the report.
pub fn table() -> ReportTable {
    let mut table = ReportTable::new(
        "What the paper does not state. The bands in figures and claims are envelopes over these, one changed at a time.",
        &["assumption", "declared", "range tried"],
    );
    let row = |a: &str, b: &str, c: &str| [a, b, c].map(str::to_owned).to_vec();
    table.rows = vec![
        row("knee angle |ξ| of the L-leg", "45°", "30° to 60°"),
        row("hip height of the force measurement (figure 3)", "2 cm above the sand", "0 to 4 cm"),
        row("phase of the tripods when the hips start", "0", "0, 45°, 90°, 135°"),
        row("size of the robot's legs, 2R", "4 cm", "3.5 to 4.5 cm"),
        row("width of the robot's legs", "1 cm", "0.8 to 1.2 cm"),
        row("height of the hips in the body", "base centre", "± 5 mm"),
        row("belly under the base centre", "1 cm", "1 to 1.5 cm"),
        row(
            "stress of the medium",
            "loosely packed poppy seeds, nine published coefficients",
            "batches differ by 20 to 40 %",
        ),
        row("speed", "net displacement over four strides, after two", "not varied"),
    ];
    table
}
