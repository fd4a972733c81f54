//! A model's numbers with one lane an environment.

use crate::number::{Real, Vec3};
use crate::sand::Ground;
use crate::sim::Model;
use crate::sim::model::{Body, Plate};

/// See [`Plate`].
#[derive(Clone, Copy)]
pub struct LanePlate<R> {
    pub center: Vec3<R>,
    pub normal: Vec3<R>,
    pub area: R,
}

/// See [`Body`].
#[derive(Clone)]
pub struct LaneBody<R> {
    pub joint: Vec3<R>,
    pub axis: Vec3<R>,
    pub mass: R,
    pub center: Vec3<R>,
    /// About the centre of mass: xx, yy, zz, then xy, xz, yz.
    pub inertia: [Vec3<R>; 2],
    pub armature: R,
    pub plates: Vec<LanePlate<R>>,
    pub chord: Vec<LanePlate<R>>,
    pub bulge: R,
}

/// See [`Model`]; `J` joints a leg.
#[derive(Clone)]
pub struct LaneModel<R, const J: usize> {
    pub base_mass: R,
    pub base_inertia: Vec3<R>,
    pub belly: Vec<LanePlate<R>>,
    pub legs: Vec<[LaneBody<R>; J]>,
    pub kp: R,
    pub kd: R,
    pub torque_limit: R,
    pub speed_limit: R,
    pub gravity: Vec3<R>,
    pub ground: Ground<R>,
    /// The same in all lanes [s].
    pub dt: R,
}

fn plate<R: Real>(p: &Plate) -> LanePlate<R> {
    LanePlate { center: Vec3::splat(p.center.into()), normal: Vec3::splat(p.normal.into()), area: R::splat(p.area) }
}

fn set_plate<R: Real>(out: &mut LanePlate<R>, lane: usize, p: &Plate) {
    out.center.set_lane(lane, p.center.into());
    out.normal.set_lane(lane, p.normal.into());
    out.area.set_lane(lane, p.area);
}

/// Diagonal, then xy, xz, yz of a symmetric matrix.
fn symmetric(m: &nalgebra::Matrix3<f64>) -> [[f64; 3]; 2] {
    [[m[(0, 0)], m[(1, 1)], m[(2, 2)]], [m[(0, 1)], m[(0, 2)], m[(1, 2)]]]
}

impl<R: Real> LaneBody<R> {
    fn splat(b: &Body) -> Self {
        Self {
            joint: Vec3::splat(b.joint.into()),
            axis: Vec3::splat(b.axis.into()),
            mass: R::splat(b.mass),
            center: Vec3::splat(b.center.into()),
            inertia: symmetric(&b.inertia).map(Vec3::splat),
            armature: R::splat(b.armature),
            plates: b.plates.iter().map(plate).collect(),
            chord: b.chord.iter().map(plate).collect(),
            bulge: R::splat(b.bulge),
        }
    }

    fn set_lane(&mut self, lane: usize, b: &Body) {
        self.joint.set_lane(lane, b.joint.into());
        self.axis.set_lane(lane, b.axis.into());
        self.mass.set_lane(lane, b.mass);
        self.center.set_lane(lane, b.center.into());
        self.inertia.iter_mut().zip(symmetric(&b.inertia)).for_each(|(out, v)| out.set_lane(lane, v));
        self.armature.set_lane(lane, b.armature);
        self.plates.iter_mut().zip(&b.plates).for_each(|(out, p)| set_plate(out, lane, p));
        self.chord.iter_mut().zip(&b.chord).for_each(|(out, p)| set_plate(out, lane, p));
        self.bulge.set_lane(lane, b.bulge);
    }
}

impl<R: Real, const J: usize> LaneModel<R, J> {
    /// `model` in every lane; its legs have `J` joints.
    pub fn splat(model: &Model) -> Self {
        Self {
            base_mass: R::splat(model.base_mass),
            base_inertia: Vec3::splat(model.base_inertia.into()),
            belly: model.belly.iter().map(plate).collect(),
            legs: model.legs.iter().map(|leg| std::array::from_fn(|j| LaneBody::splat(&leg[j]))).collect(),
            kp: R::splat(model.motor.kp),
            kd: R::splat(model.motor.kd),
            torque_limit: R::splat(model.motor.torque_limit),
            speed_limit: R::splat(model.motor.speed_limit),
            gravity: Vec3::splat(model.gravity.into()),
            ground: model.scene.ground(),
            dt: R::splat(model.scene.dt),
        }
    }

    /// Gives one lane another model with as many legs, joints and plates, and the same time step and law.
    pub fn set_lane(&mut self, lane: usize, model: &Model) {
        self.base_mass.set_lane(lane, model.base_mass);
        self.base_inertia.set_lane(lane, model.base_inertia.into());
        self.belly.iter_mut().zip(&model.belly).for_each(|(out, p)| set_plate(out, lane, p));
        for (chain, bodies) in self.legs.iter_mut().zip(&model.legs) {
            chain.iter_mut().zip(bodies).for_each(|(out, b)| out.set_lane(lane, b));
        }
        self.kp.set_lane(lane, model.motor.kp);
        self.kd.set_lane(lane, model.motor.kd);
        self.torque_limit.set_lane(lane, model.motor.torque_limit);
        self.speed_limit.set_lane(lane, model.motor.speed_limit);
        self.gravity.set_lane(lane, model.gravity.into());
        self.ground.set_lane(lane, &model.scene.medium, &model.scene.mechanisms);
    }
}
