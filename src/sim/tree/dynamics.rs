//! Accelerations of a tree of bodies with a floating base, for one robot or for lanes of robots.
//!
//! An articulated-body algorithm (Featherstone 2008, chapter 7) in one world-aligned frame at the base link's
//! origin, so that inertias and wrenches of child and parent add. The generalized acceleration of the base is the
//! classical one of its origin. A step is [`place`] (poses and velocities of all bodies), [`load`] (the wrench that
//! each body's own motion needs), the forces of sand and ground, [`fold`] toward the base, and [`unfold`] outward.

use super::{HeldMass, JointKind, Tree};
use crate::blocks::{LaneJoint, LaneState, LinkFrame, turned_about};
use crate::number::{Mat3, Real, Vec3};
use crate::spatial::{Inertia, Symmetric, Twist, Wrench};
use crate::stop::ImplicitTorque;

/// A [`super::TreeBody`], one lane for each environment.
#[derive(Clone)]
pub struct LaneTreeBody<R> {
    pub parent: usize,
    pub kind: JointKind,
    /// The body's frame in the parent's when the joint is at 0.
    pub turn: Mat3<R>,
    pub offset: Vec3<R>,
    pub axis: Vec3<R>,
    pub mass: R,
    pub center: Vec3<R>,
    pub inertia: Symmetric<R>,
    pub armature: R,
    /// Mass without weight, and its moment.
    held: (R, Vec3<R>),
    /// Has any lane such a mass? A step skips it otherwise; the results are bit-identical.
    holds: bool,
}

/// The wrench that moves a body: `inertia` times its acceleration, plus `bias`.
#[derive(Clone, Copy)]
pub struct LinkLoad<R> {
    pub inertia: Inertia<R>,
    pub bias: Wrench<R>,
}

/// Results of the inward pass for one joint, which the outward pass needs.
#[derive(Clone, Copy)]
pub struct TreeHinge<R> {
    /// Articulated inertia times the axis.
    inertia_axis: Wrench<R>,
    inverse: R,
    drive: R,
    pub push: ImplicitTorque<R>,
}

/// The torques that drive and hold the joints.
pub trait Drive<R> {
    /// The torque on joint `joint`. `own` is the inertia that the joint moves, and `load` the torque at which it does
    /// not accelerate, both with the parent held still.
    fn push(&mut self, joint: usize, own: R, load: R) -> ImplicitTorque<R>;
}

impl<R: Real> LaneTreeBody<R> {
    /// All bodies of `tree`, the same in every lane.
    pub fn all(tree: &Tree) -> Vec<Self> {
        let bodies = tree.bodies.iter().map(|b| {
            let kind = b.joint.as_ref().map_or(JointKind::Hinge, |j| j.kind);
            let zero = Vec3::zero();
            let inertia = Symmetric::zero();
            let (turn, mass) = (Mat3::identity(), R::zero());
            Self {
                parent: b.parent,
                kind,
                turn,
                offset: zero,
                axis: zero,
                mass,
                center: zero,
                inertia,
                armature: R::zero(),
                held: (R::zero(), zero),
                holds: false,
            }
        });
        let mut all: Vec<Self> = bodies.collect();
        (0..R::LANES).for_each(|lane| Self::set_lane(&mut all, lane, tree));
        all
    }

    /// Gives one lane another tree with the same parents and kinds of joints.
    pub fn set_lane(all: &mut [Self], lane: usize, tree: &Tree) {
        for (out, body) in all.iter_mut().zip(&tree.bodies) {
            let turn = body.origin.rotation.to_rotation_matrix().into_inner();
            for (column, values) in [&mut out.turn.x, &mut out.turn.y, &mut out.turn.z].into_iter().zip(0..3) {
                column.set_lane(lane, turn.column(values).into_owned().map(exact).into());
            }
            out.offset.set_lane(lane, body.origin.translation.vector.map(exact).into());
            out.mass.set_lane(lane, body.mass);
            out.center.set_lane(lane, body.center.map(exact).into());
            let i = &body.inertia;
            out.inertia.diagonal.set_lane(lane, i.diagonal().into());
            out.inertia.off.set_lane(lane, [i[(0, 1)], i[(0, 2)], i[(1, 2)]]);
            out.held.0.set_lane(lane, body.held.mass);
            out.held.1.set_lane(lane, body.held.moment.map(exact).into());
            out.holds |= body.held != HeldMass::default();
            if let Some(joint) = &body.joint {
                out.axis.set_lane(lane, joint.axis.into_inner().map(exact).into());
                out.armature.set_lane(lane, joint.armature);
            }
        }
    }

    /// The body's frame, moved by its joint.
    #[inline(always)]
    fn frame(&self, parent: &LinkFrame<R>, joint: &LaneJoint<R>) -> LinkFrame<R> {
        let rotation = parent.rotation.compose(&self.turn);
        let (axis, mut origin) = (rotation.apply(self.axis), parent.point(self.offset));
        let (rotation, axis) = match self.kind {
            JointKind::Hinge => (turned_about(&rotation, axis, joint.position), Twist::hinge(axis, origin)),
            JointKind::Slide => {
                origin = axis.scale_add(joint.position, origin);
                (rotation, Twist { angular: Vec3::zero(), linear: axis })
            }
        };
        parent.carry(rotation, origin, axis, joint)
    }
}

/// `x`, or zero if `x` is only a rounding error of a length or direction. Products of rounding errors could become denormal in `f32`.
fn exact(x: f64) -> f64 {
    if x.abs() < 1e-14 { 0.0 } else { x }
}

/// Computes positions and velocities of all bodies.
#[inline(always)]
pub fn place<R: Real>(bodies: &[LaneTreeBody<R>], state: &LaneState<R>, frames: &mut [LinkFrame<R>]) {
    frames[0] = LinkFrame::base(state);
    for i in 1..bodies.len() {
        frames[i] = bodies[i].frame(&frames[bodies[i].parent], &state.joints[i - 1]);
    }
}

/// Computes the wrench that each body's own motion needs under `gravity`.
#[inline(always)]
pub fn load<R: Real>(bodies: &[LaneTreeBody<R>], frames: &[LinkFrame<R>], gravity: Vec3<R>, loads: &mut [LinkLoad<R>]) {
    for ((body, frame), load) in bodies.iter().zip(frames).zip(loads) {
        let inertia = body.inertia.rotated(&frame.rotation);
        let (c, spin) = (frame.point(body.center), frame.velocity.angular);
        let acceleration = frame.bias.at(c) + spin.cross(frame.velocity.at(c)) - gravity;
        let force = acceleration * body.mass;
        let moment = inertia.apply(frame.bias.angular) + spin.cross(inertia.apply(spin)) + c.cross(force);
        *load = LinkLoad { inertia: Inertia::at(body.mass, c, inertia), bias: Wrench { moment, force } };
        if body.holds {
            let (mass, moment) = body.held;
            let about = frame.origin.scale_add(mass, frame.rotation.apply(moment));
            load.bias.add(&Wrench { moment: about.cross(gravity), force: gravity * mass });
        }
    }
}

/// Inward pass: adds to each parent's load the part of the child's load that the joint transmits. Then solves for
/// the base.
#[inline(always)]
pub fn fold<R: Real>(
    bodies: &[LaneTreeBody<R>],
    frames: &[LinkFrame<R>],
    drive: &mut impl Drive<R>,
    loads: &mut [LinkLoad<R>],
    hinges: &mut [TreeHinge<R>],
) -> Twist<R> {
    for i in (1..bodies.len()).rev() {
        let (before, rest) = loads.split_at_mut(i);
        let (parent, LinkLoad { inertia, bias }) = (&mut before[bodies[i].parent], &mut rest[0]);
        let axis = &frames[i].axis;
        let inertia_axis = inertia.apply(axis);
        let own = inertia_axis.dot(axis) + bodies[i].armature;
        let needed = bias.dot(axis);
        let push = drive.push(i - 1, own, needed);
        let inverse = R::one() / (own + push.yielding);
        let drive = push.torque - needed;
        hinges[i - 1] = TreeHinge { inertia_axis, inverse, drive, push };
        parent.inertia.add(inertia);
        parent.inertia.add_outer(-inverse, &inertia_axis);
        parent.bias.add(&inertia_axis.scale_add(drive * inverse, bias));
    }
    let base = &loads[0];
    base.inertia.solve(&base.bias.scale_add(-R::one(), &Wrench::zero()))
}

/// Outward pass: computes the accelerations of the joints, and for each body its acceleration less the part that is due to velocities alone.
#[inline(always)]
pub fn unfold<R: Real>(
    bodies: &[LaneTreeBody<R>],
    frames: &[LinkFrame<R>],
    hinges: &[TreeHinge<R>],
    base: &Twist<R>,
    accelerations: &mut [Twist<R>],
    joints: &mut [R],
) {
    accelerations[0] = *base;
    for i in 1..bodies.len() {
        let (hinge, parent) = (&hinges[i - 1], accelerations[bodies[i].parent]);
        joints[i - 1] = (hinge.drive - hinge.inertia_axis.dot(&parent)) * hinge.inverse;
        accelerations[i] = frames[i].axis.scale_add(joints[i - 1], &parent);
    }
}

/// Results of [`fold`].
pub struct Folded<'a, R> {
    pub bodies: &'a [LaneTreeBody<R>],
    pub frames: &'a [LinkFrame<R>],
    pub hinges: &'a [TreeHinge<R>],
    /// Articulated inertia of the base.
    pub base: &'a Inertia<R>,
}

/// Changes of the accelerations from the folded solution if a force acts on the first of two bodies and the opposite force on
/// the second body. `wrenches` is work space.
#[inline(always)]
pub fn respond<R: Real>(
    folded: &Folded<R>,
    [first, second]: [usize; 2],
    push: &Wrench<R>,
    wrenches: &mut [Wrench<R>],
    accelerations: &mut [Twist<R>],
    joints: &mut [R],
) {
    let Folded { bodies, frames, hinges, base } = *folded;
    wrenches.fill(Wrench::zero());
    wrenches[first] = push.scale_add(-R::one(), &Wrench::zero());
    wrenches[second] = *push;
    for i in (1..bodies.len()).rev() {
        let hinge = &hinges[i - 1];
        let drive = -wrenches[i].dot(&frames[i].axis);
        joints[i - 1] = drive;
        let through = hinge.inertia_axis.scale_add(drive * hinge.inverse, &wrenches[i]);
        wrenches[bodies[i].parent].add(&through);
    }
    accelerations[0] = base.solve(&wrenches[0].scale_add(-R::one(), &Wrench::zero()));
    for i in 1..bodies.len() {
        let (hinge, parent) = (&hinges[i - 1], accelerations[bodies[i].parent]);
        joints[i - 1] = (joints[i - 1] - hinge.inertia_axis.dot(&parent)) * hinge.inverse;
        accelerations[i] = frames[i].axis.scale_add(joints[i - 1], &parent);
    }
}

/// Changes of the accelerations from the folded solution if `torques` act on two joints in addition. `wrenches` is work
/// space.
#[inline(always)]
pub fn respond_to_torques<R: Real>(
    folded: &Folded<R>,
    torques: [(usize, R); 2],
    wrenches: &mut [Wrench<R>],
    accelerations: &mut [Twist<R>],
    joints: &mut [R],
) {
    let Folded { bodies, frames, hinges, base } = *folded;
    wrenches.fill(Wrench::zero());
    joints.fill(R::zero());
    torques.iter().for_each(|(joint, torque)| joints[*joint] += *torque);
    for i in (1..bodies.len()).rev() {
        let hinge = &hinges[i - 1];
        let drive = joints[i - 1] - wrenches[i].dot(&frames[i].axis);
        joints[i - 1] = drive;
        let through = hinge.inertia_axis.scale_add(drive * hinge.inverse, &wrenches[i]);
        wrenches[bodies[i].parent].add(&through);
    }
    accelerations[0] = base.solve(&wrenches[0].scale_add(-R::one(), &Wrench::zero()));
    for i in 1..bodies.len() {
        let (hinge, parent) = (&hinges[i - 1], accelerations[bodies[i].parent]);
        joints[i - 1] = (joints[i - 1] - hinge.inertia_axis.dot(&parent)) * hinge.inverse;
        accelerations[i] = frames[i].axis.scale_add(joints[i - 1], &parent);
    }
}

impl<R: Real> LinkLoad<R> {
    pub fn none() -> Self {
        Self { inertia: Inertia::at(R::zero(), Vec3::zero(), Symmetric::zero()), bias: Wrench::zero() }
    }
}

impl<R: Real> TreeHinge<R> {
    pub fn free() -> Self {
        let zero = R::zero();
        Self { inertia_axis: Wrench::zero(), inverse: zero, drive: zero, push: ImplicitTorque::none() }
    }
}
