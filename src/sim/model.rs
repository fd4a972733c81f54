//! Robot, sand and options as numbers for an engine. Immutable; randomization makes a new model.
//!
//! The world's frame is the surface's frame: x runs uphill along the surface, z along its normal, sand is at z < 0. A slope only
//! tilts gravity, so engines need no code for slopes.

use super::actuator::Actuator;
use super::links::{belly, leg};
use super::motor::Motor;
use super::obstacle::{self, Obstacle};
use super::robot::{Robot, Tripod};
use super::solid::Solid;
use super::state::{ObjectState, State};
use super::tree::{HardGround, TreeModel};
use crate::error::{Error, Result};
use crate::number::Real;
use crate::sand::memory::Moved;
use crate::sand::{Medium, SandBed};
use std::borrow::Cow;
use std::sync::Arc;

pub use super::links::{LinkBody, StripPiece};
pub use super::scene::Scene;
pub use super::solid::Plate;
pub use crate::sand::GRAVITY;

type V = nalgebra::Vector3<f64>;
type M = nalgebra::Matrix3<f64>;

/// All data that an engine needs and does not change.
#[derive(Clone, Debug, PartialEq)]
pub struct Model {
    pub robot: Robot,
    pub scene: Scene,
    /// Base with payload [kg].
    pub base_mass: f64,
    /// Principal inertia of the base about its centre [kg·m²].
    pub base_inertia: V,
    /// One-sided plates under the base.
    pub belly: Vec<Plate>,
    /// One chain of bodies for each hip, from the hip outward; all chains have the same length.
    pub legs: Vec<Vec<LinkBody>>,
    pub motor: Motor,
    /// Gravity in the surface's frame [m/s²].
    pub gravity: V,
    /// Geometry of the scene's obstacles.
    pub solids: Vec<Solid>,
    /// A robot that is a tree of bodies. `legs` is then empty, and only the name in `robot` is used.
    pub tree: Option<Arc<TreeModel>>,
}

impl Model {
    /// The bounds of robot and scene are checked here, so what can be made can also be saved and restored.
    pub fn new(robot: &Robot, scene: &Scene) -> Result<Self> {
        robot.validate()?;
        scene.validate()?;
        if !scene.hard.is_empty() {
            return Err(Error::invalid(
                "hard",
                format!("{:?} takes no hard ground; robots from URDF or MJCF files do", robot.name),
            ));
        }
        let size = V::from(robot.base.size).map(|s| s * s);
        let box_inertia = V::new(size.y + size.z, size.x + size.z, size.x + size.y) / 12.0;
        let legs = robot.hip.iter().map(|hip| leg(robot, hip.position, hip.yaw_deg.to_radians()));
        Ok(Self {
            base_mass: robot.base.mass + scene.payload,
            base_inertia: box_inertia * robot.base.mass,
            belly: belly(robot),
            legs: legs.collect::<Result<_>>()?,
            motor: Motor::new(&robot.servo, &scene.mechanisms),
            gravity: gravity(scene, GRAVITY),
            solids: solids(&scene.obstacles)?,
            robot: robot.clone(),
            scene: scene.clone(),
            tree: None,
        })
    }

    /// A model of a tree robot; a payload lies at its base's centre of mass.
    pub fn of_tree(tree: TreeModel, scene: &Scene) -> Result<Self> {
        scene.validate()?;
        if !scene.obstacles.is_empty() {
            return Err(Error::invalid("obstacles", "engine tree does not support obstacles; use hard ground instead"));
        }
        if scene.hard.len() > HardGround::MOST {
            let reason = format!("{} pieces are more than {}", scene.hard.len(), HardGround::MOST);
            return Err(Error::invalid("hard", reason));
        }
        scene.hard.iter().try_for_each(HardGround::validate)?;
        check_gravity(&tree, scene)?;
        if let Some(relief) = scene.relief.as_ref().filter(|_| !scene.hard.iter().any(HardGround::is_everything)) {
            relief.check_repose()?;
        }
        let tree =
            tree.with_payload(scene.payload).with_weak_motors(scene.mechanisms.motor_torque_limit).for_law(scene.law);
        let robot = Robot::bare(&tree.tree.name, tree.base_mass);
        Ok(Self {
            base_mass: tree.base_mass,
            base_inertia: tree.tree.bodies[0].inertia.diagonal(),
            belly: Vec::new(),
            legs: Vec::new(),
            motor: Motor::new(&robot.servo, &scene.mechanisms),
            gravity: gravity(scene, tree.tree.gravity()),
            solids: Vec::new(),
            robot,
            scene: scene.clone(),
            tree: Some(Arc::new(tree)),
        })
    }

    /// Gravity [m/s²].
    pub fn gravity_size(&self) -> f64 {
        self.tree.as_ref().map_or(GRAVITY, |tree| tree.tree.gravity())
    }

    /// The robot's weight [N], without what its file holds from outside.
    pub fn weight(&self) -> f64 {
        let held = self.tree.as_ref().map_or(0.0, |tree| tree.tree.held_mass());
        (self.total_mass() - held) * self.gravity_size()
    }

    /// The sand under the robot's gravity. The stress on a slow body is that of the weight of grains above and around it,
    /// so it grows in proportion to gravity (Slonaker et al., Phys. Rev. E 95 (2017) 052901).
    pub fn sand(&self) -> Cow<'_, Medium> {
        let medium = &self.scene.medium;
        match self.tree.as_ref().and_then(|tree| tree.tree.gravity) {
            None => Cow::Borrowed(medium),
            Some(gravity) => {
                let coefficients = medium.coefficients.scaled(gravity / GRAVITY);
                Cow::Owned(Medium { coefficients, ..medium.clone() })
            }
        }
    }

    /// The sand, ready for evaluation.
    pub fn ground<R: Real>(&self) -> SandBed<R> {
        match self.sand() {
            Cow::Borrowed(_) => self.scene.ground(),
            Cow::Owned(medium) => Scene { medium, ..self.scene.clone() }.ground(),
        }
    }

    /// Does the scene have sand?
    pub fn has_sand(&self) -> bool {
        !self.scene.hard.iter().any(HardGround::is_everything)
    }

    /// Number of bodies that each have their own surface level in sand with memory: the belly and the legs, or the
    /// bodies of a tree.
    pub fn sand_bodies(&self) -> usize {
        self.tree.as_ref().map_or(1 + self.legs.len(), |tree| tree.tree.bodies.len())
    }

    /// Memory of the sand around one robot [bytes]; 0 if it has none.
    pub fn sand_bytes(&self) -> usize {
        self.scene.memory.as_ref().map_or(0, |settings| Moved::bytes(settings, self.sand_bodies()))
    }

    /// Height of the ground at a place [m].
    pub fn surface_height(&self, x: f64, y: f64) -> f64 {
        self.scene.relief.as_ref().map_or(0.0, |relief| relief.at(x, y).0)
    }

    /// Names of all joints, in the order of [`State::angles`].
    pub fn joint_names(&self) -> Vec<String> {
        match &self.tree {
            Some(tree) => tree.tree.joints().map(|j| j.name.clone()).collect(),
            None => self.robot.joint_names(),
        }
    }

    /// The same robot and sand with other obstacles.
    pub fn with_obstacles(&self, obstacles: &[Obstacle]) -> Result<Self> {
        let solids = solids(obstacles)?;
        let scene = Scene { obstacles: obstacles.to_vec(), ..self.scene.clone() };
        Ok(Self { scene, solids, ..self.clone() })
    }

    /// The obstacles that move, at rest at their initial poses.
    pub fn objects_at_rest(&self) -> Vec<ObjectState> {
        let loose = self.scene.obstacles.iter().filter(|o| o.moves());
        let at_rest = |o: &Obstacle| ObjectState {
            position: o.position,
            orientation: o.orientation,
            velocity: [0.0; 3],
            angular_velocity: [0.0; 3],
        };
        loose.map(at_rest).collect()
    }

    /// Number of joints of the whole robot.
    pub fn joints(&self) -> usize {
        self.tree.as_ref().map_or_else(|| self.legs.iter().map(Vec::len).sum(), |tree| tree.joints())
    }

    /// [kg]
    pub fn total_mass(&self) -> f64 {
        if let Some(tree) = &self.tree {
            return tree.mass();
        }
        self.base_mass + self.legs.iter().flatten().map(|b| b.mass).sum::<f64>()
    }

    /// Joint angles [rad] at the start of the alternating tripod: hips that turn freely point straight down in tripod A
    /// and straight up in tripod B; all other joints are at 0.
    pub fn tripod_angles(&self) -> Vec<f64> {
        let links = &self.robot.leg.link;
        let turns = |j: usize| j == 0 && links[j].range.is_none();
        let angle = |t: Tripod, j: usize| if t == Tripod::B && turns(j) { std::f64::consts::PI } else { 0.0 };
        self.robot.hip.iter().flat_map(|h| (0..links.len()).map(move |j| angle(h.tripod, j))).collect()
    }

    /// The same robot on other sand.
    pub fn with_medium(&self, medium: Medium) -> Self {
        Self {
            scene: Scene { memory: self.scene.memory.map(|m| m.on(&medium)), medium, ..self.scene.clone() },
            ..self.clone()
        }
    }

    /// Sets slope [°] and payload [kg]; values beyond a scene's bounds are clipped.
    pub fn set_load(&mut self, slope_deg: f64, payload: f64) {
        self.scene.slope_deg = slope_deg.clamp(-Scene::MAX_SLOPE_DEG, Scene::MAX_SLOPE_DEG);
        self.scene.payload = payload.clamp(0.0, Scene::MAX_PAYLOAD);
        self.base_mass = self.robot.base.mass + self.scene.payload;
        self.gravity = gravity(&self.scene, self.gravity_size());
    }

    /// The same model, whose motors all get the properties that are known in `motors`.
    ///
    /// # Errors
    /// A no-load speed needs a stall torque or a torque limit.
    pub fn with_motors(mut self, motors: &Actuator) -> Result<Self> {
        if *motors == Actuator::default() {
            return Ok(self);
        }
        match &mut self.tree {
            Some(tree) => {
                for motor in &mut Arc::make_mut(tree).motors {
                    motor.actuator = motors.or(&motor.actuator)?;
                }
            }
            None => {
                let servo = &mut self.robot.servo;
                servo.set_actuator(&motors.or(&servo.actuator())?);
                self.motor = Motor::new(servo, &self.scene.mechanisms);
            }
        }
        Ok(self)
    }

    /// Sets torque limit and stall torque of the motors to `share` (at most 1) times those of the servo.
    pub fn weaken_motors(&mut self, share: f64) {
        let servo = &mut self.robot.servo;
        for torque in [&mut servo.torque_limit, &mut servo.stall_torque].into_iter().flatten() {
            *torque *= share;
        }
        self.motor = Motor::new(&self.robot.servo, &self.scene.mechanisms);
    }

    /// Sets each leg's plate areas to the leg's factor in `shares` times those in `full`, a model of the same robot.
    /// The sand's force is proportional to the area.
    pub fn scale_areas(&mut self, full: &Self, shares: &[f64]) {
        for ((chain, full), share) in self.legs.iter_mut().zip(&full.legs).zip(shares) {
            for (body, full) in chain.iter_mut().zip(full) {
                let plates = body.plates.iter_mut().chain(&mut body.chord).zip(full.plates.iter().chain(&full.chord));
                plates.for_each(|(plate, full)| plate.area = full.area * share);
            }
        }
    }

    /// Position of the tip of leg number `leg` [m], in the world.
    pub fn tip(&self, state: &State, leg: usize) -> [f64; 3] {
        let rows = state.rotation();
        let mut turn = nalgebra::Rotation3::from_matrix_unchecked(M::from_fn(|i, j| rows[i][j]));
        let mut place = V::from(state.position);
        let chain = &self.legs[leg];
        for (body, angle) in chain.iter().zip(&state.angles[leg * chain.len()..]) {
            place += turn * body.joint;
            turn *= nalgebra::Rotation3::from_axis_angle(&nalgebra::Unit::new_unchecked(body.axis), *angle);
        }
        (place + turn * chain.last().map_or(V::zeros(), |body| body.reach)).into()
    }

    /// Base height at which the lowest joint or tip touches the surface with the base level and joints at `angles`.
    pub fn standing_height(&self, angles: &[f64]) -> f64 {
        let mut angles = angles.iter();
        let mut lowest = -self.robot.belly.as_ref().map_or(0.0, |b| b.below);
        for chain in &self.legs {
            let (mut point, mut turn) = (V::zeros(), nalgebra::UnitQuaternion::identity());
            for body in chain {
                point += turn * body.joint;
                let angle = angles.next().copied().unwrap_or(0.0);
                turn *= nalgebra::UnitQuaternion::from_axis_angle(&nalgebra::Unit::new_normalize(body.axis), angle);
                lowest = lowest.min((point + turn * body.reach).z);
            }
        }
        -lowest
    }
}

/// Refuses sand that was compared with grains under the Earth's gravity alone.
fn check_gravity(tree: &TreeModel, scene: &Scene) -> Result<()> {
    let Some(gravity) = tree.tree.gravity else { return Ok(()) };
    let only = |option: &str, what: &str| {
        let reason = format!("{what} is known under the Earth's gravity only, and the robot's file has {gravity} m/s²");
        Err(Error::invalid(option, reason))
    };
    match (scene.memory.is_some(), scene.medium.terms.is_empty()) {
        (true, _) => only("memory", "the memory of sand"),
        (_, false) => only("sand", "a term that was found in data"),
        _ => Ok(()),
    }
}

/// Gravity in the surface's frame [m/s²].
fn gravity(scene: &Scene, size: f64) -> V {
    let slope = scene.slope_deg.to_radians() + scene.mechanisms.slope;
    V::new(-slope.sin(), 0.0, -slope.cos()) * size
}

fn solids(obstacles: &[Obstacle]) -> Result<Vec<Solid>> {
    if obstacles.len() > obstacle::MOST {
        let reason = format!("{} are more than {}", obstacles.len(), obstacle::MOST);
        return Err(Error::invalid("obstacles", reason));
    }
    obstacles.iter().map(Obstacle::solid).collect()
}
