//! What every engine does.

use super::command::Command;
use super::{Model, State};
use crate::sand::memory::Moved;

/// What an engine does with its robots, which it names by their index.
pub trait Integrator: Send {
    /// Gives robot `index` another model with equally many joints and plates. The model takes effect at the next
    /// `set_state` at the latest.
    fn set_model(&mut self, index: usize, model: &Model);

    /// Multiplies the sand's stress on each leg of robot `index`, which has `model`, by the leg's factor in `shares`
    /// until model or shares are set again. Takes effect at once. The default does nothing, because no task of engine
    /// `tree` has footprints.
    fn set_footing(&mut self, _index: usize, _model: &Model, _shares: &[f64]) {}

    fn set_state(&mut self, index: usize, state: &State);

    /// Copies robot `index`'s state into `out` without allocating.
    fn state(&self, index: usize, out: &mut State);

    /// The sand around robot `index`; None if it has no memory.
    fn sand(&self, _index: usize) -> Option<&Moved> {
        None
    }

    fn command(&mut self, index: usize, command: &Command);

    /// Advances every robot by `steps` time steps, which are a part of a control step; `ends`: it is the last part.
    /// Results are bit-identical for every division of a control step into parts, except in engine `rapier` with
    /// obstacles.
    fn advance_in_parts(&mut self, steps: usize, ends: bool);

    /// Begins a part of `steps` time steps, which calls of [`Integrator::go_on`] then make. However they divide it, the
    /// results have the bits of one call of [`Integrator::advance_in_parts`], in every engine.
    fn begin_part(&mut self, _steps: usize) {}

    /// Makes `steps` time steps of the part that has begun; `ends`: they are the last ones of the control step.
    fn go_on(&mut self, steps: usize, ends: bool) {
        self.advance_in_parts(steps, ends);
    }

    /// Advances every robot by `steps` time steps.
    fn advance(&mut self, steps: usize) {
        self.advance_in_parts(steps, true);
    }

    /// Fills `out` with the sand's force on each leg of robot `index` along the surface's normal in the last time step
    /// [N]. If the engine does not keep this force, `out` becomes empty, and [`super::pose::Pose`] computes the force.
    fn normal_forces(&self, _index: usize, out: &mut Vec<f64>) {
        out.clear();
    }
    /// Fills `out` with the ground's force on each foot of robot `index` along the surface's normal in the last time
    /// step of the last control step [N]. Only engine `tree` has feet; in the others `out` becomes empty.
    fn foot_loads(&self, _index: usize, out: &mut Vec<f64>) {
        out.clear();
    }
}
