//! Any rigid body in steady motion through sand: plates on its surface, and the mean force and torque on them.
//!
//! Body frame: x heading, y axle, z up, unturned against the world; the origin is where the body's velocity is given. Every
//! plate is one-sided and pushes where it leads: n·v ≥ 0 and below the surface (Agarwal, Goldman & Kamrin 2023).

mod body;
mod cut;
mod mesh;
mod trials;

pub use body::{Body, BodyShape};
pub use trials::{Given, Outcome, Status, Trial, compute, compute_all};

use crate::number::Vec3;

/// A flat piece of a body's surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plate {
    /// From the body's origin [m].
    pub center: Vec3<f64>,
    /// Unit, outward.
    pub normal: Vec3<f64>,
    /// [m²]
    pub area: f64,
}

/// The volume [m³] that plates enclose, by the divergence theorem.
pub fn volume(plates: &[Plate]) -> f64 {
    plates.iter().map(|p| p.center.dot(p.normal) * p.area).sum::<f64>() / 3.0
}

/// [m²]
pub fn area(plates: &[Plate]) -> f64 {
    plates.iter().map(|p| p.area).sum()
}
