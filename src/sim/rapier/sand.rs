//! The sand's effect on one body: a wrench, and point masses that represent the implicit part of the force.
//!
//! After a step the sand's force is f − C (v⁺ − v) with the present velocity v and C = drag·1 + edge·n nᵀ. A point mass
//! dt·C at the segment has the same effect: it resists acceleration; it gets no weight. rapier's multibody keeps
//! velocities and not momentum, so the mass may change from step to step. A mass also causes velocity-product forces
//! (centrifugal, Coriolis, gyroscopic); each wrench here contains the opposite forces, which cancel them.

use super::inertia::Masses;
use crate::frame::{BodyFrame, V};
use crate::model::{LinkBody, Plate};
use crate::number::Vec3;
use crate::sand::{Contact, SandBed, SegmentState};

/// Force [N] and moment [N·m] about the base's centre, world axes.
#[derive(Clone, Copy, Debug)]
pub struct SandWrench {
    pub force: V,
    pub moment: V,
}

impl SandWrench {
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

/// The sand's effect on one body.
#[derive(Clone, Copy, Debug)]
pub struct SandLoad {
    pub wrench: SandWrench,
    /// dt × drag, in the body's frame.
    pub drag: Masses,
    /// dt × slope of the leading-edge gate, projected on the vertical; in the body's frame.
    pub edge: Masses,
}

/// Pose of a body: its frame about the base's centre, and that centre [m].
pub struct PlacedBody<'a> {
    pub frame: &'a BodyFrame,
    pub base: &'a [f64; 3],
    /// Velocity of the base along x and y [m/s].
    pub travel: [f64; 2],
}

/// The sand's effect on a base.
pub fn load_belly(ground: &SandBed<f64>, plates: &[Plate], at: &PlacedBody, dt: f64) -> SandLoad {
    let mut load = SandLoad::none();
    load.add(plates, at, dt, |site, area, normal, velocity| ground.one_sided(site, area, normal, velocity));
    load
}

/// The sand's effect on a link that turns at `rate` [rad/s]: on its strip, and in part on the straight chord if sand fills
/// its concave leading side.
pub fn load_link(ground: &SandBed<f64>, body: &LinkBody, rate: f64, at: &PlacedBody, dt: f64) -> SandLoad {
    let concave_leads = body.bulge * rate < 0.0;
    let fill = ground.mechanisms.as_ref().filter(|_| concave_leads).map_or(0.0, |mechanisms| mechanisms.fill);
    let mut load = SandLoad::none();
    for (plates, share) in [(&body.plates, 1.0 - fill), (&body.chord, fill)] {
        if share > 0.0 {
            load.add(plates, at, dt, |site, area, n, v| ground.thin_plate(site, area * share, n, v));
        }
    }
    load
}

impl SandLoad {
    fn none() -> Self {
        Self { wrench: SandWrench::none(), drag: Masses::none(), edge: Masses::none() }
    }

    /// Adds the sand's effect on each plate. `contact` computes it from the segment's state, area [m²], unit normal and
    /// velocity [m/s].
    fn add(
        &mut self,
        plates: &[Plate],
        at: &PlacedBody,
        dt: f64,
        contact: impl Fn(&SegmentState<f64>, f64, Vec3<f64>, Vec3<f64>) -> Contact<f64>,
    ) {
        let PlacedBody { frame, base, travel } = at;
        for plate in plates {
            let arm = frame.rotation * plate.center;
            let depth = -(base[2] + frame.origin.z + arm.z);
            if depth <= 0.0 {
                continue;
            }
            let (normal, velocity) = (frame.rotation * plate.normal, frame.velocity_at(arm));
            let site = SegmentState {
                width: plate.width,
                ..SegmentState::fresh(depth, base[0] + frame.origin.x + arm.x).travelling(*travel)
            };
            let contact = contact(&site, plate.area, lanes(normal), lanes(velocity));
            let mass = contact.drag * dt;
            let force = V::new(contact.force.x, contact.force.y, contact.force.z);
            self.wrench.add_at(frame.origin + arm, force + frame.acceleration_at(arm) * mass);
            self.drag.add(mass, plate.center);
            self.edge.add(contact.edge * dt * normal.z * normal.z, plate.center);
        }
    }
}

pub fn lanes(v: V) -> Vec3<f64> {
    Vec3::new(v.x, v.y, v.z)
}
