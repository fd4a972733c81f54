//! The engine for tree robots: blocks of environments in lanes of an instruction set, as in [`crate::lanes`].

use super::dynamics::{self, JointMotion, LaneTreeBody, LaneTreeMotion};
use super::floor::{BodyContacts, Floor};
use super::model::TreeModel;
use super::relief::LaneRelief;
use super::sand::{self, Feeler};
use super::servo::{LaneMotor, LaneServo};
use super::step::{LaneTree, LaneTreeState, TreeScratch, step};
use crate::engine::Command;
use crate::error::{Error, Result};
use crate::number::{Isa, Kernel, Real, Vec3, Work};
use crate::sand::memory::Moved;
use crate::sand::{Mechanisms, Medium};
use crate::spatial::Twist;
use crate::used::{LaneMemory, Surfaces};
use crate::{Model, State};
use std::f64::consts::TAU;
use std::sync::Arc;

/// Robots in blocks of as many as the instruction set has lanes; all have the same tree, plates and points of contact.
pub struct TreeEngine {
    blocks: Vec<Box<dyn TreeBlock>>,
    lanes: usize,
}

/// Makes blocks for the number type of an instruction set.
struct TreeBlocks<'a> {
    model: &'a Model,
    tree: &'a Arc<TreeModel>,
    count: usize,
}

impl Work for TreeBlocks<'_> {
    type Out = Vec<Box<dyn TreeBlock>>;

    fn run<R: Real>(self) -> Self::Out {
        (0..self.count)
            .map(|_| -> Box<dyn TreeBlock> { Box::new(TreeLanes::<R>::new(self.model, self.tree)) })
            .collect()
    }
}

impl TreeEngine {
    /// `count` robots with `model`, motionless until their state is set; instruction set by [`Isa::choose`].
    pub fn new(model: &Model, count: usize) -> Result<Self> {
        Self::with_isa(Isa::choose()?, model, count)
    }

    pub fn with_isa(isa: Isa, model: &Model, count: usize) -> Result<Self> {
        let Some(tree) = &model.tree else {
            return Err(Error::invalid("engine", "tree takes robots from URDF or MJCF files; this one is for lanes"));
        };
        let blocks = isa.with(TreeBlocks { model, tree, count: count.div_ceil(isa.lanes()) })?;
        let lanes = isa.lanes();
        let mut engine = Self { blocks, lanes };
        (0..count).for_each(|index| engine.set_model(index, model));
        Ok(engine)
    }

    /// See [`crate::engine::Engine::set_model`].
    pub fn set_model(&mut self, index: usize, model: &Model) {
        self.blocks[index / self.lanes].set_model(index % self.lanes, model);
    }

    /// See [`crate::engine::Engine::set_state`].
    pub fn set_state(&mut self, index: usize, state: &State) {
        self.blocks[index / self.lanes].set_state(index % self.lanes, state);
    }

    /// See [`crate::engine::Engine::state`].
    pub fn state(&self, index: usize, out: &mut State) {
        self.blocks[index / self.lanes].state(index % self.lanes, out);
    }

    /// See [`crate::engine::Engine::command`].
    pub fn command(&mut self, index: usize, command: &Command) {
        self.blocks[index / self.lanes].command(index % self.lanes, command);
    }

    /// See [`crate::engine::Engine::sand`].
    pub fn sand(&self, index: usize) -> Option<&Moved> {
        self.blocks[index / self.lanes].sand(index % self.lanes)
    }

    /// See [`crate::engine::Engine::advance`].
    pub fn advance(&mut self, steps: usize) {
        self.advance_in_parts(steps, true);
    }

    /// See [`crate::engine::Engine::advance_in_parts`].
    pub fn advance_in_parts(&mut self, steps: usize, ends: bool) {
        self.blocks.iter_mut().for_each(|b| b.advance(steps, ends));
    }
}

/// One block of robots, in any number type.
trait TreeBlock: Send {
    fn set_model(&mut self, lane: usize, model: &Model);
    fn set_state(&mut self, lane: usize, state: &State);
    fn state(&self, lane: usize, out: &mut State);
    fn sand(&self, lane: usize) -> Option<&Moved>;
    fn command(&mut self, lane: usize, command: &Command);
    fn advance(&mut self, steps: usize, ends: bool);
}

struct TreeLanes<R: Real> {
    tree: LaneTree<R>,
    state: LaneTreeState<R>,
    scratch: TreeScratch<R>,
    /// The sand's memory, and the pieces that move it.
    memory: Option<(LaneMemory<R>, Vec<Feeler>)>,
    /// Joints that turn freely: whole turns are taken out of their angles.
    endless: Vec<bool>,
    /// Origin of each lane's x and y [m]. Distances from it stay small, so `f32` keeps its accuracy however far a
    /// robot walks.
    origins: Vec<[f64; 2]>,
    /// Work of each lane up to the last control step [J].
    works: Vec<f64>,
}

impl<R: Real> TreeLanes<R> {
    fn new(model: &Model, tree: &Arc<TreeModel>) -> Self {
        let zero = R::zero();
        let still = Twist { angular: Vec3::zero(), linear: Vec3::zero() };
        let joints = tree.joints();
        // Lanes without an environment hover motionless above the ground.
        let motion = LaneTreeMotion {
            orientation: (R::one(), Vec3::zero()),
            velocity: still,
            change: still,
            joints: vec![JointMotion { position: zero, rate: zero, change: zero }; joints],
        };
        let state = LaneTreeState {
            position: Vec3::splat([0.0, 0.0, 1e3]),
            travelled: [zero; 2],
            motion,
            servos: vec![LaneServo::still(); joints],
            work: zero,
        };
        let endless = tree.tree.joints().map(|j| j.range.is_none() && j.kind == super::JointKind::Hinge).collect();
        let mut bodies = LaneTreeBody::all(&tree.tree);
        bodies[0].mass = R::splat(tree.base_mass);
        let lanes = LaneTree {
            bodies,
            motors: LaneMotor::all(tree),
            followers: tree.tree.followers(),
            patches: if model.has_sand() { tree.patches.clone() } else { Arc::default() },
            contacts: if model.scene.hard.is_empty() { Vec::new() } else { BodyContacts::all(tree) },
            ground: model.scene.ground(),
            self_contact: tree.self_contact.clone(),
            floor: Floor::new(tree, &model.scene.hard),
            relief: model.scene.relief.as_ref().map(|r| LaneRelief(vec![r.clone(); R::LANES])),
            gravity: Vec3::zero(),
            dt: R::splat(model.scene.dt),
        };
        let scratch = TreeScratch::new(joints + 1);
        let (origins, works) = (vec![[0.0; 2]; R::LANES], vec![0.0; R::LANES]);
        let memory = LaneMemory::new(model, tree.tree.bodies.len())
            .map(|memory| (memory, Feeler::all(&tree.plates, model.scene.memory.map_or(1.0, |m| m.cell))));
        Self { tree: lanes, state, scratch, memory, endless, origins, works }
    }

    /// Moves each lane's x and y into its origin and its work into the sum, and takes whole turns out of angles and
    /// their references.
    #[inline(always)]
    fn fold(&mut self) {
        for lane in 0..R::LANES {
            let [x, y, z] = self.state.position.lane(lane);
            let origin = &mut self.origins[lane];
            *origin = [origin[0] + x, origin[1] + y];
            (0..2).for_each(|k| self.state.travelled[k].set_lane(lane, origin[k]));
            self.state.position.set_lane(lane, [0.0, 0.0, z]);
            self.works[lane] += self.state.work.lane(lane);
        }
        self.state.work = R::zero();
        let joints = self.state.motion.joints.iter_mut().zip(&mut self.state.servos);
        for ((joint, servo), _) in joints.zip(&self.endless).filter(|(_, endless)| **endless) {
            let turns = (joint.position * R::splat(1.0 / TAU)).round() * R::splat(TAU);
            joint.position -= turns;
            servo.reference -= turns;
        }
    }
}

/// Model and state of one robot, and the surfaces that its bodies have found in sand with memory.
type Alone = (LaneTree<f64>, LaneTreeState<f64>, Option<Surfaces<f64>>);

/// One robot in `f64`, ready for a time step from `state`; None if the model's robot is no tree.
pub fn alone(model: &Model, state: &State) -> Option<Alone> {
    let mut block = TreeLanes::<f64>::new(model, model.tree.as_ref()?);
    block.set_model(0, model);
    block.set_state(0, state);
    Some((block.tree, block.state, block.memory.map(|(memory, _)| memory.surfaces)))
}

/// The hot loop, to be compiled for the block's instruction set.
struct AdvanceTrees<'a, R: Real> {
    block: &'a mut TreeLanes<R>,
    steps: usize,
    ends: bool,
}

impl<R: Real> Kernel for AdvanceTrees<'_, R> {
    #[inline(always)]
    fn run(self) {
        let TreeLanes { tree, state, scratch, memory, origins, .. } = &mut *self.block;
        for _ in 0..self.steps {
            step(tree, state, scratch, memory.as_ref().map(|(memory, _)| &memory.surfaces));
            if let Some((memory, feelers)) = memory
                && memory.tick()
            {
                dynamics::place(&tree.bodies, &state.motion, &mut scratch.frames);
                let tops = memory.surfaces.tops;
                sand::pieces(feelers, &tree.patches, &scratch.frames, state.position, tops, &mut memory.pieces);
                memory.update(origins, state.position);
            }
        }
        if self.ends {
            self.block.fold();
        }
    }
}

impl<R: Real> TreeLanes<R> {
    /// Gives one lane other ground. A kind of ground that no lane had before costs the other lanes time, but adds exactly
    /// zero to their forces.
    fn set_ground(&mut self, lane: usize, model: &Model, tree: &Arc<TreeModel>) {
        if !model.has_sand() {
            let coefficients = model.scene.medium.coefficients.scaled(0.0);
            let nothing = Medium { coefficients, terms: Vec::new(), ..model.scene.medium.clone() };
            self.tree.ground.set_lane(lane, &nothing, &Mechanisms::PLAIN);
        } else {
            if self.tree.patches.is_empty() {
                self.tree.patches = tree.patches.clone();
            }
            self.tree.ground.set_lane(lane, &model.scene.medium, &model.scene.mechanisms);
        }
        if self.tree.contacts.is_empty() && !model.scene.hard.is_empty() {
            self.tree.contacts = BodyContacts::all(tree);
        }
    }
}

impl<R: Real> TreeBlock for TreeLanes<R> {
    fn set_model(&mut self, lane: usize, model: &Model) {
        let Some(tree) = &model.tree else { return };
        LaneTreeBody::set_lane(&mut self.tree.bodies, lane, &tree.tree);
        self.tree.bodies[0].mass.set_lane(lane, tree.base_mass);
        LaneMotor::set_lane(&mut self.tree.motors, lane, tree);
        self.set_ground(lane, model, tree);
        if let Some((memory, _)) = &mut self.memory {
            memory.set_model(lane, model);
        }
        self.tree.floor.set_lane(lane, tree, &model.scene.hard);
        self.tree.gravity.set_lane(lane, model.gravity.into());
        if let (Some(reliefs), Some(own)) = (&mut self.tree.relief, &model.scene.relief) {
            reliefs.0[lane] = own.clone();
        }
    }

    fn set_state(&mut self, lane: usize, state: &State) {
        let [x, y, z] = state.position;
        self.origins[lane] = [x, y];
        let s = &mut self.state;
        s.position.set_lane(lane, [0.0, 0.0, z]);
        s.travelled[0].set_lane(lane, x);
        s.travelled[1].set_lane(lane, y);
        let m = &mut s.motion;
        m.orientation.0.set_lane(lane, state.orientation[0]);
        m.orientation.1.set_lane(lane, [state.orientation[1], state.orientation[2], state.orientation[3]]);
        m.velocity.linear.set_lane(lane, state.velocity);
        m.velocity.angular.set_lane(lane, state.angular_velocity);
        m.change.linear.set_lane(lane, state.velocity_change);
        m.change.angular.set_lane(lane, state.angular_velocity_change);
        if let Some((memory, _)) = &mut self.memory {
            memory.set_state(lane, state);
        }
        self.works[lane] = state.work;
        s.work.set_lane(lane, 0.0);
        for (i, (joint, servo)) in m.joints.iter_mut().zip(&mut s.servos).enumerate() {
            joint.position.set_lane(lane, state.angles[i]);
            joint.rate.set_lane(lane, state.rates[i]);
            joint.change.set_lane(lane, state.rate_changes[i]);
            servo.reference.set_lane(lane, state.references[i]);
            servo.torque.set_lane(lane, state.torques[i]);
        }
    }

    fn state(&self, lane: usize, out: &mut State) {
        let s = &self.state;
        let ([x, y, z], [x0, y0]) = (s.position.lane(lane), self.origins[lane]);
        out.position = [x0 + x, y0 + y, z];
        let m = &s.motion;
        let [i, j, k] = m.orientation.1.lane(lane);
        out.orientation = [m.orientation.0.lane(lane), i, j, k];
        out.velocity = m.velocity.linear.lane(lane);
        out.angular_velocity = m.velocity.angular.lane(lane);
        out.velocity_change = m.change.linear.lane(lane);
        out.angular_velocity_change = m.change.angular.lane(lane);
        out.work = self.works[lane] + s.work.lane(lane);
        for (i, (joint, servo)) in m.joints.iter().zip(&s.servos).enumerate() {
            out.angles[i] = joint.position.lane(lane);
            out.rates[i] = joint.rate.lane(lane);
            out.rate_changes[i] = joint.change.lane(lane);
            out.references[i] = servo.reference.lane(lane);
            out.torques[i] = servo.torque.lane(lane);
        }
    }

    fn sand(&self, lane: usize) -> Option<&Moved> {
        self.memory.as_ref().map(|(memory, _)| memory.sand(lane))
    }

    fn command(&mut self, lane: usize, command: &Command) {
        for (i, servo) in self.state.servos.iter_mut().enumerate() {
            servo.command_rate.set_lane(lane, command.rates[i]);
            servo.command_torque.set_lane(lane, command.torques[i]);
            if let Some(target) = command.targets.get(i) {
                servo.reference.set_lane(lane, *target);
            }
        }
    }

    fn advance(&mut self, steps: usize, ends: bool) {
        R::dispatch(AdvanceTrees { block: self, steps, ends });
    }
}
