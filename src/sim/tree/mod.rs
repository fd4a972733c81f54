//! Any legged robot: a tree of rigid bodies with a floating base. Crate `robots` reads URDF, MJCF and TOML into it;
//! engine `tree` simulates it.
//!
//! Each body has a frame at its joint. `origin` is the pose of that frame in the parent's frame when the joint's
//! position is 0. The base's frame is the one in the file (URDF: the root link's, MJCF: the free body's).
//!
//! * [`model`]: a tree as an engine needs it: motors, plates, points of contact; [`hard`]: hard ground as a user
//!   describes it.
//! * [`engine`]: lanes of such robots; [`step`]: one time step.
//! * [`dynamics`]: accelerations of a tree, for any number type; [`flight`]: accelerations in free flight, for checks.
//! * [`servo`]: motors, bearings and stops; [`sand`]: sand on plates; [`floor`]: hard ground under points; [`forces`]:
//!   forces of sand and hard ground at one moment, for pictures.
//! * [`contact`]: the points of contact; [`terrain`]: the ground's surface near a point; [`relief`]: a surface that is
//!   not flat; [`heights`]: the heights of a file as one text.
//! * [`kinematics`]: frames of bodies and their lowest points; [`joint_values`]: values for joints by patterns of their
//!   names; [`limbs`]: legs, arms and tails, and how each moves; [`stance`]: the standing pose; [`gains`]: servo gains;
//!   [`standing`]: does the robot stand?
//! * [`gear`]: joints that follow others; [`stability`]: the joint whose motion cannot be computed.
//! * [`symmetry`]: left and right; [`looks`]: shapes for pictures; [`packed`]: a robot as one text.
//! * [`plates`]: cuts collision shapes into the plates that push on sand; [`cluster`]: replaces many plates by few;
//!   [`patches`]: gathers plates with nearly the same normal; [`eights`]: eight patches in lanes; [`robot`]: our own
//!   robots as trees.

mod cluster;
pub mod contact;
pub mod dynamics;
pub mod eights;
pub mod engine;
pub mod flight;
pub mod floor;
pub mod forces;
mod free_joints;
pub mod gains;
mod gear;
pub mod hard;
pub mod heights;
pub mod joint_values;
pub mod kinematics;
mod leading;
pub mod limbs;
pub mod looks;
pub mod model;
pub mod packed;
pub mod patches;
pub mod plain_gait;
pub mod plates;
mod reach;
pub mod relief;
mod robot;
pub mod sand;
mod self_contact;
mod servo;
pub mod stability;
pub mod stance;
pub mod standing;
mod step;
pub mod symmetry;
pub mod terrain;

pub use engine::engine;
pub use hard::HardGround;
pub use model::TreeModel;
pub use plates::{MOST_PLATES, PLATE_SIZES, of_body, of_shapes, of_touching};
pub use robot::of_robot;

use crate::actuator::Actuator;
use crate::sand::GRAVITY;
use nalgebra::{Isometry3, Matrix3, Unit, Vector3};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Least cosine of the angle between a vertical axis and z: our choice, 30°.
const VERTICAL: f64 = 0.87;

/// A robot. Bodies are in depth-first order: each comes after its parent, and the bodies of a branch are contiguous.
#[derive(Clone, Debug, PartialEq)]
pub struct Tree {
    pub name: String,
    /// The bodies. The first one is the base, which has no parent and no joint.
    pub bodies: Vec<TreeBody>,
    /// Gravity where the robot walks [m/s²]; None: standard gravity, the Earth's.
    pub gravity: Option<f64>,
}

/// The part of a body's mass whose weight is held from outside (MJCF's `gravcomp`).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct HeldMass {
    /// [kg]
    pub mass: f64,
    /// Mass times position in the body's frame [kg·m].
    pub moment: Vector3<f64>,
}

/// A rigid body and the joint that carries it.
#[derive(Clone, Debug, PartialEq)]
pub struct TreeBody {
    pub name: String,
    /// Index of the parent, less than the body's own; 0 for the base itself.
    pub parent: usize,
    /// The body's frame in the parent's when the joint is at 0 [m].
    pub origin: Isometry3<f64>,
    /// The joint to the parent. Only the base has none, because fixed joints are merged when a file is read.
    pub joint: Option<TreeJoint>,
    /// [kg]
    pub mass: f64,
    /// Centre of mass in the body's frame [m].
    pub center: Vector3<f64>,
    /// About the centre of mass, along the body's axes [kg·m²].
    pub inertia: Matrix3<f64>,
    /// The part of `mass` that has no weight.
    pub held: HeldMass,
    /// Shapes that may touch ground or sand.
    pub shapes: Vec<TreeShape>,
}

/// One degree of freedom.
#[derive(Clone, Debug, PartialEq)]
pub struct TreeJoint {
    pub name: String,
    pub kind: JointKind,
    /// Axis in the body's frame (the same in the parent's `origin` frame).
    pub axis: Unit<Vector3<f64>>,
    /// Lowest and highest position [rad or m]; None: it turns freely.
    pub range: Option<[f64; 2]>,
    /// Viscous damping [N·m·s/rad or N·s/m].
    pub damping: f64,
    /// Dry friction [N·m or N].
    pub friction: f64,
    /// Stiffness [N·m/rad or N/m] of a spring, and the position at which it is relaxed [rad or m].
    pub spring: Option<[f64; 2]>,
    /// The joint that this one follows (URDF `mimic`, MJCF `equality/joint`).
    pub mimic: Option<Mimic>,
    /// Inertia of the rotor, multiplied by the gear, at the joint [kg·m² or kg].
    pub armature: f64,
    /// Largest torque of the motor [N·m or N]; None: no known limit.
    pub torque_limit: Option<f64>,
    /// Largest speed of the motor [rad/s or m/s]; None: no known limit.
    pub speed_limit: Option<f64>,
    /// Further properties of the motor and its gear from the file; the torque limit is in `torque_limit`.
    pub motor: Actuator,
    /// Position gain of the servo [N·m/rad], if the file has one.
    pub kp: Option<f64>,
    /// Speed gain of the servo [N·m·s/rad], if the file has one.
    pub kd: Option<f64>,
    /// Position in the standing pose [rad or m], if the file has it (MJCF: in keyframe `home`, or else in the first
    /// keyframe).
    pub rest: Option<f64>,
    /// Time in which the servo's reference follows its target, as a first-order lag [s]; None: at once.
    pub target_time: Option<f64>,
}

/// A joint's position is `ratio` times the position of joint `leader`, plus `offset` [rad or m]. A stiff servo holds the joint at this position.
#[derive(Clone, Debug, PartialEq)]
pub struct Mimic {
    pub leader: String,
    pub ratio: f64,
    pub offset: f64,
}

/// A [`Mimic`] with indices of joints in place of names.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Follower {
    pub joint: usize,
    pub leader: usize,
    pub ratio: f64,
    pub offset: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JointKind {
    Hinge,
    Slide,
}

/// A collision shape, fixed to a body.
#[derive(Clone, Debug, PartialEq)]
pub struct TreeShape {
    pub name: String,
    /// The shape's frame in the body's [m].
    pub origin: Isometry3<f64>,
    pub geometry: Geometry,
    /// Coulomb friction against hard ground.
    pub friction: f64,
}

/// Triangles, counterclockwise seen from outside.
pub type Triangles = Arc<Vec<[Vector3<f64>; 3]>>;

/// Sizes in metres; cylinders and capsules lie along their own z. A mesh is its triangles, or the index of a mesh.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Geometry<M = Triangles> {
    Sphere { radius: f64 },
    Capsule { radius: f64, half_length: f64 },
    Cylinder { radius: f64, half_length: f64 },
    Box { half: Vector3<f64> },
    Mesh(M),
}

impl<M> Geometry<M> {
    /// The same shape; a mesh is replaced by what `mesh` makes of it.
    pub fn with_mesh<N>(&self, mesh: impl FnOnce(&M) -> N) -> Geometry<N> {
        match *self {
            Self::Sphere { radius } => Geometry::Sphere { radius },
            Self::Capsule { radius, half_length } => Geometry::Capsule { radius, half_length },
            Self::Cylinder { radius, half_length } => Geometry::Cylinder { radius, half_length },
            Self::Box { half } => Geometry::Box { half },
            Self::Mesh(ref triangles) => Geometry::Mesh(mesh(triangles)),
        }
    }
}

impl Tree {
    /// Joints in the order of the bodies that they carry.
    pub fn joints(&self) -> impl Iterator<Item = &TreeJoint> {
        self.bodies.iter().filter_map(|b| b.joint.as_ref())
    }

    /// The joints that follow others, without joints whose leader does not exist; readers of files refuse these.
    pub fn followers(&self) -> Vec<Follower> {
        let place = |name: &str| self.joints().position(|j| j.name == name);
        let follower = |(joint, own): (usize, &TreeJoint)| {
            let mimic = own.mimic.as_ref()?;
            Some(Follower { joint, leader: place(&mimic.leader)?, ratio: mimic.ratio, offset: mimic.offset })
        };
        self.joints().enumerate().filter_map(follower).collect()
    }

    /// [kg]
    pub fn mass(&self) -> f64 {
        self.bodies.iter().map(|b| b.mass).sum()
    }

    /// Gravity [m/s²].
    pub fn gravity(&self) -> f64 {
        self.gravity.unwrap_or(GRAVITY)
    }

    /// The part of the mass that has no weight [kg].
    pub fn held_mass(&self) -> f64 {
        self.bodies.iter().map(|b| b.held.mass).sum()
    }

    /// The centre of mass [m], with bodies at `frames`.
    pub fn center_of_mass(&self, frames: &[Isometry3<f64>]) -> Vector3<f64> {
        let moments = frames.iter().zip(&self.bodies).map(|(frame, body)| body.moment(frame));
        moments.sum::<Vector3<f64>>() / self.mass()
    }
}

impl TreeBody {
    /// Mass times the position of its centre [kg·m], with the body at `frame`.
    pub fn moment(&self, frame: &Isometry3<f64>) -> Vector3<f64> {
        frame.transform_point(&self.center.into()).coords * self.mass
    }

    /// Kind and axis of its joint, with the body at `frame`; None for the base.
    pub fn axis(&self, frame: &Isometry3<f64>) -> Option<(JointKind, Vector3<f64>)> {
        self.joint.as_ref().map(|j| (j.kind, frame.rotation * j.axis.into_inner()))
    }

    /// Axis of its joint if the joint is a hinge, with the body at `frame`; else None.
    pub fn hinge_axis(&self, frame: &Isometry3<f64>) -> Option<Vector3<f64>> {
        self.axis(frame).filter(|(kind, _)| *kind == JointKind::Hinge).map(|(_, axis)| axis)
    }

    /// Is its joint a hinge about a vertical axis, with the body at `frame`?
    pub fn turns_about_vertical(&self, frame: &Isometry3<f64>) -> bool {
        self.hinge_axis(frame).is_some_and(|axis| axis.z.abs() > VERTICAL)
    }
}
