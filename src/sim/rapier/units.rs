//! Converts between our metres in `f64` and rapier's units in `f32`.
//!
//! parry's search for contacts has absolute tolerances: it ignores a triangle whose cross product is shorter than
//! 1.1e-3 square units. In metres, all triangles of a leg or of a rock of some centimetres are that small, and parry
//! sometimes reports a deep overlap in place of a gap. So rapier's unit of length is smaller than a metre. Masses,
//! times and angles keep their units. So forces scale as lengths, and moments and inertias as squares of lengths.

use crate::frame::V;
use rapier3d::glamx::{Quat, Vec3};

/// rapier's units of length in a metre: our choice. A leg's strip of the reference robot is then 1.3 units wide, a
/// rock 1 to 4. A power of two, so that no `f32` is rounded again.
pub const PER_METRE: f64 = 128.0;

/// Moments and inertias in rapier's units per N·m and kg·m².
pub const PER_SQUARE_METRE: f64 = PER_METRE * PER_METRE;

/// Numbers without a length, such as angular velocities.
pub fn vec3(v: V) -> Vec3 {
    Vec3::new(v.x as f32, v.y as f32, v.z as f32)
}

/// A length [m], velocity [m/s] or force [N].
pub fn scaled(v: V) -> Vec3 {
    vec3(v * PER_METRE)
}

/// A moment [N·m], or moments of inertia [kg·m²].
pub fn scaled_twice(v: V) -> Vec3 {
    vec3(v * PER_SQUARE_METRE)
}

/// rapier's numbers without a length.
pub fn plain(v: Vec3) -> V {
    V::new(v.x.into(), v.y.into(), v.z.into())
}

/// A length [m] or velocity [m/s] from rapier.
pub fn metres(v: Vec3) -> V {
    plain(v) / PER_METRE
}

pub fn quat(q: &nalgebra::UnitQuaternion<f64>) -> Quat {
    Quat::from_xyzw(q.i as f32, q.j as f32, q.k as f32, q.w as f32)
}
