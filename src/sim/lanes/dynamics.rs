//! One time step of a robot on sand: servos → sand → rigid bodies.
//!
//! An articulated-body algorithm (Featherstone 2008, chapter 7) for a free base with legs, in a world-aligned frame at
//! the base's centre of mass. Sand is linearly implicit: its force after the step is f − C (v⁺ − v) with the present
//! velocity v, which has the same effect as point masses dt C at the segments. These masses are added to the inertia
//! only: velocity-product terms are computed before, with all accelerations zero, so the added masses cause none.
//!
//! In smooth motion, a step changes the velocities by about the same Δv as the last step. Then the sand's force is
//! evaluated in the middle of the step, at v + ½ w Δv, and its drag acts on the difference from the expected change, f
//! − C (v⁺ − v − w Δv). The weight w = (v² / (v² + 4 Δv²))² falls to zero if a segment sticks; at w = 0 the step is the
//! plain implicit one. Our own scheme; the factor 4 is our choice, because of 2, 4 and 6 it gave the least error over
//! 16 walks (0.47 % at 1 ms; `docs/convergence.md`).

use super::model::{LaneBody, LaneModel, LanePlate};
use super::plane::{PlaneField, PlaneForces, PlaneMoments};
use crate::actuator::{self, NEWTON, TorqueLimits};
use crate::number::{Mat3, Real, Vec3};
use crate::sand::law::StressLaw;
use crate::sand::{LawCoefficients, Plain, SandBed, SegmentState, StressModel};
use crate::spatial::{Inertia, PointMasses, Symmetric, Twist, Wrench};
use crate::stop::StopTorque;
use crate::used::{LanePiece, Surfaces};

/// State of the robots in one block, one lane each; see [`crate::State`].
#[derive(Clone)]
pub struct LaneState<R> {
    pub position: Vec3<R>,
    /// Origin of position.x [m], for sand that varies along the way.
    pub travelled: R,
    /// Quaternion w and (x, y, z).
    pub orientation: (R, Vec3<R>),
    pub velocity: Vec3<R>,
    pub angular_velocity: Vec3<R>,
    /// Change of both velocities in the last step.
    pub change: Twist<R>,
    pub work: R,
    pub joints: Vec<LaneJoint<R>>,
}

/// State and command of a joint.
#[derive(Clone, Copy)]
pub struct LaneJoint<R> {
    pub angle: R,
    pub rate: R,
    pub reference: R,
    pub torque: R,
    /// Change of `rate` in the last step [rad/s].
    pub change: R,
    /// Speed of the reference [rad/s].
    pub command_rate: R,
    /// Torque added to the servo's [N·m].
    pub command_torque: R,
}

/// Results of the inward pass for one joint, which the outward pass needs.
#[derive(Clone, Copy)]
struct Hinge<R> {
    axis: Twist<R>,
    /// Articulated inertia times the axis.
    inertia_axis: Wrench<R>,
    inverse: R,
    drive: R,
    acceleration: R,
}

impl<R: Real> Hinge<R> {
    fn empty() -> Self {
        let zero = R::zero();
        let axis = Twist { angular: Vec3::zero(), linear: Vec3::zero() };
        Self { axis, inertia_axis: Wrench::zero(), inverse: zero, drive: zero, acceleration: zero }
    }
}

/// Work space of a step; its contents are not kept.
pub struct LegScratch<R, const J: usize> {
    /// One entry for each joint.
    hinges: Vec<Hinge<R>>,
    limits: Vec<TorqueLimits<R>>,
    /// For each link of each leg, its masses with those of the sand, and the wrench that its motion needs.
    links: Vec<[(PointMasses<R>, Wrench<R>); J]>,
    /// The sand's force on each leg along the surface's normal, for sensors.
    pub supports: Vec<R>,
}

impl<R: Real, const J: usize> LegScratch<R, J> {
    pub fn new(joints: usize) -> Self {
        let link = (PointMasses::zero(), Wrench::zero());
        let (hinges, limits) = (vec![Hinge::empty(); joints], vec![TorqueLimits::none(); joints]);
        let supports = vec![R::zero(); joints / J];
        Self { hinges, limits, links: vec![[link; J]; joints / J], supports }
    }
}

/// Position and motion of a body; lengths from the base's centre of mass.
#[derive(Clone, Copy)]
struct LegFrame<R> {
    rotation: Mat3<R>,
    origin: Vec3<R>,
    velocity: Twist<R>,
    /// Acceleration that is due to velocities alone.
    bias: Twist<R>,
    /// Change of the velocity by the last step's accelerations.
    change: Twist<R>,
}

/// Position and horizontal velocity of the robot's base.
#[derive(Clone, Copy)]
struct Travel<R> {
    /// [m]; z above the surface that the present body has found.
    position: Vec3<R>,
    /// Along x and y [m/s].
    velocity: [R; 2],
    /// Strength of the sand that the present body has found; None without memory.
    strength: Option<R>,
}

impl<R: Real> Travel<R> {
    /// Over the sand that body number `body` has found: 0 is the belly, then come the legs.
    #[inline(always)]
    fn over(&self, surfaces: Option<&Surfaces<R>>, body: usize) -> Self {
        let mut found = *self;
        if let Some(surfaces) = surfaces {
            found.position.z = self.position.z - surfaces.levels[body];
            found.strength = Some(surfaces.strengths[body]);
        }
        found
    }
}

/// Advances all lanes by one time step.
#[inline(always)]
pub fn step<R: Real, const J: usize>(
    model: &LaneModel<R, J>,
    state: &mut LaneState<R>,
    scratch: &mut LegScratch<R, J>,
    surfaces: Option<&Surfaces<R>>,
) {
    let LegScratch { hinges, limits, links, supports } = scratch;
    let base = base_frame(state);
    let mut position = state.position;
    position.x += state.travelled;
    let (mut inertia, mut bias) = base_inertia(model, &base);
    let travel = Travel { position, velocity: [base.velocity.linear.x, base.velocity.linear.y], strength: None };
    let belly_found = travel.over(surfaces, 0);
    belly(model, &base, &belly_found, &mut inertia, &mut bias);
    for (l, leg) in model.legs.iter().enumerate() {
        let (joints, hinges) = (&state.joints[l * J..][..J], &mut hinges[l * J..][..J]);
        let found = travel.over(surfaces, l + 1);
        supports[l] = load_leg(model, leg, &base, &found, joints, hinges, &mut links[l]);
    }
    limits.iter_mut().for_each(TorqueLimits::begin);
    let mut acceleration = solve(model, &state.joints, links, hinges, limits, inertia, bias);
    if model.actuator.has_lines() {
        for pass in 0..NEWTON + hinges.len() {
            let joint = |i: usize| (&model.actuator, state.joints[i].rate, hinges[i].acceleration);
            if !actuator::again(limits, joint, model.dt, pass) {
                break;
            }
            acceleration = solve(model, &state.joints, links, hinges, limits, inertia, bias);
        }
    }
    for ((joint, hinge), limits) in state.joints.iter_mut().zip(hinges).zip(limits) {
        move_joint(model, joint, hinge.acceleration, limits, &mut state.work);
    }
    move_base(state, &acceleration, model.dt);
}

/// Solves for the accelerations of base and joints; `inertia` and `bias` are those of the base with its belly.
#[inline(always)]
fn solve<R: Real, const J: usize>(
    model: &LaneModel<R, J>,
    joints: &[LaneJoint<R>],
    links: &[[(PointMasses<R>, Wrench<R>); J]],
    hinges: &mut [Hinge<R>],
    limits: &mut [TorqueLimits<R>],
    mut inertia: Inertia<R>,
    mut bias: Wrench<R>,
) -> Twist<R> {
    for (l, leg) in model.legs.iter().enumerate() {
        let own = l * J..(l + 1) * J;
        let (hinges, limits) = (&mut hinges[own.clone()], &mut limits[own.clone()]);
        let (leg_inertia, leg_bias) = fold_leg(model, leg, &links[l], &joints[own], hinges, limits);
        inertia.add(&leg_inertia);
        bias.add(&leg_bias);
    }
    let acceleration = inertia.solve(&bias.scale_add(-R::one(), &Wrench::zero()));
    for leg in hinges.chunks_exact_mut(J) {
        let mut parent = acceleration;
        for hinge in leg {
            hinge.acceleration = (hinge.drive - hinge.inertia_axis.dot(&parent)) * hinge.inverse;
            parent = hinge.axis.scale_add(hinge.acceleration, &parent);
        }
    }
    acceleration
}

#[inline(always)]
fn base_frame<R: Real>(state: &LaneState<R>) -> LegFrame<R> {
    let (w, v) = state.orientation;
    let (one, two) = (R::one(), R::splat(2.0));
    let (xx, yy, zz) = (v.x * v.x, v.y * v.y, v.z * v.z);
    let (xy, xz, yz) = (v.x * v.y, v.x * v.z, v.y * v.z);
    let (wx, wy, wz) = (w * v.x, w * v.y, w * v.z);
    let rotation = Mat3::new(
        Vec3::new(one - two * (yy + zz), two * (xy + wz), two * (xz - wy)),
        Vec3::new(two * (xy - wz), one - two * (xx + zz), two * (yz + wx)),
        Vec3::new(two * (xz + wy), two * (yz - wx), one - two * (xx + yy)),
    );
    let velocity = Twist { angular: state.angular_velocity, linear: state.velocity };
    // The generalized acceleration is that of the centre of mass. If it is zero, the spatial acceleration is −ω × v.
    let bias = Twist { angular: Vec3::zero(), linear: velocity.linear.cross(velocity.angular) };
    LegFrame { rotation, origin: Vec3::zero(), velocity, bias, change: state.change }
}

#[inline(always)]
fn base_inertia<R: Real, const J: usize>(model: &LaneModel<R, J>, base: &LegFrame<R>) -> (Inertia<R>, Wrench<R>) {
    let own = Symmetric { diagonal: model.base_inertia, off: Vec3::zero() }.rotated(&base.rotation);
    let omega = base.velocity.angular;
    let bias = Wrench { moment: omega.cross(own.apply(omega)), force: -(model.gravity * model.base_mass) };
    (Inertia::central(model.base_mass, own), bias)
}

/// Adds the sand's force on the underside of the base.
#[inline(always)]
fn belly<R: Real, const J: usize>(
    model: &LaneModel<R, J>,
    base: &LegFrame<R>,
    travel: &Travel<R>,
    inertia: &mut Inertia<R>,
    bias: &mut Wrench<R>,
) {
    match (&model.ground.law, &model.ground.mechanisms) {
        (LawCoefficients::Li2013(law), None) => belly_by(law, &Plain, model, base, travel, inertia, bias),
        (law, None) => belly_by(law, &Plain, model, base, travel, inertia, bias),
        (LawCoefficients::Li2013(law), Some(mechanisms)) => {
            belly_by(law, mechanisms, model, base, travel, inertia, bias)
        }
        (law, Some(mechanisms)) => belly_by(law, mechanisms, model, base, travel, inertia, bias),
    }
}

/// The same as [`belly`], for one law. The plates are one-sided with a leading-edge gate; all face down in one plane of the base.
#[inline(always)]
fn belly_by<R: Real, const J: usize>(
    law: &impl StressLaw<R>,
    stress_model: &impl StressModel<R>,
    model: &LaneModel<R, J>,
    base: &LegFrame<R>,
    travel: &Travel<R>,
    inertia: &mut Inertia<R>,
    bias: &mut Wrench<R>,
) {
    let (mut forces, mut drag, mut edge) = (PlaneForces::zero(), PlaneMoments::zero(), PlaneMoments::zero());
    let turn = &base.rotation;
    let places = PlaneField { at: turn.z * model.belly_height, by: [turn.x, turn.y] };
    let [length, width] = model.belly_corner;
    let mut trusted = R::one();
    for corner in [[length, width], [length, -width], [-length, width], [-length, -width]] {
        trusted = trusted.min(trust(base, places.value(corner)));
    }
    let expected = base.change.scaled(trusted);
    let velocities = places.velocity(&expected.scale_add(R::splat(0.5), &base.velocity));
    let normal = -turn.z;
    let mut wet = false;
    for plate in &model.belly {
        let Some(depth) = submerged(&places, plate.center, travel.position.z) else { continue };
        wet = true;
        let site = SegmentState {
            width: plate.width,
            ..SegmentState::fresh(depth, travel.position.x + places.value(plate.center).x).travelling(travel.velocity)
        };
        let velocity = velocities.value(plate.center);
        let area = travel.strength.map_or(plate.area, |strength| plate.area * strength);
        let contact = model.ground.one_sided_by(law, stress_model, &site, area, normal, velocity);
        forces.add(contact.force, plate.center);
        drag.add(contact.drag, plate.center);
        edge.add(contact.edge, plate.center);
    }
    if wet {
        let expected = places.velocity(&expected);
        forces.plus(&drag.forces(&expected));
        forces.plus(&edge.forces(&expected.along(normal)));
        inertia.add(&Inertia::points(&drag.scaled(model.dt).of(&places)));
        inertia.add_outers(&edge.scaled(model.dt).of(&places.cross(normal)), normal);
        bias.add(&forces.wrench(&places).scale_add(-R::one(), &Wrench::zero()));
    }
}

/// Lists the pieces of the belly (body 0) and of each leg (bodies 1, 2, …) that may move sand.
#[inline(always)]
pub fn pieces<R: Real, const J: usize>(
    model: &LaneModel<R, J>,
    state: &LaneState<R>,
    cell: f64,
    pieces: &mut Vec<LanePiece<R>>,
) {
    pieces.clear();
    let base = base_frame(state);
    let turn = &base.rotation;
    let places = PlaneField { at: turn.z * model.belly_height, by: [turn.x, turn.y] };
    let velocities = places.velocity(&base.velocity);
    // Four pieces a plate, which is taken for a square.
    let quarter = R::splat(0.25);
    for plate in &model.belly {
        let side = (plate.area * quarter).sqrt();
        // The same in all lanes, up to the number of cells.
        let cells = (side.lane(0) / cell).round().clamp(1.0, 8.0) as u8;
        for k in 0..4 {
            let [u, v] = [k % 2, k / 2].map(|i| side * R::splat(f64::from(i) - 0.5));
            let at = [plate.center[0] + u, plate.center[1] + v];
            let (place, velocity) = (state.position + places.value(at), velocities.value(at));
            let area = plate.area * quarter;
            pieces.push(LanePiece { body: 0, place, normal: -turn.z, velocity, area, one_sided: true, cells });
        }
    }
    for (l, leg) in model.legs.iter().enumerate() {
        let mut frame = base;
        for (body, joint) in leg.iter().zip(&state.joints[l * J..]) {
            frame = child_frame(&frame, body, joint).0;
            let [e0, e1] = &body.plane;
            let places = PlaneField { at: frame.origin, by: [frame.rotation.apply(*e0), frame.rotation.apply(*e1)] };
            let velocities = places.velocity(&frame.velocity);
            let across = places.by[0].cross(places.by[1]);
            // Two plates at a time, in two pieces beside each other.
            for pair in body.plates.chunks(2) {
                let plate = &pair[pair.len() / 2];
                let area = pair.iter().fold(R::zero(), |sum, p| sum + p.area) * R::splat(0.5);
                let beside = across * (plate.width * quarter);
                let (place, velocity) = (state.position + places.value(plate.center), velocities.value(plate.center));
                let normal = places.change(plate.normal);
                for place in [place + beside, place - beside] {
                    let body = l + 1;
                    pieces.push(LanePiece { body, place, normal, velocity, area, one_sided: false, cells: 1 });
                }
            }
        }
    }
}

/// Weight w at `place`: near 1 in smooth motion, in which the next change of velocity is about the last one, and 0 if
/// the place sticks.
#[inline(always)]
fn trust<R: Real>(frame: &LegFrame<R>, place: Vec3<R>) -> R {
    let (speed, change) = (frame.velocity.at(place).norm_squared(), frame.change.at(place).norm_squared());
    let share = speed / change.mul_add(R::splat(4.0), speed + R::splat(1e-30));
    share * share
}

/// Depth of a place in a plane, if it is below the surface in any lane.
#[inline(always)]
fn submerged<R: Real>(places: &PlaneField<R>, p: [R; 2], height: R) -> Option<R> {
    let [e0, e1] = &places.by;
    let depth = -e0.z.mul_add(p[0], e1.z.mul_add(p[1], places.at.z + height));
    R::any(R::zero().lt(depth)).then(|| depth.max(R::zero()))
}

/// A link's masses with those that the sand adds, the wrench that its motion needs while all joint accelerations are
/// zero, and the sand's force on it along z.
#[inline(always)]
fn link<R: Real, const J: usize>(
    model: &LaneModel<R, J>,
    body: &LaneBody<R>,
    rate: R,
    frame: &LegFrame<R>,
    travel: &Travel<R>,
) -> ((PointMasses<R>, Wrench<R>), R) {
    let [e0, e1] = &body.plane;
    let places = PlaneField { at: frame.origin, by: [frame.rotation.apply(*e0), frame.rotation.apply(*e1)] };
    let velocities = places.velocity(&frame.velocity);
    let mut accelerations = places.velocity(&frame.bias).plus(&velocities.cross(-frame.velocity.angular));
    accelerations.at = accelerations.at - model.gravity;
    let expected = frame.change.scaled(trust(frame, places.value([R::zero(), body.length])));
    let middle = places.velocity(&expected.scale_add(R::splat(0.5), &frame.velocity));
    let (mut sand, drag) = link_sand(&model.ground, body, rate, &places, &middle, travel);
    sand.plus(&drag.forces(&places.velocity(&expected)));
    let bias = body.masses.forces(&accelerations).minus(&sand).wrench(&places);
    ((drag.scaled(model.dt).plus(&body.masses).of(&places), bias), sand.force.z)
}

/// Adds the sand's forces on a link, and its drags as masses. They act on the strip, or in part on the straight chord
/// if sand fills the concave leading side.
#[inline(always)]
fn link_sand<R: Real>(
    ground: &SandBed<R>,
    body: &LaneBody<R>,
    rate: R,
    places: &PlaneField<R>,
    velocities: &PlaneField<R>,
    travel: &Travel<R>,
) -> (PlaneForces<R>, PlaneMoments<R>) {
    let mut total = (PlaneForces::zero(), PlaneMoments::zero());
    let Some(mechanisms) = &ground.mechanisms else {
        let plates = &body.plates;
        let share = travel.strength.unwrap_or(R::one());
        match &ground.law {
            LawCoefficients::Li2013(law) => {
                strip(law, &Plain, ground, plates, places, velocities, travel, share, &mut total);
            }
            law => strip(law, &Plain, ground, plates, places, velocities, travel, share, &mut total),
        }
        return total;
    };
    let concave_leads = (body.bulge * rate).lt(R::zero());
    let fill = R::select(concave_leads, mechanisms.fill, R::zero());
    for (plates, share) in [(&body.plates, R::one() - fill), (&body.chord, fill)] {
        if !R::any(R::zero().lt(share)) {
            continue;
        }
        let share = travel.strength.map_or(share, |strength| share * strength);
        match &ground.law {
            LawCoefficients::Li2013(law) => {
                strip(law, mechanisms, ground, plates, places, velocities, travel, share, &mut total)
            }
            law => strip(law, mechanisms, ground, plates, places, velocities, travel, share, &mut total),
        }
    }
    total
}

/// Adds `share` of the sand's force on two-sided plates: the hottest loop of the program.
#[inline(always)]
#[allow(clippy::too_many_arguments)] // all arguments stay in registers
fn strip<R: Real>(
    law: &impl StressLaw<R>,
    stress_model: &impl StressModel<R>,
    ground: &SandBed<R>,
    plates: &[LanePlate<R>],
    places: &PlaneField<R>,
    velocities: &PlaneField<R>,
    travel: &Travel<R>,
    share: R,
    total: &mut (PlaneForces<R>, PlaneMoments<R>),
) {
    for plate in plates {
        let Some(depth) = submerged(places, plate.center, travel.position.z) else { continue };
        let (normal, velocity) = (places.change(plate.normal), velocities.value(plate.center));
        let site = SegmentState {
            width: plate.width,
            ..SegmentState::fresh(depth, travel.position.x + places.value(plate.center).x).travelling(travel.velocity)
        };
        let contact = ground.thin_plate_by(law, stress_model, &site, plate.area * share, normal, velocity);
        total.0.add(contact.force, plate.center);
        total.1.add(contact.drag, plate.center);
    }
}

/// Places one leg's links and loads them with sand. Returns the sand's force on the leg along z.
#[inline(always)]
fn load_leg<R: Real, const J: usize>(
    model: &LaneModel<R, J>,
    leg: &[LaneBody<R>; J],
    base: &LegFrame<R>,
    travel: &Travel<R>,
    joints: &[LaneJoint<R>],
    hinges: &mut [Hinge<R>],
    links: &mut [(PointMasses<R>, Wrench<R>); J],
) -> R {
    let (mut parent, mut support) = (*base, R::zero());
    for j in 0..J {
        let (frame, axis) = child_frame(&parent, &leg[j], &joints[j]);
        hinges[j].axis = axis;
        let (link, force) = link(model, &leg[j], joints[j].rate, &frame, travel);
        links[j] = link;
        support += force;
        parent = frame;
    }
    support
}

/// Inward pass over one leg: the leg's articulated inertia and bias, which add to the base's.
#[inline(always)]
fn fold_leg<R: Real, const J: usize>(
    model: &LaneModel<R, J>,
    leg: &[LaneBody<R>; J],
    links: &[(PointMasses<R>, Wrench<R>); J],
    joints: &[LaneJoint<R>],
    hinges: &mut [Hinge<R>],
    limits: &mut [TorqueLimits<R>],
) -> (Inertia<R>, Wrench<R>) {
    let mut carried: Option<(Inertia<R>, Wrench<R>)> = None;
    for j in (0..J).rev() {
        let (masses, mut bias) = links[j];
        let mut inertia = Inertia::points(&masses);
        if let Some((i, b)) = &carried {
            inertia.add(i);
            bias.add(b);
        }
        let hinge = &mut hinges[j];
        drive(model, leg[j].armature, &joints[j], &inertia, &bias, hinge, &mut limits[j]);
        inertia.add_outer(-hinge.inverse, &hinge.inertia_axis);
        let bias = hinge.inertia_axis.scale_add(hinge.drive * hinge.inverse, &bias);
        carried = Some((inertia, bias));
    }
    carried.unwrap_or((Inertia::points(&PointMasses::zero()), Wrench::zero()))
}

/// Turns `body` about its hinge.
#[inline(always)]
fn child_frame<R: Real>(parent: &LegFrame<R>, body: &LaneBody<R>, joint: &LaneJoint<R>) -> (LegFrame<R>, Twist<R>) {
    let axis = parent.rotation.apply(body.axis);
    let origin = parent.origin + parent.rotation.apply(body.joint);
    let (sin, cos) = joint.angle.sin_cos();
    let rotation = Mat3::new(
        turned(parent.rotation.x, axis, sin, cos),
        turned(parent.rotation.y, axis, sin, cos),
        turned(parent.rotation.z, axis, sin, cos),
    );
    let hinge = Twist::hinge(axis, origin);
    let velocity = hinge.scale_add(joint.rate, &parent.velocity);
    let bias = velocity.carries(&hinge).scale_add(joint.rate, &parent.bias);
    let change = hinge.scale_add(joint.change, &parent.change);
    (LegFrame { rotation, origin, velocity, bias, change }, hinge)
}

/// `u` turned about the unit vector `axis` (Rodrigues' formula).
#[inline(always)]
fn turned<R: Real>(u: Vec3<R>, axis: Vec3<R>, sin: R, cos: R) -> Vec3<R> {
    let along = axis * (axis.dot(u) * (R::one() - cos));
    axis.cross(u).scale_add(sin, u.scale_add(cos, along))
}

/// The servo, implicit in angle and speed: τ = τ0 − (dt kd + dt² kp) q̈. If that exceeds the torque limit (computed
/// with the parent held still), the torque is the limit and independent of q̈; motors with a known stall torque are checked afterwards
/// ([`actuator`]).
#[inline(always)]
fn drive<R: Real, const J: usize>(
    model: &LaneModel<R, J>,
    armature: R,
    joint: &LaneJoint<R>,
    inertia: &Inertia<R>,
    bias: &Wrench<R>,
    hinge: &mut Hinge<R>,
    limits: &mut TorqueLimits<R>,
) {
    let dt = model.dt;
    let rate = joint.command_rate.clamp(-model.speed_limit, model.speed_limit);
    let rate_error = rate - joint.rate;
    let error = rate_error.mul_add(dt, joint.reference - joint.angle);
    let torque = model.kp.mul_add(error, model.kd.mul_add(rate_error, joint.command_torque));
    let yielding = dt * dt.mul_add(model.kp, model.kd);
    let servo = model.actuator.track(StopTorque { torque, yielding }, joint.torque, dt);
    let gear = model.actuator.gear(joint.rate, joint.torque, dt);
    hinge.inertia_axis = inertia.apply(&hinge.axis);
    let own = hinge.inertia_axis.dot(&hinge.axis) + armature;
    let load = bias.dot(&hinge.axis);
    let expected = servo.plus(gear).moves(own, load);
    let limited = model.actuator.limited(servo, joint.rate, expected, dt);
    let push = limits.pass(servo, limited).plus(gear);
    hinge.inverse = R::one() / (own + push.yielding);
    hinge.drive = push.torque - load;
}

/// Computes speed, angle and servo reference after the step.
#[inline(always)]
fn move_joint<R: Real, const J: usize>(
    model: &LaneModel<R, J>,
    joint: &mut LaneJoint<R>,
    acceleration: R,
    limits: &TorqueLimits<R>,
    work: &mut R,
) {
    let torque = limits.push.at(acceleration);
    joint.torque = model.actuator.reported(torque, torque, joint.rate, acceleration, model.dt);
    joint.change = acceleration * model.dt;
    joint.rate += joint.change;
    joint.angle = joint.rate.mul_add(model.dt, joint.angle);
    let rate = joint.command_rate.clamp(-model.speed_limit, model.speed_limit);
    let reference = rate.mul_add(model.dt, joint.reference);
    joint.reference = reference.clamp(joint.angle - model.lag_limit, joint.angle + model.lag_limit);
    *work += (joint.torque * joint.rate).abs() * model.dt;
}

/// Moves the base by semi-implicit Euler; the rotation by the exponential map to third order, then normalised.
#[inline(always)]
fn move_base<R: Real>(state: &mut LaneState<R>, acceleration: &Twist<R>, dt: R) {
    state.change = acceleration.scaled(dt);
    state.velocity += state.change.linear;
    state.angular_velocity += state.change.angular;
    state.position = state.velocity.scale_add(dt, state.position);
    let half = state.angular_velocity * (dt * R::splat(0.5));
    let squared = half.norm_squared();
    let real = squared.mul_add(R::splat(-0.5), R::one());
    let half = half * squared.mul_add(R::splat(-1.0 / 6.0), R::one());
    let (w, v) = state.orientation;
    let new_w = real * w - half.dot(v);
    let new_v = v.scale_add(real, half.scale_add(w, half.cross(v)));
    let norm = R::splat(1.5) - R::splat(0.5) * new_w.mul_add(new_w, new_v.norm_squared());
    state.orientation = (new_w * norm, new_v * norm);
}
