//! The numbers of models, one environment in each lane.

use super::plane::PlaneMoments;
use crate::Model;
use crate::actuator::LaneActuator;
use crate::blocks::{LaneJoint, LinkFrame, turned_about};
use crate::error::{Error, Result};
use crate::links::exact;
use crate::model::{LinkBody, Plate};
use crate::number::{Real, Vec3};
use crate::sand::SandBed;
use crate::spatial::Twist;
use crate::stop::NO_LIMIT;

type V = nalgebra::Vector3<f64>;
type M = nalgebra::Matrix3<f64>;

/// A [`Plate`] in the coordinates of the plane that holds all plates of its body.
#[derive(Clone, Copy)]
pub struct LanePlate<R> {
    pub center: [R; 2],
    pub normal: [R; 2],
    pub area: R,
    /// [m]
    pub width: R,
}

/// See [`LinkBody`].
#[derive(Clone)]
pub struct LaneBody<R> {
    pub joint: Vec3<R>,
    pub axis: Vec3<R>,
    pub armature: R,
    /// Unit vectors e₀ and e₁ of a plane through the joint. The body's mass and its plates, with their normals, lie in
    /// this plane.
    pub plane: [Vec3<R>; 2],
    /// Distance from the joint to the next one, or to the tip, along e₁ [m].
    pub length: R,
    pub masses: PlaneMoments<R>,
    pub plates: Vec<LanePlate<R>>,
    pub chord: Vec<LanePlate<R>>,
    pub bulge: R,
}

/// The underside of the base.
#[derive(Clone)]
pub struct LaneBelly<R> {
    /// x and y of the plates, whose normals are −z.
    pub plates: Vec<LanePlate<R>>,
    /// z of all these plates [m].
    pub height: R,
    /// Half of the belly's length and width [m].
    pub corner: [R; 2],
}

/// See [`Model`]; `J` joints a leg.
#[derive(Clone)]
pub struct LaneModel<R, const J: usize> {
    pub base_mass: R,
    pub base_inertia: Vec3<R>,
    pub belly: LaneBelly<R>,
    pub legs: Vec<[LaneBody<R>; J]>,
    /// Lowest and highest angle of each leg's joints, ∓[`NO_LIMIT`] without a range; empty if no lane has ranges.
    pub ranges: Vec<[[R; 2]; J]>,
    pub kp: R,
    pub kd: R,
    pub actuator: LaneActuator<R>,
    pub speed_limit: R,
    pub lag_limit: R,
    pub gravity: Vec3<R>,
    pub ground: SandBed<R>,
    /// Time step, equal in all lanes [s].
    pub dt: R,
}

/// Largest distance of a plate's centre from its body's plane [m], and largest deviation of its normal from the
/// required direction: above rounding errors, and far too small to affect a force.
const FLAT: f64 = 1e-9;

/// The plane of a body: e₁ along its reach, e₀ across it toward the normals, or in any direction if the body is a
/// line.
pub fn plane(body: &LinkBody) -> [V; 2] {
    let along = body.reach.normalize();
    let across = |v: V| v - along * along.dot(&v);
    let axes = [V::x(), V::y()]; // one of the two is not along the reach
    let normals = body.plates.iter().map(|p| p.normal);
    let widest = |v: &mut dyn Iterator<Item = V>| v.map(across).max_by(|a, b| a.norm().total_cmp(&b.norm()));
    let e0 = widest(&mut normals.clone()).or_else(|| widest(&mut axes.into_iter()));
    [exact(e0.map_or(V::zeros(), |v| v.normalize())), exact(along)]
}

pub fn in_plane(v: V, [e0, e1]: [V; 2]) -> [f64; 2] {
    [v.dot(&e0), v.dot(&e1)].map(|x| nonzero(x, v.norm()))
}

/// Σ m r rᵀ about the joint [kg·m²]; the inertia about the centre of mass is tr(S) 1 − S, where S is the same sum about the centre of mass.
fn second_moment(body: &LinkBody) -> M {
    let about_center = M::identity() * (body.inertia.trace() / 2.0) - body.inertia;
    about_center + body.center * body.center.transpose() * body.mass
}

pub fn moments(body: &LinkBody, [e0, e1]: [V; 2]) -> PlaneMoments<f64> {
    let second = second_moment(body);
    let (reach, about) = (body.reach.norm(), second.trace());
    PlaneMoments {
        mass: body.mass,
        first: in_plane(body.center, [e0, e1]).map(|x| nonzero(x, reach) * body.mass),
        second: [e0.dot(&(second * e0)), e0.dot(&(second * e1)), e1.dot(&(second * e1))].map(|x| nonzero(x, about)),
    }
}

/// `x`, or zero if `x` is only a rounding error of numbers of the size `scale`. Products of rounding errors could
/// become denormal in `f32`: see [`crate::number::flushed`].
fn nonzero(x: f64, scale: f64) -> f64 {
    if x.abs() < 1e-9 * scale { 0.0 } else { x }
}

/// This engine needs links in a plane through their joint, and level bellies. [`Model::new`] makes no others.
pub fn check_planes(model: &Model) -> Result<()> {
    for body in model.legs.iter().flatten() {
        let [e0, e1] = plane(body);
        let normal = e0.cross(&e1);
        let flat = |v: V| v.dot(&normal).abs() < FLAT;
        let second = second_moment(body);
        // A width axis up to 1e-3 off the right angle gives 1e-9 with twelve segments, so 1e-6 (our choice) allows it.
        let thin = (second * normal).norm() <= 1e-6 * second.trace();
        let plates = || body.plates.iter().chain(&body.chord);
        if !(thin && flat(body.center) && plates().all(|p| flat(p.center) && flat(p.normal))) {
            return Err(Error::invalid("leg", "engine lanes takes links that lie in a plane through their joint"));
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

fn belly_corner(model: &Model) -> [f64; 2] {
    model.robot.belly.as_ref().map_or([0.0; 2], |belly| belly.size.map(|s| s / 2.0))
}

/// Axes of the base: the plane of its belly.
fn level() -> [V; 2] {
    [V::x(), V::y()]
}

fn plate<R: Real>(p: &Plate, plane: [V; 2]) -> LanePlate<R> {
    let splat = |v: V| in_plane(v, plane).map(R::splat);
    LanePlate { center: splat(p.center), normal: splat(p.normal), area: R::splat(p.area), width: R::splat(p.width) }
}

fn set_plate<R: Real>(out: &mut LanePlate<R>, lane: usize, p: &Plate, plane: [V; 2]) {
    let [center, normal] = [in_plane(p.center, plane), in_plane(p.normal, plane)];
    out.center.iter_mut().zip(center).for_each(|(out, v)| out.set_lane(lane, v));
    out.normal.iter_mut().zip(normal).for_each(|(out, v)| out.set_lane(lane, v));
    out.area.set_lane(lane, p.area);
    out.width.set_lane(lane, p.width);
}

impl<R: Real> LaneBody<R> {
    fn splat(b: &LinkBody) -> Self {
        let plane = plane(b);
        let PlaneMoments { mass, first, second } = moments(b, plane);
        Self {
            joint: Vec3::splat(b.joint.into()),
            axis: Vec3::splat(b.axis.into()),
            armature: R::splat(b.armature),
            plane: plane.map(|e| Vec3::splat(e.into())),
            length: R::splat(b.reach.norm()),
            masses: PlaneMoments { mass: R::splat(mass), first: first.map(R::splat), second: second.map(R::splat) },
            plates: b.plates.iter().map(|p| plate(p, plane)).collect(),
            chord: b.chord.iter().map(|p| plate(p, plane)).collect(),
            bulge: R::splat(b.bulge),
        }
    }

    /// The body's frame, turned about its hinge.
    #[inline(always)]
    pub fn frame(&self, parent: &LinkFrame<R>, joint: &LaneJoint<R>) -> LinkFrame<R> {
        let axis = parent.rotation.apply(self.axis);
        let origin = parent.point(self.joint);
        let rotation = turned_about(&parent.rotation, axis, joint.position);
        parent.carry(rotation, origin, Twist::hinge(axis, origin), joint)
    }

    fn set_lane(&mut self, lane: usize, b: &LinkBody) {
        self.joint.set_lane(lane, b.joint.into());
        self.axis.set_lane(lane, b.axis.into());
        self.armature.set_lane(lane, b.armature);
        let plane = plane(b);
        let PlaneMoments { mass, first, second } = moments(b, plane);
        self.plane.iter_mut().zip(plane).for_each(|(out, e)| out.set_lane(lane, e.into()));
        self.length.set_lane(lane, b.reach.norm());
        self.masses.mass.set_lane(lane, mass);
        self.masses.first.iter_mut().zip(first).for_each(|(out, m)| out.set_lane(lane, m));
        self.masses.second.iter_mut().zip(second).for_each(|(out, m)| out.set_lane(lane, m));
        self.plates.iter_mut().zip(&b.plates).for_each(|(out, p)| set_plate(out, lane, p, plane));
        self.chord.iter_mut().zip(&b.chord).for_each(|(out, p)| set_plate(out, lane, p, plane));
        self.bulge.set_lane(lane, b.bulge);
    }
}

impl<R: Real, const J: usize> LaneModel<R, J> {
    /// `model` in every lane; its legs have `J` joints.
    pub fn splat(model: &Model) -> Self {
        let mut all = Self {
            base_mass: R::splat(model.base_mass),
            base_inertia: Vec3::splat(model.base_inertia.into()),
            belly: LaneBelly {
                plates: model.belly.iter().map(|p| plate(p, level())).collect(),
                height: R::splat(belly_height(model)),
                corner: belly_corner(model).map(R::splat),
            },
            legs: model.legs.iter().map(|leg| std::array::from_fn(|j| LaneBody::splat(&leg[j]))).collect(),
            ranges: Vec::new(),
            kp: R::splat(model.motor.kp),
            kd: R::splat(model.motor.kd),
            actuator: LaneActuator::splat(&model.motor.actuator),
            speed_limit: R::splat(model.motor.speed_limit),
            lag_limit: R::splat(model.motor.lag_limit),
            gravity: Vec3::splat(model.gravity.into()),
            ground: model.scene.ground(),
            dt: R::splat(model.scene.dt),
        };
        (0..R::LANES).for_each(|lane| all.set_ranges(lane, model));
        all
    }

    fn set_ranges(&mut self, lane: usize, model: &Model) {
        if self.ranges.is_empty() && model.legs.iter().flatten().any(|body| body.range.is_some()) {
            self.ranges = vec![[[-NO_LIMIT, NO_LIMIT].map(R::splat); J]; model.legs.len()];
        }
        for (out, body) in self.ranges.iter_mut().flatten().zip(model.legs.iter().flatten()) {
            let range = body.range.unwrap_or([-NO_LIMIT, NO_LIMIT]);
            out.iter_mut().zip(range).for_each(|(out, end)| out.set_lane(lane, end));
        }
    }

    /// Gives one lane another model with equally many legs, joints and plates, and the same time step and law.
    pub fn set_lane(&mut self, lane: usize, model: &Model) {
        self.base_mass.set_lane(lane, model.base_mass);
        self.base_inertia.set_lane(lane, model.base_inertia.into());
        let belly = &mut self.belly;
        belly.plates.iter_mut().zip(&model.belly).for_each(|(out, p)| set_plate(out, lane, p, level()));
        belly.height.set_lane(lane, belly_height(model));
        belly.corner.iter_mut().zip(belly_corner(model)).for_each(|(out, x)| out.set_lane(lane, x));
        for (chain, bodies) in self.legs.iter_mut().zip(&model.legs) {
            chain.iter_mut().zip(bodies).for_each(|(out, b)| out.set_lane(lane, b));
        }
        self.set_ranges(lane, model);
        self.kp.set_lane(lane, model.motor.kp);
        self.kd.set_lane(lane, model.motor.kd);
        self.actuator.set_lane(lane, &model.motor.actuator);
        self.speed_limit.set_lane(lane, model.motor.speed_limit);
        self.lag_limit.set_lane(lane, model.motor.lag_limit);
        self.gravity.set_lane(lane, model.gravity.into());
        self.ground.set_lane(lane, &model.scene.medium, &model.scene.mechanisms);
    }

    /// Scales the plates' areas of each leg of one lane, which has `model`; forces are proportional to area.
    pub fn set_footing(&mut self, lane: usize, model: &Model, shares: &[f64]) {
        for ((chain, bodies), share) in self.legs.iter_mut().zip(&model.legs).zip(shares) {
            for (out, body) in chain.iter_mut().zip(bodies) {
                let full = body.plates.iter().chain(&body.chord);
                let plates = out.plates.iter_mut().chain(&mut out.chord).zip(full);
                plates.for_each(|(plate, full)| plate.area.set_lane(lane, full.area * share));
            }
        }
    }
}
