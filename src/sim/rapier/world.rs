//! One robot as a rapier multibody in a world of its own.

use super::contact::{self, Shapes};
use super::inertia::mass_properties;
use super::sand::SandWrench;
use super::units::{PER_METRE, PER_SQUARE_METRE, metres, plain, quat, scaled, scaled_twice, vec3};
use crate::actuator::LaneActuator;
use crate::frame::{M, V};
use crate::model::{LinkBody, Model};
use crate::motor::Motor;
use crate::solid::RigidPose;
use crate::stop::{ImplicitTorque, Stop};
use crate::{State, engine::Command};
use rapier3d::glamx::{Pose3, Quat, Vec3};
use rapier3d::prelude::*;

/// Sweeps of the projected Gauss-Seidel method over the motors of one step: our choice. Joints couple through the base.
/// Each sweep multiplies the remaining error by the ratio of this coupling to the servo's own damping kd + dt kp, a few
/// percent for the reference robot.
const MOTOR_SWEEPS: usize = 4;

/// Smallest kd + dt kp [N·m·s/rad] of a motor: our choice, far below any gains (`xplorer`: 0.01). With it a servo
/// without gains still applies its feed-forward torque.
const LEAST_YIELDING: f64 = 1e-9;

/// A rigid body of rapier that is part of the robot.
#[derive(Clone, Copy)]
pub struct RobotPart(RigidBodyHandle);

/// rapier's objects. They hold no state of ours: coordinates, velocities, masses and forces are written every step.
///
/// Without obstacles the base is always at rapier's origin, so that `f32` keeps its accuracy however far the robot
/// walks. In a world with obstacles, the base is at rapier's origin only when the world is built.
pub struct World {
    physics: PhysicsWorld,
    pub base: RobotPart,
    /// Massless bodies fixed to the base, for the sand's added masses. The base's own centre of mass must stay at its
    /// origin, because rapier takes a root's velocity as the velocity of the root's centre of mass.
    pub drag: RobotPart,
    /// The same as `drag`, with mass along the vertical only.
    pub edge: RobotPart,
    /// Every link of every leg, in the order of the joints.
    pub links: Vec<RobotPart>,
    /// For each link's joint, the sum of the torques that rapier's motor does not give: middle of the motor's limits, gear and
    /// stop. `torque` is their value at speed 0 [N·m], `yielding` their decrease with the speed after the step [N·m·s/rad].
    others: Vec<ImplicitTorque<f64>>,
    /// Obstacles that move, in the order of the state's objects.
    rocks: Vec<RobotPart>,
    /// The base's and the links' colliders; none without obstacles.
    colliders: Vec<ColliderHandle>,
    /// Position of rapier's origin in the world [m], in worlds with obstacles.
    origin: V,
}

/// Index of a revolute joint's free axis among rapier's six.
const HINGE: usize = JointAxis::AngX as usize;
/// Generalized coordinates of the base: velocity, then angular velocity.
const BASE_DOFS: usize = 6;

impl World {
    /// A world without obstacles; [`Self::furnish`] adds them.
    pub fn new(model: &Model) -> Self {
        let mut physics = PhysicsWorld { gravity: Vec3::ZERO, ..PhysicsWorld::default() };
        let parameters = &mut physics.integration_parameters;
        parameters.dt = model.scene.dt as f32;
        parameters.num_solver_iterations = 1; // the default, 4, takes almost four times as long; we make dt smaller
        parameters.num_internal_pgs_iterations = MOTOR_SWEEPS;
        parameters.max_ccd_substeps = 0; // no body uses continuous collision detection

        let mut part = |mass_properties, locked| {
            let body = RigidBodyBuilder::dynamic().can_sleep(false).locked_axes(locked);
            RobotPart(physics.insert_body(body.additional_mass_properties(mass_properties)))
        };
        let inertia = M::from_diagonal(&model.base_inertia);
        let base = part(mass_properties(model.base_mass, V::zeros(), &inertia), LockedAxes::empty());
        let drag = part(MassProperties::default(), LockedAxes::empty());
        let horizontal = LockedAxes::TRANSLATION_LOCKED_X | LockedAxes::TRANSLATION_LOCKED_Y;
        let edge = part(MassProperties::default(), horizontal);
        let dry = |b: &LinkBody| mass_properties(b.mass, b.center, &b.inertia);
        let links: Vec<_> = model.legs.iter().flatten().map(|b| part(dry(b), LockedAxes::empty())).collect();

        let mut handle = None;
        for extra in [drag, edge] {
            handle = physics.insert_multibody_joint(base.0, extra.0, FixedJointBuilder::new());
        }
        let mut place = links.iter();
        for chain in &model.legs {
            let mut parent = base;
            for (body, link) in chain.iter().zip(&mut place) {
                handle = physics.insert_multibody_joint(parent.0, link.0, hinge(body, &model.motor, model.scene.dt));
                parent = *link;
            }
        }
        if let Some((multibody, _)) = handle.and_then(|h| physics.multibody_joints.get_mut(h)) {
            multibody.damping_mut().fill(0.0); // the default is 0.1 for every angle, also for the free base's
            for (i, body) in model.legs.iter().flatten().enumerate() {
                let rotor = model.motor.actuator.rotor_inertia.unwrap_or(0.0);
                multibody.armature_mut()[BASE_DOFS + i] = ((body.armature + rotor) * PER_SQUARE_METRE) as f32;
            }
        }
        let others = vec![ImplicitTorque::none(); links.len()];
        Self { physics, base, drag, edge, links, others, rocks: Vec::new(), colliders: Vec::new(), origin: V::zeros() }
    }

    /// Adds the model's obstacles around the robot of `state`; the objects that are `resting` are fixed where they are.
    pub fn furnish(&mut self, model: &Model, shapes: &Shapes, state: &State, resting: &[bool]) {
        let origin = V::from(state.position);
        self.origin = origin;
        let physics = &mut self.physics;
        contact::tune(&mut physics.integration_parameters);
        let parts = [self.base].into_iter().chain(self.links.iter().copied());
        self.colliders = parts.zip(shapes.robot()).map(|(p, c)| physics.insert_collider(c, Some(p.0))).collect();
        for (obstacle, collider) in shapes.obstacles(model) {
            if obstacle.moves() {
                let (object, rests) = (&state.objects[self.rocks.len()], resting[self.rocks.len()]);
                let body = if rests { RigidBodyBuilder::fixed() } else { RigidBodyBuilder::dynamic() };
                // rapier's gyroscopic forces are off, because we compute gyroscopic moments together with weight and
                // sand.
                let body = body.can_sleep(false).gyroscopic_forces_enabled(false);
                let pose = relative(&RigidPose::new(object.position, object.orientation), origin);
                self.rocks.push(RobotPart(physics.insert(body.pose(pose), collider).0));
            } else {
                let pose = RigidPose::new(obstacle.position, obstacle.orientation);
                physics.insert_collider(collider.position(relative(&pose, origin)), None);
            }
        }
    }

    /// Sets a rock's `pose`, mass properties, and velocities of its centre of mass.
    pub fn place_rock(&mut self, rock: usize, pose: &RigidPose, masses: MassProperties, velocity: V, omega: V) {
        let body = &mut self.physics.bodies[self.rocks[rock].0];
        body.set_position(relative(pose, self.origin), false);
        body.set_additional_mass_properties(masses, false);
        body.set_linvel(scaled(velocity), false);
        body.set_angvel(vec3(omega), false);
    }

    /// Velocity of a rock's centre of mass [m/s] and angular velocity [rad/s].
    pub fn rock_velocity(&self, rock: usize) -> [V; 2] {
        let body = &self.physics.bodies[self.rocks[rock].0];
        [metres(body.linvel()), plain(body.angvel())]
    }

    fn multibody(&mut self) -> Option<&mut Multibody> {
        let link = self.physics.multibody_joints.rigid_body_link(self.base.0).copied()?;
        self.physics.multibody_joints.get_multibody_mut(link.multibody)
    }

    /// Sets the robot's pose and velocities from `state`.
    pub fn place(&mut self, state: &State) {
        let [w, x, y, z] = state.orientation.map(|c| c as f32);
        let furnished = !self.colliders.is_empty();
        let place = if furnished { scaled(V::from(state.position) - self.origin) } else { Vec3::ZERO };
        let pose = Pose3::from_parts(place, Quat::from_xyzw(x, y, z, w));
        self.physics.bodies[self.base.0].set_position(pose, false);
        let Some(multibody) = self.multibody() else { return };
        let velocity = state.velocity.map(|v| v * PER_METRE);
        let velocities = velocity.iter().chain(&state.angular_velocity).chain(&state.rates);
        for (to, from) in multibody.generalized_velocity_mut().iter_mut().zip(velocities) {
            *to = *from as f32;
        }
        let hinges = multibody.links_mut().filter(|l| l.joint.ndofs() == 1);
        for (link, angle) in hinges.zip(&state.angles) {
            link.joint = MultibodyJoint::new(link.joint.data, false);
            link.joint.apply_displacement(&[*angle as f32]);
        }
        if furnished {
            self.place_colliders();
        }
    }

    /// Sets the poses of the robot's colliders from the joint angles: rapier moves them only at the end of a step.
    fn place_colliders(&mut self) {
        let physics = &mut self.physics;
        let Some(link) = physics.multibody_joints.rigid_body_link(self.base.0).copied() else { return };
        let Some(multibody) = physics.multibody_joints.get_multibody_mut(link.multibody) else { return };
        multibody.forward_kinematics(&physics.bodies, true);
        // In a new world's first step rapier moves colliders to their bodies.
        multibody.update_rigid_bodies(&mut physics.bodies, false);
        for link in multibody.links() {
            for collider in physics.bodies[link.rigid_body_handle()].colliders() {
                physics.colliders[*collider].set_position(*link.local_to_world());
            }
        }
    }

    /// Sets every motor's target. The servo kp(θ_ref⁺ − θ⁺) + kd(ω_ref − ω⁺) + τ, with θ⁺ = θ + dt ω⁺, is a damper with
    /// the coefficient kd + dt kp that pulls toward one speed. So the gains enter implicitly, and rapier clips the
    /// torque at the limit. rapier has one limit for both directions, so the middle of the two limits is not a part of
    /// the motor ([`Self::push_joint`] applies it). A stop is also a damper, plus its torque at speed 0.
    pub fn drive(&mut self, model: &Model, state: &State, command: &Command) {
        let yielding = yielding(&model.motor, model.scene.dt);
        let mut others = std::mem::take(&mut self.others);
        let Some(multibody) = self.multibody() else { return };
        let gear = LaneActuator::<f64>::splat(&model.motor.actuator);
        let hinges = multibody.links_mut().filter(|l| l.joint.ndofs() == 1);
        for (i, (link, body)) in hinges.zip(model.legs.iter().flatten()).enumerate() {
            let (angle, rate) = (state.angles[i], state.rates[i]);
            let pull = model.motor.kp * (state.references[i] - angle);
            let torque = pull + model.motor.kd * command.rates[i] + command.torques[i];
            let push = track(model, torque, yielding, state.torques[i]);
            let [middle, half] = limits(model, rate);
            let stop = stop(body, angle, rate, (push, gear.limits(rate)), model.scene.dt);
            let torque = middle + stop.torque;
            others[i] = ImplicitTorque { torque, yielding: gear.slows(rate, state.torques[i]) + stop.yielding };
            let motor = &mut link.joint.data.motors[HINGE];
            motor.damping = (push.yielding * PER_SQUARE_METRE) as f32;
            motor.target_vel = ((push.torque - middle) / push.yielding) as f32;
            motor.max_force = (half * PER_SQUARE_METRE) as f32;
        }
        for (damping, other) in multibody.damping_mut().iter_mut().skip(BASE_DOFS).zip(&others) {
            *damping = (other.yielding * PER_SQUARE_METRE) as f32;
        }
        self.others = others;
    }

    /// Applies `wrench` to the base.
    pub fn push_base(&mut self, wrench: &SandWrench) {
        self.push(self.base, V::zeros(), wrench);
    }

    /// Gives `part` mass properties about `center` (`arm` from the base's centre in the world) and applies its
    /// wrench.
    pub fn load(&mut self, part: RobotPart, masses: MassProperties, arm: V, wrench: &SandWrench) {
        self.physics.bodies[part.0].set_additional_mass_properties(masses, false);
        self.push(part, arm, wrench);
    }

    /// Applies the torque at a joint that rapier's motor does not give (the middle of the limits and the stop's torque)
    /// to the link and, in the opposite direction, to the part before it. `axis` is the joint's axis in the world. Both
    /// parts must have got their loads before, because [`Self::load`] resets their torques.
    pub fn push_joint(&mut self, joint: usize, axis: V, [before, link]: [RobotPart; 2]) {
        let torque = self.others.get(joint).map_or(0.0, |other| other.torque);
        if torque != 0.0 {
            self.physics.bodies[link.0].add_torque(scaled_twice(axis * torque), false);
            self.physics.bodies[before.0].add_torque(scaled_twice(axis * -torque), false);
        }
    }

    fn push(&mut self, part: RobotPart, arm: V, wrench: &SandWrench) {
        let body = &mut self.physics.bodies[part.0];
        body.reset_forces(false); // rapier keeps forces until they are reset
        body.reset_torques(false);
        body.add_force(scaled(wrench.force), false);
        body.add_torque(scaled_twice(wrench.moment_about(arm)), false);
    }

    /// Solves for the velocities after one time step and writes them, and the torques applied, into `state`.
    pub fn solve(&mut self, model: &Model, state: &mut State) {
        self.physics.step();
        let yielding = track(model, 0.0, yielding(&model.motor, model.scene.dt), 0.0).yielding;
        let Some(multibody) = self.multibody() else { return };
        let hinges = multibody.links().filter(|l| l.joint.ndofs() == 1);
        for ((link, torque), old) in hinges.zip(&mut state.torques).zip(&state.rates) {
            let target = f64::from(link.joint.data.motors[HINGE].target_vel);
            let rate = f64::from(multibody.joint_velocity(link)[0]);
            let [middle, half] = limits(model, *old);
            *torque = middle + (yielding * (target - rate)).clamp(-half, half);
        }
        let velocities = multibody.generalized_velocity(); // the links' own are one step old
        let to = state.velocity.iter_mut().chain(&mut state.angular_velocity).chain(&mut state.rates);
        for (to, from) in to.zip(velocities.iter()) {
            *to = f64::from(*from);
        }
        state.velocity.iter_mut().for_each(|v| *v /= PER_METRE);
    }
}

fn relative(pose: &RigidPose, origin: V) -> Pose3 {
    let rotation = nalgebra::Rotation3::from_matrix_unchecked(pose.rotation);
    let turn = nalgebra::UnitQuaternion::from_rotation_matrix(&rotation);
    Pose3::from_parts(scaled(pose.position - origin), quat(&turn))
}

/// The motor's torque with its lag; `yielding` is its decrease with speed [N·m·s/rad].
fn track(model: &Model, torque: f64, yielding: f64, before: f64) -> ImplicitTorque<f64> {
    LaneActuator::<f64>::splat(&model.motor.actuator).track(ImplicitTorque { torque, yielding }, before, model.scene.dt)
}

/// Middle and half width of the limits of a motor's torque at this rate.
fn limits(model: &Model, rate: f64) -> [f64; 2] {
    let [low, high] = LaneActuator::<f64>::splat(&model.motor.actuator).limits(rate);
    [(low + high) / 2.0, (high - low) / 2.0]
}

/// Decrease of a servo's torque with the speed gained in a step [N·m·s/rad].
fn yielding(motor: &Motor, dt: f64) -> f64 {
    (motor.kd + dt * motor.kp).max(LEAST_YIELDING)
}

/// A stop's torque at speed 0 and its decrease with the speed after the step [N·m·s/rad]. Only the solution shows
/// whether a stop would pull, but rapier solves once. So this function decides it from the link alone, under the
/// servo's torque within its `limits`. A stop may therefore hold a joint for one step although the joint moves away
/// from it.
fn stop(
    body: &LinkBody,
    angle: f64,
    rate: f64,
    (servo, limits): (ImplicitTorque<f64>, [f64; 2]),
    dt: f64,
) -> ImplicitTorque<f64> {
    let Some(range) = body.range else { return ImplicitTorque::none() };
    let own = inertia_at_joint(body);
    let stops = Stop::of(range, angle, rate, own, dt);
    let servo = ImplicitTorque { torque: servo.torque - servo.yielding * rate, yielding: servo.yielding * dt };
    let first = servo.plus(stops.push).moves(own, 0.0);
    let limited = servo.within(limits[0], limits[1], first);
    let stop = stops.at(limited.plus(stops.push).moves(own, 0.0));
    let yielding = stop.yielding / dt;
    ImplicitTorque { torque: stop.torque + yielding * rate, yielding }
}

/// Inertia of a link and its rotor about its joint [kg·m²].
fn inertia_at_joint(body: &LinkBody) -> f64 {
    let arm = body.axis.cross(&body.center).norm();
    body.armature + body.axis.dot(&(body.inertia * body.axis)) + body.mass * arm * arm
}

/// A revolute joint about the x axis of a frame that is turned so that x lies along the hinge.
fn hinge(body: &LinkBody, motor: &Motor, dt: f64) -> GenericJoint {
    let turn = nalgebra::UnitQuaternion::rotation_between(&V::x(), &body.axis);
    let turn = turn.unwrap_or_else(|| nalgebra::UnitQuaternion::from_axis_angle(&V::z_axis(), std::f64::consts::PI));
    let mut joint = GenericJoint::new(JointAxesMask::LOCKED_REVOLUTE_AXES);
    joint.local_frame1 = Pose3::from_parts(scaled(body.joint), quat(&turn));
    joint.local_frame2 = Pose3::from_parts(Vec3::ZERO, quat(&turn));
    joint.motor_axes = JointAxesMask::ANG_X;
    joint.motors[HINGE] = JointMotor {
        damping: (yielding(motor, dt) * PER_SQUARE_METRE) as f32,
        model: MotorModel::ForceBased, // by default the gains give accelerations
        ..JointMotor::default()
    };
    joint
}
