//! Frames of a robot's bodies, and their lowest points.

use super::contact::ContactPoint;
use super::{JointKind, Tree, TreeBody};
use crate::State;
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};

type V = Vector3<f64>;

/// Frames of all bodies in the world.
pub fn frames(tree: &Tree, state: &State) -> Vec<Isometry3<f64>> {
    let [w, x, y, z] = state.orientation;
    let turn = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
    let base = Isometry3::from_parts(Translation3::from(V::from(state.position)), turn);
    chain(tree, base, &state.angles)
}

/// Frames of all bodies, with the base at `base`.
pub fn chain(tree: &Tree, base: Isometry3<f64>, angles: &[f64]) -> Vec<Isometry3<f64>> {
    let mut all = Vec::with_capacity(tree.bodies.len());
    all.push(base);
    for (body, q) in tree.bodies.iter().skip(1).zip(angles) {
        all.push(all[body.parent] * moved(body, *q));
    }
    all
}

/// The frame of a body in its parent's, with its joint at `q`.
pub fn moved(body: &TreeBody, q: f64) -> Isometry3<f64> {
    let by = match &body.joint {
        Some(j) if j.kind == JointKind::Slide => {
            Isometry3::from_parts((j.axis.into_inner() * q).into(), UnitQuaternion::identity())
        }
        Some(j) => Isometry3::from_parts(V::zeros().into(), UnitQuaternion::from_axis_angle(&j.axis, q)),
        None => Isometry3::identity(),
    };
    body.origin * by
}

/// The lowest of a body's points of contact.
pub struct Low {
    /// The lowest point [m].
    pub at: V,
    /// Centre of its ball or disc [m].
    pub center: V,
}

impl Low {
    /// For a body at `frame`; infinitely high if it has no points.
    pub fn of(frame: &Isometry3<f64>, points: &[ContactPoint]) -> Self {
        // The upward direction in the body's frame; most points need only heights.
        let up = frame.rotation.inverse_transform_vector(&V::z());
        let height = |p: &ContactPoint| {
            let drop = p.axis.map_or(1.0, |axis| (1.0 - axis.dot(&up).powi(2)).max(0.0).sqrt());
            up.dot(&p.center) - p.radius * drop
        };
        let heights = points.iter().map(height).enumerate();
        let low = heights.fold((0, f64::INFINITY), |low, one| if one.1 < low.1 { one } else { low });
        let Some(p) = points.get(low.0) else {
            let at = V::new(0.0, 0.0, f64::INFINITY);
            return Self { at, center: at };
        };
        // Direction to the lowest point of a ball or of a rim.
        let rim = p.axis.map_or(up, |axis| (up - axis * axis.dot(&up)).try_normalize(1e-9).unwrap_or_default());
        let world = |p: V| frame.transform_point(&p.into()).coords;
        Self { at: world(p.center - rim * p.radius), center: world(p.center) }
    }
}

/// The lowest of a body's points [m], for a body at `frame`; infinite if it has none.
pub fn lowest(frame: &Isometry3<f64>, points: &[ContactPoint]) -> V {
    Low::of(frame, points).at
}
