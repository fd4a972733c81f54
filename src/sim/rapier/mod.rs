//! Engine on rapier3d's reduced-coordinate multibodies: one world for each robot, RFT forces at each segment's own
//! point.
//!
//! * [`world`]: the model as a multibody; rapier's inputs and outputs.
//! * [`sand`]: force on a body, and the added masses that make it implicit.
//! * [`inertia`]: mass properties that survive rapier's `f32`; [`units`]: rapier's unit of length is not a metre.
//! * [`contact`]: colliders of robot and obstacles; [`rocks`]: obstacles that move.
//!
//! We keep the state in `f64`; rapier solves in `f32` for the velocities after each step. rapier's multibody gives the
//! right motion under certain conditions only. A comment states each condition, at the line that ensures it.
//!
//! rapier's contacts keep data between steps: impulses to start from, points, the order of pairs. A world with
//! obstacles is therefore built anew at the start of every `advance`, so that a state that is read and set again gives
//! bit-identical results. In such worlds the results depend on how a duration is divided into calls of `advance`, but
//! not on how a part that has begun is divided into calls of `go_on`.

mod contact;
pub mod inertia;
mod rocks;
mod sand;
mod units;
mod world;

use super::command::Command;
use super::frame::{BodyFrame, V};
use super::integrator::Integrator;
use super::{Model, State};
use crate::sand::SandBed;
pub(super) use sand::{PlacedBody, load_link};

use contact::Shapes;
use inertia::{Masses, mass_properties};
use rapier3d::prelude::MassProperties;
use rocks::Rock;
use sand::SandWrench;
use std::f64::consts::TAU;
use world::World;

/// Robots; independent of each other.
pub struct RapierEngine {
    robots: Vec<RapierRobot>,
}

impl RapierEngine {
    /// `count` robots with `model`, standing with all angles 0.
    pub fn new(model: &Model, count: usize) -> Self {
        Self { robots: (0..count).map(|_| RapierRobot::new(model)).collect() }
    }
}

impl Integrator for RapierEngine {
    fn set_model(&mut self, index: usize, model: &Model) {
        self.robots[index].next_model = Some(model.clone());
    }

    fn set_footing(&mut self, index: usize, model: &Model, shares: &[f64]) {
        self.robots[index].model.scale_areas(model, shares);
    }

    fn set_state(&mut self, index: usize, state: &State) {
        self.robots[index].set_state(state);
    }

    fn state(&self, index: usize, out: &mut State) {
        out.clone_from(&self.robots[index].state);
    }

    fn command(&mut self, index: usize, command: &Command) {
        self.robots[index].set_command(command);
    }

    fn advance_in_parts(&mut self, steps: usize, ends: bool) {
        self.begin_part(steps);
        self.go_on(steps, ends);
    }

    fn begin_part(&mut self, steps: usize) {
        self.robots.iter_mut().for_each(|robot| robot.renew(steps));
    }

    fn go_on(&mut self, steps: usize, _ends: bool) {
        self.robots.iter_mut().for_each(|robot| (0..steps).for_each(|_| robot.step()));
    }
}

struct RapierRobot {
    model: Model,
    /// Model that will replace the present model at the next `set_state`.
    next_model: Option<Model>,
    ground: SandBed<f64>,
    /// Mass properties of the links with no sand on them.
    dry: Vec<MassProperties>,
    world: World,
    /// Collision shapes; None if the model has no obstacles.
    shapes: Option<Shapes>,
    rocks: Vec<Rock>,
    /// For each object, whether it stays fixed until the world is built again.
    resting: Vec<bool>,
    state: State,
    command: Command,
}

impl RapierRobot {
    fn new(model: &Model) -> Self {
        let joints = model.joints();
        let angles = vec![0.0; joints];
        Self {
            ground: model.scene.ground(),
            dry: model.legs.iter().flatten().map(|b| mass_properties(b.mass, b.center, &b.inertia)).collect(),
            world: World::new(model),
            shapes: Shapes::new(model),
            rocks: Rock::all(model),
            resting: Vec::new(),
            state: State {
                objects: model.objects_at_rest(),
                ..State::at_rest(model.standing_height(&angles), &angles)
            },
            command: Command::still(joints),
            next_model: None,
            model: model.clone(),
        }
    }

    fn set_state(&mut self, state: &State) {
        // rapier disables bodies with non-finite coordinates; only a new world is certain to work again.
        if let Some(model) = self.next_model.take() {
            let command = std::mem::replace(&mut self.command, Command::still(0));
            *self = Self::new(&model);
            self.set_command(&command);
        } else if !self.state.is_sound() {
            self.world = World::new(&self.model);
        }
        self.state.clone_from(state);
        for joint in
            [&mut self.state.angles, &mut self.state.rates, &mut self.state.references, &mut self.state.torques]
        {
            joint.resize(self.model.joints(), 0.0);
        }
        self.state.forget_changes();
        self.state.rate_changes.resize(self.model.joints(), 0.0);
        // Objects that the state does not name get the scene's poses.
        let objects = &mut self.state.objects;
        objects.truncate(self.rocks.len());
        objects.extend(self.model.objects_at_rest().into_iter().skip(objects.len()));
    }

    fn set_command(&mut self, command: &Command) {
        self.command.clone_from(command);
        self.command.rates.resize(self.model.joints(), 0.0);
        self.command.torques.resize(self.model.joints(), 0.0);
        let limit = self.model.motor.speed_limit;
        self.command.rates.iter_mut().for_each(|r| *r = r.clamp(-limit, limit));
    }

    /// Builds a world with obstacles anew for `steps` time steps, so that its motion depends on the state alone.
    fn renew(&mut self, steps: usize) {
        if let Some(shapes) = self.shapes.as_ref().filter(|_| self.state.is_sound()) {
            let time = steps as f64 * self.model.scene.dt;
            self.resting = rocks::resting(&self.model, &self.rocks, &self.ground, &self.state, time);
            self.world = World::new(&self.model);
            self.world.furnish(&self.model, shapes, &self.state, &self.resting);
        }
    }

    /// Servos → sand → rigid bodies → new positions. A robot whose state is not sound does not move.
    fn step(&mut self) {
        if !self.state.is_sound() {
            return;
        }
        let dt = self.model.scene.dt;
        fold_turns(&mut self.state, self.model.legs.iter().flatten().map(|body| body.range.is_none()));
        for (reference, rate) in self.state.references.iter_mut().zip(&self.command.rates) {
            *reference += rate * dt;
        }
        self.world.place(&self.state);
        self.world.drive(&self.model, &self.state, &self.command);
        let base = BodyFrame::base(&self.state);
        self.load_base(&base);
        self.load_legs(&base);
        let wet = self.load_rocks();
        self.world.solve(&self.model, &mut self.state);
        for (i, wet) in wet {
            let object = &mut self.state.objects[i];
            wet.leave(&self.world, i, object);
            advance_pose(&mut object.position, &mut object.orientation, object.velocity, object.angular_velocity, dt);
        }
        advance_positions(&mut self.state, dt);
        let lag = self.model.motor.lag_limit;
        for (reference, angle) in self.state.references.iter_mut().zip(&self.state.angles) {
            *reference = reference.clamp(angle - lag, angle + lag);
        }
    }

    /// Applies weight and sand to each rock that is not at rest; returns the rocks as rapier got them.
    fn load_rocks(&mut self) -> Vec<(usize, rocks::RockInSand)> {
        let (model, ground, world) = (&self.model, &self.ground, &mut self.world);
        let awake = (0..self.rocks.len()).filter(|i| !self.resting[*i]);
        let load = |i: usize| {
            let (rock, object) = (&self.rocks[i], &mut self.state.objects[i]);
            let wet = rock.fall(&model.solids[rock.index], ground, model.gravity, model.scene.dt, object);
            wet.enter(world, i, object);
            (i, wet)
        };
        awake.map(load).collect()
    }

    /// Applies weight and sand to the base.
    fn load_base(&mut self, base: &BodyFrame) {
        let model = &self.model;
        let at = PlacedBody { frame: base, base: &self.state.position, travel: self.state.travel() };
        let sand = sand::load_belly(&self.ground, &model.belly, &at, model.scene.dt);
        let mut wrench = sand.wrench;
        wrench.add_at(V::zeros(), model.gravity * model.base_mass);
        self.world.push_base(&wrench);

        let arm = base.rotation * sand.drag.center();
        self.world.load(self.world.drag, sand.drag.properties(), arm, &SandWrench::none());

        let up = base.rotation.transpose() * V::z();
        let (center, inertia) = (sand.edge.center(), sand.edge.inertia_along(up));
        let (arm, omega) = (base.rotation * center, base.angular_velocity);
        // rapier will subtract this body's velocity products: m a_z at its centre and ω × I ω.
        let mut own = SandWrench::none();
        own.add_at(arm, V::z() * (sand.edge.mass * base.acceleration_at(arm).z));
        own.moment += omega.cross(&(base.rotation * inertia * (base.rotation.transpose() * omega)));
        let properties = mass_properties(sand.edge.mass, center, &inertia);
        self.world.load(self.world.edge, properties, arm, &own);
    }

    /// Applies weight and sand to each link.
    fn load_legs(&mut self, base: &BodyFrame) {
        let (model, state) = (&self.model, &self.state);
        let mut joint = 0;
        for chain in &model.legs {
            let mut frame = *base;
            let mut before = self.world.base;
            for body in chain {
                frame = frame.child(body, state.angles[joint], state.rates[joint]);
                let at = PlacedBody { frame: &frame, base: &state.position, travel: state.travel() };
                let sand = sand::load_link(&self.ground, body, state.rates[joint], &at, model.scene.dt);
                let mut wrench = sand.wrench;
                wrench.add_at(frame.origin + frame.rotation * body.center, model.gravity * body.mass);
                let (properties, center) = if sand.drag.mass > 0.0 {
                    let wet = Masses::body(body.mass, body.center, body.inertia).with(&sand.drag);
                    (wet.properties(), wet.center())
                } else {
                    (self.dry[joint], body.center)
                };
                let arm = frame.origin + frame.rotation * center;
                let link = self.world.links[joint];
                self.world.load(link, properties, arm, &wrench);
                self.world.push_joint(joint, frame.rotation * body.axis, [before, link]);
                before = link;
                joint += 1;
            }
        }
    }
}

/// Removes whole turns from the angles and references of the joints that are `endless`, so that both stay small while a
/// hip turns.
pub(super) fn fold_turns(state: &mut State, endless: impl Iterator<Item = bool>) {
    let joints = state.angles.iter_mut().zip(&mut state.references).zip(endless);
    for ((angle, reference), _) in joints.filter(|(_, endless)| *endless) {
        let turns = (*angle / TAU).round() * TAU;
        *angle -= turns;
        *reference -= turns;
    }
}

/// Moves the positions with the velocities after the step: semi-implicit Euler.
fn advance_positions(state: &mut State, dt: f64) {
    advance_pose(&mut state.position, &mut state.orientation, state.velocity, state.angular_velocity, dt);
    for ((angle, rate), torque) in state.angles.iter_mut().zip(&state.rates).zip(&state.torques) {
        *angle += rate * dt;
        state.work += (torque * rate).abs() * dt;
    }
}

fn advance_pose(position: &mut [f64; 3], orientation: &mut [f64; 4], velocity: [f64; 3], omega: [f64; 3], dt: f64) {
    for (position, velocity) in position.iter_mut().zip(velocity) {
        *position += velocity * dt;
    }
    let [w, x, y, z] = *orientation;
    let turn = nalgebra::UnitQuaternion::from_scaled_axis(V::from(omega) * dt);
    let q = (turn.into_inner() * nalgebra::Quaternion::new(w, x, y, z)).normalize();
    *orientation = [q.w, q.i, q.j, q.k];
}
