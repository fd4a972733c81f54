//! Side faces of a thick plate.
//!
//! Published stresses are for whole plates, including their sides (Li, Zhang & Goldman 2013 measured a plate of 3.8 ×
//! 2.5 × 0.6 cm). So the sides have no stress of their own. The sides only add the inertia of the sand that they push
//! away, as the faces of a solid body do in engine `tree`.

use super::track::{RigidMotion, Wrench};
use crate::sand::mechanism_laws::slope_depth;
use crate::sand::shape::Segment;

/// The two side faces at the plate's ends, normals outward; none for a thin plate.
pub fn sides(length: f64, width: f64, thickness: f64) -> Vec<Segment> {
    let side = |way: f64| Segment { center: [way * length / 2.0, 0.0], normal: [way, 0.0], area: width * thickness };
    if thickness > 0.0 { vec![side(-1.0), side(1.0)] } else { Vec::new() }
}

/// Load on the submerged sides that lead; `pressure` gives the pressure from the normal speed, and the sand's surface rises by `slope` [rad].
pub fn leading_sides(sides: &[Segment], place: RigidMotion, slope: f64, pressure: impl Fn(f64) -> f64) -> Wrench {
    let (sin, cos) = place.turn;
    let turn = |[x, z]: [f64; 2]| [x * cos - z * sin, x * sin + z * cos];
    let mut load = [0.0; 3];
    for side in sides {
        let (r, n) = (turn(side.center), turn(side.normal));
        let along = n[0] * place.velocity[0] + n[1] * place.velocity[1];
        let depth = slope_depth(slope.sin_cos(), place.origin[0] + r[0], place.origin[1] + r[1]);
        if along > 0.0 && depth > 0.0 {
            let force = pressure(along) * side.area;
            let (fx, fz) = (-force * n[0], -force * n[1]);
            load = [load[0] + fx, load[1] + fz, load[2] + r[0] * fz - r[1] * fx];
        }
    }
    load
}

#[cfg(test)]
mod tests {
    use super::super::experiment::Intruder;
    use super::super::force_model::tests::forces;
    use super::super::track::{ArmPose, Track};
    use crate::sand::mechanism::Mechanisms;

    /// A plate that moves along itself pushes sand away with its leading side, λ ρ v² on 2.5 × 0.6 cm. There is no such
    /// force on a thin plate or on a plate in the air.
    #[test]
    fn drag_acts_on_the_leading_side_of_a_thick_plate() {
        let drag = |thickness: Option<f64>, way: f64, z: f64| {
            let intruder = Intruder::Plate { length: 0.038, width: 0.025, thickness };
            let pose = |t: f64| ArmPose { t, center: [way * t, z], velocity: [way, 0.0], ..ArmPose::default() };
            let track = Track::leg(intruder, 0.0, vec![pose(0.0), pose(0.01)]);
            let load = |inertial_drag: f64| forces(Mechanisms { inertial_drag, ..Default::default() }, &track);
            let (with, without) = (load(2.0), load(0.0));
            [with[0] - without[0], with[2] - without[2]]
        };
        for way in [-0.5, 0.5] {
            let [fx, fz] = drag(Some(0.006), way, -0.03);
            let expected = -2.0 * 640.0 * 0.25 * 0.025 * 0.006 * way.signum();
            assert!((fx - expected).abs() < 1e-9 && fz.abs() < 1e-9, "{fx} {fz}");
            assert!(drag(None, way, -0.03).iter().all(|f| f.abs() < 1e-9));
            assert_eq!(drag(Some(0.006), way, 0.03), [0.0; 2]);
        }
    }
}
