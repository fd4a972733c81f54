//! Legs under driven carriages: the base moves at a prescribed velocity, joints turn at prescribed rates, and the
//! sand's forces are measured. There are no masses and no servos, so there are no equations of motion to solve.
//!
//! `work` is the work of the joints, ∫ Σ τ ω dt. It equals the work on the sand plus the work on the carriage.
//!
//! Bodies and sand are computed as in engine [`super::rapier`], in `f64`. A time step is one step of the midpoint rule.

use super::command::Command;
use super::frame::BodyFrame;
use super::integrator::Integrator;
use super::rapier::{PlacedBody, fold_turns, load_link};
use super::{Model, State};
use crate::sand::SandBed;

/// Carriages; independent of each other.
pub struct CarriageEngine {
    carriages: Vec<Carriage>,
}

struct Carriage {
    model: Model,
    ground: SandBed<f64>,
    state: State,
    /// Speed of each joint [rad/s].
    rates: Vec<f64>,
}

impl CarriageEngine {
    /// `count` carriages at rest.
    pub fn new(model: &Model, count: usize) -> Self {
        Self { carriages: (0..count).map(|_| Carriage::new(model)).collect() }
    }
}

impl Integrator for CarriageEngine {
    fn set_model(&mut self, index: usize, model: &Model) {
        let carriage = &mut self.carriages[index];
        carriage.model = model.clone();
        carriage.ground = model.scene.ground();
    }

    fn set_footing(&mut self, index: usize, model: &Model, shares: &[f64]) {
        self.carriages[index].model.scale_areas(model, shares);
    }

    /// The carriage keeps the state's velocity.
    fn set_state(&mut self, index: usize, state: &State) {
        self.carriages[index].state.clone_from(state);
        self.carriages[index].state.forget_changes();
    }

    fn state(&self, index: usize, out: &mut State) {
        out.clone_from(&self.carriages[index].state);
    }

    /// Joints turn at the given rates; torques are ignored.
    fn command(&mut self, index: usize, command: &Command) {
        self.carriages[index].rates.clone_from(&command.rates);
    }

    fn advance_in_parts(&mut self, steps: usize, ends: bool) {
        for carriage in &mut self.carriages {
            (0..steps).for_each(|_| carriage.step());
            if ends {
                fold_turns(&mut carriage.state, std::iter::repeat(true));
            }
        }
    }
}

impl Carriage {
    fn new(model: &Model) -> Self {
        let joints = model.joints();
        Self {
            ground: model.scene.ground(),
            state: State::at_rest(0.0, &vec![0.0; joints]),
            rates: vec![0.0; joints],
            model: model.clone(),
        }
    }

    /// Makes a time step: half of the motion → sand → the other half.
    fn step(&mut self) {
        let dt = self.model.scene.dt;
        self.state.rates.clone_from(&self.rates);
        self.travel(dt / 2.0);
        self.feel(dt);
        self.travel(dt / 2.0);
        self.state.references.clone_from(&self.state.angles);
    }

    fn travel(&mut self, time: f64) {
        let State { position, velocity, angles, rates, .. } = &mut self.state;
        position.iter_mut().zip(velocity).for_each(|(p, v)| *p += *v * time);
        angles.iter_mut().zip(rates).for_each(|(a, rate)| *a += *rate * time);
    }

    /// Adds the sand's impulse and the joints' work during `dt`, and stores the joint torques that balance the sand's forces.
    fn feel(&mut self, dt: f64) {
        let state = &mut self.state;
        let base = BodyFrame::base(state);
        let mut first = 0;
        for chain in &self.model.legs {
            let mut frame = base;
            let joints = first..first + chain.len();
            first = joints.end;
            state.torques[joints.clone()].fill(0.0);
            let mut hinges = Vec::with_capacity(chain.len());
            for (body, joint) in chain.iter().zip(joints) {
                frame = frame.child(body, state.angles[joint], state.rates[joint]);
                hinges.push((joint, frame.origin, frame.rotation * body.axis));
                let at = PlacedBody { frame: &frame, base: &state.position, travel: state.travel() };
                // With a time step of 0 the wrench has no implicit part.
                let sand = load_link(&self.ground, body, state.rates[joint], &at, 0.0).wrench;
                for (joint, origin, axis) in &hinges {
                    state.torques[*joint] -= axis.dot(&sand.moment_about(*origin));
                }
                state.impulse.iter_mut().zip(&sand.force).for_each(|(sum, f)| *sum += f * dt);
            }
        }
        state.work += state.torques.iter().zip(&state.rates).map(|(t, rate)| t * rate).sum::<f64>() * dt;
    }
}
