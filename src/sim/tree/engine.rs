//! The engine for tree robots: blocks of environments in lanes of an instruction set, as in [`crate::lanes`].

use super::dynamics::{self, LaneTreeBody};
use super::floor::{BodyContacts, Floor};
use super::gear::LaneGear;
use super::model::TreeModel;
use super::relief::LaneRelief;
use super::sand::{self, Feeler};
use super::servo::LaneMotor;
use super::step::{GroundForces, LaneTree, TargetLag, TreeScratch, step};
use crate::blocks::{LaneEngine, LaneState};
use crate::command::Command;
use crate::error::{Error, Result};
use crate::integrator::Integrator;
use crate::number::{Isa, Kernel, Real, Vec3, Work};
use crate::sand::memory::Moved;
use crate::sand::{Mechanisms, Medium};
use crate::used::{LaneMemory, Surfaces};
use crate::{Model, State};
use std::sync::Arc;

/// Makes a block for the number type of an instruction set.
#[derive(Clone, Copy)]
struct TreeBlock<'a> {
    model: &'a Model,
    tree: &'a Arc<TreeModel>,
}

impl Work for TreeBlock<'_> {
    type Out = Box<dyn Integrator>;

    fn run<R: Real>(self) -> Self::Out {
        Box::new(TreeLanes::<R>::new(self.model, self.tree))
    }
}

/// `count` robots with `model`, motionless until their state is set; all have the same tree, plates and points of contact.
pub fn engine(isa: Isa, model: &Model, count: usize) -> Result<LaneEngine> {
    let Some(tree) = &model.tree else {
        return Err(Error::invalid("engine", "tree takes robots from URDF or MJCF files; this one is for lanes"));
    };
    LaneEngine::new(isa, model, count, TreeBlock { model, tree })
}

struct TreeLanes<R: Real> {
    tree: LaneTree<R>,
    state: LaneState<R>,
    scratch: TreeScratch<R>,
    /// The sand's memory, and the pieces that move it.
    memory: Option<(LaneMemory<R>, Vec<Feeler>)>,
    /// For each joint, whether it turns freely. Whole turns are then removed from its angle.
    endless: Vec<bool>,
}

impl<R: Real> TreeLanes<R> {
    fn new(model: &Model, tree: &Arc<TreeModel>) -> Self {
        let joints = tree.joints();
        let mut endless: Vec<bool> =
            tree.tree.joints().map(|j| j.range.is_none() && j.kind == super::JointKind::Hinge).collect();
        // A follower's place depends on the leader's whole turns.
        for follower in tree.tree.followers() {
            (endless[follower.joint], endless[follower.leader]) = (false, false);
        }
        let mut bodies = LaneTreeBody::all(&tree.tree);
        bodies[0].mass = R::splat(tree.base_mass);
        let lanes = LaneTree {
            bodies,
            motors: LaneMotor::all(tree),
            gears: LaneGear::all(&tree.tree),
            lags: TargetLag::all(&tree.tree, model.scene.dt),
            patches: if model.has_sand() { tree.patches.clone() } else { Arc::default() },
            contacts: if model.scene.hard.is_empty() { Vec::new() } else { BodyContacts::all(tree) },
            ground: model.scene.ground(),
            self_contact: tree.self_contact.clone(),
            floor: Floor::new(tree, &model.scene.hard),
            relief: model.scene.relief.as_ref().map(|r| LaneRelief(vec![r.clone(); R::LANES])),
            gravity: Vec3::zero(),
            dt: R::splat(model.scene.dt),
        };
        let mut scratch = TreeScratch::new(joints + 1, lanes.gears.len());
        scratch.ground_forces = GroundForces::on(tree.stance.feet.clone());
        let memory = LaneMemory::new(model, tree.tree.bodies.len())
            .map(|memory| (memory, Feeler::all(&tree.plates, model.scene.memory.map_or(1.0, |m| m.cell))));
        Self { tree: lanes, state: LaneState::hovering(joints), scratch, memory, endless }
    }

    /// Ends a control step: removes whole turns from the angles of free joints and their references.
    #[inline(always)]
    fn fold(&mut self) {
        self.state.fold();
        for (i, joint) in self.state.joints.iter_mut().enumerate().filter(|(i, _)| self.endless[*i]) {
            let turns = joint.whole_turns();
            joint.turn_back(turns);
            for lag in self.tree.lags.iter_mut().filter(|lag| lag.joint == i) {
                lag.target -= turns;
            }
        }
    }
}

/// Model and state of one robot, and, in sand with memory, the sand's level and strength at each body.
type Alone = (LaneTree<f64>, LaneState<f64>, Option<Surfaces<f64>>);

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
        let TreeLanes { tree, state, scratch, memory, .. } = &mut *self.block;
        for k in 0..self.steps {
            scratch.ground_forces.weigh = self.ends && k + 1 == self.steps;
            step(tree, state, scratch, memory.as_ref().map(|(memory, _)| &memory.surfaces));
            if let Some((memory, feelers)) = memory
                && memory.tick()
            {
                dynamics::place(&tree.bodies, state, &mut scratch.frames);
                sand::move_sand(feelers, &tree.patches, &scratch.frames, state, memory);
            }
        }
        if self.ends {
            self.block.fold();
        }
    }
}

impl<R: Real> TreeLanes<R> {
    /// Gives one lane other ground. If no lane had this kind of ground before, all lanes now compute it, but the ground
    /// adds exactly zero to the forces in the other lanes.
    fn set_ground(&mut self, lane: usize, model: &Model, tree: &Arc<TreeModel>) {
        if !model.has_sand() {
            let coefficients = model.scene.medium.coefficients.scaled(0.0);
            let nothing = Medium { coefficients, terms: Vec::new(), ..model.scene.medium.clone() };
            self.tree.ground.set_lane(lane, &nothing, &Mechanisms::PLAIN);
        } else {
            if self.tree.patches.is_empty() {
                self.tree.patches = tree.patches.clone();
            }
            self.tree.ground.set_lane(lane, &model.sand(), &model.scene.mechanisms);
        }
        if self.tree.contacts.is_empty() && !model.scene.hard.is_empty() {
            self.tree.contacts = BodyContacts::all(tree);
        }
    }
}

impl<R: Real> Integrator for TreeLanes<R> {
    fn set_model(&mut self, lane: usize, model: &Model) {
        let Some(tree) = &model.tree else { return };
        LaneTreeBody::set_lane(&mut self.tree.bodies, lane, &tree.tree);
        self.tree.bodies[0].mass.set_lane(lane, tree.base_mass);
        LaneMotor::set_lane(&mut self.tree.motors, lane, tree);
        LaneGear::set_lane(&mut self.tree.gears, lane, tree);
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
        self.state.set_lane(lane, state);
        for lag in &mut self.tree.lags {
            lag.target.set_lane(lane, state.references[lag.joint]);
        }
        if let Some((memory, _)) = &mut self.memory {
            memory.set_state(lane, state);
        }
    }

    fn state(&self, lane: usize, out: &mut State) {
        self.state.lane(lane, out);
    }

    fn sand(&self, lane: usize) -> Option<&Moved> {
        self.memory.as_ref().map(|(memory, _)| memory.sand(lane))
    }

    fn foot_loads(&self, lane: usize, out: &mut Vec<f64>) {
        out.clear();
        out.extend(self.scratch.ground_forces.normal.iter().map(|force| force.lane(lane)));
    }

    fn command(&mut self, lane: usize, command: &Command) {
        let Self { state, tree, .. } = self;
        let before: Vec<f64> = tree.lags.iter().map(|lag| state.joints[lag.joint].reference.lane(lane)).collect();
        state.command(lane, command);
        for (lag, before) in tree.lags.iter_mut().zip(before) {
            let reference = &mut state.joints[lag.joint].reference;
            lag.target.set_lane(lane, reference.lane(lane));
            reference.set_lane(lane, before);
        }
    }

    fn advance_in_parts(&mut self, steps: usize, ends: bool) {
        R::dispatch(AdvanceTrees { block: self, steps, ends });
    }
}
