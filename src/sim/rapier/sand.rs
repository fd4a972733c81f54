//! What the sand does to one body: a wrench, and the point masses that make it implicit.
//!
//! After a step the sand's force is f − C (v⁺ − v) with the present velocity v and C = drag·1 + edge·n nᵀ. A point mass
//! dt·C at the segment does the same: it resists acceleration, carries no weight, and because rapier's multibody keeps
//! velocities and not momentum it may change from step to step. A mass also brings velocity-product forces of its own
//! (centrifugal, Coriolis, gyroscopic); each wrench here holds what cancels them.

use super::frame::{Frame, V};
use super::inertia::Masses;
use crate::number::Vec3;
use crate::sand::{Ground, Site};
use crate::sim::model::Plate;

/// Force [N] and moment [N·m] about the base's centre, world axes.
#[derive(Clone, Copy, Debug)]
pub struct Wrench {
    pub force: V,
    pub moment: V,
}

impl Wrench {
    pub fn none() -> Self {
        Self { force: V::zeros(), moment: V::zeros() }
    }

    /// Adds `force` [N] acting `arm` [m] away from the base's centre.
    pub fn add_at(&mut self, arm: V, force: V) {
        self.force += force;
        self.moment += arm.cross(&force);
    }

    /// The same wrench's moment [N·m] about a point `arm` [m] away from the base's centre.
    pub fn moment_about(&self, arm: V) -> V {
        self.moment - arm.cross(&self.force)
    }
}

/// Sand on one body.
#[derive(Clone, Copy, Debug)]
pub struct Load {
    pub wrench: Wrench,
    /// dt × drag, in the body's frame.
    pub drag: Masses,
    /// dt × slope of the leading-edge gate, projected on the vertical; in the body's frame.
    pub edge: Masses,
}

/// Sand under `plates` of the body at `frame`, whose base centre is at `place` [m].
pub fn load(ground: &Ground<f64>, plates: &[Plate], one_sided: bool, frame: &Frame, place: &[f64; 3], dt: f64) -> Load {
    let mut load = Load { wrench: Wrench::none(), drag: Masses::none(), edge: Masses::none() };
    for plate in plates {
        let arm = frame.rotation * plate.center;
        let depth = -(place[2] + frame.origin.z + arm.z);
        if depth <= 0.0 {
            continue;
        }
        let (normal, velocity) = (frame.rotation * plate.normal, frame.velocity_at(arm));
        let site = Site::fresh(depth, place[0] + frame.origin.x + arm.x);
        let contact = if one_sided {
            ground.one_sided(&site, plate.area, lanes(normal), lanes(velocity))
        } else {
            ground.thin_plate(&site, plate.area, lanes(normal), lanes(velocity))
        };
        let mass = contact.drag * dt;
        let force = V::new(contact.force.x, contact.force.y, contact.force.z);
        load.wrench.add_at(frame.origin + arm, force + frame.acceleration_at(arm) * mass);
        load.drag.add(mass, plate.center);
        load.edge.add(contact.edge * dt * normal.z * normal.z, plate.center);
    }
    load
}

pub fn lanes(v: V) -> Vec3<f64> {
    Vec3::new(v.x, v.y, v.z)
}
