//! One time step of a robot on sand: servos → sand → rigid bodies.
//!
//! An articulated-body algorithm (Featherstone 2008, chapter 7) for a free base with legs, in a world-aligned frame at
//! the base's centre of mass. Sand is linearly implicit: its force after the step is f − C (v⁺ − v) with the present
//! velocity v. This has the same effect as point masses dt C at the segments. The masses enter the inertia only:
//! velocity-product terms are computed earlier, without these masses and with all accelerations zero.
//!
//! In smooth motion, a step changes the velocities by about the same Δv as the last step. So the sand's force f is
//! evaluated in the middle of the step, at v + ½ w Δv, and its drag acts on the difference from the expected change: f
//! − C (v⁺ − v − w Δv). The weight w = (v² / (v² + 4 Δv²))² falls to zero if a segment sticks. At w = 0 the step is
//! plainly implicit. The scheme is our own. The factor 4 is our choice: among 2, 4 and 6 it gave the least error over
//! 16 walks (0.47 % at 1 ms; `docs/convergence.md`).

use super::model::{LaneBody, LaneModel};
use super::plane::PlaneField;
use super::sand::{Travel, belly, link_sand};
use crate::actuator::{self, LimitedTorque, NEWTON};
use crate::blocks::{LaneJoint, LaneState, LinkFrame};
use crate::number::{Real, Vec3};
use crate::spatial::{Inertia, PointMasses, Symmetric, Twist, Wrench};
use crate::stop::{ImplicitTorque, Stop};
use crate::used::Surfaces;

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
        Self { axis: Twist::zero(), inertia_axis: Wrench::zero(), inverse: zero, drive: zero, acceleration: zero }
    }
}

/// Work space of a step; its contents are not kept.
pub struct LegScratch<R, const J: usize> {
    /// One entry for each joint.
    hinges: Vec<Hinge<R>>,
    limits: Vec<LimitedTorque<R>>,
    /// For each link of each leg: its masses with the masses that the sand adds, and the wrench that its motion needs.
    links: Vec<[(PointMasses<R>, Wrench<R>); J]>,
    /// The sand's force on each leg along the surface's normal, for sensors.
    pub normal_forces: Vec<R>,
}

impl<R: Real, const J: usize> LegScratch<R, J> {
    pub fn new(joints: usize) -> Self {
        let link = (PointMasses::zero(), Wrench::zero());
        let (hinges, limits) = (vec![Hinge::empty(); joints], vec![LimitedTorque::none(); joints]);
        let normal_forces = vec![R::zero(); joints / J];
        Self { hinges, limits, links: vec![[link; J]; joints / J], normal_forces }
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
    let LegScratch { hinges, limits, links, normal_forces } = scratch;
    let base = LinkFrame::base(state);
    let mut position = state.position;
    position.x += state.travelled[0];
    let (mut inertia, mut bias) = base_inertia(model, &base);
    let travel = Travel { position, velocity: [base.velocity.linear.x, base.velocity.linear.y], strength: None };
    let belly_found = travel.above(surfaces, 0);
    belly(model, &base, &belly_found, &mut inertia, &mut bias);
    for (l, leg) in model.legs.iter().enumerate() {
        let (joints, hinges) = (&state.joints[l * J..][..J], &mut hinges[l * J..][..J]);
        let found = travel.above(surfaces, l + 1);
        normal_forces[l] = load_leg(model, leg, &base, &found, joints, hinges, &mut links[l]);
    }
    limits.iter_mut().for_each(LimitedTorque::begin);
    let lines = model.actuator.has_lines();
    let mut acceleration = Twist::zero();
    for pass in 0..=NEWTON + hinges.len() {
        acceleration = solve(model, &state.joints, links, hinges, limits, inertia, bias);
        let joint = |i: usize| (&model.actuator, state.joints[i].rate, hinges[i].acceleration);
        if !lines || pass == NEWTON + hinges.len() || !actuator::next_pass(limits, joint, model.dt, pass) {
            break;
        }
    }
    for ((joint, hinge), limits) in state.joints.iter_mut().zip(hinges).zip(limits) {
        move_joint(model, joint, hinge.acceleration, limits, &mut state.work);
    }
    state.move_base(&acceleration, model.dt);
}

/// Solves for the accelerations of base and joints; `inertia` and `bias` belong to the base with its belly.
#[inline(always)]
fn solve<R: Real, const J: usize>(
    model: &LaneModel<R, J>,
    joints: &[LaneJoint<R>],
    links: &[[(PointMasses<R>, Wrench<R>); J]],
    hinges: &mut [Hinge<R>],
    limits: &mut [LimitedTorque<R>],
    mut inertia: Inertia<R>,
    mut bias: Wrench<R>,
) -> Twist<R> {
    for (l, leg) in model.legs.iter().enumerate() {
        let own = l * J..(l + 1) * J;
        let (hinges, limits) = (&mut hinges[own.clone()], &mut limits[own.clone()]);
        let ranges = model.ranges.get(l);
        let (leg_inertia, leg_bias) = fold_leg(model, (leg, ranges), &links[l], &joints[own], hinges, limits);
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
fn base_inertia<R: Real, const J: usize>(model: &LaneModel<R, J>, base: &LinkFrame<R>) -> (Inertia<R>, Wrench<R>) {
    let own = Symmetric { diagonal: model.base_inertia, off: Vec3::zero() }.rotated(&base.rotation);
    let omega = base.velocity.angular;
    let bias = Wrench { moment: omega.cross(own.apply(omega)), force: -(model.gravity * model.base_mass) };
    (Inertia::central(model.base_mass, own), bias)
}

/// Returns a link's masses with the masses that the sand adds, the wrench that the link's motion needs while all joint
/// accelerations are zero, and the sand's force on the link along z.
#[inline(always)]
fn link<R: Real, const J: usize>(
    model: &LaneModel<R, J>,
    body: &LaneBody<R>,
    rate: R,
    frame: &LinkFrame<R>,
    travel: &Travel<R>,
) -> ((PointMasses<R>, Wrench<R>), R) {
    let [e0, e1] = &body.plane;
    let places = PlaneField { at: frame.origin, by: [frame.rotation.apply(*e0), frame.rotation.apply(*e1)] };
    let velocities = places.velocity(&frame.velocity);
    let mut accelerations = places.velocity(&frame.bias).plus(&velocities.cross(-frame.velocity.angular));
    accelerations.at = accelerations.at - model.gravity;
    let expected = frame.change.scaled(frame.trust(places.value([R::zero(), body.length])));
    let middle = places.velocity(&expected.scale_add(R::splat(0.5), &frame.velocity));
    let (mut sand, drag) = link_sand(&model.ground, body, rate, &places, &middle, travel);
    sand.plus(&drag.forces(&places.velocity(&expected)));
    let bias = body.masses.forces(&accelerations).minus(&sand).wrench(&places);
    ((drag.scaled(model.dt).plus(&body.masses).of(&places), bias), sand.force.z)
}

/// Places one leg's links and loads them with sand. Returns the sand's force on the leg along z.
#[inline(always)]
fn load_leg<R: Real, const J: usize>(
    model: &LaneModel<R, J>,
    leg: &[LaneBody<R>; J],
    base: &LinkFrame<R>,
    travel: &Travel<R>,
    joints: &[LaneJoint<R>],
    hinges: &mut [Hinge<R>],
    links: &mut [(PointMasses<R>, Wrench<R>); J],
) -> R {
    let (mut parent, mut support) = (*base, R::zero());
    for j in 0..J {
        let frame = leg[j].frame(&parent, &joints[j]);
        hinges[j].axis = frame.axis;
        let (link, force) = link(model, &leg[j], joints[j].rate, &frame, travel);
        links[j] = link;
        support += force;
        parent = frame;
    }
    support
}

/// Inward pass over one leg, whose joints may have ranges. Returns the leg's articulated inertia and bias, to be added to those of the base.
#[inline(always)]
fn fold_leg<R: Real, const J: usize>(
    model: &LaneModel<R, J>,
    (leg, ranges): (&[LaneBody<R>; J], Option<&[[R; 2]; J]>),
    links: &[(PointMasses<R>, Wrench<R>); J],
    joints: &[LaneJoint<R>],
    hinges: &mut [Hinge<R>],
    limits: &mut [LimitedTorque<R>],
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
        hinge.inertia_axis = inertia.apply(&hinge.axis);
        let own = hinge.inertia_axis.dot(&hinge.axis) + leg[j].armature;
        let load = bias.dot(&hinge.axis);
        let push = drive(model, ranges.map(|all| all[j]), &joints[j], own, load, &mut limits[j]);
        hinge.inverse = R::one() / (own + push.yielding);
        hinge.drive = push.torque - load;
        inertia.add_outer(-hinge.inverse, &hinge.inertia_axis);
        let bias = hinge.inertia_axis.scale_add(hinge.drive * hinge.inverse, &bias);
        carried = Some((inertia, bias));
    }
    carried.unwrap_or((Inertia::points(&PointMasses::zero()), Wrench::zero()))
}

/// The torque at a joint with inertia `own` under `load`.
///
/// The servo is implicit in angle and speed: τ = τ0 − (dt kd + dt² kp) q̈. If this torque exceeds the limit (computed
/// with the parent held still), the torque is the limit and independent of q̈. Motors with a known stall torque are
/// checked afterwards ([`actuator`]). The stops of the joint's range act as in [`crate::tree`].
#[inline(always)]
fn drive<R: Real, const J: usize>(
    model: &LaneModel<R, J>,
    range: Option<[R; 2]>,
    joint: &LaneJoint<R>,
    own: R,
    load: R,
    limits: &mut LimitedTorque<R>,
) -> ImplicitTorque<R> {
    let dt = model.dt;
    let rate = joint.command_rate.clamp(-model.speed_limit, model.speed_limit);
    let rate_error = rate - joint.rate;
    let error = rate_error.mul_add(dt, joint.reference - joint.position);
    let torque = model.kp.mul_add(error, model.kd.mul_add(rate_error, joint.command_torque));
    let yielding = dt * dt.mul_add(model.kp, model.kd);
    let servo = model.actuator.track(ImplicitTorque { torque, yielding }, joint.torque, dt);
    let mut others = model.actuator.gear(joint.rate, joint.torque, dt);
    if let Some(range) = range {
        let stops = Stop::of(range, joint.position, joint.rate, own, dt);
        let acts = R::zero().lt(stops.push.yielding);
        if R::any(acts) {
            let stop = stops.at(servo.plus(others).plus(stops.push).moves(own, load));
            others = ImplicitTorque::select(acts, others.plus(stop), others);
        }
    }
    let expected = servo.plus(others).moves(own, load);
    let limited = model.actuator.limited(servo, joint.rate, expected, dt);
    limits.pass(servo, limited).plus(others)
}

/// Computes speed, angle and servo reference after the step.
#[inline(always)]
fn move_joint<R: Real, const J: usize>(
    model: &LaneModel<R, J>,
    joint: &mut LaneJoint<R>,
    acceleration: R,
    limits: &LimitedTorque<R>,
    work: &mut R,
) {
    let torque = limits.push.at(acceleration);
    joint.torque = model.actuator.reported(torque, torque, joint.rate, acceleration, model.dt);
    joint.change = acceleration * model.dt;
    joint.rate += joint.change;
    joint.position = joint.rate.mul_add(model.dt, joint.position);
    let rate = joint.command_rate.clamp(-model.speed_limit, model.speed_limit);
    let reference = rate.mul_add(model.dt, joint.reference);
    joint.reference = reference.clamp(joint.position - model.lag_limit, joint.position + model.lag_limit);
    *work += (joint.torque * joint.rate).abs() * model.dt;
}
