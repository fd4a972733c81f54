//! The robot and the obstacles as rapier's colliders, and how contacts are solved.
//!
//! Colliders carry no mass: we compute masses (`inertia`, `rocks`). Each body has one collider in its own frame, so
//! that rapier adds nothing to its mass properties.

use super::units::{PER_METRE, quat, scaled};
use crate::Model;
use crate::frame::V;
use crate::model::LinkBody;
use crate::obstacle::{Obstacle, ObstacleShape};
use crate::solid::Solid;
use rapier3d::glamx::{Pose3, Quat};
use rapier3d::prelude::*;

/// Thickness of a leg's strip over its width: 2 mm on the reference robot. Our choice, because the paper does not say.
const THICKNESS: f64 = 0.2;

/// Sweeps of the projected Gauss-Seidel method over contacts and motors together, in worlds with obstacles: our choice,
/// because 16 sweeps take no measurably longer than 8; the dynamics take far longer than either.
const SWEEPS: usize = 16;

/// Contacts are springs with this frequency [Hz] and damping ratio between the touching bodies' masses. Our choice:
/// a third of an overlap closes in a step of 0.5 ms; `examples/rocks_study.rs` measures the remaining overlaps.
const SOFTNESS: SpringCoefficients<f32> = SpringCoefficients { natural_frequency: 1000.0, damping_ratio: 3.0 };

/// Upper bound of speeds [m/s]: our choice, eight times the speed of a leg's tip at 5 Hz. Contacts are found before a
/// step if the bodies would meet within the step at this speed.
const TOP_SPEED: f32 = 10.0;

/// Largest speed at which a penetration is pushed out [m/s]: our choice, below that of a leg's tip at 5 Hz (1.3 m/s).
const PUSH_OUT: f32 = 1.0;

const ROBOT: Group = Group::GROUP_1;
const FIXED: Group = Group::GROUP_2;
const LOOSE: Group = Group::GROUP_3;

/// Shapes of a model, made once and shared by all worlds of that model.
pub struct Shapes {
    base: SharedShape,
    links: Vec<SharedShape>,
    obstacles: Vec<SharedShape>,
}

impl Shapes {
    /// None if the model has no obstacles.
    pub fn new(model: &Model) -> Option<Self> {
        let obstacles = &model.scene.obstacles;
        if obstacles.is_empty() {
            return None;
        }
        Some(Self {
            base: base(model),
            links: model.legs.iter().flatten().map(link).collect(),
            obstacles: obstacles.iter().zip(&model.solids).map(|(o, s)| obstacle(o, s)).collect(),
        })
    }

    /// The base, then the links: one collider each.
    pub fn robot(&self) -> impl Iterator<Item = ColliderBuilder> {
        [&self.base].into_iter().chain(&self.links).map(|shape| collider(shape, ROBOT, FIXED | LOOSE, 0.0))
    }

    /// The colliders of the obstacles, in the order of the scene.
    pub fn obstacles<'a>(&'a self, model: &'a Model) -> impl Iterator<Item = (&'a Obstacle, ColliderBuilder)> {
        self.obstacles.iter().zip(&model.scene.obstacles).map(|(shape, obstacle)| {
            let (own, others) = if obstacle.moves() { (LOOSE, ROBOT | FIXED | LOOSE) } else { (FIXED, ROBOT | LOOSE) };
            (obstacle, collider(shape, own, others, obstacle.friction))
        })
    }
}

fn collider(shape: &SharedShape, own: Group, others: Group, friction: f64) -> ColliderBuilder {
    ColliderBuilder::new(shape.clone())
        .mass_properties(MassProperties::default())
        .collision_groups(InteractionGroups::new(own, others, InteractionTestMode::And))
        .friction(friction as f32)
        .friction_combine_rule(CoefficientCombineRule::Max)
}

/// The base's box, cut off at the belly if the belly is higher than the box's bottom, so that rock and sand touch the
/// same surface.
fn base(model: &Model) -> SharedShape {
    let [length, width, height] = model.robot.base.size;
    let bottom = model.robot.belly.as_ref().map_or(-height / 2.0, |b| -b.below.min(height / 2.0));
    let size = V::new(length, width, height / 2.0 - bottom);
    let middle = V::new(0.0, 0.0, height / 4.0 + bottom / 2.0);
    SharedShape::compound(vec![(Pose3::from_parts(scaled(middle), Quat::IDENTITY), cuboid(size))])
}

/// A link's strip as a chain of thin boxes.
fn link(body: &LinkBody) -> SharedShape {
    let piece = |p: &crate::model::StripPiece| {
        let axes = [p.along, p.across, p.along.cross(&p.across)];
        let turn = nalgebra::Rotation3::from_matrix_unchecked(nalgebra::Matrix3::from_columns(&axes));
        let pose = Pose3::from_parts(scaled(p.center), quat(&nalgebra::UnitQuaternion::from_rotation_matrix(&turn)));
        (pose, cuboid(V::new(p.size[0], p.size[1], THICKNESS * p.size[1])))
    };
    SharedShape::compound(body.pieces.iter().map(piece).collect())
}

fn cuboid(size: V) -> SharedShape {
    let half = scaled(size / 2.0);
    SharedShape::cuboid(half.x, half.y, half.z)
}

fn obstacle(obstacle: &Obstacle, solid: &Solid) -> SharedShape {
    match &obstacle.shape {
        ObstacleShape::Sphere { radius } => SharedShape::ball((radius * PER_METRE) as f32),
        ObstacleShape::Box { size } => cuboid(V::from(*size)),
        ObstacleShape::Hull { .. } => {
            let corners: Vec<_> = solid.corners.iter().map(|c| scaled(*c)).collect();
            // The points are a hull's corners; the bounding box replaces the hull if `f32` rounding makes it fail.
            let reach = (solid.reach() * PER_METRE) as f32;
            SharedShape::convex_hull(&corners).unwrap_or_else(|| SharedShape::cuboid(reach, reach, reach))
        }
    }
}

/// Sets how a world with obstacles solves its contacts.
pub fn tune(parameters: &mut IntegrationParameters) {
    parameters.num_internal_pgs_iterations = SWEEPS;
    // The "normalized" lengths below are in metres; 2e-3 is our choice, a tenth of the default distance.
    parameters.length_unit = PER_METRE as f32;
    // We integrate the positions, so the velocities that we read must include the velocities with which rapier pushes a penetration out.
    parameters.num_internal_stabilization_iterations = 0;
    parameters.contact_softness = SOFTNESS;
    parameters.static_contact_softness = SOFTNESS;
    parameters.normalized_max_corrective_velocity = PUSH_OUT;
    parameters.normalized_prediction_distance = (TOP_SPEED * parameters.dt).max(2e-3);
    // By default rapier keeps old contact points until a pair of bodies has moved by 5 cm, a third of the robot.
    parameters.contact_recycling = false;
    parameters.friction_model = FrictionModel::Coulomb;
}
