//! The fast engine: articulated-body dynamics over lanes of environments. The instruction set is chosen at run time.
//!
//! * `dynamics`: one time step; generic over the number type, so one code serves `f64`, and 8 and 16 lanes of `f32`.
//! * `sand`: forces of the sand on the bodies.
//! * [`plane`]: sand forces on the plates of one plane, summed in its two coordinates.
//! * [`model`]: the model's numbers, one lane for each environment.
//!
//! Lanes never read each other, so an environment's results are bit-identical in any lane, with any neighbours and in any batch.

mod dynamics;
pub mod model;
pub mod plane;
mod sand;

use super::blocks::{LaneEngine, LaneState};
use super::command::Command;
use super::integrator::Integrator;
use super::used::LaneMemory;
use super::{Model, State};
use crate::error::{Error, Result};
use crate::number::{Isa, Kernel, Real, Vec3, Work};
use crate::sand::memory::Moved;
use crate::stop::NO_LIMIT;
use dynamics::LegScratch;
use model::LaneModel;

/// Makes a block for the number type of an instruction set.
#[derive(Clone, Copy)]
struct LegBlock<'a> {
    model: &'a Model,
    joints: usize,
}

impl Work for LegBlock<'_> {
    type Out = Box<dyn Integrator>;

    fn run<R: Real>(self) -> Self::Out {
        match self.joints {
            1 => Box::new(LegLanes::<R, 1>::new(self.model)),
            _ => Box::new(LegLanes::<R, 3>::new(self.model)),
        }
    }
}

/// `count` robots with `model`, motionless until their state is set.
pub fn engine(isa: Isa, model: &Model, count: usize) -> Result<LaneEngine> {
    if !model.scene.obstacles.is_empty() {
        return Err(Error::invalid("engine", "lanes has no rigid obstacles; rapier does"));
    }
    model::check_planes(model)?;
    let joints = model.legs.first().map_or(0, Vec::len);
    if ![1, 3].contains(&joints) {
        return Err(Error::invalid("robot", format!("{joints} joints a leg; engine lanes takes 1 or 3")));
    }
    LaneEngine::new(isa, model, count, LegBlock { model, joints })
}

struct LegLanes<R: Real, const J: usize> {
    model: LaneModel<R, J>,
    state: LaneState<R>,
    scratch: LegScratch<R, J>,
    memory: Option<LaneMemory<R>>,
}

impl<R: Real, const J: usize> LegLanes<R, J> {
    fn new(model: &Model) -> Self {
        let mut block = Self {
            model: LaneModel::splat(model),
            state: LaneState::hovering(model.joints()),
            scratch: LegScratch::new(model.joints()),
            memory: LaneMemory::new(model, 1 + model.legs.len()),
        };
        block.model.gravity = Vec3::zero();
        block
    }

    /// Ends a control step: removes whole turns from the angles and references of joints without a range.
    #[inline(always)]
    fn fold(&mut self) {
        self.state.fold();
        let mut ranges = self.model.ranges.iter().flatten();
        for joint in &mut self.state.joints {
            let mut turns = joint.whole_turns();
            if let Some([_, most]) = ranges.next() {
                turns = R::select(most.lt(R::splat(NO_LIMIT)), R::zero(), turns);
            }
            joint.turn_back(turns);
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
        let LegLanes { model, state, scratch, memory } = &mut *self.block;
        for _ in 0..self.steps {
            dynamics::step(model, state, scratch, memory.as_ref().map(|memory| &memory.surfaces));
            if let Some(memory) = memory
                && memory.tick()
            {
                sand::move_sand(model, state, memory);
            }
        }
        if self.ends {
            self.block.fold();
        }
    }
}

impl<R: Real, const J: usize> Integrator for LegLanes<R, J> {
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
        self.state.set_lane(lane, state);
        if let Some(memory) = &mut self.memory {
            memory.set_state(lane, state);
        }
    }

    fn state(&self, lane: usize, out: &mut State) {
        self.state.lane(lane, out);
    }

    fn sand(&self, lane: usize) -> Option<&Moved> {
        self.memory.as_ref().map(|memory| memory.sand(lane))
    }

    fn normal_forces(&self, lane: usize, out: &mut Vec<f64>) {
        out.clear();
        out.extend(self.scratch.normal_forces.iter().map(|force| force.lane(lane)));
    }

    fn command(&mut self, lane: usize, command: &Command) {
        self.state.command(lane, command);
    }

    fn advance_in_parts(&mut self, steps: usize, ends: bool) {
        R::dispatch(AdvanceLegs { block: self, steps, ends });
    }
}
