//! Obstacles that move: weight and sand in `f64`, contacts by rapier.
//!
//! A rock's whole surface is made of one-sided facets of resistive force theory, like a belly. This is our choice,
//! because facets need no parameters besides the sand's. It neglects the grains that pile up in front of a pushed rock.
//!
//! The motion under weight and sand is solved first, linearly implicit as for the robot but with the full 6 × 6 matrix.
//! rapier starts from the resulting velocities and adds the effect of contacts. For rapier the rock's mass includes the
//! point masses that represent sand. The masses for the leading-edge gate should act along the normal only, but
//! rapier's act in all directions. So a body that touches a rock feels the sand behind the rock a little too strongly.

use super::inertia::Masses;
use super::sand::lanes;
use super::world::World;
use crate::frame::{M, V};
use crate::model::LinkBody;
use crate::sand::{SandBed, SegmentState};
use crate::solid::{RigidPose, Solid};
use crate::state::ObjectState;
use crate::{Model, Obstacle, State};
use nalgebra::{Matrix6, Vector6};
use rapier3d::prelude::MassProperties;

/// A loose obstacle of the model.
pub struct Rock {
    /// Its index among the scene's obstacles.
    pub index: usize,
    /// [kg]
    mass: f64,
    /// About the centre of mass, own frame [kg·m²].
    inertia: M,
}

/// A rock slower than this [m/s] rests: ten times the speed with which it creeps in sand under a constant load.
const REST: f64 = 1e-4;

/// No body that may meet a resting rock is faster than this [m/s]: our choice, more than twice the fastest walk of
/// `docs/convergence.md` (0.77 m/s).
const APPROACH: f64 = 2.0;

/// For each object, whether it stays fixed for the next `time` [s]. An object stays fixed if it neither moves nor
/// falls, and neither the robot nor a moving object can reach it. If a rock is nevertheless pushed against it within
/// that time, it acts as fixed until the next call.
pub fn resting(model: &Model, rocks: &[Rock], ground: &SandBed<f64>, state: &State, time: f64) -> Vec<bool> {
    let slow = |(rock, object): (&Rock, &ObjectState)| {
        let (solid, mut after) = (&model.solids[rock.index], *object);
        rock.fall(solid, ground, model.gravity, model.scene.dt, &mut after);
        let fast = |o: &ObjectState| V::from(o.velocity).norm() + V::from(o.angular_velocity).norm() * solid.reach();
        fast(object) < REST && fast(&after) < REST
    };
    let slow: Vec<bool> = rocks.iter().zip(&state.objects).map(slow).collect();
    let robot = (V::from(state.position), reach(model));
    let near = |i: usize, (place, radius): (V, f64)| {
        let gap = (V::from(state.objects[i].position) - place).norm() - radius - model.solids[rocks[i].index].reach();
        gap < APPROACH * time
    };
    let moving: Vec<_> = (0..rocks.len()).filter(|i| !slow[*i]).collect();
    let other = |i: usize| (V::from(state.objects[i].position), model.solids[rocks[i].index].reach());
    let woken = |i: usize| near(i, robot) || moving.iter().any(|j| near(i, other(*j)));
    (0..rocks.len()).map(|i| slow[i] && !woken(i)).collect()
}

/// Radius of a ball around the base's centre that holds the robot [m].
fn reach(model: &Model) -> f64 {
    let leg = |chain: &Vec<LinkBody>| chain.iter().map(|b| b.joint.norm() + b.reach.norm()).sum::<f64>();
    let base = V::from(model.robot.base.size).norm() / 2.0;
    model.legs.iter().map(leg).fold(base, f64::max)
}

/// A rock with the point masses that the sand adds to it, as rapier gets it.
pub struct RockInSand {
    pub pose: RigidPose,
    pub properties: MassProperties,
    /// From the rock's centre of mass to the common centre of mass of rock and sand, world axes [m].
    arm: V,
}

impl Rock {
    pub fn all(model: &Model) -> Vec<Self> {
        let obstacles = model.scene.obstacles.iter().zip(&model.solids).enumerate();
        let rock = |(index, (obstacle, solid)): (usize, (&Obstacle, &Solid))| {
            let density = obstacle.density?;
            Some(Self { index, mass: density * solid.volume, inertia: solid.inertia * density })
        };
        obstacles.filter_map(rock).collect()
    }

    /// Gives `object` the velocities after a step of `dt` [s] under weight and sand alone.
    pub fn fall(
        &self,
        solid: &Solid,
        ground: &SandBed<f64>,
        gravity: V,
        dt: f64,
        object: &mut ObjectState,
    ) -> RockInSand {
        let pose = RigidPose::new(object.position, object.orientation);
        let (velocity, omega) = (V::from(object.velocity), V::from(object.angular_velocity));
        let inertia = pose.rotation * self.inertia * pose.rotation.transpose();
        let mut force = gravity * self.mass;
        let mut moment = -omega.cross(&(inertia * omega));
        let mut matrix = Matrix6::zeros();
        matrix.fixed_view_mut::<3, 3>(0, 0).fill_diagonal(self.mass);
        matrix.fixed_view_mut::<3, 3>(3, 3).copy_from(&inertia);
        let mut masses = Masses::body(self.mass, V::zeros(), self.inertia);
        let mut sunk = false;
        for facet in &solid.facets {
            let arm = pose.rotation * facet.center;
            let depth = -(pose.position.z + arm.z);
            if depth <= 0.0 {
                continue;
            }
            let normal = pose.rotation * facet.normal;
            let site = SegmentState::fresh(depth, pose.position.x + arm.x);
            let contact = ground.one_sided(&site, facet.area, lanes(normal), lanes(velocity + omega.cross(&arm)));
            let push = V::new(contact.force.x, contact.force.y, contact.force.z);
            force += push;
            moment += arm.cross(&push);
            let resist = (M::identity() * contact.drag + normal * normal.transpose() * contact.edge) * dt;
            let cross = arm.cross_matrix();
            let turned = resist * cross;
            let mut add = |i, j, block: M| {
                let mut view = matrix.fixed_view_mut::<3, 3>(i, j);
                view += block;
            };
            add(0, 0, resist);
            add(0, 3, -turned);
            add(3, 0, -turned.transpose());
            add(3, 3, cross.transpose() * turned);
            masses.add(resist.trace() / 3.0, facet.center);
            sunk = true;
        }
        let mut pull = Vector6::zeros();
        pull.fixed_rows_mut::<3>(0).copy_from(&(force * dt));
        pull.fixed_rows_mut::<3>(3).copy_from(&(moment * dt));
        // The matrix is a positive definite one plus semidefinite ones.
        let gained = matrix.cholesky().map_or(Vector6::repeat(f64::NAN), |c| c.solve(&pull));
        object.velocity = (velocity + gained.fixed_rows::<3>(0)).into();
        object.angular_velocity = (omega + gained.fixed_rows::<3>(3)).into();
        let arm = if sunk { pose.rotation * masses.center() } else { V::zeros() };
        RockInSand { pose, properties: masses.properties(), arm }
    }
}

impl RockInSand {
    /// Velocity of the centre of mass of rock and sand together, and angular velocity, rounded to rapier's precision.
    fn held(&self, object: &ObjectState) -> [V; 2] {
        let omega = V::from(object.angular_velocity);
        [V::from(object.velocity) + omega.cross(&self.arm), omega].map(|v| v.map(|c| f64::from(c as f32)))
    }

    /// Puts the rock into `world`.
    pub fn enter(&self, world: &mut World, rock: usize, object: &ObjectState) {
        let [velocity, omega] = self.held(object);
        world.place_rock(rock, &self.pose, self.properties, velocity, omega);
    }

    /// Adds the changes of velocity by contacts in `world` to `object`.
    pub fn leave(&self, world: &World, rock: usize, object: &mut ObjectState) {
        let held = self.held(object);
        let [velocity, omega] = world.rock_velocity(rock);
        let [velocity, omega] = [velocity - held[0], omega - held[1]];
        object.velocity = (V::from(object.velocity) + velocity - omega.cross(&self.arm)).into();
        object.angular_velocity = (V::from(object.angular_velocity) + omega).into();
    }
}
