//! Any rigid body in steady motion through sand: plates on its surface, and the mean force and torque on them.
//!
//! The frame of a [`PlatedBody`] has x along the heading, y along the axle and z up, parallel to the world's axes. The
//! given velocity is the velocity of the origin. Every plate is one-sided. It pushes where it leads, n·v ≥ 0, and is
//! below the surface (Agarwal, Goldman & Kamrin 2023).

mod body;
pub mod cut;
mod gather;
mod mesh;
mod passing;
pub mod path;
mod trials;

pub use body::{BodyShape, PlatedBody, sizes_of};
pub use gather::gathered;
pub use mesh::{Triangle, read as read_file, read_mesh};
pub use trials::{DepthOrLoad, Status, Trial, TrialOutcome, check_all, compute, with_friction, without_effect};

use crate::number::Vec3;

/// A flat piece of a body's surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IntruderPlate {
    /// From the body's origin [m].
    pub center: Vec3<f64>,
    /// Outward unit vector.
    pub normal: Vec3<f64>,
    /// [m²]
    pub area: f64,
    /// From the centre to two neighbouring edges, along the surface [m].
    pub half: [Vec3<f64>; 2],
    /// Curvature of the surface along each vector of `half` [1/m]; 0 where it is flat.
    pub bend: [f64; 2],
}

impl IntruderPlate {
    /// Half of the plate's vertical extent [m].
    fn rise(&self) -> f64 {
        self.half[0].z.abs() + self.half[1].z.abs()
    }

    /// Difference of n·v between the centre and an edge [m/s], for velocity `v` at the centre and spin `spin`.
    fn unevenness(&self, v: Vec3<f64>, spin: Vec3<f64>) -> f64 {
        let along = |k: usize| self.bend[k] * self.half[k].dot(v) + self.normal.dot(spin.cross(self.half[k]));
        along(0).abs() + along(1).abs()
    }
}

/// The volume [m³] that the plates enclose, by the divergence theorem.
pub fn volume(plates: &[IntruderPlate]) -> f64 {
    plates.iter().map(|p| p.center.dot(p.normal) * p.area).sum::<f64>() / 3.0
}

/// [m²]
pub fn area(plates: &[IntruderPlate]) -> f64 {
    plates.iter().map(|p| p.area).sum()
}

#[cfg(test)]
mod courses;
