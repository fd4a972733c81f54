//! A leg rotated about a fixed hip: the experiment of Li et al. 2012, section 3.

use super::beyond::Site;
use super::contact::Ground;
use super::shape::Segment;
use crate::number::Vec3;

/// Force and torque on an intruder.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Load {
    /// Horizontal force on the intruder [N], positive along +x.
    pub fx: f64,
    /// Vertical force [N], positive up.
    pub fz: f64,
    /// Torque x·Fz − z·Fx about the hip [N·m].
    pub ty: f64,
}

/// The load on a leg at angle `theta` [rad] (0: tip straight down; positive: tip forward) that turns with `omega`
/// [rad/s] about a hip `hip_height` [m] above the surface.
pub fn rotating_leg(ground: &Ground<f64>, segments: &[Segment], theta: f64, omega: f64, hip_height: f64) -> Load {
    let (sin, cos) = theta.sin_cos();
    let turn = |p: [f64; 2]| [p[0] * cos - p[1] * sin, p[0] * sin + p[1] * cos];
    let mut load = Load::default();
    for s in segments {
        let ([x, z], n) = (turn(s.center), turn(s.normal));
        let depth = -(hip_height + z);
        if depth <= 0.0 {
            continue;
        }
        let v = Vec3::new(-omega * z, 0.0, omega * x);
        let f = ground.thin_plate(&Site::fresh(depth, x), s.area, Vec3::new(n[0], 0.0, n[1]), v).force;
        load.fx += f.x;
        load.fz += f.z;
        load.ty += x * f.z - z * f.x;
    }
    load
}
