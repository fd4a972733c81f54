//! One time step of a tree robot: positions → sand → hard ground → joints → accelerations → motion.

use super::dynamics::{self, Folded, LaneTreeBody, LinkLoad, TreeHinge};
use super::floor::{BodyContacts, Floor, Touch};
use super::gear::{GearScratch, LaneGear, couple};
use super::patches::BodyPatches;
use super::relief::LaneRelief;
use super::sand;
use super::self_contact::{SelfContact, SelfContactScratch, StepAccelerations};
use super::servo::{JointTorques, LaneMotor};
use super::{Tree, TreeJoint};
use crate::actuator::{self, LimitedTorque, NEWTON};
use crate::blocks::{LaneState, LinkFrame};
use crate::number::{Kernel, Real, Vec3};
use crate::sand::SandBed;
use crate::spatial::Twist;
use crate::used::Surfaces;
use std::sync::Arc;

/// All data of the robots that do not change while they move, one robot in each lane.
pub struct LaneTree<R> {
    pub bodies: Vec<LaneTreeBody<R>>,
    pub motors: Vec<LaneMotor<R>>,
    /// Joints that follow others.
    pub gears: Vec<LaneGear<R>>,
    /// Servos whose references follow their targets with a lag, the same in all lanes.
    pub lags: Vec<TargetLag<R>>,
    pub patches: Arc<Vec<BodyPatches>>,
    pub contacts: Vec<BodyContacts>,
    /// None: parts of the robot pass through each other.
    pub self_contact: Option<Arc<SelfContact>>,
    pub ground: SandBed<R>,
    pub floor: Floor<R>,
    /// None: the surface is flat.
    pub relief: Option<LaneRelief>,
    pub gravity: Vec3<R>,
    /// Time step, equal in all lanes [s].
    pub dt: R,
}

/// The ground's forces on some bodies. Only a step that is asked to weigh computes them.
pub struct GroundForces<R> {
    /// The bodies that are weighed.
    bodies: Vec<usize>,
    /// The ground's force on each of them along the world's z in the last step that was weighed [N].
    pub normal: Vec<R>,
    pub weigh: bool,
    /// The loads of each body without and with the ground.
    loads: Vec<[LinkLoad<R>; 2]>,
}

impl<R: Real> GroundForces<R> {
    pub fn on(bodies: Vec<usize>) -> Self {
        let count = bodies.len();
        Self { bodies, normal: vec![R::zero(); count], weigh: false, loads: vec![[LinkLoad::none(); 2]; count] }
    }

    /// Keeps the loads: `part` 0 without the ground, 1 with it.
    #[inline(always)]
    fn keep(&mut self, part: usize, loads: &[LinkLoad<R>]) {
        if self.weigh {
            self.loads.iter_mut().zip(&self.bodies).for_each(|(kept, body)| kept[part] = loads[*body]);
        }
    }

    /// What the ground adds to a body's load at the body's acceleration is the ground's force.
    #[inline(always)]
    fn end(&mut self, accelerations: &[Twist<R>]) {
        if self.weigh {
            for ((normal, loads), body) in self.normal.iter_mut().zip(&self.loads).zip(&self.bodies) {
                let [without, with] =
                    [0, 1].map(|k| loads[k].inertia.apply(&accelerations[*body]).force.z + loads[k].bias.force.z);
                *normal = without - with;
            }
        }
    }
}

/// A servo's reference that follows its target as a first-order lag, as MuJoCo's `filterexact`.
pub struct TargetLag<R> {
    pub joint: usize,
    pub target: R,
    /// The part of the way to the target that the reference goes in a time step.
    share: R,
}

impl<R: Real> TargetLag<R> {
    /// The lags of a robot's servos for the time step `dt` [s].
    pub fn all(tree: &Tree, dt: f64) -> Vec<Self> {
        let lag = |(joint, own): (usize, &TreeJoint)| {
            let share = 1.0 - (-dt / own.target_time.filter(|time| *time > 0.0)?).exp();
            Some(Self { joint, target: R::zero(), share: R::splat(share) })
        };
        tree.joints().enumerate().filter_map(lag).collect()
    }
}

/// Work space of a step; its contents are not kept.
pub struct TreeScratch<R> {
    pub frames: Vec<LinkFrame<R>>,
    loads: Vec<LinkLoad<R>>,
    /// Loads without the forces of hard ground.
    bare: Vec<LinkLoad<R>>,
    /// Loads before they are folded.
    unfolded: Vec<LinkLoad<R>>,
    hinges: Vec<TreeHinge<R>>,
    pub accelerations: Vec<Twist<R>>,
    joints: Vec<R>,
    limits: Vec<LimitedTorque<R>>,
    pub touches: Vec<Touch<R>>,
    self_contact: SelfContactScratch<R>,
    pub ground_forces: GroundForces<R>,
    gears: GearScratch<R>,
    /// Torques of gears on the joints in the step before.
    geared: Vec<R>,
}

impl<R: Real> TreeScratch<R> {
    pub fn new(bodies: usize, gears: usize) -> Self {
        Self {
            frames: vec![LinkFrame::at_rest(); bodies],
            loads: vec![LinkLoad::none(); bodies],
            bare: vec![LinkLoad::none(); bodies],
            unfolded: vec![LinkLoad::none(); bodies],
            hinges: vec![TreeHinge::free(); bodies - 1],
            accelerations: vec![Twist::zero(); bodies],
            joints: vec![R::zero(); bodies - 1],
            limits: vec![LimitedTorque::none(); bodies - 1],
            touches: Vec::new(),
            self_contact: SelfContactScratch::new(),
            ground_forces: GroundForces::on(Vec::new()),
            gears: GearScratch::new(bodies, gears),
            geared: vec![R::zero(); bodies - 1],
        }
    }
}

/// Advances all lanes by one time step.
#[inline(always)]
pub fn step<R: Real>(
    model: &LaneTree<R>,
    state: &mut LaneState<R>,
    scratch: &mut TreeScratch<R>,
    found: Option<&Surfaces<R>>,
) {
    for gear in &model.gears {
        state.joints[gear.joint].reference = gear.place(&state.joints);
    }
    accelerate(model, state, scratch, found);
    move_joints(model, state, &scratch.joints, &scratch.limits);
    for (gear, torque) in model.gears.iter().zip(&scratch.gears.torques) {
        state.joints[gear.joint].torque = *torque;
    }
    for lag in &model.lags {
        let joint = &mut state.joints[lag.joint];
        joint.reference = lag.share.mul_add(lag.target - joint.reference, joint.reference);
    }
    state.move_base(&scratch.accelerations[0], model.dt);
}

/// Computes the accelerations in a time step.
#[inline(always)]
pub fn accelerate<R: Real>(
    model: &LaneTree<R>,
    state: &LaneState<R>,
    scratch: &mut TreeScratch<R>,
    found: Option<&Surfaces<R>>,
) {
    R::dispatch(AccelerateTrees { model, state, scratch, found });
}

/// A call of [`accelerate`], the same for steps and pictures.
struct AccelerateTrees<'a, R: Real> {
    model: &'a LaneTree<R>,
    state: &'a LaneState<R>,
    scratch: &'a mut TreeScratch<R>,
    found: Option<&'a Surfaces<R>>,
}

impl<R: Real> Kernel for AccelerateTrees<'_, R> {
    #[inline(always)]
    fn run(self) {
        accelerations(self.model, self.state, self.scratch, self.found);
    }
}

#[inline(always)]
fn accelerations<R: Real>(
    model: &LaneTree<R>,
    state: &LaneState<R>,
    scratch: &mut TreeScratch<R>,
    found: Option<&Surfaces<R>>,
) {
    let surface = &model.relief;
    let dt = model.dt;
    let place = state.place();
    scratch.geared.fill(R::zero());
    for (joint, torque) in model.gears.iter().flat_map(|gear| gear.torques(&state.joints)) {
        scratch.geared[joint] += torque;
    }
    dynamics::place(&model.bodies, state, &mut scratch.frames);
    dynamics::load(&model.bodies, &scratch.frames, model.gravity, &mut scratch.loads);
    scratch.ground_forces.keep(0, &scratch.loads);
    sand::press(&model.ground, &model.patches, &scratch.frames, &place, surface, found, &mut scratch.loads, dt);
    model.floor.find(&model.contacts, &scratch.frames, &place, surface, &mut scratch.touches);
    // The first solution on hard ground tells which points push, hold and slide in the second.
    let rounds = if scratch.touches.is_empty() { 1 } else { 2 };
    if rounds > 1 {
        scratch.bare.copy_from_slice(&scratch.loads);
    }
    for round in 0..rounds {
        if round > 0 {
            model.floor.classify(&mut scratch.touches, &scratch.accelerations, dt);
            scratch.loads.copy_from_slice(&scratch.bare);
        }
        model.floor.press(&scratch.touches, &mut scratch.loads, dt);
        scratch.ground_forces.keep(1, &scratch.loads);
        R::dispatch(SolveTrees { model, state, scratch });
    }
    if !model.gears.is_empty() {
        let TreeScratch { frames, loads, hinges, accelerations, joints, gears, .. } = scratch;
        let folded = Folded { bodies: &model.bodies, frames, hinges, base: &loads[0].inertia };
        let mut step = StepAccelerations { bodies: accelerations, joints };
        couple(&model.gears, &model.motors, &state.joints, &folded, &mut step, (gears, dt));
    }
    if let Some(contact) = &model.self_contact {
        let TreeScratch { frames, loads, hinges, accelerations, joints, self_contact, .. } = scratch;
        let folded = Folded { bodies: &model.bodies, frames, hinges, base: &loads[0].inertia };
        contact.keep_apart(&folded, &mut StepAccelerations { bodies: accelerations, joints }, self_contact, dt);
    }
    scratch.ground_forces.end(&scratch.accelerations);
}

/// Solves for the accelerations of base and joints under the present loads.
struct SolveTrees<'a, R: Real> {
    model: &'a LaneTree<R>,
    state: &'a LaneState<R>,
    scratch: &'a mut TreeScratch<R>,
}

impl<R: Real> Kernel for SolveTrees<'_, R> {
    #[inline(always)]
    fn run(self) {
        solve(self.model, self.state, self.scratch);
    }
}

#[inline(always)]
fn solve<R: Real>(model: &LaneTree<R>, state: &LaneState<R>, s: &mut TreeScratch<R>) {
    let (dt, joints) = (model.dt, &state.joints);
    s.limits.iter_mut().for_each(LimitedTorque::begin);
    let geared = (!model.gears.is_empty()).then_some(&s.geared[..]);
    // `fold` changes the loads, so a copy is needed if it runs several times, which it does for motors with lines of torque over speed.
    let lines = model.motors.iter().any(|motor| motor.actuator.has_lines());
    if lines {
        s.unfolded.copy_from_slice(&s.loads);
    }
    for pass in 0..NEWTON + joints.len() {
        let mut drive = JointTorques { motors: &model.motors, joints, limits: &mut s.limits, geared, dt };
        let base = dynamics::fold(&model.bodies, &s.frames, &mut drive, &mut s.loads, &mut s.hinges);
        dynamics::unfold(&model.bodies, &s.frames, &s.hinges, &base, &mut s.accelerations, &mut s.joints);
        let joint = |i: usize| (&model.motors[i].actuator, joints[i].rate, s.joints[i]);
        if !lines || !actuator::next_pass(&mut s.limits, joint, dt, pass) {
            break;
        }
        s.loads.copy_from_slice(&s.unfolded);
    }
}

/// Computes rates, positions, torques and servos' references after the step.
#[inline(always)]
fn move_joints<R: Real>(
    model: &LaneTree<R>,
    state: &mut LaneState<R>,
    accelerations: &[R],
    limits: &[LimitedTorque<R>],
) {
    let dt = model.dt;
    for (i, acceleration) in accelerations.iter().enumerate() {
        let joint = &mut state.joints[i];
        let torque = model.motors[i].torque(joint, &limits[i], *acceleration, dt);
        joint.change = *acceleration * dt;
        joint.rate += joint.change;
        joint.position = joint.rate.mul_add(dt, joint.position);
        joint.torque = torque;
        joint.reference = model.motors[i].reference_rate(joint).mul_add(dt, joint.reference);
        state.work += (torque * joint.rate).abs() * dt;
    }
}
