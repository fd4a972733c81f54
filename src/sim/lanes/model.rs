//! A model's numbers with one lane an environment.

use crate::error::{Error, Result};
use crate::number::{Real, Vec3};
use crate::sand::Ground;
use crate::sim::Model;
use crate::sim::model::{Body, Plate};

type V = nalgebra::Vector3<f64>;

/// A [`Plate`] in the coordinates of the plane that holds all plates of its body.
#[derive(Clone, Copy)]
pub struct LanePlate<R> {
    pub center: [R; 2],
    pub normal: [R; 2],
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
    /// Unit vectors e₀ and e₁ of the plane through the joint that holds centres and normals of all plates.
    pub plane: [Vec3<R>; 2],
    pub plates: Vec<LanePlate<R>>,
    pub chord: Vec<LanePlate<R>>,
    pub bulge: R,
}

/// See [`Model`]; `J` joints a leg.
#[derive(Clone)]
pub struct LaneModel<R, const J: usize> {
    pub base_mass: R,
    pub base_inertia: Vec3<R>,
    /// x and y of the plates, whose normals are −z.
    pub belly: Vec<LanePlate<R>>,
    /// z of all of them [m].
    pub belly_height: R,
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

/// How far a plate may be out of its plane [m], and its normal: rounding, far below what a force notices.
const FLAT: f64 = 1e-9;

/// The plane of a body's strip: e₁ along its reach, e₀ across it toward the normals.
fn plane(body: &Body) -> [V; 2] {
    let along = body.reach.normalize();
    let across = |p: &Plate| p.normal - along * along.dot(&p.normal);
    let widest = body.plates.iter().map(across).max_by(|a, b| a.norm_squared().total_cmp(&b.norm_squared()));
    [widest.map_or(V::zeros(), |v| v.normalize()), along]
}

fn in_plane(v: V, [e0, e1]: [V; 2]) -> [f64; 2] {
    [v.dot(&e0), v.dot(&e1)]
}

/// This engine takes strips in a plane through their joint, and level bellies: the only ones that [`Model::new`] makes.
pub fn check_planes(model: &Model) -> Result<()> {
    let flat = |v: V, [e0, e1]: [V; 2]| (v - e0 * v.dot(&e0) - e1 * v.dot(&e1)).norm() < FLAT;
    for body in model.legs.iter().flatten() {
        let plane = plane(body);
        if !body.plates.iter().chain(&body.chord).all(|p| flat(p.center, plane) && flat(p.normal, plane)) {
            return Err(Error::invalid("leg", "engine lanes takes strips that lie in a plane through their joint"));
        }
    }
    let height = belly_height(model);
    if !model.belly.iter().all(|p| (p.center.z - height).abs() < FLAT && (p.normal + V::z()).norm() < FLAT) {
        return Err(Error::invalid("belly", "engine lanes takes plates of one height that face down"));
    }
    Ok(())
}

fn belly_height(model: &Model) -> f64 {
    model.belly.first().map_or(0.0, |p| p.center.z)
}

/// Axes of the base: its belly's plane.
fn level() -> [V; 2] {
    [V::x(), V::y()]
}

fn plate<R: Real>(p: &Plate, plane: [V; 2]) -> LanePlate<R> {
    let splat = |v: V| in_plane(v, plane).map(R::splat);
    LanePlate { center: splat(p.center), normal: splat(p.normal), area: R::splat(p.area) }
}

fn set_plate<R: Real>(out: &mut LanePlate<R>, lane: usize, p: &Plate, plane: [V; 2]) {
    let [center, normal] = [in_plane(p.center, plane), in_plane(p.normal, plane)];
    out.center.iter_mut().zip(center).for_each(|(out, v)| out.set_lane(lane, v));
    out.normal.iter_mut().zip(normal).for_each(|(out, v)| out.set_lane(lane, v));
    out.area.set_lane(lane, p.area);
}

/// Diagonal, then xy, xz, yz of a symmetric matrix.
fn symmetric(m: &nalgebra::Matrix3<f64>) -> [[f64; 3]; 2] {
    [[m[(0, 0)], m[(1, 1)], m[(2, 2)]], [m[(0, 1)], m[(0, 2)], m[(1, 2)]]]
}

impl<R: Real> LaneBody<R> {
    fn splat(b: &Body) -> Self {
        let plane = plane(b);
        Self {
            joint: Vec3::splat(b.joint.into()),
            axis: Vec3::splat(b.axis.into()),
            mass: R::splat(b.mass),
            center: Vec3::splat(b.center.into()),
            inertia: symmetric(&b.inertia).map(Vec3::splat),
            armature: R::splat(b.armature),
            plane: plane.map(|e| Vec3::splat(e.into())),
            plates: b.plates.iter().map(|p| plate(p, plane)).collect(),
            chord: b.chord.iter().map(|p| plate(p, plane)).collect(),
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
        let plane = plane(b);
        self.plane.iter_mut().zip(plane).for_each(|(out, e)| out.set_lane(lane, e.into()));
        self.plates.iter_mut().zip(&b.plates).for_each(|(out, p)| set_plate(out, lane, p, plane));
        self.chord.iter_mut().zip(&b.chord).for_each(|(out, p)| set_plate(out, lane, p, plane));
        self.bulge.set_lane(lane, b.bulge);
    }
}

impl<R: Real, const J: usize> LaneModel<R, J> {
    /// `model` in every lane; its legs have `J` joints.
    pub fn splat(model: &Model) -> Self {
        Self {
            base_mass: R::splat(model.base_mass),
            base_inertia: Vec3::splat(model.base_inertia.into()),
            belly: model.belly.iter().map(|p| plate(p, level())).collect(),
            belly_height: R::splat(belly_height(model)),
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
        self.belly.iter_mut().zip(&model.belly).for_each(|(out, p)| set_plate(out, lane, p, level()));
        self.belly_height.set_lane(lane, belly_height(model));
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
