//! The fast engine: articulated-body dynamics over lanes of environments. The instruction set is chosen at run time.
//!
//! * `dynamics`: one time step; generic over the number, so it exists once for `f64`, and for 8 and 16 lanes of `f32`.
//! * `frames`: positions and motions of the bodies; `sand`: forces of the sand on them.
//! * [`plane`]: sand forces on the plates of one plane, summed in its two coordinates.
//! * [`model`]: the model's numbers, one lane for each environment.
//!
//! Lanes never read each other: an environment's bits do not depend on its lane, its neighbours or the batch.

mod dynamics;
mod frames;
pub mod model;
pub mod plane;
mod sand;

use super::command::Command;
use super::spatial::Twist;
use super::used::LaneMemory;
use super::{Model, State};
use crate::error::{Error, Result};
use crate::number::{Isa, Kernel, Real, Vec3, Work};
use crate::sand::memory::Moved;
use crate::stop::NO_LIMIT;
use dynamics::LegScratch;
use frames::{LaneJoint, LaneState};
use model::LaneModel;
use std::f64::consts::TAU;

/// Robots in blocks of as many as the instruction set has lanes.
pub struct LanesEngine {
    blocks: Vec<Box<dyn LegBlock>>,
    lanes: usize,
}

/// Makes blocks for the number type of an instruction set.
struct LegBlocks<'a> {
    model: &'a Model,
    count: usize,
    joints: usize,
}

impl Work for LegBlocks<'_> {
    type Out = Vec<Box<dyn LegBlock>>;

    fn run<R: Real>(self) -> Self::Out {
        let block = if self.joints == 1 { LegLanes::<R, 1>::boxed } else { LegLanes::<R, 3>::boxed };
        (0..self.count).map(|_| block(self.model)).collect()
    }
}

impl LanesEngine {
    /// `count` robots with `model`, motionless until their state is set; instruction set by [`Isa::choose`].
    pub fn new(model: &Model, count: usize) -> Result<Self> {
        Self::with_isa(Isa::choose()?, model, count)
    }

    pub fn with_isa(isa: Isa, model: &Model, count: usize) -> Result<Self> {
        if !model.scene.obstacles.is_empty() {
            return Err(Error::invalid("engine", "lanes has no rigid obstacles; rapier does"));
        }
        model::check_planes(model)?;
        let joints = model.legs.first().map_or(0, Vec::len);
        if ![1, 3].contains(&joints) {
            return Err(Error::invalid("robot", format!("{joints} joints a leg; engine lanes takes 1 or 3")));
        }
        let blocks = isa.with(LegBlocks { model, count: count.div_ceil(isa.lanes()), joints })?;
        let lanes = isa.lanes();
        let mut engine = Self { blocks, lanes };
        (0..count).for_each(|index| engine.set_model(index, model));
        Ok(engine)
    }

    /// See [`super::engine::Engine::set_model`].
    pub fn set_model(&mut self, index: usize, model: &Model) {
        self.blocks[index / self.lanes].set_model(index % self.lanes, model);
    }

    /// See [`super::engine::Engine::set_footing`].
    pub fn set_footing(&mut self, index: usize, model: &Model, shares: &[f64]) {
        self.blocks[index / self.lanes].set_footing(index % self.lanes, model, shares);
    }

    /// See [`super::engine::Engine::set_state`].
    pub fn set_state(&mut self, index: usize, state: &State) {
        self.blocks[index / self.lanes].set_state(index % self.lanes, state);
    }

    /// See [`super::engine::Engine::state`].
    pub fn state(&self, index: usize, out: &mut State) {
        self.blocks[index / self.lanes].state(index % self.lanes, out);
    }

    /// See [`super::engine::Engine::command`].
    pub fn command(&mut self, index: usize, command: &Command) {
        self.blocks[index / self.lanes].command(index % self.lanes, command);
    }

    /// See [`super::engine::Engine::sand`].
    pub fn sand(&self, index: usize) -> Option<&Moved> {
        self.blocks[index / self.lanes].sand(index % self.lanes)
    }

    /// See [`super::engine::Engine::supports`].
    pub fn supports(&self, index: usize, out: &mut Vec<f64>) {
        self.blocks[index / self.lanes].supports(index % self.lanes, out);
    }

    /// See [`super::engine::Engine::advance`].
    pub fn advance(&mut self, steps: usize) {
        self.advance_in_parts(steps, true);
    }

    /// See [`super::engine::Engine::advance_in_parts`].
    pub fn advance_in_parts(&mut self, steps: usize, ends: bool) {
        self.blocks.iter_mut().for_each(|b| b.advance(steps, ends));
    }
}

/// One block of robots, in any number type.
trait LegBlock: Send {
    fn set_model(&mut self, lane: usize, model: &Model);
    fn set_footing(&mut self, lane: usize, model: &Model, shares: &[f64]);
    fn set_state(&mut self, lane: usize, state: &State);
    fn state(&self, lane: usize, out: &mut State);
    fn sand(&self, lane: usize) -> Option<&Moved>;
    fn supports(&self, lane: usize, out: &mut Vec<f64>);
    fn command(&mut self, lane: usize, command: &Command);
    fn advance(&mut self, steps: usize, ends: bool);
}

struct LegLanes<R: Real, const J: usize> {
    model: LaneModel<R, J>,
    state: LaneState<R>,
    scratch: LegScratch<R, J>,
    memory: Option<LaneMemory<R>>,
    /// Origin of each lane's x and y [m]. Distances from it stay small, so `f32` keeps its accuracy however far a
    /// robot walks.
    origins: Vec<[f64; 2]>,
    /// Work of each lane up to the last control step [J]. The state holds the work since then, so that small
    /// amounts are not lost in a large sum.
    works: Vec<f64>,
}

impl<R: Real, const J: usize> LegLanes<R, J> {
    fn boxed(model: &Model) -> Box<dyn LegBlock> {
        let mut parked = model.clone();
        parked.gravity = nalgebra::Vector3::zeros();
        let joint = {
            let zero = R::zero();
            LaneJoint {
                angle: zero,
                rate: zero,
                reference: zero,
                torque: zero,
                change: zero,
                command_rate: zero,
                command_torque: zero,
            }
        };
        // Lanes without an environment hover motionless above the sand.
        let state = LaneState {
            position: Vec3::splat([0.0, 0.0, 1e3]),
            travelled: R::zero(),
            orientation: (R::one(), Vec3::zero()),
            velocity: Vec3::zero(),
            angular_velocity: Vec3::zero(),
            change: Twist { angular: Vec3::zero(), linear: Vec3::zero() },
            work: R::zero(),
            joints: vec![joint; model.joints()],
        };
        let mut block = Self {
            model: LaneModel::splat(&parked),
            state,
            scratch: LegScratch::new(model.joints()),
            memory: LaneMemory::new(model, 1 + model.legs.len()),
            origins: vec![[0.0; 2]; R::LANES],
            works: vec![0.0; R::LANES],
        };
        block.model.gravity = Vec3::zero();
        Box::new(block)
    }

    /// Moves each lane's x and y into its origin and its work into the sum, and takes whole turns out of angles and
    /// their references where joints have no range.
    #[inline(always)]
    fn fold(&mut self) {
        for lane in 0..R::LANES {
            let [x, y, z] = self.state.position.lane(lane);
            let origin = &mut self.origins[lane];
            *origin = [origin[0] + x, origin[1] + y];
            self.state.travelled.set_lane(lane, origin[0]);
            self.state.position.set_lane(lane, [0.0, 0.0, z]);
            self.works[lane] += self.state.work.lane(lane);
        }
        self.state.work = R::zero();
        let mut ranges = self.model.ranges.iter().flatten();
        for joint in &mut self.state.joints {
            let mut turns = (joint.angle * R::splat(1.0 / TAU)).round() * R::splat(TAU);
            if let Some([_, most]) = ranges.next() {
                turns = R::select(most.lt(R::splat(NO_LIMIT)), R::zero(), turns);
            }
            joint.angle -= turns;
            joint.reference -= turns;
        }
    }
}

/// The hot loop, to be compiled for the block's instruction set.
struct AdvanceLegs<'a, R: Real, const J: usize> {
    block: &'a mut LegLanes<R, J>,
    steps: usize,
    ends: bool,
}

impl<R: Real, const J: usize> Kernel for AdvanceLegs<'_, R, J> {
    #[inline(always)]
    fn run(self) {
        let LegLanes { model, state, scratch, memory, origins, .. } = &mut *self.block;
        for _ in 0..self.steps {
            dynamics::step(model, state, scratch, memory.as_ref().map(|memory| &memory.surfaces));
            if let Some(memory) = memory
                && memory.tick()
            {
                sand::pieces(model, state, memory.cell(), &mut memory.pieces);
                memory.update(origins, state.position);
            }
        }
        if self.ends {
            self.block.fold();
        }
    }
}

impl<R: Real, const J: usize> LegBlock for LegLanes<R, J> {
    fn set_model(&mut self, lane: usize, model: &Model) {
        self.model.set_lane(lane, model);
        if let Some(memory) = &mut self.memory {
            memory.set_model(lane, model);
        }
    }

    fn set_footing(&mut self, lane: usize, model: &Model, shares: &[f64]) {
        self.model.set_footing(lane, model, shares);
    }

    fn set_state(&mut self, lane: usize, state: &State) {
        let [x, y, z] = state.position;
        self.origins[lane] = [x, y];
        let s = &mut self.state;
        s.position.set_lane(lane, [0.0, 0.0, z]);
        s.travelled.set_lane(lane, x);
        s.orientation.0.set_lane(lane, state.orientation[0]);
        s.orientation.1.set_lane(lane, [state.orientation[1], state.orientation[2], state.orientation[3]]);
        s.velocity.set_lane(lane, state.velocity);
        s.angular_velocity.set_lane(lane, state.angular_velocity);
        s.change.linear.set_lane(lane, state.velocity_change);
        s.change.angular.set_lane(lane, state.angular_velocity_change);
        if let Some(memory) = &mut self.memory {
            memory.set_state(lane, state);
        }
        self.works[lane] = state.work;
        s.work.set_lane(lane, 0.0);
        for (i, joint) in s.joints.iter_mut().enumerate() {
            joint.angle.set_lane(lane, state.angles[i]);
            joint.rate.set_lane(lane, state.rates[i]);
            joint.reference.set_lane(lane, state.references[i]);
            joint.torque.set_lane(lane, state.torques[i]);
            joint.change.set_lane(lane, state.rate_changes[i]);
        }
    }

    fn state(&self, lane: usize, out: &mut State) {
        let s = &self.state;
        let ([x, y, z], [x0, y0]) = (s.position.lane(lane), self.origins[lane]);
        out.position = [x0 + x, y0 + y, z];
        let [i, j, k] = s.orientation.1.lane(lane);
        out.orientation = [s.orientation.0.lane(lane), i, j, k];
        out.velocity = s.velocity.lane(lane);
        out.angular_velocity = s.angular_velocity.lane(lane);
        out.velocity_change = s.change.linear.lane(lane);
        out.angular_velocity_change = s.change.angular.lane(lane);
        out.work = self.works[lane] + s.work.lane(lane);
        for (i, joint) in s.joints.iter().enumerate() {
            out.angles[i] = joint.angle.lane(lane);
            out.rates[i] = joint.rate.lane(lane);
            out.references[i] = joint.reference.lane(lane);
            out.torques[i] = joint.torque.lane(lane);
            out.rate_changes[i] = joint.change.lane(lane);
        }
    }

    fn sand(&self, lane: usize) -> Option<&Moved> {
        self.memory.as_ref().map(|memory| memory.sand(lane))
    }

    fn supports(&self, lane: usize, out: &mut Vec<f64>) {
        out.clear();
        out.extend(self.scratch.supports.iter().map(|force| force.lane(lane)));
    }

    fn command(&mut self, lane: usize, command: &Command) {
        for (i, joint) in self.state.joints.iter_mut().enumerate() {
            joint.command_rate.set_lane(lane, command.rates[i]);
            joint.command_torque.set_lane(lane, command.torques[i]);
        }
    }

    fn advance(&mut self, steps: usize, ends: bool) {
        R::dispatch(AdvanceLegs { block: self, steps, ends });
    }
}
